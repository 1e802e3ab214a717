"""How well a structure explains a record as it stands, to compare what may have been recorded in its place.

A channel of the wrong sign, or in another unit, or in the place of another, leaves residuals that no change of coefficients
explains. Records that differ by such an error are compared by the likelihood of the weak equations, each with its own
coefficients and the noise that the channels show.
"""

from __future__ import annotations

import numpy as np

from linkwise.model.link import refuse_memory
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.displacements import read_displacements
from linkwise.weak.estimate import weak_search
from linkwise.weak.scatter import SlopeStatistics, noise_power
from linkwise.weak.tested_terms import first_inertia

_SHARED = 0.5  # neighbouring windows share their noise, so that two count as one


def record_misfit(record: Record, structure: Structure) -> float:
    """-2 log likelihood of the weak equations of a structure in a record, with the coefficients that fit it best.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure, with one unknown at least.

    Returns
    -------
    float
        The misfit, up to a constant that is the same for records that differ by a factor, a shift or the order of their
        channels: the residuals are those of the accelerations, relative to what was recorded of these.

    Raises
    ------
    IdentificationError
        As `weak_search`.
    """
    refuse_memory(structure.links, "the comparison of channels", "their states have no acceleration")
    equations, fit, _ = weak_search(record, structure, read_displacements(record, structure))
    misfit = 0.0
    for patch in equations.patches:
        statistics = SlopeStatistics.along(patch, equations, fit.values)
        windows = statistics.stretches.windows[statistics.stretches.inside]
        power = noise_power(patch, statistics, equations)
        first = first_inertia(patch.layout)
        inertia = patch.rows[first : first + len(patch.layout.masses)] * statistics.masses[:, None]
        recorded = np.maximum(np.mean(inertia**2, axis=1, keepdims=True), np.finfo(float).tiny)
        terms = patch.residual(fit.values)[:, windows] ** 2 / power + np.log(power / recorded)
        misfit += equations.thinning * float(np.sum(terms @ patch.valid[windows]))
    return _SHARED * misfit
