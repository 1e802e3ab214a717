"""The interface of integrators: what running a structure needs, whatever library integrates it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats

Time = float | np.longdouble  # s, in the precision of the integrator


class Outcome(Enum):
    """Why a propagation ended."""

    DONE = "the last time was reached"
    STEP_LIMIT = "the number of steps was reached"
    KINK = "a law or an input is not smooth here"
    NOT_FINITE = "the state is no longer finite"


@dataclass(frozen=True, eq=False)
class Placement:
    """Where an integrator is: `time` in s, scaled `state` (2n + S,) and `parameters` (P,).

    The state has displacements, velocities and states of links.
    """

    time: Time
    state: NDArray[Any]
    parameters: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Propagation:
    """Scaled states (M, 2n + S) at the requested times that were reached, the number of steps, and why it ended."""

    states: NDArray[Any]
    steps: int
    outcome: Outcome


class Integrator(Protocol):
    """An integrator of one compiled system; its state moves on with every propagation.

    States are scaled: displacements, velocities and states of links over `shape.SCALE`.
    """

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """The precision: `np.float64` or `np.longdouble`."""

    @property
    def time(self) -> Time:
        """Current time in s."""

    @property
    def state(self) -> NDArray[Any]:
        """A copy of the scaled state, shape (2n + S,)."""

    @property
    def parameters(self) -> NDArray[Any]:
        """A copy of the run-time parameters, shape (P,)."""

    def place(self, placement: Placement) -> None:
        """Set time, state and parameters."""

    def set_parameters(self, where: slice, values: NDArray[Any]) -> None:
        """Set some of the parameters."""

    def add_to_state(self, jump: NDArray[Any]) -> None:
        """Add a scaled jump (2n + S,) to the state."""

    def propagate(
        self,
        times: NDArray[Any],
        *,
        most_steps: int = 0,
        longest_step: float = np.inf,
        log: list[float] | None = None,
    ) -> Propagation:
        """Integrate from the current time to the last of `times` (M,) in s.

        At most `most_steps` steps are taken, or any number for 0, of at most `longest_step` in s. The time after each step is
        appended to `log`.
        """

    def trial_step(self, fraction: float, longest: float) -> tuple[Floats, float]:
        """State (2n + S,) and time in s after a `fraction` of the next step, which is at most `longest` in s.

        Time and state move on by the whole step.
        """

    def last_finite(self, time: float, state: NDArray[Any]) -> tuple[float, NDArray[Any]]:
        """Time in s and state (2n + S,) before the first step from `time` and `state` that is not finite."""
