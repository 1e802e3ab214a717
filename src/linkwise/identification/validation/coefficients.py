"""Whether a record agrees with identified coefficients: they are estimated again from it alone."""

from __future__ import annotations

import math
from dataclasses import replace

import scipy

from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Posterior
from linkwise.identification.validation.result import CoefficientAgreement
from linkwise.likelihood.estimate import MaximumLikelihood
from linkwise.model.coefficient import Coefficient
from linkwise.model.host_damping import is_between_modes
from linkwise.model.parameters import coefficient_slots, is_shape, replace_coefficients, replace_shapes
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record

LEVEL = 1e-3  # probability that a right answer is said to disagree


def uncertain(posterior: Posterior) -> Structure:
    """The structure with its uncertain coefficients as unknowns."""
    masses = posterior.structure.mass_names
    selectors = []
    for name in posterior.names:
        owner, _, key = name.rpartition(".")
        selectors.append(f"mass:{owner}" if key == "mass" and owner in masses else name)
    return posterior.structure.unknown(*selectors)


def estimated_again(record: Record, posterior: Posterior, progress: Progress) -> Estimate:
    """The uncertain coefficients from the record alone, by maximum likelihood that starts at the answer.

    Shapes of hosts, and damping between their modes, stay known to within what the answer says: a record need not show again
    what they are.
    """
    starts = dict(zip(posterior.names, map(float, posterior.values), strict=True))
    deviations = dict(zip(posterior.names, posterior.covariance.diagonal() ** 0.5, strict=True))
    free = uncertain(posterior)
    slots = coefficient_slots(free.masses, free.links, free.hosts)
    known = {
        name: Coefficient.unknown(starts[name], sigma=float(deviation))
        for name, deviation in deviations.items()
        if _is_of_host(name) and deviation > 0.0 and slots[name].coefficient.same_as is None
    }
    masses, links = replace_coefficients(free.masses, free.links, slots, known)
    structure = replace(free, masses=masses, links=links, hosts=replace_shapes(free.hosts, known))
    return MaximumLikelihood(starts=starts).estimate([record], structure, progress)


def agreements(estimate: Estimate, posterior: Posterior) -> tuple[CoefficientAgreement, ...]:
    """The answer beside an estimate from another record, coefficient by coefficient, but for those known to within there."""
    count = len(posterior.names)
    limit = float(-scipy.special.ndtri(LEVEL / (2 * max(count, 1))))
    rows = []
    for index, name in enumerate(posterior.names):
        if _is_of_host(name):
            continue
        own = estimate.coefficient(name)
        error = math.sqrt(max(posterior.covariance[index, index], 0.0))
        if own.standard_error is None or not own.standard_error > 0.0:
            continue
        rows.append(
            CoefficientAgreement(
                name=name,
                unit=own.unit,
                value=float(posterior.values[index]),
                standard_error=error,
                record_value=own.value,
                record_error=own.standard_error,
                z=(own.value - float(posterior.values[index])) / math.hypot(error, own.standard_error),
                limit=limit,
            )
        )
    return tuple(rows)


def _is_of_host(name: str) -> bool:
    return is_shape(name) or is_between_modes(name)
