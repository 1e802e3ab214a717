"""Maximum likelihood for links alone on a rig: from records of motion and force to an estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import Cause, NoiseEstimate, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import LinkMotion, extremes
from linkwise.likelihood.prescribed.diagnosis import rig_causes
from linkwise.likelihood.prescribed.fit import RigFit, rig_fit
from linkwise.likelihood.prescribed.judgement import judged
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.records import (
    BASE_CHANNEL,
    cell_name,
    cell_noise,
    require_same_cells,
    rig_forces,
)
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record


def rig_estimate(
    records: Sequence[Record],
    structure: Structure,
    *,
    offsets: Sequence[str],
    admitted: Sequence[str],
    starts: Mapping[str, float],
    progress: Progress,
) -> Estimate:
    """Estimate the unknowns of links between the base and the ground, whose forces load cells show.

    `offsets` are channels with an unknown constant error; with "offset" `admitted`, those that the diagnosis names are added.
    """
    forces = tuple(rig_forces(record, structure) for record in records)
    require_same_cells(forces, structure)
    noise = cell_noise(records, structure)
    offered = [BASE_CHANNEL, *(cell_name(structure, link) for link in forces[0].cells)]
    for name in offsets:
        if name not in offered:
            raise IdentificationError(
                f"no offset of {name} can be found{near_miss(name, offered)}; on a rig choose from {', '.join(offered)}"
            )
    with_offset = list(dict.fromkeys(offsets))
    while True:
        cells = tuple(link for link in forces[0].cells if cell_name(structure, link) in with_offset)
        problem = RigProblem(structure, forces, cells, BASE_CHANNEL in with_offset)
        fit = rig_fit(problem, noise, starts, progress)
        causes = rig_causes(fit)
        if (
            not causes
            or causes[0].kind not in admitted
            or causes[0].kind != "offset"
            or causes[0].where in with_offset
        ):
            return _estimate(fit, structure, records, noise, causes)
        with_offset.append(causes[0].where)


def _estimate(
    fit: RigFit,
    structure: Structure,
    records: Sequence[Record],
    noise: Mapping[int, float],
    causes: tuple[Cause, ...],
) -> Estimate:
    parameters, unknowns = structure.parameters, fit.minimum.unknowns
    p = len(parameters)
    identified = structure.with_values(
        {q.name: float(value) for q, value in zip(parameters, unknowns, strict=False)}
    )
    verdict, message, share = judged(fit, causes)
    sigma = {BASE_CHANNEL: fit.problem.records[0].motion.sigma}
    sigma |= {cell_name(structure, link): noise[link] for link in fit.problem.links}
    return Estimate(
        method="ml",
        fit_verdicts=(verdict,),
        message=message,
        seconds=0.0,
        given_structure=structure,
        parameters=parameters,
        values=unknowns[:p],
        covariance=fit.covariance[:p, :p],
        free=fit.free[:p],
        noise={name: NoiseEstimate.of(records[0], name, value) for name, value in sigma.items()},
        chi_square_per_sample=fit.chi_square,
        samples=int(np.count_nonzero(fit.residuals)),
        compute_motion=partial(_motion, fit, identified, tuple(records)),
        record=records[0],
        more_records=tuple(records[1:]),
        remarks=_remarks(fit),
        sensor_errors=_sensor_errors(fit),
        model_error=share,
        diagnosis=causes,
    )


def _sensor_errors(fit: RigFit) -> tuple[SensorErrorEstimate, ...]:
    """Offsets of the load cells, and of the displacement of the base."""
    problem, unknowns = fit.problem, fit.minimum.unknowns
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    channels = [cell_name(problem.structure, link) for link in problem.cell_offsets]
    channels += [BASE_CHANNEL] if problem.motion_offset else []
    found = slice(len(problem.parameters), len(problem.parameters) + len(channels))
    return tuple(
        SensorErrorEstimate(channel, "offset", value, error, channel.unit)
        for channel, value, error in zip(
            channels, unknowns[found].tolist(), errors[found].tolist(), strict=True
        )
    )


def _remarks(fit: RigFit) -> tuple[str, ...]:
    problem = fit.problem
    names = [p.name for p in problem.parameters]
    others = [
        "Another set of values explains the records as well: "
        f"{', '.join(f'{name} = {value:.4g}' for name, value in zip(names, values, strict=True))}."
        for values in fit.others
    ]
    return (*(error.description for error in _sensor_errors(fit)), *others)


def _motion(fit: RigFit, identified: Structure, records: Sequence[Record]) -> LinkMotion:
    """The links along the recorded motion, at the samples of all records."""
    problem, links = fit.problem, len(identified.links)
    counts = [len(record) for record in records]
    shape = (sum(counts), links)
    d, v, force, measured = np.zeros(shape), np.zeros(shape), np.full(shape, np.nan), np.full(shape, np.nan)
    firsts = np.cumsum([0, *counts[:-1]])
    for number, (first, count) in enumerate(zip(firsts, counts, strict=True)):
        motion = problem.records[number].motion
        at = slice(int(first), int(first) + count)
        d[at] = np.outer(motion.d[:: motion.substeps], identified.base_incidence)
        v[at] = np.outer(motion.v[:: motion.substeps], identified.base_incidence)
    for number, ((record, link, _), path) in enumerate(zip(problem.states, fit.minimum.paths, strict=True)):
        at = slice(int(firsts[record]), int(firsts[record]) + counts[record])
        every = problem.records[record].motion.substeps
        d[at, link] = path.d[::every]
        force[at, link] = path.force()[::every]
        measured[at, link] = problem.cell(number) - problem.offset(link, fit.minimum.unknowns)
    time = np.concatenate([record.time for record in records])
    return LinkMotion(
        structure=identified,
        time=time,
        d=d,
        v=v,
        d_range=extremes(d),
        compute_residual=_nothing,
        identified_force=force,
        measured_force=measured,
    )


def _nothing() -> Floats | None:
    """There is no mass whose equation leaves a residual."""
    return None
