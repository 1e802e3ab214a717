"""The methods of identification by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkwise.errors import IdentificationError
from linkwise.registry import Registry

if TYPE_CHECKING:
    from linkwise.estimates.estimate import Estimator

METHODS: Registry[type[Estimator]] = Registry(
    "method",
    {
        "ml": "linkwise.likelihood.estimate:MaximumLikelihood",
        "weak": "linkwise.weak.estimate:WeakForm",
        "sindy": "linkwise.sindy.estimate:PhysicsInformedSindy",
    },
    IdentificationError,
)
