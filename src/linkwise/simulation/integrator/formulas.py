"""Equations of motion in the algebra of an integrator, what they are compiled for, and the interface of integrators,
of which heyoka has one where it is installed and SciPy the other.

    m s y'' = -B f(d, d'),  d = s B'y + e x_base(t),  x = s y       (METHODS section 1)

The scale s makes every y large: heyoka's step control is relative where a state exceeds one and absolute below, and a
motion of micrometres needs the same digits as one of metres. States of links with memory are scaled by the same s: their
rates are divided by it.

A law with kinks (abs, sign, max, min) is written on its smooth branches: each kink g has a run-time parameter sigma =
sign(g), and abs(g) is sigma*g.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import cache, cached_property, lru_cache
from math import prod
from pkgutil import resolve_name
from typing import Any, NamedTuple, Protocol, cast

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
    add,
    differentiate,
    kink_and_branch,
    kinks,
    symbols,
    walk,
)
from linkwise.model.law import VARIABLES, dissipated_power
from linkwise.model.structure import LinkShape, Weights

SCALE = 2.0**-40  # m, a power of two so that scaling causes no rounding


BASE_INPUT: Weights = ()
"""Where the motion of the base acts: on no mass but through links."""


class SystemShape(NamedTuple):
    """The key of compiled equations of motion; structures of equal shape share compiled code.

    `masses` is their number; `links` has for each link its weights, its law and the rates of its states, with masses numbered
    as in `Structure.topology`; `inputs` has for each driven place the weights of the masses, `BASE_INPUT` for the base, for a
    signal of laws its name, and an expression of t, whose other symbols are run-time parameters, or, for a piecewise
    polynomial, its order.
    """

    masses: int
    links: tuple[LinkShape, ...]
    inputs: tuple[tuple[Weights | str, Expression | int], ...] = ()

    @property
    def pushes(self) -> list[tuple[int, int, float]]:
        """The forces among the inputs: number of the input, of the mass, and its part."""
        places = [(number, where) for number, (where, _) in enumerate(self.inputs)]
        return [(n, mass, part) for n, where in places if not isinstance(where, str) for mass, part in where]

    @property
    def states(self) -> list[tuple[int, str]]:
        """The states of links, each as number of the link and name, in the order of the state vector."""
        return [(number, name) for number, link in enumerate(self.links) for name in link.states]


class ParameterLayout:
    """Slices of the vector of run-time parameters of a shape.

    In this order: `values`, the coefficients link by link in the order of the law; `branches`, the sign of every kink;
    `unwatched`, an offset for every kink whose crossings are not to be detected; `pieces`, for every piecewise input its start
    and its coefficients, lowest power first, and for every expression its symbols; `inverse_masses`, 1/(m s) of every mass.
    The last are used by every integrator, as heyoka requires of the last parameter.
    """

    def __init__(self, shape: SystemShape, kinks: int) -> None:
        self.coefficients = [coefficient_names(link) for link in shape.links]
        self.values = slice(0, sum(len(names) for names in self.coefficients))
        self.branches = slice(self.values.stop, self.values.stop + kinks)
        self.unwatched = slice(self.branches.stop, self.branches.stop + kinks)
        self.inputs: list[slice] = []
        end = self.unwatched.stop
        for _, kind in shape.inputs:
            width = kind + 2 if isinstance(kind, int) else len(input_symbols(kind))
            self.inputs.append(slice(end, end + width))
            end += width
        self.pieces = slice(self.unwatched.stop, end)
        self.inverse_masses = slice(end, end + shape.masses)
        self.size = end + shape.masses


def coefficient_names(link: LinkShape) -> tuple[str, ...]:
    """The coefficients of a law, and of the rates of its states, in order of appearance."""
    trees = (link.law, *(rate for _, rate in link.rates))
    names = dict.fromkeys(name for tree in trees for name in symbols(tree))
    return tuple(name for name in names if name not in (*VARIABLES, *link.states, *link.signals))


def input_symbols(tree: Expression) -> tuple[str, ...]:
    """The symbols of an input other than t, in order of appearance."""
    return tuple(name for name in symbols(tree) if name != "t")


def flat_ends(tree: Expression) -> list[Expression]:
    """Expressions whose zeros are the ends of the flat parts of functions such as exp and tanh.

    On a flat part derivatives are lost in rounding, so a Taylor step taken there would pass over what follows: a pulse in
    time, or the reversal of a steep F*tanh(v/s). Steps have to end there.
    """
    return [
        add(argument, Number(-end))
        for node in walk(tree)
        if isinstance(node, Call)
        for argument in node.arguments
        for end in FUNCTIONS[node.function].flat
    ]


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


class StepRule(NamedTuple):
    """How steps are taken: at `most` so many, or any number for 0, of at most `longest` in s; their times go to `log`."""

    most: int = 0
    longest: float = np.inf
    log: list[float] | None = None


class Integrator(Protocol):
    """An integrator of one structure; its state moves on with every propagation.

    States are scaled: displacements, velocities and states of links over `SCALE`.
    """

    dtype: type[np.floating[Any]]
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

    def propagate(self, times: NDArray[Any], rule: StepRule) -> Propagation:
        """Integrate from the current time to the last of `times` (M,) in s."""

    def trial_step(self, fraction: float, longest: float) -> tuple[Floats, float]:
        """State (2n + S,) and time in s after a `fraction` of the next step, which is at most `longest` in s.

        Time and state move on by the whole step.
        """


class BatchIntegrator(Protocol):
    """An integrator of several structures of one shape without kinks, each in a lane.

    States (2n + L + 1, lanes) are y, y', the energy in J that each link has dissipated and the work of the inputs. Parameters
    (size + W, lanes) are those of the layout and, for each of the W `watched` links, the elongation in m whose crossings are
    recorded.
    """

    crossings: list[list[tuple[int, float]]]
    """For each watched link, (lane, time in s) of its crossings."""

    @property
    def state(self) -> Floats:
        """A copy of the states, shape (2n + L + 1, lanes)."""

    def place(self, state: Floats, parameters: Floats) -> None:
        """Start at time 0 from these states and parameters, with no crossings recorded."""

    def set_parameters(self, where: slice, values: Floats) -> None:
        """Set some of the parameters, (k, lanes), or (k, 1) for the same in all lanes."""

    def set_state(self, state: Floats) -> None:
        """Set the states (2n + L + 1, lanes)."""

    def propagate(self, times: Floats, most_steps: int) -> tuple[Floats, Bools]:
        """States (M, 2n + L + 1, lanes) at `times` (M,) in s, and which lanes failed.

        If one lane fails, no longer finite or out of steps, the others may not reach the last time either.
        """


class Turn(NamedTuple):
    """The end (N,) of a motion in SI units, and its derivatives by the start (N, N) and by omega (N,) in s/rad."""

    end: Floats
    by_start: Floats
    by_omega: Floats


class PhaseIntegrator(Protocol):
    """The equations of motion of one shape without kinks over the phase of its excitation in rad.

    `parameters` (P,) are those of `ParameterLayout`; the angular frequency stands apart from them.
    """

    layout: ParameterLayout
    """The layout of the run-time parameters."""

    def set_parameters(self, parameters: Floats) -> None:
        """Set the parameters (P,)."""

    def turn(self, start: Floats, omega: float, phase: float) -> Turn:
        """The motion from `start` (N,) at phase 0 to a `phase` in rad; NaN where it diverges."""

    def motion(self, start: Floats, omega: float, phases: Floats) -> Floats:
        """(M, N) the motion from `start` at phases[0] at all `phases` (M,) in rad; NaN from where it diverges."""


class CompiledSystem(ABC):
    """The integrators of one shape, compiled on first use; one object for each thread, since they hold a state.

    `layout` is that of the run-time parameters, `kinks` the number of kinks of laws and inputs.
    """

    def __init__(self, motion: MotionFormulas) -> None:
        self._motion, self.layout, self.kinks = motion, motion.layout, motion.kinks
        self._batches: dict[tuple[int, tuple[int, ...]], BatchIntegrator] = {}

    @cached_property
    def double(self) -> Integrator:
        """The integrator in double precision, which ends its steps at kinks."""
        return self._integrator(events=True)

    @cached_property
    def without_events(self) -> Integrator:
        """The same, which does not detect kinks."""
        return self._integrator(events=False) if self.kinks else self.double

    @cached_property
    def extended(self) -> Integrator | None:
        """The integrator in 80-bit arithmetic; None where there is none, and for shapes with kinks."""
        return None

    def batch(self, lanes: int, watched: tuple[int, ...] = ()) -> BatchIntegrator:
        """The integrator of `lanes` structures of a shape without kinks, which records crossings of `watched` links."""
        if (lanes, watched) not in self._batches:
            self._batches[lanes, watched] = self._batch(lanes, watched)
        return self._batches[lanes, watched]

    def link_of(self, kink: int) -> int | None:
        """The number of the link whose law has this kink; None for an input."""
        return self._motion.link_of(kink)

    @abstractmethod
    def kinks_at(self, state: Floats, parameters: NDArray[Any], time: float) -> Floats:
        """(2, kinks) the kinks at a scaled state (2n + S,), parameters (P,) and time in s: their values, and the sizes of
        their terms, to which their rounding is relative.
        """

    @abstractmethod
    def _integrator(self, *, events: bool) -> Integrator:
        """A new integrator in double precision."""

    @abstractmethod
    def _batch(self, lanes: int, watched: tuple[int, ...]) -> BatchIntegrator:
        """A new integrator of a batch."""


Formula = Any  # of an algebra: what +, -, *, / and ** combine
_INPUT = -1  # owner of a kink of an input


class Algebra(NamedTuple):
    """How an integrator writes formulas; they are combined by the operators of Python.

    `time` is one, and functions give a constant, a component of the state by its name, a run-time parameter by its index, the
    sum of a list, and a function of `FUNCTIONS` without kinks by its name and its arguments.
    """

    time: Formula
    number: Callable[[float], Formula]
    variable: Callable[[str], Formula]
    parameter: Callable[[int], Formula]
    total: Callable[[list[Formula]], Formula]
    call: Callable[..., Formula]


class MotionFormulas:
    """The equations of motion of one shape in an algebra.

    States are y of every mass, then y', then the states of the links over s. `kinks` is the number of expressions at whose
    zeros a law, a rate or an input is not smooth, or leaves a flat part (`flat_ends`).
    """

    def __init__(self, shape: SystemShape, algebra: Algebra) -> None:
        self.shape, self.algebra = shape, algebra
        trees = [(number, link.law) for number, link in enumerate(shape.links)]
        trees += [(number, rate) for number, link in enumerate(shape.links) for _, rate in link.rates]
        trees += [(_INPUT, kind) for _, kind in shape.inputs if isinstance(kind, Expression)]
        owned = [(owner, kink) for owner, tree in trees for kink in (*kinks(tree), *flat_ends(tree))]
        self._kinks = {kink: number for number, kink in enumerate(dict.fromkeys(owned))}
        self.kinks = len(self._kinks)
        self.layout = ParameterLayout(shape, self.kinks)

    def link_of(self, kink: int) -> int | None:
        """The number of the link whose law has this kink; None for an input."""
        owner = [owner for owner, _ in self._kinks][kink]
        return None if owner == _INPUT else owner

    @cached_property
    def variables(self) -> tuple[list[Formula], list[Formula]]:
        """Symbols of y and y' of every mass."""
        numbers, variable = range(self.shape.masses), self.algebra.variable
        return [variable(f"y{i}") for i in numbers], [variable(f"u{i}") for i in numbers]

    @cached_property
    def states(self) -> dict[tuple[int, str], Formula]:
        """Symbols of the scaled states of links, each by number of the link and name."""
        return {key: self.algebra.variable(f"s{number}") for number, key in enumerate(self.shape.states)}

    @cached_property
    def equations(self) -> list[tuple[Formula, Formula]]:
        """Pairs of variable and derivative, (2n + S,)."""
        y, u = self.variables
        forces: list[list[Formula]] = [[] for _ in y]
        rates = []
        for number, link in enumerate(self.shape.links):
            names = self._link_names(number)
            force = self._translated(link.law, names, number)
            for mass, part in link.weights:
                forces[mass].append(_weighted(-part, force))
            for name, rate in link.rates:
                rates.append((self.states[number, name], self._translated(rate, names, number) / SCALE))
        for number, mass, part in self.shape.pushes:
            forces[mass].append(_weighted(part, self._input(number)[0]))
        inverse = self.layout.inverse_masses
        inverses = map(self.algebra.parameter, range(inverse.start, inverse.stop))
        accelerations = [self.algebra.total(f) * part for f, part in zip(forces, inverses, strict=True)]
        return [*zip(y, u, strict=True), *zip(u, accelerations, strict=True), *rates]

    @cached_property
    def energy_equations(self) -> list[tuple[Formula, Formula]]:
        """Equations of the energy in J that each link dissipates, and of the work of forces and base, (L + 1,)."""
        dissipated, work = [], [self.algebra.number(0.0)]
        base = [self._input(i)[1] for i, (where, _) in enumerate(self.shape.inputs) if where == BASE_INPUT]
        for number, link in enumerate(self.shape.links):
            names = self._link_names(number)
            inside = (*link.states, *link.signals)
            power = self._translated(dissipated_power(link.law, inside), names, number)
            dissipated.append((self.algebra.variable(f"h{number}"), power))
            if link.base:
                work.append(link.base * self._translated(link.law, names, number) * base[0])
        for number, mass, part in self.shape.pushes:
            work.append(SCALE * part * self._input(number)[0] * self.variables[1][mass])
        return [*dissipated, (self.algebra.variable("w"), self.algebra.total(work))]

    @cached_property
    def kink_formulas(self) -> list[Formula]:
        """The expressions whose zeros are the kinks, (kinks,)."""
        return [self._translated(kink, self._names_of(owner), owner) for owner, kink in self._kinks]

    @cached_property
    def kink_sizes(self) -> list[Formula]:
        """Sums of the sizes of the terms of `kink_formulas`, to which their rounding is relative, (kinks,)."""
        sizes = []
        for owner, kink in self._kinks:
            parts = kink.parts if isinstance(kink, Sum) else (kink,)
            terms = [self._translated(part, self._names_of(owner), owner) for part in parts]
            sizes.append(self.algebra.total([self.algebra.call("sqrt", term * term) for term in terms]))
        return sizes

    def _names_of(self, owner: int) -> dict[str, Formula]:
        """Formulas of the symbols of a link, or of the time for an input."""
        return {"t": self.algebra.time} if owner == _INPUT else self._link_names(owner)

    def elongation(self, link: int) -> Formula:
        """Elongation of a link in m."""
        return self._link_names(link)["d"]

    def _link_names(self, number: int) -> dict[str, Formula]:
        """Formulas of d, v, the states, the signals and the coefficients of a link."""
        link, inputs = self.shape.links[number], list(enumerate(self.shape.inputs))
        offset = sum(len(names) for names in self.layout.coefficients[:number])
        coefficients = enumerate(self.layout.coefficients[number], start=offset)
        names = {name: self.algebra.parameter(place) for place, name in coefficients}
        names |= {name: SCALE * self.states[number, name] for name in link.states}
        names |= {str(name): self._input(i)[0] for i, (name, _) in inputs if name in link.signals}
        base = [self._input(i) for i, (where, _) in inputs if where == BASE_INPUT]
        for name, variables, derivative in zip(("d", "v"), self.variables, (0, 1), strict=True):
            # scaled mass by mass, which the links of a mass share
            parts = [(part, SCALE * variables[mass]) for mass, part in link.weights]
            names[name] = _combination(self.algebra, parts)
            if link.base:
                names[name] = names[name] + link.base * base[0][derivative]
        return names

    def _input(self, number: int) -> tuple[Formula, Formula]:
        """An input and its derivative as functions of time."""
        _, kind = self.shape.inputs[number]
        start = self.layout.inputs[number].start
        if isinstance(kind, Expression):
            symbols_of = enumerate(input_symbols(kind))
            names = {name: self.algebra.parameter(start + k) for k, name in symbols_of}
            names["t"] = self.algebra.time
            rate = self._translated(differentiate(kind, "t"), names, _INPUT)
            return self._translated(kind, names, _INPUT), rate
        elapsed = self.algebra.time - self.algebra.parameter(start)
        value = self.algebra.parameter(start + 1 + kind)
        slope = kind * value
        for k in range(kind - 1, -1, -1):
            value = self.algebra.parameter(start + 1 + k) + elapsed * value
            if k:
                slope = k * self.algebra.parameter(start + 1 + k) + elapsed * slope
        return value, slope if kind else self.algebra.number(0.0)

    def _translated(self, tree: Expression, names: Mapping[str, Formula], owner: int) -> Formula:
        """A tree in the algebra, on the branch that the parameters sigma select."""
        sigmas = self.layout.branches.start

        def translate(node: Expression) -> Formula:
            match node:
                case Number(value):
                    return self.algebra.number(value)
                case Symbol(name):
                    return names[name]
                case Sum(parts):
                    return self.algebra.total([translate(part) for part in parts])
                case Product(factors):
                    return prod(map(translate, factors[1:]), start=translate(factors[0]))
                case Power(base, int() as exponent):
                    return _integer_power(translate(base), exponent)
                case Power(base, exponent):
                    raised = translate(exponent) if isinstance(exponent, Expression) else exponent
                    return translate(base) ** raised
                case Call(function, arguments) if FUNCTIONS[function].kink is not None:
                    kink, branch = kink_and_branch(function, arguments)
                    inner = dict(zip(("x", "y"), map(translate, arguments), strict=False))
                    return self._translated(
                        branch,
                        {**inner, "s": self.algebra.parameter(sigmas + self._kinks[owner, kink])},
                        owner,
                    )
                case Call(function, arguments):
                    return self.algebra.call(function, *map(translate, arguments))
            raise TypeError(f"not an expression: {node!r}")

        return translate(tree)


