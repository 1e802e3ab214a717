"""Random forces that nobody stated beside those that were, and stated ones that are too small: whether residuals show them.

Beside random forces the states are integrated out, and the multiplier of each defect is the slope of half of -2 log of the
marginal likelihood by a kick there. The excess of the sum of squares of these slopes is the score of the variance of kicks of
a mass; that of the forces found in each segment is the score of their own variance. Deviations of noise and of forces that
were found with the coefficients subtract what they explain of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause, RandomForceEstimate
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.shooting.segments import RandomStates
from linkwise.likelihood.tests.variances import (
    DRAWS,
    LARGEST,
    SEED,
    SIGNIFICANT,
    DrawnEquations,
    SquareSum,
    VarianceScore,
    at_once,
    input_kicks,
    spectral_causes,
)
from linkwise.model.structure import Structure
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread

_LARGER = 1.1  # times what was stated: with less, 95 % intervals still cover 92 %
_CERTAIN = 3.0  # standard errors of its square by which a deviation that was found is no chance
_ONE_SIDED = 1.645  # standard errors, which a normal variable exceeds in 5 % of cases


def unstated_forces(fit: LikelihoodFit, identified: Structure, channels: Sequence[str]) -> tuple[Cause, ...]:
    """Causes of what random forces leave: others that nobody stated, stated ones that are larger, and what is not white.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit; nothing is tested where it has no random forces.
    identified : Structure
        The structure with the values of the fit.
    channels : sequence of str
        The channels of the record.

    Returns
    -------
    tuple of Cause
        Those that are significant.
    """
    if not fit.random_forces:
        return ()
    sizes, kicks = _kicks(fit, identified, channels)
    stated = [number for number, force in enumerate(fit.random_forces) if not force.found]
    ambient = any(force.ambient for force in fit.random_forces)
    sums = _Sums.of(fit, kicks) if kicks or stated or ambient else None
    if sums is None:
        return ()
    beside = sums.found()
    causes = list(spectral_causes(fit, sums.slopes))
    for place, tested in sums.kicks.items():
        score = VarianceScore.of(tested, beside)
        if score is not None and score.normal > SIGNIFICANT:
            causes.append(_unstated(place, score, sizes.get(place), fit, identified))
    for number in stated:
        score = VarianceScore.of(sums.forces[number], beside)
        if score is not None and score.normal > SIGNIFICANT and np.hypot(1.0, score.deviation) > _LARGER:
            causes.append(_larger(fit.random_forces[number], score))
    return tuple(causes)


def with_limits(fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with upper limits of the random forces that were looked for and not found, or not beyond chance.

    Deviations of the former are small in its equations, and zero in what is reported.
    """
    random = fit.optimum.segments.random
    if random is None or not random.is_estimated.any():
        return fit
    with one_blas_thread():
        sums = _Sums.of(fit, {})
    if sums is None:
        return fit
    forces = list(fit.random_forces)
    for number in np.flatnonzero(random.is_estimated).tolist():
        score = VarianceScore.of(sums.forces[number], sums.found(but=number))
        is_present = bool(random.present[number])
        if score is None or (is_present and score.error < 1.0 / _CERTAIN):
            continue
        deviation = float(random.deviation[number, 0])
        variance = 1.0 if is_present else score.deviation**2
        limit = deviation * float(np.sqrt(variance + _ONE_SIDED * score.error))
        ambient = forces[number].ambient
        forces[number] = replace(forces[number], upper_limit=_density(fit) * limit if ambient else limit)
    return replace(fit, random_forces=tuple(forces))


def _kicks(
    fit: LikelihoodFit, identified: Structure, channels: Sequence[str]
) -> tuple[dict[str, float], dict[str, Floats]]:
    """Root mean squares of inputs, and the kicks (K - 1, n) in m/s that noise of each of size one gives at the nodes.

    Of inputs that nobody stated noise of, by channel, and, beside ambient forces, of masses that none was stated to act on.
    """
    optimum, stated = fit.optimum, {force.where for force in fit.random_forces}
    segments = optimum.segments
    sizes, kicks = {}, {}
    for channel, rms, pattern in input_kicks(optimum, identified, channels):
        if channel not in stated and channel.removeprefix("force:") not in stated:
            sizes[channel], kicks[channel] = rms, pattern
    if not any(force.ambient for force in fit.random_forces):
        return sizes, kicks
    masses = segments.system.at(optimum.point.theta).masses
    step = (segments.step * segments.refine)[:-1, None]
    for number, name in enumerate(identified.mass_names):
        if not {name, f"force:{name}"} & (stated | set(kicks)):
            kicks[name] = np.sqrt(step * step[0]) * np.eye(identified.size)[number] / masses[number]
    return sizes, kicks


def _unstated(
    place: str, score: VarianceScore, rms: float | None, fit: LikelihoodFit, identified: Structure
) -> Cause:
    """A random force that nobody stated: noise of the input, where its root mean square `rms` is far larger, else ambient."""
    if rms is not None and (score.deviation < LARGEST * rms or place.startswith("signal:")):
        return score.cause("input noise", place, unit_in(identified, place))
    mass = place.rpartition(":")[2]
    unit = f"{unit_in(identified, f'force:{mass}')}/sqrt(Hz)"
    return score.cause("ambient", mass, unit, _density(fit))


