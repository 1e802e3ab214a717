"""Starting values of the parameters for a likelihood fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.coefficients import law_start
from linkwise.likelihood.starts.hosts import equivalent_start, host_start
from linkwise.likelihood.starts.inverse_dynamics import needs_integration
from linkwise.model.names import MASS
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.joining import common_samples
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.signals.noise import channel_noise
from linkwise.weak.displacements import read_densely
from linkwise.weak.estimate import weak_search
from linkwise.weak.fit import WeakFit
from linkwise.weak.integrated_displacements import with_displacements

ValuesAndDeviations: TypeAlias = tuple[Floats, Floats]
WeakStart: TypeAlias = Callable[[Structure, Mapping[str, float]], ValuesAndDeviations]

_NAMED = 6  # parameters that a message names
_FIRM = 0.1  # relative deviation of a prior up to which its mean is a better start than what the record alone says


def starting_values(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float] | None = None,
    *,
    weak: WeakStart | None = None,
) -> tuple[Floats, Floats | None]:
    """Starting values of the parameters.

    Given values come first, then the means of narrow priors.
    The others come from inverse dynamics where displacements were not measured and accelerations
    determine the forces, else from the weak form, else from the structure.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    given : mapping of str to float, optional
        Starting values by name of the parameter.
    weak : callable, optional
        Gives values and standard deviations by the weak form; by default the best of the weak fits to single records.

    Returns
    -------
    values : array of shape (p,)
        Starting values.
    deviations : array of shape (p,) or None
        Their standard deviations, where known.

    Raises
    ------
    IdentificationError
        If a parameter has no starting value, or a mass none above zero.
    """
    records = framed_records(records, structure, integrated=True)
    given = dict(given or {})
    priors = {p.name: p for p in structure.parameters if p.sigma < np.inf and p.name not in given}
    firm = [name for name, p in priors.items() if p.sigma <= _FIRM * abs(_start(p))]
    try:
        return _with_masses(structure, _beside_priors(records, structure, given, firm, weak))
    except IdentificationError:
        if len(firm) == len(priors):
            raise
    return _with_masses(structure, _beside_priors(records, structure, given, list(priors), weak))


def _with_masses(structure: Structure, starts: tuple[Floats, Floats | None]) -> tuple[Floats, Floats | None]:
    """The `starts`; IdentificationError where a mass has none above zero."""
    for parameter, value in zip(structure.parameters, starts[0].tolist(), strict=True):
        if not value > 0.0 and any(key == MASS for _, key in parameter.members):
            raise IdentificationError(
                f"no starting value for {parameter.name}: what the record gives first is {value:.3g} {parameter.unit}, as "
                "noise can make it. State { start = ... } for it in the structure"
            )
    return starts


def equivalent_values(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float] | None = None
) -> Floats:
    """Starting values (p,) of a structure with hosts, from equivalent springs and dampers of its links.

    Raises IdentificationError if a parameter has no starting value.
    """
    record, parameters = framed_records(records, structure, integrated=True)[0], structure.parameters
    known = {p.name: p.start for p in parameters if p.start is not None} | dict(given or {})
    values = equivalent_start(record, structure, channel_noise(record), known)
    return np.array([values[p.name] for p in parameters])


def _beside_priors(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    fixed: Sequence[str],
    weak: WeakStart | None,
) -> tuple[Floats, Floats | None]:
    """Starting values with the parameters `fixed` at the most likely values of their priors."""
    priors = {p.name: p for p in structure.parameters if p.name in fixed}
    reduced = structure.with_values({name: _start(p) for name, p in priors.items()}) if priors else structure
    values, deviations = (
        _values(records, reduced, given, weak) if reduced.parameters else (np.zeros(0), np.zeros(0))
    )
    names = [p.name for p in reduced.parameters]
    values_by_name = dict(zip(names, values, strict=True)) | {name: _start(p) for name, p in priors.items()}
    start = np.array([values_by_name[p.name] for p in structure.parameters])
    if deviations is None:
        return start, None
    spread = dict(zip(names, deviations, strict=True)) | {name: p.sigma for name, p in priors.items()}
    return start, np.array([spread[p.name] for p in structure.parameters])


def _start(parameter: Parameter) -> float:
    """The start of a parameter that has one, as every parameter with a prior does."""
    assert parameter.start is not None
    return parameter.start


def _values(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    weak: WeakStart | None,
) -> tuple[Floats, Floats | None]:
    parameters = structure.parameters
    known = {p.name: p.start for p in parameters if p.start is not None} | dict(given)
    if parameters and all(p.name in given for p in parameters):
        return np.array([given[p.name] for p in parameters]), None
    if structure.hosts:
        values = host_start(records[0], structure, channel_noise(records[0]), known)
        return np.array([values[p.name] for p in parameters]), None
    if needs_integration(records[0], structure):
        values = known | law_start(records[0], structure, channel_noise(records[0]), known)
        return np.array([values[p.name] for p in parameters]), None
    integrated = _integrated(records, structure)
    try:
        with one_blas_thread():
            estimated, deviations = (weak or partial(_best_weak_fit, integrated or records))(structure, known)
    except IdentificationError as error:
        missing = [p.name for p in parameters if p.name not in known]
        if 0 < len(missing) < len(parameters):  # a hidden mass hides its own links, not those of others
            values = {p.name: known[p.name] for p in parameters if p.name in known}
            others = _values(records, structure.with_values(values), {}, weak)[0]
            values |= dict(zip(missing, others, strict=True))
            return np.array([values[p.name] for p in parameters]), None
        if missing:
            more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
            raise IdentificationError(
                f"no starting value for {', '.join(missing[:_NAMED])}{more}: the weak form, which would estimate one, fails "
                f"because {error}. State {{ start = ... }} for it in the structure"
            ) from error
        return np.array([known[p.name] for p in parameters]), None
    start = np.array([given.get(p.name, value) for p, value in zip(parameters, estimated, strict=True)])
    return start, None if integrated else deviations  # integration takes more than noise from them


def _integrated(records: Sequence[Record], structure: Structure) -> list[Record]:
    """The records with integrated displacements, if they lack some and every mass has a sensor; else none."""
    displaced = all(f"x:{name}" in records[0].channels for name in structure.mass_names)
    measured = all(records[0].motions_of(name) for name in structure.mass_names)
    if displaced or not measured:
        return []
    return [with_displacements(record, structure.masses) for record in records]


def _best_weak_fit(
    records: Sequence[Record], structure: Structure, known: Mapping[str, float]
) -> ValuesAndDeviations:
    """The weak fit with the smallest standard deviations, in the geometric mean, among those to each of the records.

    Short gaps are bridged where no record has enough windows without one.
    """
    sampled = [common_samples(record) or record for record in records]
    fits, failures = _weak_fits(sampled, structure, known)
    if not fits:
        bridged = [filled for record in sampled if (filled := short_gaps_bridged(record)) is not None]
        fits = _weak_fits(bridged, structure, known)[0]
    if not fits:
        raise failures[0]
    tiny = np.finfo(float).tiny
    best = min(fits, key=lambda fit: float(np.mean(np.log(np.maximum(fit.covariance.diagonal(), tiny)))))
    return best.values, np.sqrt(np.maximum(best.covariance.diagonal(), 0.0))


def _weak_fits(
    records: Sequence[Record], structure: Structure, known: Mapping[str, float]
) -> tuple[list[WeakFit], list[IdentificationError]]:
    """The weak fits to each of the records, and why others fail."""
    fits, failures = [], []
    for record in records:
        try:
            dense, motion = read_densely(record, structure)
            fits.append(weak_search(dense, structure, motion, known)[1])
        except IdentificationError as error:
            failures.append(error)
    return fits, failures
