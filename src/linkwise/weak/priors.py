"""What is known of coefficients beforehand, joined with what a regression on weak equations says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from linkwise.errors import IdentificationError
from linkwise.model.parameters import Parameter
from linkwise.weak.fit import WeakFit

_CONTRADICTED = 4.0  # standard errors between a prior and the record: chance does that once in 16 000


def with_priors(fit: WeakFit, parameters: Sequence[Parameter]) -> tuple[WeakFit, tuple[str, ...]]:
    """The fit with Gaussian priors of its parameters, and the names of those that the record contradicts.

    The product of two normal densities, the regression's and the priors'. Raises IdentificationError for a structure so large
    that the regression gives no covariance of all its parameters.
    """
    known = np.flatnonzero([p.sigma < np.inf and free for p, free in zip(parameters, fit.free, strict=True)])
    if not known.size:
        return fit, ()
    if not isinstance(fit.covariance, np.ndarray):
        raise IdentificationError(
            f"the weak form takes what is known beforehand of up to some hundred unknowns, not of {len(parameters)}: "
            'use method "ml", or state numbers'
        )
    covariance = fit.covariance
    mean = np.array([p.start or 0.0 for p in parameters])[known]
    variance = np.array([p.sigma for p in parameters])[known] ** 2
    given = np.isin(np.arange(len(parameters)), known)
    innovation = covariance[np.ix_(known, known)] + np.diag(variance)
    unit = np.sqrt(innovation.diagonal())
    scaled = cho_factor(innovation / np.outer(unit, unit))
    missed = mean - fit.values[known]
    gain = cho_solve(scaled, (covariance[known] / unit[:, None])).T / unit
    contradicted = tuple(parameters[i].name for i in known[np.abs(missed) > _CONTRADICTED * unit].tolist())
    lower = np.array([p.lower for p in parameters])
    upper = np.array([p.upper for p in parameters])
    response = np.eye(len(parameters))
    response[:, known] -= gain
    joined = replace(
        fit,
        values=np.clip(fit.values + gain @ missed, lower, upper),
        covariance=covariance - gain @ covariance[known],
        significance=np.where(
            given, np.inf, fit.significance
        ),  # what is known beforehand stands beside the record
        response=response,
    )
    return joined, contradicted