def _larger(force: RandomForceEstimate, score: VarianceScore) -> Cause:
    """A stated random force that is larger; its score is in units of what was stated."""
    factor = float(np.hypot(1.0, score.deviation))
    error = 0.5 * score.error / factor
    size = force.spectral_density if force.ambient else force.deviation
    return Cause(
        kind="ambient" if force.ambient else "input noise",
        where=force.where,
        size=factor * size,
        unit=f"{force.unit}/sqrt(Hz)" if force.ambient else force.unit,
        gain=score.gain,
        standard_error=error * size,
        remark=f"{size:.3g} was stated",
    )


def _density(fit: LikelihoodFit) -> float:
    """The spectral density of a deviation of one, at the rate of the first record."""
    segments = fit.optimum.segments
    return float(np.sqrt(2.0 * segments.step[0] * segments.refine))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums of squares of slopes: by `kicks` of each name, by the random `forces` in their deviations, and by `noise`.

    `slopes` (r, K, 1 + d) are those by the forces, of the record and of draws; of those with numbers in `present` a deviation
    was found, while one that is absent has none.
    """

    kicks: dict[str, SquareSum]
    forces: list[SquareSum]
    noise: list[SquareSum]
    slopes: Floats
    present: Sequence[int]

    def found(self, but: int | None = None) -> list[SquareSum]:
        """Those of what has deviations that were found, `but` a force."""
        return [*self.noise, *(self.forces[number] for number in self.present if number != but)]

    @classmethod
    def of(cls, fit: LikelihoodFit, kicks: Mapping[str, Floats]) -> _Sums | None:
        """Those at the optimum of a fit; None where its equations are singular."""
        random, q = fit.optimum.segments.random, fit.optimum.q
        equations = DrawnEquations.of(fit, fit.optimum, q)
        if equations is None or random is None:
            return None
        rng, m = np.random.default_rng(SEED), fit.optimum.segments.system.dimension
        forces = fit.optimum.point.nodes[random.rows] / random.deviation
        observed = (
            equations.of_defects(fit.misfit.defects.reshape(m, -1).T[..., None]),
            forces[:, :, None],
            fit.misfit.residuals.transpose(1, 2, 0)[..., None],
        )
        widths = [part.stop - part.start for part in at_once(DRAWS, m * forces.shape[1])]
        parts = zip(observed, *(_drawn(equations, random, rng, count) for count in widths), strict=True)
        of_kicks, of_forces, of_noise = (np.concatenate(part, axis=-1) for part in parts)
        return cls(
            {
                name: SquareSum.of(np.einsum("kn,knd->kd", pattern, of_kicks))
                for name, pattern in kicks.items()
            },
            [SquareSum.of(slopes) for slopes in of_forces],
            [SquareSum.of(slopes.reshape(-1, slopes.shape[-1])) for slopes in of_noise],
            of_forces,
            np.flatnonzero(random.is_estimated & random.present).tolist(),
        )


def _drawn(
    equations: DrawnEquations, random: RandomStates, rng: np.random.Generator, count: int
) -> tuple[Floats, Floats, Floats]:
    """By so many draws, states and unknowns following: slopes by kicks, forces (r, K, d) and residuals (C, K, M, d) left."""
    optimum, segments, linear = equations.optimum, equations.optimum.segments, equations.linear
    samples, channels, K = segments.samples.shape
    m = segments.system.dimension
    root = np.sqrt(random.curvature(optimum.scales.state))[:, :, None]
    forces = rng.standard_normal((*root.shape[:2], count))
    noise = rng.standard_normal((K, samples * channels, count))
    noise *= segments.observed.transpose(2, 0, 1).reshape(K, -1, 1)
    nodes, border = equations.pulls(count, lambda part, rows: noise[part])
    nodes[:, random.rows] += (root * forces).transpose(1, 0, 2)
    # pulls of drawn defects that forces leave in displacements, as they vary within a segment
    loosened = np.zeros((*linear.joined.shape, count))
    loose = np.flatnonzero(((linear.joined > 0.0) & (linear.joined < 1.0)).any(axis=0))
    loosened[:, loose] = rng.standard_normal((len(linear.joined), len(loose), count)) / optimum.q
    nodes[:-1] += np.einsum("kij,kid->kjd", linear.state_ends, loosened)
    nodes[1:] -= linear.joined[:, :, None] * loosened
    border += np.einsum("kip,kid->pd", linear.right_ends[..., :-1], loosened)
    nodes, border = equations.solved(nodes, border)
    for part, rows in equations.rows(count):
        noise[part] -= rows[..., :m] @ nodes[part] + rows[..., m:-1] @ border
    left = noise.reshape(K, samples, channels, count).transpose(2, 0, 1, 3)
    return equations.by_kicks(nodes, border), forces - root * nodes[:, random.rows].transpose(1, 0, 2), left
