"""The motion of the links along a fitted orbit."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.link_estimate import LinkMotion, extremes
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed_records
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations
from linkwise.weak.residual import weak_residual


def motion_of_links(fit: LikelihoodFit, identified: Structure, records: Sequence[Record]) -> LinkMotion:
    """The links along the fitted orbit, at the samples of all records; residuals are those of the weak form."""
    records = framed_records(records, identified, integrated=True)
    segments, samples = fit.segments, len(fit.segments.samples)
    states = fit.misfit.trajectories.states[segments.at_samples]
    x = states[:, 0].transpose(2, 0, 1).reshape(-1, identified.size)
    v = (states[:, 1] / segments.step).transpose(2, 0, 1).reshape(-1, identified.size)
    whole = [-(-len(record) // samples) * samples for record in records]
    firsts = np.cumsum([0, *whole[:-1]])
    memory = fit.misfit.trajectories.memory[segments.at_samples]
    inside = memory.transpose(2, 0, 1).reshape(len(x), -1)
    left = fit.misfit.residuals.transpose(2, 0, 1).reshape(len(x), -1)
    observed = fit.segments.observed.transpose(2, 0, 1).reshape(len(x), -1)
    left = np.where(observed, left, np.nan)
    d, rates, forces, remains = [], [], [], []
    for record, first in zip(records, firsts, strict=True):
        own = slice(first, first + len(record))
        remains.append(left[own])
        base = record.channel("x:base") if "x:base" in record.channels else None
        d.append(identified.elongations(x[own], base))
        rate = None if base is None else np.gradient(base, record.step)
        rates.append(identified.elongations(v[own], rate))
        if segments.system.states:
            forces.append(
                _forces_with_memory(identified, d[-1], rates[-1], inside[own], segments.system.states)
            )
    return LinkMotion(
        structure=identified,
        time=np.concatenate([record.time for record in records]),
        d=np.concatenate(d),
        v=np.concatenate(rates),
        d_range=extremes(np.concatenate(d)),
        compute_residual=partial(_residual, identified, records),
        identified_force=np.concatenate(forces) if forces else None,
        residuals=dict(zip(fit.noise, np.concatenate(remains).T, strict=True)),
    )


def _forces_with_memory(
    identified: Structure, d: Floats, v: Floats, inside: Floats, states: Sequence[tuple[int, str]]
) -> Floats:
    """(N, L) forces in N of links with memory, whose `states` (N, S) are of these links and names; NaN for others."""
    forces = np.full(d.shape, np.nan)
    for index, link in enumerate(identified.links):
        own = {name: inside[:, column] for column, (number, name) in enumerate(states) if number == index}
        if own:
            forces[:, index] = link.force(d[:, index], v[:, index], own)
    return forces


def _residual(identified: Structure, records: Sequence[Record]) -> Floats | None:
    """(N, n) of the weak equations at the samples, where the records have the displacements that they need.

    None for links with memory and for hosts, which the weak form does not take.
    """
    if identified.hosts or any(link.law.states for link in identified.links):
        return None
    columns = []
    for record in records:
        try:
            equations = weak_equations(record, identified, read_displacements(record, identified))
        except IdentificationError:
            return None
        windows = weak_residual(equations, np.zeros(0))
        columns.append(
            np.stack([np.interp(record.time, equations.time, column) for column in windows.T], axis=1)
        )
    return np.concatenate(columns)
