"""The integrators of a shape: heyoka's where it has wheels, else SciPy's behind the same interface."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import cache, lru_cache
from importlib.util import find_spec
from pkgutil import resolve_name

from linkwise.errors import SimulationError
from linkwise.simulation.integrator.formulas import CompiledSystem, PhaseIntegrator, SystemShape

_HOME = "linkwise.simulation.integrator"


@cache
def _kind() -> Callable[[SystemShape], CompiledSystem]:
    """The class of systems that is available."""
    kind: Callable[[SystemShape], CompiledSystem] = resolve_name(
        f"{_HOME}.taylor:HeyokaSystem" if find_spec("heyoka") else f"{_HOME}.dop853:ScipySystem"
    )
    return kind


def compiled_system(shape: SystemShape) -> CompiledSystem:
    """The compiled equations of a shape, kept for this thread."""
    return system_of_thread(shape, threading.get_ident())


@lru_cache(maxsize=128)
def system_of_thread(shape: SystemShape, thread: Hashable) -> CompiledSystem:
    """The compiled equations of a shape for one thread."""
    return _kind()(shape)


def phase_integrator(shape: SystemShape) -> PhaseIntegrator:
    """The equations of a shape without kinks over phase; SimulationError where heyoka, which integrates them, is missing."""
    if find_spec("heyoka") is None:
        raise SimulationError(
            "periodic motion of smooth laws is computed with heyoka, which is not installed: pip install heyoka where it has "
            "wheels (Linux), or conda install heyoka.py"
        )
    kind: Callable[[SystemShape], PhaseIntegrator] = resolve_name(f"{_HOME}.periods:HeyokaPhase")
    return kind(shape)
