"""What the smoothing of rates may have done to coefficients: they change in proportion as rates are smoothed more.

A law that jumps by the rate, as friction, bends the motion within the window that smooths the rate, so that zeros of the rate
move, by a part of the width of that window. A law that bends is biased by a higher power of it, for which the proportion is a
bound. Intervals include what it says.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import WeakFit, normal_equations, residual_power
from linkwise.weak.weak_form import weak_law
from linkwise.weak.window import ORDER, Window

_WIDER = 1.4  # rates are smoothed by test functions of so many times the width: twice the width flattens fast motion


def rated_links(structure: Structure) -> list[str]:
    """The links whose laws need a smoothed rate.

    Parameters
    ----------
    structure : Structure
        The structure.

    Returns
    -------
    list of str
        Their names.
    """
    return [
        link.name for link in structure.links if weak_law(link.law, frozenset(link.law.nonlinear)).needs_rate
    ]


def with_smoothing(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> WeakFit:
    """The fit with a covariance that includes what the smoothing of rates may have done to it.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.

    Returns
    -------
    WeakFit
        The fit; as it was where no law needs a smoothed rate, and for structures so large that they have no covariance of
        all their parameters.
    """
    if not (rated_links(structure) and isinstance(fit.covariance, np.ndarray) and fit.free.any()):
        return fit
    try:
        bias = _change(record, structure, equations, fit) / (_WIDER - 1.0)
    except (
        IdentificationError
    ):  # the wider window leaves too few of the samples, or the law is not finite by it
        return fit
    return replace(fit, covariance=fit.covariance + np.outer(bias, bias))


def _change(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> Floats:
    """(p,) change of the parameters as rates are smoothed more, to first order, in windows that both smoothings leave."""
    window, count = equations.window, len(fit.values)
    rate_window = equations.context.rate_window
    wide = weak_equations(
        record,
        structure,
        equations.motion,
        window=window,
        rate_window=Window.of_deviation(_WIDER * rate_window.half / sqrt(2 * ORDER + 3), window.step),
        values=dict(zip(equations.parameters, map(float, fit.values), strict=True)),
    )
    valid = {mass: patch.valid for patch in wide.patches for mass in patch.masses.tolist()}
    patches = [patch for patch in equations.patches if len(patch.layout.free_terms)]
    weights = [1.0 / residual_power(patch, fit.values) for patch in patches]
    left = []
    for context in (equations.context, wide.context):
        shared = [
            context.patch(masses, np.min([patch.valid, *(valid[mass] for mass in masses)], axis=0))
            for patch, masses in zip(patches, (patch.masses.tolist() for patch in patches), strict=True)
        ]
        normal, right = normal_equations(shared, weights, count)
        left.append(right - normal @ fit.values)
    whole, free = np.asarray(normal_equations(patches, weights, count)[0]), fit.free
    scale = 1.0 / np.sqrt(whole.diagonal()[free])
    inner = whole[np.ix_(free, free)] * np.outer(scale, scale)
    change = np.zeros(count)
    change[free] = scale * np.linalg.solve(inner, scale * (left[1] - left[0])[free])
    return change
