"""Errors of masses and of applied forces: the force that each would add to its mass, per unit of its size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Floats
from linkwise.expression import Number, substitute, symbols, to_text
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.hypotheses import Hypothesis
from linkwise.likelihood.score_test import (
    CandidateForce,
    LocalQuadratic,
    augmented_quadratic,
    candidate_forces,
    in_their_units,
)
from linkwise.likelihood.shooting.flow import at_ends_and_middles
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.likelihood.shooting.uncertain_forces import UncertainForces
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.runtime import one_blas_thread

_ROUNDING = 1e-9  # of a force
_NOTHING = Number(0.0)
_OF_MODES = (("frequency", "d", 2.0), ("damping", "v", 1.0))
"""Coefficients of modes, and by how many times a relative error of one changes the stiffness or damping."""


def force_errors(
    optimum: Optimum, misfit: Misfit, identified: Structure
) -> tuple[list[Hypothesis], CandidateForces, Floats]:
    """The errors of all masses and applied forces, as forces of root mean square 1; with the size of that in its own unit."""
    hypotheses, masses, units, starts, middles = [], [], [], [], []
    for hypothesis, mass, at_ends, between in _inertia_and_inputs(optimum, misfit, identified):
        scale = float(np.sqrt(np.mean(at_ends**2)))
        if not 0.0 < scale < np.inf:
            continue
        hypotheses.append(hypothesis)
        masses.append(mass)
        units.append(1.0 / scale)
        starts.append(at_ends / scale)
        middles.append(between / scale)
    steps, count = len(misfit.trajectories.middle_links), optimum.segments.count
    steps //= optimum.segments.flow_steps_per_tangent
    forces = CandidateForces(
        np.full(len(masses), -1),
        np.array(masses, dtype=int),
        np.stack(starts, axis=1) if starts else np.empty((steps + 1, 0, count)),
        np.stack(middles, axis=1) if middles else np.empty((steps, 0, count)),
    )
    return hypotheses, forces, np.array(units)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def errors_of_stated_values(
    optimum: Optimum, structure: Structure, identified: Structure
) -> tuple[list[Hypothesis], LocalQuadratic]:
    """Relative errors of masses, of applied forces and of coefficients of laws that `structure` has as known, and delays.

    With the local model, at the `identified` structure, in the parameters and, after them, the sizes of these errors. Raises
    numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        hypotheses, errors, units = force_errors(optimum, misfit, identified)
        of_coefficients, forces, sizes = _known_terms(structure)
        terms, of_terms = candidate_forces(optimum, misfit, forces)
        augmented = augmented_quadratic(optimum, misfit, errors.joined(terms))
    units = np.concatenate([units, of_terms / np.array(sizes)])
    return hypotheses + of_coefficients, in_their_units(optimum, augmented, units)


def _known_terms(structure: Structure) -> tuple[list[Hypothesis], list[CandidateForce], list[float]]:
    """The terms of links whose coefficients are known and not 0, by the names of these, with the size of a relative error.

    Of modes of hosts these are frequencies and damping.
    """
    hypotheses, forces, sizes = [], [], []
    for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True):
        known_values = {
            name: Number(coefficient.value or 0.0)
            for name, coefficient in link.coefficients.items()
            if coefficient.known
        }
        for name in () if link.name in structure.modes else link.law.linear:
            basis = substitute(
                link.law.basis[name], {key: known_values[key] for key in known_values if key != name}
            )
            if known_values.get(name, _NOTHING) == _NOTHING or not set(symbols(basis)) <= set(VARIABLES):
                continue
            hypotheses.append(Hypothesis("coefficient", f"{link.name}.{name}"))
            forces.append(CandidateForce(first, second, Law.parse(to_text(basis))))
            sizes.append(known_values[name].value)
        for name, variable, weight in _OF_MODES if link.name in structure.mass_names else ():
            if (value := _weight(link, variable) * weight) and link.coefficients[name].known:
                hypotheses.append(Hypothesis(name, link.name))
                forces.append(CandidateForce(first, second, Law.parse(variable)))
                sizes.append(value)
    return hypotheses, forces, sizes


def _weight(link: Link, variable: str) -> float:
    """The stiffness, of the variable "d", or the damping, of "v", of a mode in SI units."""
    slopes = link.law.partials(
        0.0, 0.0, {name: coefficient.value or 0.0 for name, coefficient in link.coefficients.items()}
    )
    return float(slopes.by_d if variable == "d" else slopes.by_v)


def _inertia_and_inputs(
    optimum: Optimum, misfit: Misfit, identified: Structure
) -> Iterator[tuple[Hypothesis, int, Floats, Floats]]:
    """What a relative error of a mass, or of an applied force, or a delay of it, does to the mass.

    Yields the hypothesis, the number of the mass, and the force on it at the ends (J + 1, K) and in the middles (J, K) of the
    steps of the tangents, per unit of the error.
    """
    segments, names = optimum.segments, identified.mass_names
    stride = segments.flow_steps_per_tangent
    accelerations = segments.inputs.accelerations(misfit.trajectories.thinned(stride))
    for i, name in enumerate(names):
        if name in identified.modes:  # of unit mass by definition; its frequency and damping are terms
            continue
        inertia = -float(identified.mass_values[i])
        ends, middles = (inertia * acceleration[:, i] for acceleration in accelerations)
        yield Hypothesis("mass", name), i, ends, middles
    if segments.inputs.force is None:
        return
    scaled, late = _estimated(segments.inputs.uncertain)
    step, forces = (
        segments.step * stride,
        segments.inputs.applied(segments.system.at(optimum.point.theta), slice(None)),
    )
    for i, name in enumerate(names):
        if name in identified.modes:  # on which a force acts at points
            continue
        applied = forces[:, :, i]
        smallest = 0.0
        if segments.inputs.frame is not None:  # less the forces of inertia, which are no applied ones
            of_frame = float(identified.mass_values[i]) * segments.inputs.frame
            smallest = _ROUNDING * float(np.max(np.abs(of_frame)))
            applied = applied + of_frame
        ends, middles = at_ends_and_middles(applied, stride)
        if not np.max(np.abs(ends)) > smallest:
            continue
        if f"force:{name}" not in scaled:
            yield Hypothesis("force gain", f"force:{name}"), i, ends, middles
        if f"force:{name}" in late:
            continue
        both = np.empty((len(ends) + len(middles), ends.shape[-1]))
        both[::2], both[1::2] = ends, middles
        rate = np.gradient(both, axis=0, edge_order=2) / (0.5 * step)
        yield Hypothesis("force delay", f"force:{name}"), i, -rate[::2], -rate[1::2]


def _estimated(uncertain: UncertainForces | None) -> tuple[list[str], list[str]]:
    """The forces whose gains, and those whose delays, are among the unknowns: their scores are rounding."""
    if uncertain is None:
        return [], []
    gains, delays = (
        [name for name, number in zip(uncertain.channels, numbers, strict=True) if number >= 0]
        for numbers in (uncertain.gains, uncertain.delays)
    )
    return gains, delays
