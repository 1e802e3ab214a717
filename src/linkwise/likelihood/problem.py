"""The multiple-shooting problem of some records: segments with sufficiently small steps, start and scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.random_forces import (
    first_deviations,
    shown_directly,
    system_with,
    with_random_forces,
)
from linkwise.likelihood.room import require_room
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.random_states import RandomStates
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import A, Iterate, Scales, Segments
from linkwise.likelihood.shooting.tangents import tangents
from linkwise.likelihood.starts.states import segment_nodes, start_states
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.runtime import keep_freed_memory

_FLOW_ERROR = 1e-3  # of the standard deviation of the noise: errors of the steps are systematic over thousands of segments
_TANGENT_ERROR = 0.002  # of a sensitivity over a segment
_MAX_REFINEMENT = 8  # steps per sample
_TESTED_SEGMENTS = 150  # whose residuals decide how fine the steps must be
_TESTED_NUMBERS = 1_000_000  # in the sensitivities that do, with many masses


@dataclass(frozen=True, eq=False)
class ShootingProblem:
    """A multiple-shooting problem.

    Attributes
    ----------
    segments : Segments
        The records in segments.
    start : Iterate
        Starting values.
    scales : Scales
        Units of the unknowns.
    """

    segments: Segments
    start: Iterate
    scales: Scales


def shooting_problem(
    records: Sequence[Record],
    structure: Structure,
    theta: Floats,
    spread: Floats | None,
    sensing: SensorModel,
) -> ShootingProblem:
    """The multiple-shooting problem of some records.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    theta : array of shape (p,)
        Starting values of the parameters.
    spread : array of shape (p,) or None
        Their standard deviations, where known.
    sensing : SensorModel
        Noise, offsets and gains of the channels.

    Returns
    -------
    ShootingProblem
        The problem.

    Raises
    ------
    IdentificationError
        If it needs more memory than is free.
    """
    places = [force.place for force in sensing.random]
    system = system_with(structure, places, min(record.step for record in records))
    count = sum(-(-len(record) // sensing.samples) for record in records)
    require_room(count, structure.size, system.dimension, system.parameters.size)
    keep_freed_memory()
    valued = structure.with_values(dict(zip(system.parameters.names, map(float, theta), strict=True)))
    pairs = zip(records, sensing.noise, strict=True)
    starts = [start_states(record, valued, noise, sensing.samples) for record, noise in pairs]
    deviations = (
        first_deviations(sensing.random, sensing.frames[0], valued, starts[0].v)
        if sensing.random
        else np.zeros(0)
    )
    unit = np.maximum(np.abs(theta), 0.0 if spread is None else spread)
    if system.shapes is not None:  # which may be small, beside a node
        priors = np.array([parameter.sigma for parameter in structure.parameters])[system.shapes.columns]
        unit[system.shapes.columns] = np.maximum(
            unit[system.shapes.columns], np.where(np.isfinite(priors), priors, 0.0)
        )
    waveforms = [
        name for disturbance in sensing.disturbances for name in [disturbance.channel] * disturbance.count
    ]
    offset_units = [sensing.noise[0].get(name, 1.0) for name in (*sensing.offsets, *waveforms)]
    scales = Scales(
        sensing.sigma,
        np.append(
            np.min([start.scale for start in starts], axis=0), deviations
        ),  # the record with the least noise needs the tightest flow
        np.concatenate(
            [
                np.where(unit > 0.0, unit, 1.0),
                offset_units,
                np.ones(len(sensing.gains)),
                np.full(len(sensing.delays), records[0].step),
            ]
        ),
    )
    nodes = segment_nodes(starts, sensing.samples)
    point = Iterate(
        np.concatenate([nodes, np.zeros((len(places), nodes.shape[1]))]),
        np.clip(theta, system.parameters.lower, system.parameters.upper),
        np.zeros(len(offset_units)),
        np.ones(len(sensing.gains)),
        np.zeros(len(sensing.delays)),
    )
    cut = partial(sensing.segments, records, with_random_forces(structure, places), system)
    segments = _fine_segments(cut, point, scales, least=2 if sensing.centred else 1)
    if sensing.random:
        segments = replace(segments, random=_random_states(segments, sensing, deviations, records[0].step))
    return ShootingProblem(segments, point, scales)


def _random_states(segments: Segments, sensing: SensorModel, deviations: Floats, step: float) -> RandomStates:
    """Random forces with `deviations` (r,) in a record with this `step`; those of ambient ones follow the rate of each."""
    rate = np.sqrt(step / (segments.step * segments.refine))
    ambient = np.array([force.ambient for force in sensing.random])
    return RandomStates(
        rows=np.arange(segments.system.dimension - len(deviations), segments.system.dimension),
        deviation=deviations[:, None] * np.where(ambient[:, None], rate, 1.0),
        is_estimated=np.array([force.deviation is None for force in sensing.random]),
        shown=shown_directly(sensing.random, sensing.frames[0]),
        varying=None
        if (segments.sensors.kind == A).any() and not segments.centred
        else ambient,  # of accelerations
    )


def _fine_segments(
    segments_of: Callable[[int], Segments], point: Iterate, scales: Scales, *, least: int
) -> Segments:
    """The segments in steps that are fine enough, for the flow and for its tangents.

    `segments_of` makes the segments with a number of steps of the flow a sample, of which there are the `least` or more.
    """
    cut = cache(segments_of)
    tests = cache(lambda refine: _TestedFlow.of(cut(refine), point, scales))
    refine = least
    while refine < _MAX_REFINEMENT and not _same_residuals(tests(refine), tests(2 * refine)):
        refine *= 2
    steps = least
    while steps < _MAX_REFINEMENT and not _same_tangents(tests(max(refine, 2 * steps)), steps):
        steps *= 2
    return replace(cut(max(refine, steps)), tangent_refine=steps)


@dataclass(frozen=True, eq=False)
class _TestedFlow:
    """The flow in some of the `segments`, which decide how fine the steps must be."""

    segments: Segments
    scales: Scales
    misfit: Misfit

    @classmethod
    def of(cls, segments: Segments, point: Iterate, scales: Scales) -> _TestedFlow:
        """The flow from the nodes of `point`."""
        which = np.arange(segments.count)[:: max(1, segments.count // _TESTED_SEGMENTS)]
        some = segments.chosen(which)
        some = replace(some, linked=np.zeros(some.count - 1, dtype=bool))
        misfit = evaluate(some, replace(point, nodes=point.nodes[..., which]), scales, Gaussian())
        return cls(some, scales, misfit)

    def end_sensitivities(self, steps: int) -> Floats:
        """(2n + S, P, k) of the states at the segments' ends, by tangents in `steps` steps a sample."""
        segments, theta = self.segments, self.misfit.point.theta
        thinned, some = segments.refine // steps, self._tested
        orbit, step = self.misfit.trajectories.part(some).thinned(thinned), segments.step[some] * thinned
        units, inputs = (self.scales.state, self.scales.theta[: len(theta)]), segments.inputs.part(some)
        for tangent in tangents(
            segments.system.at(theta), orbit, step, *units, inputs=inputs, of_links=False
        ):
            ends = tangent
        x, u = ends.state
        return np.concatenate([x, u / step, ends.memory]) / self.scales.state[:, None, None]

    @property
    def _tested(self) -> slice:
        """The segments whose sensitivities are tested: fewer of many masses, each of which has as many to test."""
        n, links = self.segments.system.incidence.shape
        if n < MANY:
            return slice(None)
        numbers = links * (len(self.scales.state) + len(self.scales.theta)) * self.segments.count
        return slice(None, None, -(-numbers // _TESTED_NUMBERS))


def _same_residuals(coarse: _TestedFlow, fine: _TestedFlow) -> bool:
    """Whether steps half as long change the residuals by no more than a small part of the noise."""
    change = fine.misfit.residuals - coarse.misfit.residuals
    size = np.sqrt(np.mean(change[np.isfinite(change)] ** 2))
    return bool(np.isfinite(fine.misfit.residuals).all() and size < _FLOW_ERROR)


def _same_tangents(tested: _TestedFlow, steps: int) -> bool:
    """Whether twice as many steps than `steps` a sample change no column of the sensitivities by more than a small part.

    Segments are tied to each other by them: where they are wrong the search creeps, and ends beside the optimum.
    """
    fine = tested.end_sensitivities(2 * steps)
    change = fine - tested.end_sensitivities(steps)
    power, error = np.sum(fine**2, axis=(0, 2)), np.sum(change**2, axis=(0, 2))
    return not bool((error > _TANGENT_ERROR**2 * power).any())
