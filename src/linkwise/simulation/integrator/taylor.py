"""heyoka's Taylor integrators, for one structure, for several side by side and over phase, compiled once for each shape and
thread.

Masses, coefficients and inputs are run-time parameters, so all structures of one shape share what was compiled for the
first. heyoka keeps up to 20 GB of it in one folder for all programs, and each process that compiles reads that from end
to end: with 1.7 GB there, the first simulation takes twice as long. linkwise keeps a few of its own.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, final

import heyoka
import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats
from linkwise.simulation.integrator.formulas import (
    SCALE,
    Algebra,
    CompiledSystem,
    MotionFormulas,
    Outcome,
    Placement,
    Propagation,
    StepRule,
    SystemShape,
    Time,
    Turn,
    input_symbols,
)

_CHOSEN_BY_USER = "HEYOKA_CACHE_DIR"
_LARGEST = 2**26  # bytes: some hundreds of structures


def use_own_cache() -> None:
    """Keep what this process compiles in a small folder of linkwise, unless the user chose one for heyoka."""
    if os.environ.get(_CHOSEN_BY_USER):
        return
    state = heyoka.llvm_state
    shared = Path(state.get_diskcache_path())
    if not shared.name:  # no home: the working directory is no place for a cache
        state.set_diskcache_enabled(False)
        return
    try:
        state.set_diskcache_path(str(shared.with_name("linkwise")))
        state.set_diskcache_limit(_LARGEST)
    except RuntimeError:  # a home that cannot be written to
        state.set_diskcache_enabled(False)


TOLERANCE = 1e-14  # truncation per step, relative to the largest state: order 18, whose remainder is 1e-16
EXTENDED_TOLERANCE = 1e-16  # order 20, enough for 80-bit arithmetic, which stays far below its tolerance

use_own_cache()
heyoka.set_logger_level_critical()  # its warnings go to standard output; `Outcome` tells of a state that is not finite

_OUTCOMES = {
    heyoka.taylor_outcome.time_limit: Outcome.DONE,
    heyoka.taylor_outcome.step_limit: Outcome.STEP_LIMIT,
    heyoka.taylor_outcome.err_nf_state: Outcome.NOT_FINITE,
}
_FAILED = (heyoka.taylor_outcome.err_nf_state, heyoka.taylor_outcome.step_limit)


HEYOKA = Algebra(
    time=heyoka.time,
    number=heyoka.expression,
    variable=heyoka.expression,
    parameter=heyoka.par.__getitem__,
    total=heyoka.sum,
    call=lambda function, *arguments: getattr(heyoka, function)(*arguments),
)
"""Formulas as heyoka expressions."""


@final
class TaylorIntegrator:
    """heyoka's integrator of one structure, see `formulas.Integrator`. `options` are heyoka's: steps end at
    `t_events`, and code in `compact_mode` has loops, which is slower, but quick to compile.
    """

    def __init__(self, motion: MotionFormulas, tolerance: float, **options: Any) -> None:
        #: The precision: `np.float64` or `np.longdouble`.
        self.dtype: type[np.floating[Any]] = options.get("fp_type", np.float64)
        start = np.zeros(len(motion.equations), dtype=self.dtype)
        self._taylor = heyoka.taylor_adaptive(motion.equations, start, tol=self.dtype(tolerance), **options)
        # heyoka keeps those only that its equations use: a law may have a coefficient that cancels
        self._parameters = np.zeros(motion.layout.size, dtype=self.dtype)

    @property
    def time(self) -> Time:
        """Current time in s."""
        time: Time = self._taylor.time
        return time

    @property
    def state(self) -> NDArray[Any]:
        """A copy of the scaled state, shape (2n + S,)."""
        state: NDArray[Any] = self._taylor.state.copy()
        return state

    @property
    def parameters(self) -> NDArray[Any]:
        """A copy of the run-time parameters, shape (P,)."""
        return self._parameters.copy()

    def place(self, placement: Placement) -> None:
        """Set time, state and parameters."""
        self.set_parameters(slice(None), placement.parameters)
        # from 80 bits to 64: a motion that went so far is refused as diverging
        with np.errstate(over="ignore"):
            self._taylor.state[:] = placement.state
        self._taylor.time = self.dtype(placement.time)

    def set_parameters(self, where: slice, values: NDArray[Any]) -> None:
        """Set some of the parameters."""
        self._parameters[where] = values
        self._taylor.pars[:] = self._parameters[: len(self._taylor.pars)]

    def add_to_state(self, jump: NDArray[Any]) -> None:
        """Add a scaled jump (2n + S,) to the state."""
        self._taylor.state[:] += jump

    def propagate(self, times: NDArray[Any], rule: StepRule) -> Propagation:
        """Integrate from the current time to the last of `times` (M,) in s."""
        dtype = self.dtype
        grid = np.empty(1 + len(times), dtype)
        grid[0], grid[1:] = self._taylor.time, times
        how = rule.most, dtype(rule.longest), None if rule.log is None else _StepLog(rule.log)
        code, _, _, steps, *_, states = self._taylor.propagate_grid(grid, *how)
        return Propagation(states[1:], steps, _OUTCOMES.get(code, Outcome.KINK))

    def trial_step(self, fraction: float, longest: float) -> tuple[Floats, float]:
        """State (2n + S,) and time in s after a `fraction` of the next step, which is at most `longest` in s.

        Time and state move on by the whole step.
        """
        start = float(self._taylor.time)
        self._taylor.step(max_delta_t=longest, write_tc=True)
        time = start + fraction * float(self._taylor.last_h)
        return self._taylor.update_d_output(time).copy(), time


@dataclass(frozen=True)
class _StepLog:
    """A step callback that records times."""

    times: list[float]

    def __call__(self, taylor: Any) -> bool:
        self.times.append(float(taylor.time))
        return True


@final
class TaylorBatch:
    """heyoka's integrator of several structures side by side, see `formulas.BatchIntegrator`."""

    def __init__(self, motion: MotionFormulas, lanes: int, watched: Sequence[int], *, compact: bool) -> None:
        self.crossings: list[list[tuple[int, float]]] = [[] for _ in watched]
        """For each watched link, (lane, time in s) of its crossings."""
        equations = [*motion.equations, *motion.energy_equations]
        self._parameters = np.zeros((motion.layout.size + len(watched), lanes))
        self._taylor = heyoka.taylor_adaptive_batch(
            equations,
            np.zeros((len(equations), lanes)),
            tol=TOLERANCE,
            fast_math=True,
            compact_mode=compact,
            nt_events=[
                heyoka.nt_event_batch(
                    motion.elongation(link) - heyoka.par[motion.layout.size + number],
                    callback=_recording(self.crossings[number]),
                )
                for number, link in enumerate(watched)
            ],
        )

    @property
    def state(self) -> Floats:
        """A copy of the states, shape (2n + L + 1, lanes)."""
        state: Floats = self._taylor.state.copy()
        return state

    def place(self, state: Floats, parameters: Floats) -> None:
        """Start at time 0 from these states and parameters, with no crossings recorded."""
        self._taylor.set_time(0.0)
        self.set_parameters(slice(None), parameters)
        self.set_state(state)
        for crossings in self.crossings:
            crossings.clear()

    def set_parameters(self, where: slice, values: Floats) -> None:
        """Set some of the parameters, (k, lanes), or (k, 1) for the same in all lanes."""
        self._parameters[where] = values
        self._taylor.pars[:] = self._parameters[: len(self._taylor.pars)]

    def set_state(self, state: Floats) -> None:
        """Set the states (2n + L + 1, lanes)."""
        self._taylor.state[:] = state

    def propagate(self, times: Floats, most_steps: int) -> tuple[Floats, Bools]:
        """States (M, 2n + L + 1, lanes) at `times` (M,) in s, and which lanes failed.

        If one lane fails, no longer finite or out of steps, the others may not reach the last time either.
        """
        lanes = self._taylor.batch_size
        grid = np.concatenate([self._taylor.time[None], np.repeat(times[:, None], lanes, axis=1)])
        _, states = self._taylor.propagate_grid(grid, most_steps)
        return states[1:], np.array([result[0] in _FAILED for result in self._taylor.propagate_res])


