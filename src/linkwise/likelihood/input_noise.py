"""Noise of the channels of inputs, which nobody stated: whether the residuals of exact laws show it.

Noise of an input kicks the masses, and the structure rings where it resonates. There are few residuals in a band so narrow,
and they hardly stand out among all, but they are the ones that a damping is judged by. The multiplier of each defect is the
slope of the cost by a kick there. Under noise of sensors alone the sum of squares of these slopes has a mean and a scatter
that draws of such noise give, with states and coefficients following; its excess is the score of the variance of the kicks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from linkwise.arrays import Bools, Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.eliminated_states import eliminated_rows
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.normal_equations import Linearization, chunks, linearise, whitened_jacobian
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.variance_score import SquareSum, VarianceScore
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread

# of noise of sensors, whose products give the moments of a sum of squares: 2016 pairs, 41664 triples
DRAWS = 64
SEED = 20200
_RELAXED = 1e-3  # relaxation: multipliers of smaller defects are lost to rounding
SIGNIFICANT = 3.3  # a normal score, as one input in 2000 gives by chance
_HINT = 2.0  # a normal score beyond which intervals hold the noise that residuals hint at: one input in 44 by chance
_MANY, _FEW = (
    20_000,
    16,
)  # segments from which so few of the draws are followed at once, which takes a quarter of the memory
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
    def description(self) -> str:
        """In words, with its size."""
        return f"noise of {self.channel} of {self.score.deviation:.3g} {self.unit}"

    @property
    def cause(self) -> Cause | None:
        """The noise as a cause of the residuals, where it is significant and small enough to be noise."""
        score = self.score
        if score.normal < SIGNIFICANT or score.deviation > LARGEST * self.rms:
            return None
        return Cause(
            kind="input noise",
            where=self.channel,
            size=score.deviation,
            unit=self.unit,
            gain=score.gain,
            standard_error=0.5 * score.error / score.deviation,
        )


def noise_of_inputs(
    fit: LikelihoodFit, identified: Structure, channels: Sequence[str]
) -> tuple[InputNoise, ...]:
    """What the residuals of exact laws say of the noise of each input among `channels`; nothing for other fits."""
    optimum = fit.optimum
    exact = fit.model_error == 0.0 and not fit.random_forces and isinstance(optimum.loss, Gaussian)
    if not exact or identified.hosts or identified.size >= MANY:
        return ()
    misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    inputs = list(input_kicks(optimum, misfit, identified, channels))
    if not inputs:
        return ()
    try:
        with one_blas_thread():
            multipliers = _multipliers(*_beginning(optimum, misfit), free_of_bounds(fit))
    except np.linalg.LinAlgError:
        return ()
    estimates = []
    for channel, rms, pattern in inputs:
        slopes = np.einsum("kn,knr->kr", pattern[: len(multipliers)], multipliers)
        score = VarianceScore.of(SquareSum.of(slopes[:, 0], slopes[:, 1:]))
        if score is not None:
            estimates.append(InputNoise(channel, rms, pattern, score, unit_in(identified, channel)))
    return tuple(estimates)


def for_noise_of_inputs(
    fit: LikelihoodFit, input_noises: Sequence[InputNoise]
) -> tuple[InputNoise, Floats] | None:
    """The input whose noise the residuals hint at, and the covariance (p, p) that it adds to the parameters.

    Its variance is taken as one standard error above the value from the score. None where nothing hints at such noise.
    """
    hinted = [
        candidate
        for candidate in input_noises
        if candidate.score.normal > _HINT and candidate.score.deviation < LARGEST * candidate.rms
    ]
    if not hinted:
        return None
    noise, optimum = max(hinted, key=lambda candidate: candidate.score.normal), fit.optimum
    segments, scales, n = optimum.segments, optimum.scales, len(optimum.segments.system.incidence)
    misfit = evaluate(segments, optimum.point, scales, optimum.loss)
    free, p = free_of_bounds(fit), len(fit.values)
    with one_blas_thread():
        factor = linearise(segments, misfit, scales, optimum.loss).equations(_RELAXED).factor()
        rows = eliminated_rows(segments, misfit, scales, optimum.loss, _RELAXED)
        if factor is None or rows is None:
            return None
        kicks = np.zeros((segments.count, n))
        kicks[:-1] = noise.pattern / scales.state[n : 2 * n] / _RELAXED
        pulls = np.concatenate(
            [np.einsum("knp,kn->kp", chunk.defects[:, n : 2 * n], kicks[chunk.part]) for chunk in rows]
        )
    inverse = np.zeros((len(free), len(free)))
    inverse[np.ix_(free, free)] = np.linalg.inv(factor.schur[np.ix_(free, free)])
    moved = (pulls @ inverse)[:, :p] * scales.theta[:p]
    return noise, np.asarray((noise.score.deviation**2 + noise.score.error) * (moved.T @ moved))


def _beginning(optimum: Optimum, misfit: Misfit) -> tuple[Optimum, Misfit]:
    """The optimum and its misfit in the beginning of a long record, whose residuals tell the noise of inputs well enough."""
    if optimum.segments.count <= _ENOUGH or misfit.clipped is not None:
        return optimum, misfit
    segments, point = optimum.segments.chosen(np.arange(_ENOUGH)), optimum.point
    point = replace(point, nodes=point.nodes[:, :_ENOUGH])
    return replace(optimum, segments=segments, point=point), misfit.part(slice(0, _ENOUGH))


def free_of_bounds(fit: LikelihoodFit) -> Bools:
    """(P,) whether an unknown of the border is not at a bound."""
    free = np.ones(fit.optimum.segments.parameters, dtype=bool)
    free[: len(fit.free)] = fit.free
    return free


def input_kicks(
    optimum: Optimum, misfit: Misfit, identified: Structure, channels: Sequence[str]
) -> Iterator[tuple[str, float, Floats]]:
    """Each input with its root mean square, and the kick (K - 1, n) in m/s that its noise of size one gives at the nodes."""
    segments, inputs = optimum.segments, optimum.segments.inputs
    mechanics = segments.system.at(optimum.point.theta)
    length = (segments.step * segments.refine * np.sqrt(len(segments.samples)))[:-1, None]
    if inputs.frame is not None and f"a:{BASE}" in channels:
        size = float(np.sqrt(np.mean(inputs.frame[:, 0] ** 2)))
        yield f"a:{BASE}", size, length * np.ones(identified.size)
    if inputs.base is not None:
        d, v = misfit.trajectories.links[0]
        slopes = mechanics.partials(d, v, misfit.trajectories.memory[0])
        pulls = mechanics.gain @ (segments.system.base[:, None] * slopes.by_d)
        yield f"x:{BASE}", float(np.sqrt(np.mean(inputs.base[:, 0, 0] ** 2))), length * pulls.T[:-1]
    for number, name in enumerate(identified.mass_names):
        if f"force:{name}" not in channels or inputs.force is None:
            continue
        applied = inputs.applied(mechanics, slice(None))[:, 0, number]
        if inputs.frame is not None:
            applied = applied + mechanics.masses[number] * inputs.frame[:, 0]
        pattern = np.eye(identified.size)[number] / mechanics.masses[number]
        yield f"force:{name}", float(np.sqrt(np.mean(applied**2))), length * pattern


def _multipliers(optimum: Optimum, misfit: Misfit, free: Bools) -> Floats:
    """(K - 1, n, 1 + draws) slopes of half the cost by kicks of the masses at the nodes, in s/m.

    Those of the residuals first, then those of draws of noise of the same size; unknowns of the border follow where `free`.
    """
    segments, scales, n = optimum.segments, optimum.scales, len(optimum.segments.system.incidence)
    linear = linearise(segments, misfit, scales, optimum.loss)
    equations = linear.equations(_RELAXED)
    factor = equations.factor()
    if factor is None:
        raise np.linalg.LinAlgError("the equations at the optimum are not positive definite")
    kicked = np.empty((segments.count - 1, n, 1 + DRAWS))
    draws = DRAWS if segments.count < _MANY else _FEW
    rng = np.random.default_rng(SEED)
    for first in range(0, DRAWS, draws):
        nodes, border = _gradients(optimum, misfit, len(equations.corner), draws, rng)
        for columns in at_once(1 + draws, nodes[..., 0].size):
            steps = steps_of(factor, free, nodes[..., columns], border[:, columns])
            places = np.arange(columns.start, columns.stop)
            places[places > 0] += first
            kicked[..., places] = changes_of_defects(linear, *steps)[:, n : 2 * n]
    kicked /= _RELAXED**2
    kicked /= scales.state[n : 2 * n, None]
    return kicked


def at_once(count: int, size: int) -> list[slice]:
    """Parts of `count` things of `size` numbers each, that take little memory together."""
    width = max(_AT_ONCE // max(size, 1), 1)
    return [slice(first, min(first + width, count)) for first in range(0, count, width)]


def _gradients(
    optimum: Optimum, misfit: Misfit, unknowns: int, draws: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Slopes by the nodes (K, m, 1 + draws) and by the border (P, 1 + draws) of residuals and of draws of their noise."""
    segments, m = optimum.segments, optimum.segments.system.dimension
    nodes, border = np.zeros((segments.count, m, 1 + draws)), np.zeros((unknowns, 1 + draws))
    drawn = _noise(optimum, misfit, draws, rng)
    wide_parts = at_once(segments.count, segments.samples[..., 0].size * (1 + draws))
    for part in min(chunks(segments, unknowns), wide_parts, key=lambda parts: parts[0].stop):
        rows, _ = whitened_jacobian(segments, misfit, optimum.scales, optimum.loss, part)
        wide = rows.astype(float)
        observed = segments.observed[..., part].transpose(2, 0, 1).reshape(len(wide), -1, 1)
        noise = np.concatenate([wide[..., -1:], observed * drawn(part)], axis=2)
        nodes[part] = wide[..., :m].transpose(0, 2, 1) @ noise
        border += np.einsum("krp,krd->pd", wide[..., m:-1], noise)
    return nodes, border


