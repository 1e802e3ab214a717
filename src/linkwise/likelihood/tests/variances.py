"""Scores of the variance of something random, from draws of what is there without it: ambient forces, and noise of inputs.

Slopes of half the cost by what is random have a covariance under the rest of the noise. Their sum of squares has a mean and a
scatter that draws of that noise give; its excess is the score of the variance. Variances that were found from the same
residuals leave less of it: what their own scores explain of it is subtracted (the efficient score).

Ambient forces are taken to be white and independent of each other, which is tested. Laws take up what forces differ by from
white ones: behind a wind that falls off with the frequency a damper comes out three times as large, and each stiffness by tens
of its standard errors too small. The slopes of the cost by the forces have a spectrum that draws of white and independent
forces give, with states and coefficients following. In the band in which the structure moves, the spectrum of the record must
be the same multiple of it everywhere, and the forces on two masses must have no more in common than their draws. Beyond that
band forces hardly matter to the laws, and are seldom white.

Residuals of exact laws show noise of an input that nobody stated. It kicks the masses, and the structure rings where it
resonates. There are few residuals in a band so narrow, and they hardly stand out among all, but they are the ones that a
damping is judged by. The multiplier of each defect is the slope of the cost by a kick there. Under noise of sensors alone the
sum of squares of these slopes has a mean and a scatter that draws of such noise give, with states and coefficients following;
its excess is the score of the variance of the kicks.

References
----------
C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948), for score tests; X. Lin, Biometrika 84, 309 (1997), for those of variances.

E. S. Pearson, Biometrika 46, 364 (1959), for a sum of squares as a chi-square of the same three first moments.

P. Whittle, Ark. Mat. 2, 423 (1953), for the likelihood of a spectrum: its ordinates are independent and exponential.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.estimates.causes import Cause, RandomForceEstimate
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.noise import residual_levels
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.normal_equations import Linearization, chunks, linearise
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.system import MANY
from linkwise.likelihood.shooting.tangents import whitened_jacobian
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread

_APART = 0.02  # of a score that is left beside those of variances found: with less the record does not distinguish them


@dataclass(frozen=True, eq=False)
class SquareSum:
    """A sum of squares of slopes, its `total`, and the `products` (d, d) of those of draws."""

    total: float
    products: Floats

    @classmethod
    def of(cls, slopes: Floats) -> SquareSum:
        """From slopes (K, 1 + d), those of draws last."""
        return cls(float(slopes[:, 0] @ slopes[:, 0]), slopes[:, 1:].T @ slopes[:, 1:])

    def with_other(self, second: SquareSum) -> float:
        """Half the covariance of both, from products of different draws."""
        count = len(self.products)
        both = self.products * second.products
        return float(both.sum() - np.trace(both)) / (count * (count - 1))


@dataclass(frozen=True)
class VarianceScore:
    """Of a variance: its `normal` score, the standard `deviation` that follows from it, and the `error` of its square.

    Attributes
    ----------
    gain : float
        What the variance would take off -2 log likelihood.
    """

    normal: float
    deviation: float
    error: float
    gain: float

    @classmethod
    def of(cls, tested: SquareSum, estimated: Sequence[SquareSum] = ()) -> VarianceScore | None:
        """From the sums of squares of what is tested, and of what has variances that were found.

        None where kicks move nothing, or do what those found do. Products of different draws tell the traces of the square
        and the cube of the covariance of the slopes.
        """
        alone = tested.with_other(tested)
        if estimated:
            among = np.array([[a.with_other(b) for b in estimated] for a in estimated])
            beside = np.array([tested.with_other(one) for one in estimated])
            weights = np.linalg.lstsq(among, beside)[0]
            for one, weight in zip(estimated, weights.tolist(), strict=True):
                tested = SquareSum(tested.total - weight * one.total, tested.products - weight * one.products)
        products = tested.products.copy()
        count = len(products)
        excess = tested.total - float(np.trace(products)) / count
        square = tested.with_other(tested)
        np.fill_diagonal(products, 0.0)
        cube = float(np.trace(products @ products @ products)) / (count * (count - 1) * (count - 2))
        if square <= _APART * alone:
            return None
        return cls(
            normal=normal_score(excess, square, cube),
            deviation=float(np.sqrt(max(excess, 0.0) / square)),
            error=float(np.sqrt(2.0 / square)),
            gain=_gain(excess, square, cube),
        )

    def cause(self, kind: str, where: str, unit: str, scale: float = 1.0) -> Cause:
        """The cause of a kind whose size is the deviation, in a `unit` of which that of the score is so many."""
        error = 0.5 * self.error / self.deviation
        return Cause(kind, where, scale * self.deviation, unit, self.gain, scale * error)


def _gain(excess: float, square: float, cube: float) -> float:
    """What a variance takes off -2 log likelihood, the sum of squares being a chi-square of the same moments."""
    if cube <= 0.0:
        return 0.5 * excess**2 / square
    freedom = square**3 / cube**2
    ratio = max(1.0 + excess / (cube / square * freedom), np.finfo(float).tiny)
    return float(freedom * (ratio - 1.0 - np.log(ratio)))


def normal_score(excess: float, square: float, cube: float) -> float:
    """The normal score of the `excess` over its mean of a sum of squares, by traces of powers of their covariance.

    Of many slopes draws may tell a `cube` that is not positive; their sum is then normal.
    """
    if cube <= 0.0:
        return excess / float(np.sqrt(2.0 * square))
    freedom, scale = square**3 / cube**2, cube / square
    half, place = 0.5 * freedom, 0.5 * max(excess / scale + freedom, 0.0)
    below, above = float(scipy.special.gammainc(half, place)), float(scipy.special.gammaincc(half, place))
    if above > 0.0:
        chance = float(np.log1p(-below) if below < 0.5 else np.log(above))
    else:  # below the least number: the first term of the incomplete gamma function far out
        chance = (half - 1.0) * float(np.log(place)) - place - float(scipy.special.gammaln(half))
    return -float(scipy.special.ndtri_exp(chance))


SPECTRAL_KINDS = ("coloured force", "correlated forces")
"""Kinds of causes; what else a structure lacks makes forces seem so, too, and is told before them."""

UNSTEADY = "unsteady force"
"""The kind of cause of a force whose level changes with time: terms that follow the motion seem to be missing then."""

BEHIND_FILTER = ", as behind a filter against aliasing"
"""Ends the remark on a force of which accelerations show nothing near half the sampling rate."""

_BANDS = 6  # of the same width, up to the end of the motion
_FEWEST = 8  # frequencies in a band: of fewer the spectrum is too rough to be judged
_MOTION = 0.99  # of the kinetic energy lies below the frequency where the motion ends ...
_BEYOND = 1.5  # ... and dampers and stiffnesses are still told a little further
_SIGNIFICANT = 4.0  # a normal score, as one force in 30 000 gives by chance, or one pair in 15 000
_SIZEABLE = 0.1  # of the density, by root mean square, or of the correlation: less moves laws by a standard error or so
_ROLLED_OFF = 0.5  # of the mean density: less in the last band is a filter's
_FEWEST_PARTS, _MOST_PARTS = 5, 50  # of the records, in which the level of a force is compared
_FREEDOM = 16.0  # degrees of freedom of the level in a part
_UNSTEADY = 0.46  # of the square of the density, by root mean square: intervals are too narrow by a tenth


def spectral_causes(fit: LikelihoodFit, slopes: Floats) -> Iterator[Cause]:
    """Causes of what ambient forces that are not white, not independent, or not steady, leave.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit with random forces.
    slopes : array of shape (r, K, 1 + d)
        Slopes of the cost by the random forces in each segment, in their deviations; and those of d draws.

    Yields
    ------
    Cause
        Those of `SPECTRAL_KINDS`, and of the kind `UNSTEADY`, that are significant.
    """
    random = fit.optimum.segments.random
    assert random is not None
    ambient = {
        number: force
        for number, force in enumerate(fit.random_forces)
        if force.ambient and random.present[number] and force.upper_limit is None  # else it may be chance
    }
    parts, counts, highest = zip(*_bands(fit), strict=True)
    if not ambient or sum(counts) < _BANDS * _FEWEST:
        return
    spectra: dict[int, Floats] = {}
    for number, force in ambient.items():
        lines = (np.fft.rfft(slopes[number][part], axis=0) for part in parts)
        spectra[number] = np.concatenate(
            [of_part[1 : count + 1] for of_part, count in zip(lines, counts, strict=True)]
        )
        bands = np.concatenate([np.arange(count) * _BANDS // max(count, 1) for count in counts])
        yield from _coloured(
            force, spectra[number], bands, max(highest), of_accelerations=fit.optimum.segments.centred
        )
        yield from _unsteady(force, slopes[number] ** 2)
    for first, second in combinations(ambient, 2):
        yield from _correlated(ambient[first], ambient[second], spectra[first], spectra[second])


def _uneven(powers: Floats, counts: Floats) -> tuple[Floats, float] | None:
    """How powers (b, 1 + d) in parts differ from those of draws, behind the first, by other factors than a common one.

    The factors (b,), with a mean of 1, and what they take off -2 log likelihood where the parts are means of so many `counts`
    (b,) exponential variables; None where chance gives as much.
    """
    expected = powers[:, 1:].mean(axis=1)
    if not np.all(expected > 0.0):
        return None
    ratio = np.maximum(powers[:, 0] / expected, np.finfo(float).tiny)
    ratio *= counts.sum() / (counts @ ratio)
    gain, freedom = -2.0 * float(counts @ np.log(ratio)), len(ratio) - 1.0
    return (ratio, gain) if normal_score(gain - freedom, freedom, freedom) > _SIGNIFICANT else None


def _coloured(
    force: RandomForceEstimate, spectrum: Floats, bands: Indices, highest: float, *, of_accelerations: bool
) -> Iterator[Cause]:
    """A force whose `spectrum` (F, 1 + d), at lines in `bands` (F,), is no multiple of that of a white one."""
    count = np.bincount(bands, minlength=_BANDS).astype(float)
    sums = [np.bincount(bands, power, _BANDS).astype(float) for power in np.abs(spectrum.T) ** 2]
    found = None if count.min() < _FEWEST else _uneven(np.stack(sums, axis=1), count)
    if found is None:
        return
    ratio, gain = found
    size = float(np.sqrt(count @ (ratio - 1.0) ** 2 / count.sum()))
    if size > _SIZEABLE:
        remark = (
            f"its density is {ratio.min():.2g} to {ratio.max():.2g} times its mean below {highest:.3g} Hz"
        )
        if of_accelerations and ratio[-1] < _ROLLED_OFF:
            remark += BEHIND_FILTER
        error = float(1.0 / np.sqrt(count.sum()))
        yield Cause(SPECTRAL_KINDS[0], force.where, size, "1", gain, error, remark=remark)


def _correlated(
    first: RandomForceEstimate, second: RandomForceEstimate, one: Floats, other: Floats
) -> Iterator[Cause]:
    """A pair of forces whose spectra (F, 1 + d) have more in common than those of independent ones."""
    common = np.sum((one.conj() * other).real, axis=0)
    excess, scatter = common[0] - common[1:].mean(), common[1:].std()
    powers = [float(np.sum(np.abs(spectrum[:, 0]) ** 2)) for spectrum in (one, other)]
    whole = max(float(np.sqrt(powers[0] * powers[1])), np.finfo(float).tiny)
    correlation, error = float(excess / whole), float(scatter / whole)
    if abs(excess) > _SIGNIFICANT * scatter and abs(correlation) > _SIZEABLE:
        gain = -2.0 * len(one) * float(np.log1p(-min(correlation**2, 1.0 - 1e-12)))
        yield Cause(SPECTRAL_KINDS[1], first.where, correlation, "1", gain, error, source=second.where)


def _unsteady(force: RandomForceEstimate, square: Floats) -> Iterator[Cause]:
    """A force whose squared slopes (K, 1 + d) are in some parts of the records another multiple of those of a steady one.

    Intervals of laws are too narrow then by the root of 1 + size^2, as the strongest parts tell most.
    """
    drawn = _in_parts(square[:, 1:], _FEWEST_PARTS)
    scatter = max(float(np.sum(drawn.var(axis=1))), np.finfo(float).tiny)
    independent = float(_FEWEST_PARTS * np.sum(drawn.mean(axis=1) ** 2)) / scatter  # of all parts
    count = int(min(2.0 * independent / _FREEDOM, _MOST_PARTS, len(square)))
    counts: Floats = np.full(count, independent / max(count, 1))
    found = None if count < _FEWEST_PARTS else _uneven(_in_parts(square, count), counts)
    if found is None:
        return
    ratio, gain = found
    size = float(np.sqrt(max(float(np.mean((ratio - 1.0) ** 2)) - count / independent, 0.0)))
    if size > _UNSTEADY:
        low, high = np.sqrt(np.array([ratio.min(), ratio.max()]))
        remark = f"its density is {low:.2g} to {high:.2g} times its root mean square in {count} parts of the record"
        error = float(1.0 / np.sqrt(independent))
        yield Cause(UNSTEADY, force.where, size, "1", gain, error, remark=remark)


def _in_parts(values: Floats, count: int) -> Floats:
    """(count, ...) sums of values (K, ...) in parts of about equal length."""
    return np.add.reduceat(values, np.arange(count) * len(values) // count)


def _bands(fit: LikelihoodFit) -> Iterator[tuple[slice, int, float]]:
    """Of each record its segments, and how many frequencies its structure moves at, with the highest in Hz."""
    segments, point = fit.optimum.segments, fit.optimum.point
    n, masses = len(segments.system.incidence), segments.system.at(point.theta).masses
    ends = np.flatnonzero(~segments.linked) + 1
    for start, stop in pairwise([0, *ends.tolist(), segments.count]):
        velocities = np.fft.rfft(point.nodes[n : 2 * n, start:stop], axis=1)
        energy = np.cumsum(masses @ np.abs(velocities) ** 2)
        end, whole = int(np.searchsorted(energy, _MOTION * energy[-1])), len(energy) - 1
        # accelerations show the forces themselves, and tell their level by all frequencies
        count = whole if segments.centred else min(int(_BEYOND * end), whole)
        step = float(segments.step[start] * segments.refine * len(segments.samples))
        yield slice(start, stop), count, count / ((stop - start) * step)


# of noise of sensors, whose products give the moments of a sum of squares: 2016 pairs, 41664 triples
DRAWS = 64
SEED = 20200
RELAXED = 1e-3  # relaxation: multipliers of smaller defects are lost to rounding
# relaxation at which laws hold: with a larger one kicks are forgotten within a long record, and move coefficients too little
_HELD = 1e-5
SIGNIFICANT = 3.3  # a normal score, as one input in 2000 gives by chance
_HINT = 2.0  # a normal score beyond which intervals hold the noise that residuals hint at: one input in 44 by chance
# segments from which so few of the draws are followed at once, which takes a quarter of the memory
_MANY, _FEW = (20_000, 16)
_ENOUGH = 60_000  # segments in which such noise is looked for
_AT_ONCE = 4_000_000  # numbers in the steps of the states, or the noise of sensors, of one part of the draws
LARGEST = 0.2  # of the input, by root mean square; more is no noise of a channel


@dataclass(frozen=True, eq=False)
class InputNoise:
    """What residuals say of the noise of a `channel` of an input, whose root mean square is `rms`.

    Attributes
    ----------
    pattern : array of shape (K - 1, n)
        Kicks in m/s that noise of size one gives the masses at the nodes.
    score : VarianceScore
        That of its variance.
    """

    channel: str
    rms: float
    pattern: Floats
    score: VarianceScore
    unit: str

    @property
    def cause(self) -> Cause | None:
        """The noise as a cause of the residuals, where it is significant and small enough to be noise."""
        score = self.score
        if score.normal < SIGNIFICANT or score.deviation > LARGEST * self.rms:
            return None
        return score.cause("input noise", self.channel, self.unit)


def noise_of_inputs(
    fit: LikelihoodFit, identified: Structure, channels: Sequence[str]
) -> tuple[InputNoise, ...]:
    """What the residuals of exact laws say of the noise of each input among `channels`; nothing for other fits."""
    optimum = fit.optimum
    exact = fit.model_error == 0.0 and not fit.random_forces and isinstance(optimum.loss, Gaussian)
    if not exact or identified.hosts or identified.size >= MANY:
        return ()
    inputs = list(input_kicks(optimum, identified, channels))
    if not inputs:
        return ()
    try:
        with one_blas_thread():
            equations = DrawnEquations.of(fit, _beginning(optimum), RELAXED)
            multipliers = None if equations is None else _multipliers(equations)
    except np.linalg.LinAlgError:
        return ()
    if multipliers is None:
        return ()
    estimates = []
    for channel, rms, pattern in inputs:
        slopes = np.einsum("kn,knr->kr", pattern[: len(multipliers)], multipliers)
        score = VarianceScore.of(SquareSum.of(slopes))
        if score is not None:
            estimates.append(InputNoise(channel, rms, pattern, score, unit_in(identified, channel)))
    return tuple(estimates)


def for_noise_of_inputs(
    fit: LikelihoodFit, input_noises: Sequence[InputNoise], levels: Mapping[str, float]
) -> tuple[str, Floats] | None:
    """What noise of inputs adds to the covariance (p, p) of the parameters, with what was allowed for in words.

    Its standard deviations are those `levels` by channel that the records state or show. Where they show none, and residuals
    hint at such noise, its variance is taken as one standard error above the value from the score. None for no such noise.
    """
    variances = {}
    for noise in input_noises:
        score = noise.score
        if noise.channel in levels:
            variances[noise.channel] = levels[noise.channel] ** 2
        elif score.normal > _HINT and score.deviation < LARGEST * noise.rms:
            variances[noise.channel] = score.deviation**2 + score.error
    named = [noise for noise in input_noises if noise.channel in variances]
    if not named:
        return None
    kicks = np.stack([np.sqrt(variances[noise.channel]) * noise.pattern for noise in named])
    optimum, p = fit.optimum, len(fit.values)
    with one_blas_thread():
        equations = DrawnEquations.of(fit, optimum, _HELD)
        if equations is None:
            return None
        # parameters move by a kick as much as a unit slope by them adds to the slope by the kick
        unit = np.eye(len(equations.free))[:, :p]
        nodes = np.zeros((optimum.segments.count, optimum.segments.system.dimension, p))
        slopes = equations.by_kicks(*equations.solved(nodes, unit))
    moved = np.einsum("rkn,knp->rkp", kicks, slopes) * optimum.scales.theta[:p]
    words = " and ".join(
        f"noise of {noise.channel} of {np.sqrt(variances[noise.channel]):.3g} {noise.unit}" for noise in named
    )
    return words, np.einsum("rkp,rkq->pq", moved, moved)


def _beginning(optimum: Optimum) -> Optimum:
    """The optimum in the beginning of a long record, whose residuals tell the noise of inputs well enough."""
    if optimum.segments.count <= _ENOUGH or optimum.misfit.clipped is not None:
        return optimum
    segments = optimum.segments.chosen(np.arange(_ENOUGH))
    return replace(optimum, misfit=optimum.misfit.part(slice(0, _ENOUGH), segments))


def free_of_bounds(fit: LikelihoodFit) -> Bools:
    """(P,) whether an unknown of the border is not at a bound."""
    free = np.ones(fit.optimum.segments.parameters, dtype=bool)
    free[: len(fit.free)] = fit.free
    return free


def input_kicks(
    optimum: Optimum, identified: Structure, channels: Sequence[str]
) -> Iterator[tuple[str, float, Floats]]:
    """Each input with its root mean square, and the kick (K - 1, n) in m/s that its noise of size one gives at the nodes."""
    segments, inputs = optimum.segments, optimum.segments.inputs
    mechanics, misfit = segments.system.at(optimum.point.theta), optimum.misfit
    length = (segments.step * segments.refine * np.sqrt(len(segments.samples)))[:-1, None]
    if inputs.frame is not None and f"a:{BASE}" in channels:
        size = float(np.sqrt(np.mean(inputs.frame[:, 0] ** 2)))
        yield f"a:{BASE}", size, length * np.ones(identified.size)
    if inputs.base is not None:
        d, v = misfit.trajectories.links[0]
        slopes = mechanics.partials(d, v, misfit.trajectories.memory[0])
        pulls = mechanics.gain @ (segments.system.base[:, None] * slopes.by_d)
        yield f"x:{BASE}", float(np.sqrt(np.mean(inputs.base[:, 0, 0] ** 2))), length * pulls.T[:-1]
    for number, name in enumerate(identified.signals, start=len(segments.system.states)):
        (d, v), inside = misfit.trajectories.links[0], misfit.trajectories.memory[0]
        pulls = mechanics.gain @ mechanics.by_signal(number, d, v, inside)
        size = float(np.sqrt(np.mean(inputs.signals[name][:, 0] ** 2)))
        yield f"signal:{name}", size, length * pulls.T[:-1]
    for number, name in enumerate(identified.mass_names):
        if f"force:{name}" not in channels or inputs.force is None:
            continue
        applied = inputs.applied(mechanics, slice(None))[:, 0, number]
        noisy = np.sqrt(np.mean(inputs.acts(number)[:: segments.refine], axis=0))[:-1, None]
        if inputs.frame is not None:
            applied = applied + mechanics.masses[number] * inputs.frame[:, 0]
        pattern = np.eye(identified.size)[number] / mechanics.masses[number]
        yield f"force:{name}", float(np.sqrt(np.mean(applied**2))), length * noisy * pattern


@dataclass(frozen=True, eq=False)
class DrawnEquations:
    """The linearised equations at an optimum and a relaxation, for right-hand sides of noise; unknowns follow where `free`."""

    optimum: Optimum
    linear: Linearization
    factor: BorderedFactor
    free: Bools
    q: float

    @classmethod
    def of(
        cls, fit: LikelihoodFit, optimum: Optimum, q: float, linear: Linearization | None = None
    ) -> DrawnEquations | None:
        """Those of a fit, in all of its segments, their beginning or longer ones, of which the `linear` model may be known;
        None where they are singular.
        """
        if linear is None:
            linear = linearise(optimum.misfit)
        factor = linear.equations(q).factor()
        return None if factor is None else cls(optimum, linear, factor, free_of_bounds(fit), q)

    def rows(self, width: int) -> Iterator[tuple[slice, Floats]]:
        """(k, M C, m + P + 1) the residuals by nodes and border, and themselves, in parts for so many right-hand sides."""
        optimum, segments = self.optimum, self.optimum.segments
        wide = at_once(segments.count, segments.samples[..., 0].size * width)
        for part in min(chunks(segments, len(self.free)), wide, key=lambda parts: parts[0].stop):
            rows, _ = whitened_jacobian(optimum.misfit, part)
            yield part, rows.astype(float)

    def pulls(self, width: int, noise: Callable[[slice, Floats], Floats]) -> tuple[Floats, Floats]:
        """Slopes by the nodes (K, m, width) and the border (P, width) of the `noise` of residuals in parts, by their rows."""
        segments = self.optimum.segments
        m = segments.system.dimension
        nodes, border = np.zeros((segments.count, m, width)), np.zeros((len(self.free), width))
        for part, rows in self.rows(width):
            own = noise(part, rows)
            nodes[part] = rows[..., :m].transpose(0, 2, 1) @ own
            border += np.einsum("krp,krd->pd", rows[..., m:-1], own)
        return nodes, border

    def eliminated(self, nodes: Floats, border: Floats) -> tuple[Floats, Floats, Floats]:
        """Right-hand sides (K, m, d) and (P, d), the nodes eliminated, and the border (P, d) that solves them; zero where not
        `free`.
        """
        factor, free = self.factor, self.free
        forward, solved = factor.root.forward(nodes.copy()), np.zeros_like(border)
        right = border - np.tensordot(factor.forward[..., :-1], forward, ((0, 1), (0, 1)))
        right[~free] = 0.0
        if free.any():
            solved[free] = np.linalg.solve(factor.schur[np.ix_(free, free)], right[free])
        return forward, right, solved

    def solved(self, nodes: Floats, border: Floats) -> tuple[Floats, Floats]:
        """Solutions (K, m, d) and (P, d) for right-hand sides of the same shapes, zero where not `free`."""
        forward, _, solved = self.eliminated(nodes, border)
        return self.factor.root.backward(forward - self.factor.forward[..., :-1] @ solved), solved

    def by_kicks(self, nodes: Floats, border: Floats) -> Floats:
        """(K - 1, n, d) slopes of half the cost in s/m by kicks of the masses, from steps (K, m, d) and (P, d)."""
        return self.of_defects(self.defects(nodes, border))

    def defects(self, nodes: Floats, border: Floats) -> Floats:
        """(K - 1, m, d) scaled defects from steps (K, m, d) and (P, d)."""
        ends = np.einsum("kij,kjd->kid", self.linear.state_ends, nodes[:-1])
        ends += self.linear.right_ends[..., : len(border)] @ border
        return np.asarray(nodes[1:] * self.linear.joined[:, :, None] - ends)

    def of_defects(self, defects: Floats) -> Floats:
        """The same from scaled defects (K - 1, m, d)."""
        n = len(self.optimum.segments.system.incidence)
        scale = self.optimum.scales.state[n : 2 * n, None]
        return np.asarray(defects[:, n : 2 * n] / self.q**2 / scale)


def _multipliers(equations: DrawnEquations) -> Floats:
    """(K - 1, n, 1 + draws) slopes of half the cost by kicks of the masses at the nodes, in s/m.

    Those of the residuals first, then those of draws of noise of the same size.
    """
    segments = equations.optimum.segments
    multipliers = np.empty((segments.count - 1, len(segments.system.incidence), 1 + DRAWS))
    draws = DRAWS if segments.count < _MANY else _FEW
    rng = np.random.default_rng(SEED)
    for first in range(0, DRAWS, draws):
        drawn = noise_draws(equations.optimum, draws, rng)
        nodes, border = equations.pulls(1 + draws, partial(with_draws, segments, drawn))
        for columns in at_once(1 + draws, nodes[..., 0].size):
            places = np.arange(columns.start, columns.stop)
            places[places > 0] += first
            steps = equations.solved(nodes[..., columns], border[:, columns])
            multipliers[..., places] = equations.by_kicks(*steps)
    return multipliers


def with_draws(segments: Segments, drawn: Callable[[slice], Floats], part: slice, rows: Floats) -> Floats:
    """(k, M C, 1 + draws) the residuals of a part of the segments, and draws of their noise."""
    observed = segments.observed[..., part].transpose(2, 0, 1).reshape(len(rows), -1, 1)
    return np.concatenate([rows[..., -1:], observed * drawn(part)], axis=2)


def at_once(count: int, size: int) -> list[slice]:
    """Parts of `count` things of `size` numbers each, that take little memory together."""
    width = max(_AT_ONCE // max(size, 1), 1)
    return [slice(first, min(first + width, count)) for first in range(0, count, width)]


def noise_draws(optimum: Optimum, draws: int, rng: np.random.Generator) -> Callable[[slice], Floats]:
    """Draws (k, M C, draws) of the noise of sensors in k segments: as large as the residuals, or as coloured as was found."""
    segments = optimum.segments
    M, C, K = segments.samples.shape
    if optimum.coloured is None:
        sizes = residual_levels(optimum.misfit)[:, None]
        return lambda part: (sizes * rng.standard_normal((part.stop - part.start, M, C, draws))).reshape(
            part.stop - part.start, M * C, draws
        )
    whole = np.empty((K, M, C, draws), np.float32)
    for channel in range(C):
        series = optimum.coloured.drawn(rng.standard_normal((K * M, draws)), channel)
        whole[:, :, channel] = series.reshape(K, M, draws)
    return lambda part: whole[part].reshape(-1, M * C, draws).astype(float)
