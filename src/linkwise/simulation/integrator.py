"""The one door to the integrator: a structure's shape in, compiled equations of motion out.

heyoka's Taylor method needs the equations as symbols once; masses, coefficients and inputs are run-time parameters, so all
structures of one shape share what was compiled for the first (`equations`, cached).

    m s y'' = -B f(d, d'),  d = s B'y + e x_base(t),  x = s y       (METHODS section 1)

The scale s makes every y large: heyoka's step control is relative where a state exceeds one and absolute below, and a
motion of micrometres deserves the same digits as one of metres.

A law with kinks (abs, sign, max, min) is compiled on its smooth branches: each kink g has a parameter sigma = sign(g), abs(g)
is written sigma*g, and an event ends the step where g changes sign, so that the method keeps its order.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import heyoka
import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats
from linkwise.expression import (
    FUNCTIONS,
    Call,
    Expression,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
    differentiate,
    kink_and_branch,
    kinks,
    symbols,
)
from linkwise.simulation.shape import SCALE, ParameterLayout, Shape, edges, power_lost

Formula = Any  # heyoka.expression: the library ships no types

TOLERANCE = 1e-14  # truncation per step, relative to the largest state: order 18, whose remainder is 1e-16
EXTENDED_TOLERANCE = 1e-16  # order 20, enough for 80-bit arithmetic: the method stays far below its tolerance
UNROLLED = 12  # masses up to which the step is compiled without loops: twice as fast, compiles longer


class CompiledSystem:
    """The equations of motion of one shape, compiled; one object a thread, since a run leaves its state in it.

    State vectors are (2n,): y of every mass, then y'. `kinks` is the number of places where a law or an input bends, or wakes
    up (`edges`).
    """

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        trees = [(link, law) for link, (_, _, law) in enumerate(shape.links)]
        trees += [(-1, kind) for _, kind in shape.inputs if isinstance(kind, Expression)]
        bends = [(owner, kink) for owner, tree in trees for kink in (*kinks(tree), *edges(tree))]
        self._bends = {bend: number for number, bend in enumerate(dict.fromkeys(bends))}
        self.kinks = len(self._bends)
        self.layout = ParameterLayout(shape, self.kinks)
        self._batches: dict[tuple[int, tuple[int, ...]], BatchIntegrator] = {}

    def owner(self, kink: int) -> int:
        """The number of the link whose law has this kink; -1 for an input."""
        return [link for link, _ in self._bends][kink]

    @cached_property
    def _symbols(self) -> tuple[list[Formula], list[Formula]]:
        numbers = range(self.shape.masses)
        return [heyoka.expression(f"y{i}") for i in numbers], [heyoka.expression(f"u{i}") for i in numbers]

    @cached_property
    def system(self) -> list[tuple[Formula, Formula]]:
        """The equations as heyoka wants them."""
        y, u = self._symbols
        forces: list[list[Formula]] = [[] for _ in y]
        for number, (first, second, law) in enumerate(self.shape.links):
            force = self._translate(law, self._link_names(number), number)
            if first >= 0:
                forces[first].append(-force)
            if second >= 0:
                forces[second].append(force)
        for number, (mass, _) in enumerate(self.shape.inputs):
            if mass >= 0:
                forces[mass].append(self._input(number)[0])
        inverse = self.layout.inverse_masses.start
        accelerations = [heyoka.sum(f) * heyoka.par[inverse + i] for i, f in enumerate(forces)]
        return [*zip(y, u, strict=True), *zip(u, accelerations, strict=True)]

    def _link_names(self, number: int) -> dict[str, Formula]:
        """What a law's d, v and coefficients are."""
        first, second, _ = self.shape.links[number]
        offset = sum(len(names) for names in self.layout.coefficients[:number])
        names = {name: heyoka.par[offset + k] for k, name in enumerate(self.layout.coefficients[number])}
        base = [self._input(i) for i, (mass, _) in enumerate(self.shape.inputs) if mass == -2]
        for name, of, at in zip(("d", "v"), self._symbols, (0, 1), strict=True):
            ends = [(sign, of[end]) for sign, end in ((1.0, first), (-1.0, second)) if end >= 0]
            moving = ends[0][1] - ends[1][1] if len(ends) == 2 else ends[0][0] * ends[0][1]
            names[name] = SCALE * moving
            if -2 in (first, second):
                names[name] = names[name] + (1.0 if first == -2 else -1.0) * base[0][at]
        return names

    def _input(self, number: int) -> tuple[Formula, Formula]:
        """An input and its derivative as functions of time."""
        _, kind = self.shape.inputs[number]
        if isinstance(kind, Expression):
            clock = {"t": heyoka.time}
            return self._translate(kind, clock, -1), self._translate(differentiate(kind, "t"), clock, -1)
        place = self.layout.inputs[number].start
        elapsed = heyoka.time - heyoka.par[place]
        value = heyoka.par[place + 1 + kind]
        slope = kind * value
        for k in range(kind - 1, -1, -1):
            value = heyoka.par[place + 1 + k] + elapsed * value
            if k:
                slope = k * heyoka.par[place + 1 + k] + elapsed * slope
        return value, slope if kind else heyoka.expression(0.0)

    def _translate(self, tree: Expression, names: Mapping[str, Formula], owner: int) -> Formula:
        """A tree as a heyoka expression on the branch that the parameters sigma choose."""

        def of(node: Expression) -> Formula:
            match node:
                case Number(value):
                    return heyoka.expression(value)
                case Symbol(name):
                    return names[name]
                case Sum(parts):
                    return heyoka.sum([of(part) for part in parts])
                case Product(factors):
                    return _product([of(factor) for factor in factors])
                case Power(base, int() as exponent):
                    return _power(of(base), exponent)
                case Power(base, exponent):
                    return of(base) ** (of(exponent) if isinstance(exponent, Expression) else exponent)
                case Call(function, arguments) if FUNCTIONS[function].kink is not None:
                    kink, branch = kink_and_branch(function, arguments)
                    inner = dict(zip(("x", "y"), map(of, arguments), strict=False))
                    return self._translate(branch, {**inner, "s": self._branch(owner, kink)}, owner)
                case Call(function, arguments):
                    return getattr(heyoka, FUNCTIONS[function].integrator or function)(*map(of, arguments))
            raise TypeError(f"no expression: {node!r}")

        return of(tree)

    def _branch(self, owner: int, kink: Expression) -> Formula:
        return heyoka.par[self.layout.branches.start + self._bends[owner, kink]]

    @cached_property
    def _bend_formulas(self) -> list[Formula]:
        clock = {"t": heyoka.time}
        return [
            self._translate(kink, self._link_names(owner) if owner >= 0 else clock, owner)
            for owner, kink in self._bends
        ]

    @property
    def _events(self) -> list[Any]:
        """The kinks that the motion or time can cross; one of coefficients alone keeps its sign."""
        first = self.layout.muted.start
        return [
            heyoka.t_event(
                formula + heyoka.par[first + number], cooldown=0.0
            )  # kinks.settle leaves them behind
            for (_, kink), (number, formula) in zip(self._bends, enumerate(self._bend_formulas), strict=True)
            if {"d", "v", "t"} & set(symbols(kink))
        ]

    @cached_property
    def double(self) -> Any:
        """The Taylor integrator in double precision, ending its steps at kinks."""
        return self._compile(self._events)

    @cached_property
    def blind(self) -> Any:
        """The same, without an eye for kinks."""
        return self._compile([]) if self.kinks else self.double

    def _compile(self, events: list[Any]) -> Any:
        return heyoka.taylor_adaptive(
            self.system,
            np.zeros(2 * self.shape.masses),
            pars=np.zeros(self.layout.size),
            tol=TOLERANCE,
            fast_math=not self.kinks,  # reassociates sums, a third faster; but events have to find exact zeros
            compact_mode=self.shape.masses > UNROLLED,
            t_events=events,
        )

    def batch(self, lanes: int, watched: tuple[int, ...] = ()) -> BatchIntegrator:
        """The integrator of `lanes` structures side by side, for a shape without kinks.

        Its states (2n + L + 1, lanes) are y, y', the energy in J that each link has dissipated and the work of the inputs;
        parameters (size + W, lanes) those of the layout, then for each of the W `watched` links the elongation in m at whose
        passages the time is noted.
        """
        if (lanes, watched) not in self._batches:
            passages: list[list[tuple[int, float]]] = [[] for _ in watched]
            elongations = (self._link_names(link)["d"] for link in watched)
            self._batches[lanes, watched] = BatchIntegrator(
                heyoka.taylor_adaptive_batch(
                    [*self.system, *self._accounts],
                    np.zeros((len(self.system) + len(self._accounts), lanes)),
                    pars=np.zeros((self.layout.size + len(watched), lanes)),
                    tol=TOLERANCE,
                    fast_math=True,
                    compact_mode=self.shape.masses > UNROLLED,
                    nt_events=[
                        heyoka.nt_event_batch(
                            d - heyoka.par[self.layout.size + k], callback=_noting(passages[k])
                        )
                        for k, d in enumerate(elongations)
                    ],
                ),
                passages,
            )
        return self._batches[lanes, watched]

    @cached_property
    def _accounts(self) -> list[tuple[Formula, Formula]]:
        """CompiledSystem of the energies: heat of every link, then the work of forces and base."""
        heat, work = [], [heyoka.expression(0.0)]
        base = [self._input(i)[1] for i, (mass, _) in enumerate(self.shape.inputs) if mass == -2]
        for number, (first, second, law) in enumerate(self.shape.links):
            names = self._link_names(number)
            heat.append((heyoka.expression(f"h{number}"), self._translate(power_lost(law), names, number)))
            if -2 in (first, second):
                work.append((1.0 if first == -2 else -1.0) * self._translate(law, names, number) * base[0])
        for number, (mass, _) in enumerate(self.shape.inputs):
            if mass >= 0:
                work.append(SCALE * self._input(number)[0] * self._symbols[1][mass])
        return [*heat, (heyoka.expression("w"), heyoka.sum(work))]

    @cached_property
    def extended(self) -> Any | None:
        """The integrator in 80-bit arithmetic; None where the machine has none, and for shapes with kinks."""
        if self.kinks or not hasattr(heyoka, "taylor_adaptive_ldbl") or np.finfo(np.longdouble).eps > 1e-18:
            return None
        return heyoka.taylor_adaptive(
            self.system,
            np.zeros(2 * self.shape.masses, dtype=np.longdouble),
            pars=list(np.zeros(self.layout.size, dtype=np.longdouble)),
            tol=np.longdouble(EXTENDED_TOLERANCE),
            compact_mode=True,
            fp_type=np.longdouble,
        )

    @cached_property
    def _bend_values(self) -> Any:
        return heyoka.cfunc(self._bend_formulas, vars=[*self._symbols[0], *self._symbols[1]])

    def bends(self, state: Floats, parameters: Floats, time: float) -> Floats:
        """(kinks,) values of the kinks."""
        values = self._bend_values
        clock = {"time": time} if values.is_time_dependent else {}
        return np.asarray(values(state, pars=parameters[: values.nparams], **clock), dtype=float)


