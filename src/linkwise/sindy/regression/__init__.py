"""Coefficients from equations: regressors on one Gram matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkwise.errors import IdentificationError
from linkwise.registry import Registry

if TYPE_CHECKING:
    from linkwise.sindy.regression.regressor import Regressor

REGRESSORS: Registry[type[Regressor]] = Registry(
    "regressor",
    {
        "stlsq": "linkwise.sindy.regression.regressor:Stlsq",
        "l1": "linkwise.sindy.regression.regressor:L1",
        "least-squares": "linkwise.sindy.regression.regressor:LeastSquares",
    },
    IdentificationError,
)
