"""SciPy's Runge-Kutta method of order 8 (Dormand and Prince) behind the interface of integrators, where heyoka has no wheels.

The laws are evaluated by NumPy, all lanes of a batch at once. Kinks are found where they change sign within a step, by
Brent's method on the interpolant of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq

from linkwise.arrays import Bools, Floats
from linkwise.expression import Program, Symbol, add, call
from linkwise.expression.tree import as_expression
from linkwise.simulation.integrator.formulas import (
    SCALE,
    Algebra,
    CompiledSystem,
    Formula,
    MotionFormulas,
    Outcome,
    Placement,
    Propagation,
    StepRule,
    SystemShape,
)

_TOLERANCE = 1e-12  # relative, of a step
_SMALL = 1e-3  # of the largest displacement, velocity or state: below, errors are absolute
_FLOOR = 1e-18 / SCALE  # in m and m/s: motion of no interest
_LOOKS = np.array([0.25, 0.5, 0.75, 1.0])  # of a step, at which crossings are looked for
_FIRST = 1e-3  # of the longest step that is tried: where nothing tells a better one


TREES = Algebra(
    time=Symbol("time"),
    number=as_expression,
    variable=lambda name: Symbol(f"state {name}"),
    parameter=lambda index: Symbol(f"parameter {index}"),
    total=lambda parts: add(*parts),
    call=call,
)
"""Formulas as trees of expressions."""


@final
class _Evaluation:
    """Formulas (k,) as functions of time in s, of states (D, lanes) and of `parameters` (P, lanes), which it holds."""

    def __init__(
        self, formulas: Sequence[Formula], variables: Sequence[Formula], size: int, lanes: int
    ) -> None:
        self.parameters = np.zeros((size, lanes))
        self._time, self._state = np.zeros(lanes), np.zeros((len(variables), lanes))
        self._out = np.zeros((len(formulas), lanes))
        states = [variable.name for variable in variables]
        names = ["time", *states, *(f"parameter {i}" for i in range(size))]
        program = Program(formulas, names)
        arrays = [self._time, *self._state, *self.parameters]
        self._operations = program.into(arrays, list(self._out)) if formulas else []

    def __call__(self, time: float, state: Floats) -> Floats:
        """Values (k, lanes)."""
        self._time[:] = time
        self._state[...] = state.reshape(self._state.shape)
        for operation in self._operations:
            operation()
        return self._out.copy()

    def flat(self, time: float, state: Floats) -> Floats:
        """The same as a vector, of a state as a vector."""
        return self(time, state).ravel()


@final
class DormandPrince:
    """SciPy's integrator of one structure, see `formulas.Integrator`; steps end where the `watched` kinks change sign."""

    dtype: type[np.floating[Any]] = np.float64

    def __init__(self, motion: MotionFormulas, watched: Sequence[int]) -> None:
        size = motion.layout.size
        variables = [variable for variable, _ in motion.equations]
        self._rates = _Evaluation([rate for _, rate in motion.equations], variables, size, 1)
        self._kinks = _Evaluation([motion.kink_formulas[number] for number in watched], variables, size, 1)
        self._offsets = motion.layout.unwatched.start + np.array(watched, dtype=int)
        self._masses = motion.shape.masses
        self.time, self.state = 0.0, np.zeros(len(variables))
        self._step = 0.0  # s, the last one that was long enough for its error; 0 where there was none

    @property
    def parameters(self) -> NDArray[Any]:
        return self._rates.parameters[:, 0].copy()

    def place(self, placement: Placement) -> None:
        self.set_parameters(slice(None), placement.parameters)
        self.time, self.state = float(placement.time), np.array(placement.state, dtype=float)
        if self.time == 0.0:
            self._step = 0.0  # the same run takes the same steps

    def set_parameters(self, where: slice, values: NDArray[Any]) -> None:
        self._rates.parameters[where, 0] = values
        self._kinks.parameters[where, 0] = values

    def add_to_state(self, jump: NDArray[Any]) -> None:
        self.state = self.state + jump

    def propagate(self, times: NDArray[Any], rule: StepRule) -> Propagation:
        times = np.asarray(times, dtype=float)
        states, reached, steps = np.empty((len(times), len(self.state))), 0, 0
        solver = self._solver(float(times[-1]), rule.longest)
        while solver is not None and solver.status == "running":
            if rule.most and steps == rule.most:
                return Propagation(states[:reached], steps, Outcome.STEP_LIMIT)
            if not _stepped(solver):
                return Propagation(states[:reached], steps, Outcome.NOT_FINITE)
            self.time, self.state, steps = solver.t, solver.y, steps + 1
            cut = solver.status != "running"  # at the last of the times
            self._step = max(solver.step_size, self._step) if cut else solver.h_abs
            watched = len(self._offsets)
            dense = solver.dense_output() if watched or times[reached] <= solver.t else None
            kink = self._first_kink(solver.t_old, solver.t, dense) if watched else None
            if dense is not None and kink is not None:
                self.time, self.state = kink, dense(kink)
            if rule.log is not None:
                rule.log.append(self.time)
            passed = int(np.searchsorted(times, self.time, side="right"))
            if dense is not None and passed > reached:
                states[reached:passed] = dense(times[reached:passed]).T
                states[reached:passed][times[reached:passed] == self.time] = self.state
                reached = passed
            if kink is not None:
                return Propagation(states[:reached], steps, Outcome.KINK)
        if solver is None:
            states[:] = self.state
        return Propagation(states, steps, Outcome.DONE)

    def trial_step(self, fraction: float, longest: float) -> tuple[Floats, float]:
        self._step = self._step or _FIRST * longest
        solver = self._solver(self.time + longest, np.inf)
        if solver is None or not _stepped(solver):
            return self.state, self.time
        self.time, self.state = solver.t, solver.y
        time = solver.t_old + fraction * (solver.t - solver.t_old)
        return solver.dense_output()(time), time

    def _solver(self, end: float, longest: float) -> DOP853 | None:
        """A solver from here to a time; None where there is nothing to do."""
        if not end > self.time:
            return None
        absolute = _absolute(self.state, self._rates.flat(self.time, self.state), self._masses)
        first = min(self._step, longest, end - self.time) if self._step else None
        options = {"max_step": longest, "first_step": first, "rtol": _TOLERANCE, "atol": absolute}
        return DOP853(self._rates.flat, self.time, self.state, end, **options)

    def _first_kink(self, start: float, end: float, dense: Any) -> float | None:
        """The first time in a step at which a kink changes its sign."""
        offsets = self._kinks.parameters[self._offsets]
        crossings = _crossings(lambda t: self._kinks(t, dense(t)) + offsets, start, end)
        return min((time for time, _, _ in crossings), default=None)