def _product(factors: Sequence[Formula]) -> Formula:
    product = factors[0]
    for factor in factors[1:]:
        product = product * factor
    return product


def _power(base: Formula, exponent: int) -> Formula:
    """An integer power by products: heyoka's own power has no Taylor series at 0."""
    if exponent < 0:
        return 1.0 / _power(base, -exponent)
    if exponent == 1:
        return base
    half = _power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


@dataclass(frozen=True, eq=False)
class BatchIntegrator:
    """An integrator of several structures, and where it notes (lane, time in s) of each watched passage."""

    integrator: Any
    passages: list[list[tuple[int, float]]]

    def propagate(self, grid: Floats, most_steps: int) -> tuple[Floats, Bools]:
        """States (M, variables, lanes) at `grid` (M,), whose first time is where the lanes stand, and which lanes failed.

        Where one lane fails, no longer finite or out of steps, the others may not come to the end either.
        """
        times = np.repeat(grid[:, None], self.integrator.batch_size, axis=1)
        times[0] = self.integrator.time
        _, states = self.integrator.propagate_grid(times, most_steps)
        bad = (heyoka.taylor_outcome.err_nf_state, heyoka.taylor_outcome.step_limit)
        return states, np.array([result[0] in bad for result in self.integrator.propagate_res])