def _weighted(part: float, formula: Formula) -> Formula:
    """A formula times a number that is mostly 1 or -1."""
    if part == 1.0:
        return formula
    return -formula if part == -1.0 else part * formula


def _combination(algebra: Algebra, parts: Sequence[tuple[float, Formula]]) -> Formula:
    """A weighted sum; the difference of two, as written, where their weights are 1 and -1."""
    if [part for part, _ in parts] == [1.0, -1.0]:
        return parts[0][1] - parts[1][1]
    return algebra.total([part * formula for part, formula in parts])


def _integer_power(base: Formula, exponent: int) -> Formula:
    """An integer power by products: heyoka's own power has no Taylor series at 0."""
    if exponent < 0:
        return 1.0 / _integer_power(base, -exponent)
    if exponent == 1:
        return base
    half = _integer_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


_HOME = "linkwise.simulation.integrator"


@cache
def _of_heyoka(name: str) -> Callable[[SystemShape], Any] | None:
    """A class of `taylor`; None where there is no heyoka, or one whose libraries are not there."""
    with suppress(ImportError):
        return cast(Callable[[SystemShape], Any], resolve_name(f"{_HOME}.taylor:{name}"))
    return None


def compiled_system(shape: SystemShape) -> CompiledSystem:
    """The compiled equations of a shape, kept for this thread."""
    return system_of_thread(shape, threading.get_ident())


@lru_cache(maxsize=128)
def system_of_thread(shape: SystemShape, thread: Hashable) -> CompiledSystem:
    """The compiled equations of a shape for one thread."""
    kind = _of_heyoka("HeyokaSystem") or resolve_name(f"{_HOME}.dop853:ScipySystem")
    return cast(CompiledSystem, kind(shape))


def phase_integrator(shape: SystemShape) -> PhaseIntegrator | None:
    """The equations of a shape without kinks over phase; None where heyoka, which integrates them, is missing."""
    kind = _of_heyoka("HeyokaPhase")
    return kind and kind(shape)
