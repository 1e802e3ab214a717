"""One call from records to a maximum-likelihood fit: cut, start, anneal, and say how far to believe it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from linkwise.likelihood.anneal import Fit, Progress, Schedule, Status, anneal
from linkwise.likelihood.cut import cut
from linkwise.likelihood.gaps import broken, carried
from linkwise.likelihood.loss import Gaussian, Loss
from linkwise.likelihood.mechanics import System
from linkwise.likelihood.optimum import Optimum
from linkwise.likelihood.segments import Misfit, Point, Scales, Segments, evaluate, linearise
from linkwise.likelihood.start import channel_noise, nodes, start_states
from linkwise.record import Record
from linkwise.structure import Structure

Array = NDArray[np.float64]

SAMPLES = 5  # in a segment: shorter ones cost unknowns, longer ones make a chaotic flow steep
_NEAR = Schedule(loose=0.1, fast=0.01, trust=10.0)  # from a start with known deviations: the weak fit's
_FLOW_ERROR = 0.02  # of a noise deviation: what the steps of the flow may be wrong by
_FINEST = 8
_TRIED = 150  # segments that tell how fine the steps must be
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_WHITE = 0.1  # autocorrelation of the residuals beyond which they are not noise of another size
_LARGEST_EXCESS = 2.0  # coloured residual power over the noise that no model error explains
_LOOSENING = 3.0  # from rung to rung of the ladder of model errors
_JOINING = 30  # steps that linking the sides of a gap may take
_RUNGS = 19  # from q = 1e-5 to 4e3
_MOST_WORKERS = 8


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """`values` (p,) with `covariance` (p, p), `free` (p,) False at a bound; `offsets`, `gains` and `noise` by
    channel (the noise of the first
    record).

    `chi_square` compares what is left to the noise that was stated or found beforehand; `model_error` is the relaxation q of
    the flow where the laws alone leave residuals that are no noise, else 0, and `force_error` (n,) in N on each mass what
    that means.
    """

    values: Array
    covariance: Array
    free: NDArray[np.bool_]
    offsets: dict[str, float]
    gains: dict[str, float]
    noise: dict[str, float]
    chi_square: float
    chi_square_off: bool
    model_error: float
    force_error: Array
    samples: int
    status: Status
    path: tuple[Progress, ...]
    segments: Segments
    misfit: Misfit
    optimum: Optimum


@dataclass(frozen=True)
class Annealer:
    """How annealing runs here: on which threads, what a residual costs, and whom it tells."""

    executor: Executor
    loss: Loss
    report: Callable[[Progress], None] | None

    def __call__(self, segments: Segments, start: Point, scales: Scales, schedule: Schedule) -> Fit:
        return anneal(
            segments, start, scales, schedule, loss=self.loss, executor=self.executor, report=self.report
        )


@dataclass(frozen=True, eq=False)
class Sensing:
    """Which channels have an unknown offset or gain, and the `noise` of every channel in each record."""

    offsets: tuple[str, ...]
    gains: tuple[str, ...]
    noise: tuple[dict[str, float], ...]

    @classmethod
    def of(cls, records: Sequence[Record], offsets: Sequence[str], gains: Sequence[str]) -> Sensing:
        """With the noise that the records state, else what is found in them."""
        return cls(tuple(offsets), tuple(gains), tuple(channel_noise(record) for record in records))

    @property
    def sigma(self) -> Array:
        """(C,) noise in the first record; that of the others is `cut` in as a factor."""
        return np.array(list(self.noise[0].values()))

    def cut(self, records: Sequence[Record], structure: Structure, system: System, refine: int) -> Segments:
        """The segments of the records."""
        loudness = (
            [np.array(list(noise.values())) / self.sigma for noise in self.noise]
            if len(self.noise) > 1
            else None
        )
        return cut(
            records,
            structure,
            system,
            samples=SAMPLES,
            refine=refine,
            offsets=self.offsets,
            gains=self.gains,
            loudness=loudness,
        )


@lru_cache(maxsize=1)
def _pools() -> ThreadpoolController:
    """The BLAS libraries of this process; finding them costs milliseconds."""
    return ThreadpoolController()


def _one_thread_each() -> AbstractContextManager[object]:
    """Small products run on our own threads, chunk by chunk; a BLAS that splits each of them would only wait."""
    limited: AbstractContextManager[object] = _pools().limit(limits=1, user_api="blas")
    return limited


def _workers() -> int:
    free = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    return min(len(free), _MOST_WORKERS)


def likelihood_fit(
    records: Sequence[Record],
    structure: Structure,
    theta: Array,
    *,
    spread: Array | None = None,
    offsets: Sequence[str] = (),
    gains: Sequence[str] = (),
    loss: Loss | None = None,
    model_error: bool = True,
    report: Callable[[Progress], None] | None = None,
) -> LikelihoodFit:
    """The most likely parameters of `structure` given `records`, from a start `theta` (p,) with deviations `spread` (p,).

    `offsets` and `gains` name channels with an unknown constant error or factor. Where the laws leave what is no
    noise, the flow is relaxed by the
    `model_error` that is most likely, unless that is False. Raises IdentificationError for records that do not fit together.
    """
    with _one_thread_each(), ThreadPoolExecutor(_workers()) as executor:
        annealer = Annealer(executor, loss or Gaussian(), report)
        sensing = Sensing.of(records, tuple(offsets), tuple(gains))
        return _fitted(records, structure, theta, spread, sensing, model_error, annealer)


def _fitted(
    records: Sequence[Record],
    structure: Structure,
    theta: Array,
    spread: Array | None,
    sensing: Sensing,
    wants_model_error: bool,
    annealer: Annealer,
) -> LikelihoodFit:
    system = System.of(structure)
    channels = records[0].responses
    pairs = zip(records, sensing.noise, strict=True)
    valued = structure.with_values(dict(zip(system.parameters.names, map(float, theta), strict=True)))
    starts = [start_states(record, valued, noise, SAMPLES) for record, noise in pairs]
    unit = np.maximum(np.abs(theta), 0.0 if spread is None else spread)
    unit = np.where(unit > 0.0, unit, 1.0)
    scales = Scales(
        sensing.sigma,
        np.min([each.scale for each in starts], axis=0),  # the quietest record asks for the tightest flow
        np.concatenate(
            [unit, [sensing.noise[0].get(name, 1.0) for name in sensing.offsets], np.ones(len(sensing.gains))]
        ),
    )
    point = Point(
        nodes(starts, SAMPLES),
        np.clip(theta, system.parameters.lower, system.parameters.upper),
        np.zeros(len(sensing.offsets)),
        np.ones(len(sensing.gains)),
    )
    segments = _fine_enough(records, structure, system, point, scales, sensing)
    whole, segments = segments, broken(segments)
    point = carried(segments, point)
    fit = annealer(segments, point, scales, Schedule())
    limit = _CHI_SQUARE + _SIGMAS * np.sqrt(2.0 / fit.samples)
    joined = _joined(whole, fit, limit, annealer) if whole.chains < segments.chains else None
    if joined is not None:
        fit, segments = joined, whole
    model_error, factor, chi_square = 0.0, 1.0, fit.chi_square
    off = bool(abs(chi_square - 1.0) > limit)
    lost = fit.status in (Status.EXHAUSTED, Status.STUCK)
    coloured = fit.status is Status.CONVERGED and chi_square > 1.0 and _colour(fit.misfit) > _WHITE
    rung = None
    if wants_model_error and (lost or (off and coloured)):
        rung = _with_model_error(segments, fit, point, annealer)
    if rung is not None:
        fit, model_error, factor = rung.fit, rung.q, rung.noise
        chi_square = factor**2
        stated = any(name in record.noise for record in records for name in channels)
        off = (stated and abs(chi_square - 1.0) > limit) or (
            chi_square > _LARGEST_EXCESS and _colour(fit.misfit) > _WHITE
        )
    p = system.parameters.size
    return LikelihoodFit(
        values=fit.point.theta,
        covariance=factor**2 * fit.covariance[:p, :p],
        free=~fit.at_bound[:p],
        offsets=dict(zip(sensing.offsets, map(float, fit.point.offsets), strict=True)),
        gains=dict(zip(sensing.gains, map(float, fit.point.gains), strict=True)),
        noise=_found_noise(fit, channels),
        chi_square=chi_square,
        chi_square_off=off,
        model_error=model_error,
        force_error=_force_error(fit, system, segments),
        samples=fit.samples,
        status=fit.status,
        path=fit.path,
        segments=segments,
        misfit=fit.misfit,
        optimum=Optimum(segments, fit.point, fit.scales, fit.q, factor, annealer.loss),
    )


def _fine_enough(
    records: Sequence[Record],
    structure: Structure,
    system: System,
    point: Point,
    scales: Scales,
    sensing: Sensing,
) -> Segments:
    """Segments whose flow is exact to a small part of the noise: the steps are halved until nothing changes."""
    refine = 1
    segments = sensing.cut(records, structure, system, refine)
    every = max(1, segments.count // _TRIED)
    residuals = _predicted(segments, point, scales, every)
    while refine < _FINEST:
        finer = sensing.cut(records, structure, system, 2 * refine)
        exact = _predicted(finer, point, scales, every)
        change = exact - residuals
        if np.isfinite(exact).all() and np.sqrt(np.mean(change[np.isfinite(change)] ** 2)) < _FLOW_ERROR:
            return segments
        refine, segments, residuals = 2 * refine, finer, exact
    return segments


def _predicted(segments: Segments, point: Point, scales: Scales, every: int) -> Array:
    """The residuals of some of the segments."""
    which = slice(None, None, every)
    some = replace(
        segments,
        samples=segments.samples[..., which],
        seen=segments.seen[..., which],
        step=segments.step[which],
        linked=np.zeros(len(segments.step[which]) - 1, dtype=bool),
        inputs=segments.inputs.part(which),
        loudness=None if segments.loudness is None else segments.loudness[:, which],
    )
    return evaluate(some, replace(point, nodes=point.nodes[..., which]), scales, Gaussian()).residuals


def _joined(whole: Segments, fit: Fit, limit: float, annealer: Annealer) -> Fit | None:
    """The fit with both sides of every long gap linked, None where laws and samples do not tell how."""
    if fit.status is not Status.CONVERGED:
        return None
    joined = annealer(whole, carried(whole, fit.point), fit.scales, Schedule(steps=_JOINING))
    return (
        joined if joined.status is Status.CONVERGED and joined.chi_square < fit.chi_square + limit else None
    )


@dataclass(frozen=True, eq=False)
class Rung:
    """A fit at relaxation q, the factor on the noise that it asks for, and -2 log of its marginal likelihood."""

    fit: Fit
    q: float
    noise: float
    cost: float


def _with_model_error(segments: Segments, fit: Fit, start: Point, annealer: Annealer) -> Rung | None:
    """The most likely split of what the laws leave into noise of the sensors and errors of the flow.

    For every relaxation q on a ladder the orbit is fitted again and the noise profiled out; the marginal likelihood, Gaussian
    in nodes and theta about their optimum (Laplace), chooses q. A tight fit is loosened; where there is none, for laws too
    wrong for it, the `start` is tightened. None where no rung is the best.
    """
    if fit.status is Status.CONVERGED:
        rungs = [fit.q * _LOOSENING**rung for rung in range(_RUNGS)]
        return _climb(segments, fit.point, fit.scales, rungs, annealer)
    best = _climb(segments, start, fit.scales, [_LOOSENING**-rung for rung in range(_RUNGS)], annealer)
    if best is not None and best.q == 1.0:
        rungs = [_LOOSENING**rung for rung in range(_RUNGS)]
        return _climb(segments, best.fit.point, fit.scales, rungs, annealer)
    return best


def _climb(
    segments: Segments, point: Point, scales: Scales, rungs: Sequence[float], annealer: Annealer
) -> Rung | None:
    """The best rung, once two worse ones follow it; None where the ladder ends before, or a rung is out of reach."""
    best, worse = None, 0
    for q in rungs:
        fit = annealer(segments, point, scales, Schedule(loose=q, tight=q))
        if fit.status is not Status.CONVERGED:
            return None
        point = fit.point
        noise, cost = _evidence(segments, fit, q, annealer.loss)
        if best is None or cost < best.cost:
            best, worse = Rung(fit, q, noise, cost), 0
        else:
            worse += 1
        if worse == 2:
            return best
    return None


def _evidence(segments: Segments, fit: Fit, q: float, loss: Loss) -> tuple[float, float]:
    """The factor on the noise (and on q) that this orbit asks for, and -2 log of the marginal likelihood with it."""
    linear = linearise(segments, fit.misfit, fit.scales, loss)
    factor = linear.equations(q).factor()
    if factor is None:
        return 1.0, np.inf
    defects = 2 * segments.system.incidence.shape[0] * int(segments.linked.sum())
    nodes = 2 * segments.system.incidence.shape[0] * int((~segments.lone).sum())
    free = ~fit.at_bound
    freedom = fit.samples + defects - nodes - int(free.sum())
    noise = np.sqrt(fit.misfit.cost(q) / freedom)
    return float(noise), float(
        2.0 * freedom * np.log(noise) + 2.0 * defects * np.log(q) + factor.log_determinant(free)
    )


def _colour(misfit: Misfit) -> float:
    """Largest autocorrelation at one sample among the channels' residuals."""
    r = misfit.residuals
    before, after = r[:-1], r[1:]
    power = np.maximum(np.sum(r**2, axis=(0, 2)) * (1.0 - 1.0 / len(r)), np.finfo(float).tiny)
    return float(np.max(np.sum(before * after, axis=(0, 2)) / power))


def _found_noise(fit: Fit, channels: Sequence[str]) -> dict[str, float]:
    squares = np.sum(fit.misfit.residuals**2, axis=(0, 2))
    counts = np.maximum(np.sum(fit.misfit.residuals != 0.0, axis=(0, 2)), 1)
    return dict(zip(channels, map(float, fit.scales.sigma * np.sqrt(squares / counts)), strict=True))


def _force_error(fit: Fit, system: System, segments: Segments) -> Array:
    """(n,) root mean square in N of the force that the velocity defects stand for."""
    n = len(fit.scales.state) // 2
    duration = np.mean(segments.step) * segments.steps
    jumps = np.sqrt(np.mean(fit.misfit.defects[1] ** 2, axis=1)) * fit.scales.state[n:]
    return np.asarray(system.at(fit.point.theta).masses * jumps / duration)