def _noting(times: list[tuple[int, float]]) -> Callable[[Any, float, int, int], None]:
    """What notes lane and time of a passage: a function, since heyoka copies objects and would note in the copy."""
    return lambda _, time, __, lane: times.append((lane, time))


def equations(shape: Shape) -> CompiledSystem:
    """The compiled equations of a shape; compiled once a thread and kept."""
    return _equations(shape, threading.get_ident())


@lru_cache(maxsize=128)
def _equations(shape: Shape, thread: Hashable) -> CompiledSystem:
    return CompiledSystem(shape)


def compilations() -> int:
    """How many shapes have been compiled since the start of the process or the last `forget`."""
    return _equations.cache_info().misses


def forget() -> None:
    """Drop everything compiled."""
    _equations.cache_clear()


@dataclass(frozen=True)
class PropagationResult:
    """What one call of `propagate` did: `states` (M, 2n) at the requested times that were reached, the time it came to, the
    number of steps, and why it ended.
    """

    states: NDArray[Any]
    time: float
    steps: int
    ended: str  # "done", "steps", "kink", "not finite"


def propagate(
    integrator: Any,
    grid: NDArray[Any],
    *,
    most_steps: int = 0,
    longest_step: float = np.inf,
    log: list[float] | None = None,
) -> PropagationResult:
    """Run an integrator over `grid` (M,), whose first time is where it stands; its state and time move on.

    The time after every step is added to `log`, if there is one.
    """
    callback = None if log is None else _Logger(log)
    outcome, _, _, steps, *_, states = integrator.propagate_grid(
        grid, most_steps, grid.dtype.type(longest_step), callback
    )
    if outcome == heyoka.taylor_outcome.time_limit:
        ended = "done"
    elif outcome == heyoka.taylor_outcome.step_limit:
        ended = "steps"
    elif outcome == heyoka.taylor_outcome.err_nf_state:
        ended = "not finite"
    else:
        ended = "kink"
    return PropagationResult(states, float(integrator.time), steps, ended)


@dataclass(frozen=True)
class _Logger:
    """A step callback that notes times."""

    log: list[float]

    def __call__(self, integrator: Any) -> bool:
        self.log.append(float(integrator.time))
        return True


def last_finite(integrator: Any, time: float, state: NDArray[Any]) -> tuple[float, NDArray[Any]]:
    """Time and state before the first step from `state` that leaves the finite numbers."""
    integrator.time, integrator.state[:] = integrator.state.dtype.type(time), state
    for _ in range(100_000):
        outcome, _ = integrator.step()
        if outcome == heyoka.taylor_outcome.err_nf_state or not np.all(np.isfinite(integrator.state)):
            break
        time, state = float(integrator.time), integrator.state.copy()
    return time, state


def trial_step(integrator: Any, part: float, longest: float) -> tuple[Floats, float]:
    """State and time after a `part` of the step that the integrator would take, at most `longest` in s; it moves on."""
    start = float(integrator.time)
    integrator.step(max_delta_t=longest, write_tc=True)
    moment = start + part * float(integrator.last_h)
    return integrator.update_d_output(moment).copy(), moment