def _stepped(solver: DOP853) -> bool:
    """Whether a step leads to a finite state."""
    solver.step()
    return solver.status != "failed" and bool(np.isfinite(solver.y).all())


def _crossings(
    function: Callable[[float], Floats], start: float, end: float
) -> Iterator[tuple[float, int, int]]:
    """When and where values (k, lanes) of a function of time change their signs in a step."""
    last, before = start, function(start)
    for look in start + _LOOKS * (end - start):
        after = function(look)
        for row, lane in np.argwhere(before * after < 0.0).tolist():
            beyond = partial(lambda t, row, lane: float(function(t)[row, lane]), row=row, lane=lane)
            yield float(brentq(beyond, last, look, xtol=1e-300, rtol=1e-15)), row, lane
        last, before = look, after


def _absolute(state: Floats, rates: Floats, masses: int) -> Floats:
    """Errors that are allowed whatever a component is: a small part of the largest one of its kind; a velocity counts as that
    of an oscillation with this displacement and acceleration.
    """
    x, v = slice(masses), slice(masses, 2 * masses)
    largest = np.abs(state)
    largest[x] = np.max(largest[x], initial=0.0)
    swing = np.sqrt(np.max(largest[x], initial=0.0) * np.max(np.abs(rates[v]), initial=0.0))
    largest[v] = max(float(np.max(largest[v], initial=0.0)), float(swing))
    largest[2 * masses :] = np.max(largest[2 * masses :], initial=0.0)
    return np.asarray(_TOLERANCE * np.maximum(_SMALL * largest, _FLOOR))