def _noise(
    optimum: Optimum, misfit: Misfit, draws: int, rng: np.random.Generator
) -> Callable[[slice], Floats]:
    """Draws (k, M C, draws) of the noise of sensors in k segments: as large as the residuals, or as coloured as was found."""
    segments = optimum.segments
    M, C, K = segments.samples.shape
    if optimum.coloured is None:
        samples = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
        sizes = np.sqrt(np.sum(misfit.residuals**2, axis=(0, 2)) / samples)[:, None]
        return lambda part: (sizes * rng.standard_normal((part.stop - part.start, M, C, draws))).reshape(
            -1, M * C, draws
        )
    whole = np.empty((K, M, C, draws), np.float32)
    for channel in range(C):
        series = optimum.coloured.drawn(rng.standard_normal((K * M, draws)), channel)
        whole[:, :, channel] = series.reshape(K, M, draws)
    return lambda part: whole[part].reshape(-1, M * C, draws).astype(float)


def steps_of(factor: BorderedFactor, free: Bools, nodes: Floats, border: Floats) -> tuple[Floats, Floats]:
    """Solutions (K, m, d) and (P, d) of the equations for right-hand sides of the same shapes, zero where not `free`."""
    P, d = border.shape
    columns = factor.forward[..., :P].reshape(-1, P)
    forward, _ = lapack.dtbtrs(factor.chol, nodes.reshape(-1, d), uplo="L")
    solved = np.zeros_like(border)
    if free.any():
        right = border - columns.T @ forward
        solved[free] = np.linalg.solve(factor.schur[np.ix_(free, free)], right[free])
    back, _ = lapack.dtbtrs(factor.chol, forward - columns @ solved, uplo="L", trans="T")
    return back.reshape(nodes.shape), solved


def changes_of_defects(linear: Linearization, nodes: Floats, border: Floats) -> Floats:
    """(K - 1, m, d) of the defects by steps of the nodes (K, m, d) and the border (P, d)."""
    ends = np.einsum("kij,kjd->kid", linear.state_ends, nodes[:-1])
    ends += linear.right_ends[..., : len(border)] @ border
    return np.asarray(nodes[1:] * linear.joined[:, :, None] - ends)
