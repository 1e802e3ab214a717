"""Compiled equations of motion, kept for every shape and thread.

Masses, coefficients and inputs are run-time parameters, so all structures of one shape share what was compiled for the first.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable
from functools import cached_property, lru_cache
from typing import Any

import heyoka
import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.simulation.integrator.formulas import MotionFormulas
from linkwise.simulation.integrator.interface import Integrator
from linkwise.simulation.integrator.shape import ParameterLayout, SystemShape
from linkwise.simulation.integrator.taylor import BatchIntegrator, TaylorIntegrator

UNROLLED = 12  # masses up to which code is compiled without loops: twice as fast, but longer to compile


class CompiledSystem:
    """The integrators of one shape, compiled on first use; one object for each thread, since they hold a state.

    `unrolled` is the number of masses up to which code is compiled without loops.
    """

    def __init__(self, shape: SystemShape, *, unrolled: int = UNROLLED) -> None:
        self._motion = MotionFormulas(shape)
        self._compact = shape.masses > unrolled
        self._batches: dict[tuple[int, tuple[int, ...]], BatchIntegrator] = {}

    @property
    def layout(self) -> ParameterLayout:
        """The layout of the run-time parameters."""
        return self._motion.layout

    @property
    def kinks(self) -> int:
        """The number of kinks of laws and inputs."""
        return self._motion.kinks

    def link_of(self, kink: int) -> int | None:
        """The number of the link whose law has this kink; None for an input."""
        return self._motion.link_of(kink)

    @cached_property
    def double(self) -> Integrator:
        """The integrator in double precision, which ends its steps at kinks."""
        return TaylorIntegrator.double(self._motion, compact=self._compact, events=self._motion.kink_events())

    @cached_property
    def without_events(self) -> Integrator:
        """The same, which does not detect kinks."""
        return TaylorIntegrator.double(self._motion, compact=self._compact) if self.kinks else self.double

    @cached_property
    def extended(self) -> Integrator | None:
        """The integrator in 80-bit arithmetic; None where the machine has none, and for shapes with kinks."""
        if self.kinks or not hasattr(heyoka, "taylor_adaptive_ldbl") or np.finfo(np.longdouble).eps > 1e-18:
            return None
        return TaylorIntegrator.extended(self._motion)

    def batch(self, lanes: int, watched: tuple[int, ...] = ()) -> BatchIntegrator:
        """The integrator of `lanes` structures of a shape without kinks, which records crossings of `watched` links."""
        if (lanes, watched) not in self._batches:
            self._batches[lanes, watched] = BatchIntegrator(
                self._motion, lanes, watched, compact=self._compact
            )
        return self._batches[lanes, watched]

    def kink_values(self, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        """Values (kinks,) of the kinks at a scaled state (2n + S,), parameters (P,) and time in s."""
        return self._evaluated(self._kink_function, state, parameters, time)

    def kink_sizes(self, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        """Sizes (kinks,) of the terms of the kinks there, to which their rounding is relative."""
        return self._evaluated(self._size_function, state, parameters, time)

    def _evaluated(self, function: Any, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        clock = {"time": time} if function.is_time_dependent else {}
        return np.asarray(function(state, pars=parameters[: function.nparams], **clock), dtype=float)

    @cached_property
    def _kink_function(self) -> Any:
        return self._function(self._motion.kink_formulas)

    @cached_property
    def _size_function(self) -> Any:
        return self._function(self._motion.kink_sizes)

    def _function(self, formulas: list[Any]) -> Any:
        y, u = self._motion.variables
        return heyoka.cfunc(formulas, vars=[*y, *u, *self._motion.states.values()])


def compiled_system(shape: SystemShape) -> CompiledSystem:
    """The compiled equations of a shape, kept for this thread."""
    return system_of_thread(shape, threading.get_ident())


@lru_cache(maxsize=128)
def system_of_thread(shape: SystemShape, thread: Hashable) -> CompiledSystem:
    """The compiled equations of a shape for one thread."""
    return CompiledSystem(shape)
