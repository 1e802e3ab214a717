"""What absorption.json says."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.absorption.intervals import AbsorptionIntervals
from linkwise.absorption.map_result import AbsorptionMap
from linkwise.absorption.result import Absorption


def absorption_of(found: Absorption | AbsorptionIntervals | AbsorptionMap) -> dict[str, Any]:
    """What absorption.json says, as plain data."""
    return {**found.to_dict(), "version": version("linkwise")}