@final
class DormandPrinceBatch:
    """SciPy's integrator of several structures side by side with common steps, see `formulas.BatchIntegrator`.

    Steps are chosen by the motion; energies follow.
    """

    def __init__(self, motion: MotionFormulas, lanes: int, watched: Sequence[int]) -> None:
        self.crossings: list[list[tuple[int, float]]] = [[] for _ in watched]
        equations = [*motion.equations, *motion.energy_equations]
        size, self._motion_size = motion.layout.size + len(watched), len(motion.equations)
        variables = [variable for variable, _ in equations]
        self._rates = _Evaluation([rate for _, rate in equations], variables, size, lanes)
        levels = [
            motion.elongation(link) - motion.algebra.parameter(motion.layout.size + number)
            for number, link in enumerate(watched)
        ]
        self._levels = _Evaluation(levels, variables, size, lanes)
        self._masses, self.time = motion.shape.masses, 0.0
        self.state = np.zeros((len(equations), lanes))

    def place(self, state: Floats, parameters: Floats) -> None:
        self.time = 0.0
        self.set_parameters(slice(None), parameters)
        self.set_state(state)
        for crossings in self.crossings:
            crossings.clear()

    def set_parameters(self, where: slice, values: Floats) -> None:
        self._rates.parameters[where] = values
        self._levels.parameters[where] = values

    def set_state(self, state: Floats) -> None:
        self.state = np.array(state, dtype=float)

    def propagate(self, times: Floats, most_steps: int) -> tuple[Floats, Bools]:
        times, shape = np.asarray(times, dtype=float), self.state.shape
        states = np.full((len(times), *shape), np.nan)
        absolute = np.full(shape, np.inf)  # of energies
        rates = self._rates(self.time, self.state)
        for lane in range(shape[1]):
            of_motion = slice(self._motion_size), lane
            absolute[of_motion] = _absolute(self.state[of_motion], rates[of_motion], self._masses)
        start, errors = self.state.ravel(), {"rtol": _TOLERANCE, "atol": absolute.ravel()}
        solver = DOP853(self._rates.flat, self.time, start, times[-1], **errors)
        reached = 0
        for _ in range(most_steps):
            if solver.status != "running" or not _stepped(solver):
                break
            dense = solver.dense_output()
            if self.crossings:
                levels = partial(lambda t, dense: self._levels(t, dense(t)), dense=dense)
                for time, level, lane in _crossings(levels, solver.t_old, solver.t):
                    self.crossings[level].append((lane, time))
            passed = int(np.searchsorted(times, solver.t, side="right"))
            states[reached:passed] = dense(times[reached:passed]).T.reshape(-1, *shape)
            reached = passed
        self.time, self.state = float(solver.t), solver.y.reshape(shape).copy()
        if reached == len(times):
            states[-1] = self.state
            return states, np.zeros(shape[1], dtype=bool)
        failed = np.array(~np.isfinite(self._rates(self.time, self.state)).all(axis=0))
        if not failed.any():
            failed[np.argmax(np.abs(self.state[: self._motion_size]).max(axis=0))] = True
        return states, failed


@final
class ScipySystem(CompiledSystem):
    """The integrators of one shape, see `formulas.CompiledSystem`."""

    def __init__(self, shape: SystemShape) -> None:
        super().__init__(MotionFormulas(shape, TREES))

    def _integrator(self, *, events: bool) -> DormandPrince:
        return DormandPrince(self._motion, range(self.kinks) if events else ())

    def _batch(self, lanes: int, watched: tuple[int, ...]) -> DormandPrinceBatch:
        return DormandPrinceBatch(self._motion, lanes, watched)

    def kinks_at(self, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        self._kinks.parameters[:, 0] = parameters
        return self._kinks.flat(time, np.asarray(state, dtype=float)).reshape(2, -1)

    @cached_property
    def _kinks(self) -> _Evaluation:
        variables, size = [variable for variable, _ in self._motion.equations], self.layout.size
        return _Evaluation([*self._motion.kink_formulas, *self._motion.kink_sizes], variables, size, 1)