def _recording(crossings: list[tuple[int, float]]) -> Callable[[Any, float, int, int], None]:
    """A callback that records crossings: a function, since heyoka copies objects and would record in the copy."""
    return lambda _, time, __, lane: crossings.append((lane, time))


UNROLLED = 12  # masses up to which code is compiled without loops: twice as fast, but longer to compile


@final
class HeyokaSystem(CompiledSystem):
    """The integrators of one shape, see `formulas.CompiledSystem`."""

    def __init__(self, shape: SystemShape) -> None:
        super().__init__(MotionFormulas(shape, HEYOKA))
        self._compact = shape.masses > UNROLLED

    def _integrator(self, *, events: bool) -> TaylorIntegrator:
        smooth = not self.kinks  # fast_math reassociates sums, a third faster; but events need exact zeros
        watched = self._kink_events() if events else []
        options = {"fast_math": smooth, "compact_mode": self._compact, "t_events": watched}
        return TaylorIntegrator(self._motion, TOLERANCE, **options)

    def _kink_events(self) -> list[Any]:
        """Terminal events of the kinks that motion or time can cross; one of coefficients alone keeps its sign."""
        first, at_any_time = self.layout.unwatched.start, {heyoka.time: heyoka.make_vars("at")}
        return [
            # without cooldown: `branches.choose_branches` leaves a kink behind before the event is watched again
            heyoka.t_event(formula + heyoka.par[first + number], cooldown=0.0)
            for number, formula in enumerate(self._motion.kink_formulas)
            if heyoka.get_variables(heyoka.subs(formula, at_any_time))
        ]

    @cached_property
    def extended(self) -> TaylorIntegrator | None:
        """The integrator in 80-bit arithmetic; None where the machine has none, and for shapes with kinks."""
        if self.kinks or not hasattr(heyoka, "taylor_adaptive_ldbl") or np.finfo(np.longdouble).eps > 1e-18:
            return None
        return TaylorIntegrator(self._motion, EXTENDED_TOLERANCE, compact_mode=True, fp_type=np.longdouble)

    def _batch(self, lanes: int, watched: tuple[int, ...]) -> TaylorBatch:
        return TaylorBatch(self._motion, lanes, watched, compact=self._compact)

    def kinks_at(self, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        function = self._kinks
        clock = {"time": time} if function.is_time_dependent else {}
        both = function(state, pars=parameters[: function.nparams], **clock)
        return np.asarray(both, dtype=float).reshape(2, -1)

    @cached_property
    def _kinks(self) -> Any:
        y, u = self._motion.variables
        state = [*y, *u, *self._motion.states.values()]
        return heyoka.cfunc([*self._motion.kink_formulas, *self._motion.kink_sizes], vars=state)


_OMEGA = "omega"  # the symbol of an input that is the angular frequency in rad/s
_PHASE_TOLERANCE = 1e-13
_UNROLLED_EQUATIONS = 60  # up to which code over phase is compiled without loops
_LANES = 8  # tangent vectors that are integrated side by side: two registers of most processors
_MOST_STEPS = 2_000  # in a turn: a motion that needs more diverges


@final
class HeyokaPhase:
    """heyoka's integrator of one shape without kinks over phase, see `formulas.PhaseIntegrator`: where a structure is after a
    turn of its excitation, and the derivatives of that, which shooting for periodic motion needs.

    Time is the phase, omega*t, so that a turn ends at 2 pi whatever its frequency, and the frequency is a parameter like
    others. Variational equations are integrated with the motion, a tangent vector in each lane of a batch.
    """

    def __init__(self, shape: SystemShape) -> None:
        self._motion = motion = MotionFormulas(shape, HEYOKA)
        self.layout = motion.layout
        self._parameters = np.zeros(self.layout.size + 1)  # omega last

    @cached_property
    def _equations(self) -> list[tuple[Any, Any]]:
        """Pairs of variable and derivative by phase."""
        omega = heyoka.par[self.layout.size]
        replaced = {heyoka.time: heyoka.time / omega}
        for (_, kind), where in zip(self._motion.shape.inputs, self.layout.inputs, strict=True):
            if not isinstance(kind, int) and _OMEGA in input_symbols(kind):
                replaced[heyoka.par[where.start + input_symbols(kind).index(_OMEGA)]] = omega
        return [(variable, heyoka.subs(rate, replaced) / omega) for variable, rate in self._motion.equations]

    @cached_property
    def _plain(self) -> Any:
        equations = self._equations
        return heyoka.taylor_adaptive(
            equations,
            np.zeros(len(equations)),
            tol=_PHASE_TOLERANCE,
            compact_mode=len(equations) > _UNROLLED_EQUATIONS,
            fast_math=True,
        )

    @cached_property
    def _tangent(self) -> Any:
        """The motion, and in each lane a tangent vector to it."""
        equations = self._equations
        size, first = len(equations), self.layout.size
        variables = [variable for variable, _ in equations]
        tangent = [heyoka.expression(f"tangent{k}") for k in range(size)]
        share = heyoka.par[first + 1]  # 1 in the lane whose tangent is that by omega
        varied = []
        for (_, rate), own in zip(equations, tangent, strict=True):
            names = {str(name) for name in heyoka.get_variables(rate)}
            others = zip(variables, tangent, strict=True)
            by_tangent = [heyoka.diff(rate, other) * part for other, part in others if str(other) in names]
            varied.append((own, heyoka.sum([heyoka.diff(rate, heyoka.par[first]) * share, *by_tangent])))
        return heyoka.taylor_adaptive_batch(
            [*equations, *varied],
            np.zeros((2 * size, _LANES)),
            tol=_PHASE_TOLERANCE,
            compact_mode=2 * size > _UNROLLED_EQUATIONS,
            fast_math=True,
        )

    def set_parameters(self, parameters: Floats) -> None:
        self._parameters[:-1] = parameters

    def turn(self, start: Floats, omega: float, phase: float) -> Turn:
        taylor, size = self._tangent, len(start)
        pars, state = taylor.pars, taylor.state
        self._parameters[-1] = omega
        pars[:-1] = self._parameters[:, None]
        most_steps = math.ceil(_MOST_STEPS * phase / (2.0 * math.pi))
        batches = -(-(size + 1) // _LANES)
        columns = np.eye(size + 1, batches * _LANES)
        for lanes in np.split(columns, batches, axis=1):
            taylor.set_time(0.0)
            pars[-1] = lanes[-1]
            state[:size] = start[:, None] / SCALE
            state[size:] = lanes[:-1]
            taylor.propagate_until(phase, max_steps=most_steps)
            if any(result[0] != heyoka.taylor_outcome.time_limit for result in taylor.propagate_res):
                return Turn(np.full(size, np.nan), np.full((size, size), np.nan), np.full(size, np.nan))
            lanes[:-1] = state[size:]
        return Turn(state[:size, 0] * SCALE, columns[:-1, :size], columns[:-1, size] * SCALE)

    def motion(self, start: Floats, omega: float, phases: Floats) -> Floats:
        taylor = self._plain
        self._parameters[-1] = omega
        taylor.pars[:] = self._parameters[: len(taylor.pars)]
        taylor.time = phases[0]
        taylor.state[:] = start / SCALE
        most_steps = math.ceil(_MOST_STEPS * float(phases[-1] - phases[0]) / (2.0 * math.pi))
        *_, states = taylor.propagate_grid(phases, max_steps=most_steps)
        result = np.full((len(phases), len(start)), np.nan)
        result[: len(states)] = states * SCALE
        return result
