"""How far estimates are from the truth, in the standard errors that they state."""

from collections.abc import Mapping

import numpy as np
from problems import truth

import linkwise as lw
from linkwise.arrays import Floats


def errors(fit: lw.Estimate, true: lw.Structure | Mapping[str, float]) -> Floats:
    """(p,) errors in standard errors of all coefficients, or of those that are named; NaN without a standard error."""
    if isinstance(true, lw.Structure):
        names = [parameter.name for parameter in fit.parameters]
        true = dict(zip(names, truth(true, fit.given_structure).tolist(), strict=True))
    found = [fit.coefficient(name) for name in true]
    deviations = [np.nan if each.standard_error is None else each.standard_error for each in found]
    return (
        np.array([each.value - value for each, value in zip(found, true.values(), strict=True)]) / deviations
    )


def assert_within(fit: lw.Estimate, true: lw.Structure | Mapping[str, float], most: float = 4.0) -> None:
    """The fit is trusted, and within `most` standard errors: of 4 once in 16 000 coefficients, of 5 in two millions."""
    assert fit.trusted, str(fit)
    off = errors(fit, true)
    assert len(off) and np.abs(off).max() < most, off


def of(owner: str, values: Mapping[str, float]) -> dict[str, float]:
    """Coefficients of a link by their whole names."""
    return {f"{owner}.{name}": value for name, value in values.items()}
