"""Maximum likelihood for links alone on a rig: the answer in the terms of the record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from linkwise.estimates.causes import NoiseEstimate, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import LinkMotion, extremes
from linkwise.expression import Expression, Number, Symbol, add, multiply, substitute, to_text
from linkwise.likelihood.rigs.motion import BASE_CHANNEL, PrescribedMotion, cell_name, prescribed
from linkwise.likelihood.shooting.segmentation import require_same_channels
from linkwise.model.coefficient import Coefficient, Name
from linkwise.model.law import Law, LinkState
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record

Identify = Callable[[Sequence[Record], Structure, Progress, Sequence[PrescribedMotion]], Estimate]
_OFFSET = "x_base"


def rig_estimate(
    identify: Identify, records: Sequence[Record], structure: Structure, progress: Progress, *, off: bool
) -> Estimate:
    """Estimate the unknowns of links between the base and the ground, whose forces load cells show.

    Where the displacement of the base is `off` by an unknown constant, that is a coefficient of all laws.
    """
    require_same_channels(records)
    smoothed, motions = zip(*(prescribed(record, structure) for record in records), strict=True)
    answer = identify(smoothed, with_offset(structure) if off else structure, progress, motions)
    return as_recorded(answer, records, motions, off=off)


def with_offset(structure: Structure) -> Structure:
    """The structure with an unknown constant taken off the displacement of the base in all laws."""
    leader = Name(structure.links[0].name, _OFFSET)
    links: list[Link] = []
    for link, sign in zip(structure.links, structure.base_incidence, strict=True):
        law = _replaced(link.law, "d", add(Symbol("d"), multiply(Number(-float(sign)), Symbol(_OFFSET))))
        offset = Coefficient.shared(leader) if links else Coefficient.unknown(0.0)
        links.append(replace(link, law=law, coefficients={**link.coefficients, _OFFSET: offset}))
    return replace(structure, links=tuple(links))


def _without_offset(structure: Structure) -> Structure:
    """The structure without that constant."""
    links = []
    for link in structure.links:
        law = _replaced(link.law, _OFFSET, Number(0.0))
        kept = {name: own for name, own in link.coefficients.items() if name != _OFFSET}
        links.append(replace(link, law=law, coefficients=kept))
    return replace(structure, links=tuple(links))


def _replaced(law: Law, name: str, by: Expression) -> Law:
    """The law with an expression in place of a name, in its force and in the rates of its states."""
    states = {
        rate.name: LinkState(to_text(substitute(rate.expression, {name: by})), rate.initial, rate.unit)
        for rate in law.rates
    }
    force = to_text(substitute(law.expression, {name: by}))
    return Law.parse(force, states, signals=dict(law.signal_units))


def as_recorded(
    answer: Estimate, records: Sequence[Record], motions: Sequence[PrescribedMotion], *, off: bool
) -> Estimate:
    """The answer with the records as they are, and an offset of the displacement among the errors of sensors."""
    errors, given = answer.sensor_errors, answer.given_structure
    own = np.array([parameter.name.key != _OFFSET for parameter in answer.parameters])
    if off:
        deviations = np.sqrt(np.maximum(answer.covariance.diagonal()[~own], 0.0)).tolist()
        pairs = zip(answer.values[~own].tolist(), deviations, strict=True)
        found = [SensorErrorEstimate(BASE_CHANNEL, "offset", *pair, BASE_CHANNEL.unit) for pair in pairs]
        errors, given = (*found, *errors), _without_offset(given)
    added, alternative = answer.for_dropped_terms, answer.alternative
    parameters = tuple(p for p, chosen in zip(answer.parameters, own, strict=True) if chosen)
    identified = given.with_values(
        dict(zip((p.name for p in parameters), answer.values[own].tolist(), strict=True))
    )
    noise = NoiseEstimate.of(records[0], BASE_CHANNEL, motions[0].sigma)
    return replace(
        answer,
        given_structure=given,
        parameters=parameters,
        values=answer.values[own],
        covariance=answer.covariance[np.ix_(own, own)],
        free=answer.free[own],
        noise={BASE_CHANNEL: noise, **answer.noise},
        record=records[0],
        more_records=tuple(records[1:]),
        compute_motion=partial(_motion, answer, records, motions, identified, errors),
        remarks=(*(error.description for error in errors[: int(off)]), *answer.remarks),
        sensor_errors=errors,
        for_dropped_terms=None if added is None else added[np.ix_(own, own)],
        alternative=None if alternative is None else as_recorded(alternative, records, motions, off=off),
    )


def _motion(
    answer: Estimate,
    records: Sequence[Record],
    motions: Sequence[PrescribedMotion],
    identified: Structure,
    errors: Sequence[SensorErrorEstimate],
) -> LinkMotion:
    """The links along the motion, with the forces by their laws and by load cells."""
    motion, offsets = answer.compute_motion(), {e.channel: e.value for e in errors if e.kind == "offset"}
    d, v = (np.concatenate([getattr(own, of)[:: own.substeps] for own in motions]) for of in ("d", "v"))
    elongations = np.outer(d - offsets.get(BASE_CHANNEL, 0.0), identified.base_incidence)
    rates = np.outer(v, identified.base_incidence)
    force, measured = motion.identified_force, np.full(elongations.shape, np.nan)
    if force is None:
        links = enumerate(identified.links)
        force = np.stack([link.force(elongations[:, n], rates[:, n]) for n, link in links], axis=1)
    for number in range(len(identified.links)):
        channel = cell_name(identified, number)
        if channel in records[0].channels:
            shown = np.concatenate([record.channel(channel) for record in records])
            measured[:, number] = shown - offsets.get(channel, 0.0)
    return replace(
        motion,
        structure=identified,
        d=elongations,
        v=rates,
        d_range=extremes(elongations),
        compute_residual=_nothing,
        identified_force=force,
        measured_force=measured,
    )


def _nothing() -> None:
    """There is no mass whose equation leaves a residual."""
