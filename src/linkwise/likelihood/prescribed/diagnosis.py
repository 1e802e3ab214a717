"""Zero errors of load cells and of the displacement, tested by their scores where they are not among the unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.estimates.cause import Cause
from linkwise.likelihood.prescribed.covariance import newey_west
from linkwise.likelihood.prescribed.fit import RigFit
from linkwise.likelihood.prescribed.records import BASE_CHANNEL, cell_name

_GAIN = 25.0  # in -2 log likelihood: five standard deviations
_ALIKE = 10.0  # of gain, by which an offset of the displacement must be the better explanation
_SEPARATE = 1e-6  # of the power of a column: less beside the others, and they stand for it


def offset_causes(fit: RigFit) -> tuple[Cause, ...]:
    """Offsets that would explain a part of the residuals, the largest gain first."""
    problem, p = fit.problem, len(fit.problem.parameters)
    asked = replace(problem, cell_offsets=problem.links, motion_offset=True)
    extra = len(problem.links) + 1
    every = asked.jacobian(fit.minimum.paths)
    weights, columns = fit.weights, fit.weights[:, None] * problem.jacobian(fit.minimum.paths)[:, fit.free]
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), 1e-300)
    names = [*(cell_name(problem.structure, link) for link in problem.links), BASE_CHANNEL]
    causes = []
    for number in range(extra):
        link = problem.links[number] if number < len(problem.links) else None
        if (link in problem.cell_offsets) if link is not None else problem.motion_offset:
            continue
        column = weights * every[:, p + number]
        beside = column - columns / size @ np.linalg.lstsq(columns / size, column, rcond=1e-10)[0]
        power = float(beside @ beside)
        if power <= _SEPARATE * float(column @ column):
            continue
        whitened = weights * fit.residuals
        score = float(beside @ whitened)
        rows = (beside * (whitened - score / power * beside))[:, None]  # of what is left with the offset
        variance = max(power, float(newey_west(problem, rows)[0, 0]) if fit.model_force > 0.0 else 0.0)
        gain = score**2 / variance
        if gain > _GAIN:
            unit = "N" if link is not None else "m"
            error = float(np.sqrt(variance)) / power
            causes.append(Cause("offset", names[number], score / power, unit, gain, error))
    return tuple(sorted(causes, key=lambda cause: (cause.where == BASE_CHANNEL) * _ALIKE - cause.gain))
