"""The multiple-shooting problem of some records: segments with steps that are fine enough, the start, and the scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.loss import Gaussian
from linkwise.likelihood.residuals import evaluate
from linkwise.likelihood.segments import Iterate, Scales, Segments
from linkwise.likelihood.sensors import SAMPLES, SensorModel
from linkwise.likelihood.starts.states import segment_nodes, start_states
from linkwise.likelihood.system import System
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_FLOW_ERROR = 1e-3  # of a noise deviation: an error of the steps is systematic over thousands of segments
_MAX_REFINEMENT = 8  # steps per sample
_TESTED_SEGMENTS = 150  # whose residuals decide how fine the steps must be


@dataclass(frozen=True, eq=False)
class ShootingProblem:
    """Records cut into `segments`, the `start` of a search and the `scales` of its unknowns."""

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
    """The problem of `records`, from parameters `theta` (p,) with deviations `spread` (p,), None where these are unknown."""
    system = System.of(structure)
    valued = structure.with_values(dict(zip(system.parameters.names, map(float, theta), strict=True)))
    pairs = zip(records, sensing.noise, strict=True)
    starts = [start_states(record, valued, noise, SAMPLES) for record, noise in pairs]
    unit = np.maximum(np.abs(theta), 0.0 if spread is None else spread)
    offset_units = [sensing.noise[0].get(name, 1.0) for name in sensing.offsets]
    scales = Scales(
        sensing.sigma,
        np.min(
            [each.scale for each in starts], axis=0
        ),  # the record with the least noise needs the tightest flow
        np.concatenate([np.where(unit > 0.0, unit, 1.0), offset_units, np.ones(len(sensing.gains))]),
    )
    point = Iterate(
        segment_nodes(starts, SAMPLES),
        np.clip(theta, system.parameters.lower, system.parameters.upper),
        np.zeros(len(sensing.offsets)),
        np.ones(len(sensing.gains)),
    )
    segments = _refined_segments(records, structure, system, point, scales, sensing)
    return ShootingProblem(segments, point, scales)


def _refined_segments(
    records: Sequence[Record],
    structure: Structure,
    system: System,
    point: Iterate,
    scales: Scales,
    sensing: SensorModel,
) -> Segments:
    """Segments whose flow is exact to a small part of the noise: the steps are halved until the residuals stay the same."""
    refine = 1
    segments = sensing.segments(records, structure, system, refine)
    every = max(1, segments.count // _TESTED_SEGMENTS)
    residuals = _predicted(segments, point, scales, every)
    while refine < _MAX_REFINEMENT:
        finer = sensing.segments(records, structure, system, 2 * refine)
        exact = _predicted(finer, point, scales, every)
        change = exact - residuals
        if np.isfinite(exact).all() and np.sqrt(np.mean(change[np.isfinite(change)] ** 2)) < _FLOW_ERROR:
            return segments
        refine, segments, residuals = 2 * refine, finer, exact
    return segments


def _predicted(segments: Segments, point: Iterate, scales: Scales, every: int) -> Floats:
    """The residuals of some of the segments."""
    which = slice(None, None, every)
    some = replace(
        segments,
        samples=segments.samples[..., which],
        observed=segments.observed[..., which],
        step=segments.step[which],
        linked=np.zeros(len(segments.step[which]) - 1, dtype=bool),
        inputs=segments.inputs.part(which),
        relative_noise=None if segments.relative_noise is None else segments.relative_noise[:, which],
    )
    return evaluate(some, replace(point, nodes=point.nodes[..., which]), scales, Gaussian()).residuals
