"""Zero offsets of sensors beside which constant forces that were found would not be needed.

About another zero of its displacement a linear spring pulls with a constant force, and a cubic one has a quadratic part beside
that. A selection with such terms and one with the offset of a channel explain a record equally well, or the latter does so
with fewer terms. In the local quadratic model each constant force in turn gives way to the offset of each channel, and to one
that all sensors of displacement have in common, as where the equilibrium of a structure is not where its sensors show zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np
from scipy.linalg import block_diag

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.rival_errors import RivalError, without_term
from linkwise.discovery.selection import Selection
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.shooting.residuals import SensorErrors, evaluate
from linkwise.likelihood.tests.score_test import (
    LocalQuadratic,
    augmented_quadratic,
    candidate_forces,
    in_their_units,
)
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread


def rival_offsets(
    selection: Selection, candidates: Candidates, channels: Sequence[Channel]
) -> tuple[RivalError, ...]:
    """For each set of terms with a constant force the offset that replaces it best, the best of all first.

    `channels` are those of the records; offsets that the fit has found already are left out.
    """
    names = selection.quadratic.names[: len(selection.structure.parameters)]
    constants = [
        number
        for number, name in enumerate(names)
        if (entry := candidates.by_name.get(name)) is not None and entry.term.is_constant
    ]
    shown = [name for name in channels if not name.is_input]
    tested = [number for number, name in enumerate(shown) if name not in selection.fit.offsets]
    if not (constants and tested):
        return ()
    errors: list[tuple[str, str]] = [("offset", shown[number]) for number in tested]
    of_channels = np.eye(len(tested))
    units = [unit_in(selection.structure, where) for _, where in errors]
    displacements = np.array([shown[number].kind == "x" for number in tested])
    if np.count_nonzero(displacements) > 1 and len(set(compress(units, displacements))) == 1:
        errors.append(("common offset", "all displacements"))
        of_channels = np.column_stack([of_channels, displacements])
        units += [*compress(units, displacements)][:1]
    try:
        model = selection.quadratic_beside(
            _combined(_with_offsets(selection.fit.optimum, tested), of_channels),
            [f"{kind} of {where}" for kind, where in errors],
        )
    except np.linalg.LinAlgError:
        return ()
    rivals = [
        RivalError(kind, where, size, terms, excess, units[column])
        for term in constants
        for column, (kind, where) in enumerate(errors)
        for size, terms, excess in without_term(selection, model, len(names) + column, term)
        if excess < CERTAIN
    ]
    best: dict[tuple[int, ...], RivalError] = {}
    for rival in sorted(rivals, key=lambda rival: rival.excess):
        best.setdefault(rival.terms, rival)
    return tuple(best.values())


def _combined(local: LocalQuadratic, offsets: Floats) -> LocalQuadratic:
    """The local model in its parameters and in errors that are sums of its last (c,) unknowns, as `offsets` (c, e) says."""
    p = len(local.slope) - len(offsets)
    sums = block_diag(np.eye(p), offsets)
    scatter = None if local.scatter is None else sums.T @ local.scatter @ sums
    return LocalQuadratic(sums.T @ local.curvature @ sums, sums.T @ local.slope, scatter)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def _with_offsets(optimum: Optimum, channels: Sequence[int]) -> LocalQuadratic:
    """The local model in the parameters and, after them, in offsets of the `channels`, by number, in their SI units.

    Raises numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        errors = SensorErrors.of(optimum.segments, misfit)
        numbers = [
            number
            for number, (channel, kind) in enumerate(zip(errors.channel.tolist(), errors.kind, strict=True))
            if kind == "offset" and channel in channels
        ]
        offsets = SensorErrors(
            errors.channel[numbers],
            tuple(errors.kind[number] for number in numbers),
            errors.source[numbers],
            errors.values[:, numbers],
        )
        nothing, _ = candidate_forces(optimum, misfit, [])
        augmented = augmented_quadratic(optimum, misfit, nothing, offsets)
    units: Floats = np.ones(len(numbers))
    return in_their_units(optimum, augmented, units)
