"""Named laws: texts of laws from the literature, with and without memory, that a user sees and may edit.

A law is added by one table of named_laws.toml. In a structure file the name stands in place of the law; it is replaced by
the text when the file is read.

Estimators round the corner between sticking and sliding over a small part of the largest force of a slider. Its rate,
`k*v*(1 - 0.25*(1 + sign(abs(q) - Fs))*(1 + sign(q*v)))`, jumps where the force reaches Fs: its derivative by Fs is 0 wherever
it exists, and an integrator with fixed steps leaves the force where the step ended that passed Fs. Estimators take a ramp in
place of the jump. It begins a little below Fs and goes on beyond it, so that a force too large is pulled back to Fs. It is
wider where the slider slides so fast that explicit steps could not follow it. Simulation ends its steps at the corner and
takes the rate as it is written.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import final

import msgspec

from linkwise.errors import StructureError
from linkwise.expression import (
    Call,
    Expression,
    Number,
    Product,
    Program,
    Sum,
    Symbol,
    add,
    call,
    differentiate,
    multiply,
    power,
    symbols,
)
from linkwise.expression.tree import children, rebuilt
from linkwise.model.coefficient import Coefficient, as_coefficient
from linkwise.model.law import Law, LinkState
from linkwise.model.link import Link
from linkwise.registry import Registry


@final
@dataclass(frozen=True, kw_only=True)
class NamedLaw:
    """A law of the literature.

    Parameters
    ----------
    title : str
        What it describes.
    source : str
        Where it comes from.
    coefficients : mapping of str to str
        Meaning of each coefficient.
    law : str, optional
        The law; of a family that with its number of branches.
    states : mapping of str to LinkState, optional
        The states by name; empty for a law without memory.
    branches : int, optional
        Number of branches of a family, such as the sliders of Iwan's law; 0 of a single law.
    bounds : mapping of str to tuple, optional
        Bounds in SI units of coefficients that have some, within which they are searched for.
    wider : str, optional
        The named law that also takes what the bounds of this one exclude; empty where there is none.

    Examples
    --------
    >>> import linkwise as lw
    >>> law = lw.model.named_law("dahl")
    >>> law.law, law.states["q"].rate
    ('q + c*v', 'sigma*(v - abs(v)*q/Fc)')
    """

    title: str
    source: str
    coefficients: Mapping[str, str]
    law: str = ""
    states: Mapping[str, LinkState] = field(default_factory=dict)
    branches: int = 0
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    wider: str = ""

    def within_bounds(self, name: str, given: Coefficient) -> Coefficient:
        """An unknown as it is given, within the bounds of the law where it has none of its own.

        Parameters
        ----------
        name : str
            Its name.
        given : Coefficient
            The coefficient. A number stays as it is, as does one that is equal to another coefficient.

        Returns
        -------
        Coefficient
            The coefficient.

        Raises
        ------
        StructureError
            If a start is outside the bounds.
        """
        lower, upper = self.bounds.get(name, (-math.inf, math.inf))
        if given.known or given.same_as is not None:
            return given
        least = given.lower if given.lower > -math.inf else lower
        return replace(given, lower=least, upper=given.upper if given.upper < math.inf else upper)

    def link(
        self,
        name: str,
        between: tuple[str, str],
        coefficients: Mapping[str, Coefficient | float] | None = None,
    ) -> Link:
        """A link with this law.

        Parameters
        ----------
        name : str
            Name of the link.
        between : tuple of two str
            Its ends.
        coefficients : mapping of str to Coefficient or float, optional
            Coefficients, within the bounds of the law where they have none; a number is known, and the others are unknown.

        Returns
        -------
        Link
            The link.

        Raises
        ------
        StructureError
            As of `Link`.

        Examples
        --------
        >>> import linkwise as lw
        >>> link = lw.model.named_law("jenkins").link("joint", ("m1", "ground"), {"k": 1e4})
        >>> [name for name, coefficient in link.coefficients.items() if not coefficient.known]
        ['Fs']
        """
        law = Law.parse(self.law, self.states)
        given = {key: self.within_bounds(key, Coefficient.unknown()) for key in law.coefficients}
        given |= {
            key: self.within_bounds(key, as_coefficient(coefficient, f'link "{name}", coefficient {key}'))
            for key, coefficient in (coefficients or {}).items()
        }
        return Link(name, between, law, given, self.states)


_SPELLED = re.compile(r"\s*([a-z]+(?:-[a-z]+)*)\s*(?:\(\s*(\d+)\s*\))?\s*")
_MOST_BRANCHES = 16  # whose force still fits the longest text of a law
_DECADES = math.exp(2.0)  # between neighbouring rates of a fractional law: errors of its sum are below 1e-3


def named_law(name: str) -> NamedLaw:
    """Look up a law of the literature.

    Parameters
    ----------
    name : str
        Its name, such as ``"bouc-wen"``; of a family also with a number of branches, ``"iwan(8)"``.

    Returns
    -------
    NamedLaw
        The law.

    Raises
    ------
    StructureError
        If there is no law of this name, or the number of branches is not possible.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.model.named_law("maxwell").law
    'q'
    """
    spelled = _SPELLED.fullmatch(name)
    if spelled is None:
        raise StructureError(f"{name!r} is not the name of a law; choose from {', '.join(NAMED_LAWS)}")
    law = NAMED_LAWS.lookup(spelled[1])
    if spelled[2] is None:
        return law
    count = int(spelled[2])
    if not law.branches:
        raise StructureError(f"{spelled[1]} has no branches, got {name!r}; write {spelled[1]}")
    if not 1 <= count <= _MOST_BRANCHES:
        raise StructureError(f"{spelled[1]} has 1 to {_MOST_BRANCHES} branches, got {count}")
    return _with_branches(spelled[1], count)


def _with_branches(name: str, count: int) -> NamedLaw:
    """A law of a family."""
    law, states = _FAMILIES[name](count)
    return replace(NAMED_LAWS[name], law=law, states=states, branches=count)


@lru_cache(maxsize=256)
def named_law_of(law: Law) -> NamedLaw | None:
    """The named law of which a law has the text and the states; None where the law is of one's own."""
    rates = {rate.name: rate.text for rate in law.rates}
    for name, named in NAMED_LAWS.items():
        counts = range(1, _MOST_BRANCHES + 1) if named.branches and rates else ()
        for candidate in [_with_branches(name, count) for count in counts] or [named]:
            states = {name: state.rate for name, state in candidate.states.items()}
            if candidate.law == law.text and states == rates:
                return candidate
    return None


def is_law_name(text: str) -> bool:
    """Whether a text in place of a law names one."""
    spelled = _SPELLED.fullmatch(text)
    return spelled is not None and spelled[1] in NAMED_LAWS


def _iwan(sliders: int) -> tuple[str, dict[str, LinkState]]:
    """Sliders over equal parts of the slip displacements up to the largest; their sums are F_S and K_T exactly."""
    largest = "FS*(1 + beta)/(KT*(beta + (chi + 1)/(chi + 2)))"
    states, force = {}, []
    for j in range(1, sliders + 1):
        upper, lower = f"({j}/{sliders})" if j < sliders else "1", f"({j - 1}/{sliders})"
        share = f"({upper}**(chi + 1) - {lower}**(chi + 1))" if j > 1 else f"{upper}**(chi + 1)"
        moment = f"({upper}**(chi + 2) - {lower}**(chi + 2))" if j > 1 else f"{upper}**(chi + 2)"
        slip = f"{largest}*(chi + 1)/(chi + 2)*{moment}/{share}"
        states[f"u{j}"] = LinkState(_stick_slip(f"u{j}", slip))
        force.append(f"{share}*u{j}")
    states["ub"] = LinkState(_stick_slip("ub", largest))
    return (f"KT/(1 + beta)*({' + '.join(force)} + beta*ub)", states)


def _stick_slip(state: str, largest: str) -> str:
    """A rate that is v until the state reaches its largest size, and 0 while it would exceed it."""
    return f"v*(1 - 0.25*(1 + sign(abs({state}) - {largest}))*(1 + sign({state}*v)))"


def _fractional(branches: int) -> tuple[str, dict[str, LinkState]]:
    """A fractional derivative as a sum over relaxation rates, evenly spaced in their logarithm (Diethelm 2008)."""
    states, force = {}, []
    for j in range(branches):
        ratio = repr(float(f"{_DECADES**j:.12g}"))
        states[f"q{j + 1}"] = LinkState(f"v - {ratio}*w*q{j + 1}")
        force.append(f"{ratio}**a*q{j + 1}")
    return (f"2*K*sin(pi*a)/pi*({' + '.join(force)})", states)


_FAMILIES = {"iwan": _iwan, "fractional": _fractional}
_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
NAMED_LAWS = Registry("law", msgspec.convert(_TABLES, dict[str, NamedLaw]), StructureError)
"""The named laws."""
NAMED_LAWS.update({name: _with_branches(name, NAMED_LAWS[name].branches) for name in _FAMILIES})


#: Of a sample: how long a force that slides fast may lag behind its corner.
LAG = 0.125
_ROUNDED = 0.03  # of the largest force; at the corner 3 % divided by e = 1.1 % of it are missing
_HALVES = Number(-0.25)  # of the product of two parts that are 0 or 2
_ONE = Number(1.0)


@lru_cache(maxsize=512)
def smooth_rates(law: Law, lag: float = 0.0) -> tuple[Expression, ...]:
    """The rates of the states of a law for an estimator; those without a slider as they are.

    A force that slides fast may lag by `lag` in s behind its corner: explicit steps not much longer follow it.
    """
    moving = frozenset(law.variables)
    rounded = []
    for rate in law.rates:
        slope = differentiate(_replaced(rate.expression, moving, lambda *_: Number(0.0)), "v")
        passed = multiply(Number(lag), call("abs", multiply(slope, Symbol("v"))))
        rounded.append(_replaced(rate.expression, moving, partial(_ramp, passed)))
    return tuple(rounded)


@lru_cache(maxsize=512)
def slider_parts(law: Law) -> Program | None:
    """What sets the states of a law, all of which are sliders, each a stiffness times d held within a largest size: from
    the coefficients all stiffnesses, then all sizes; None for other laws.
    """
    moving = frozenset(law.variables)
    stiffness, largest = [], []
    for name, rate in law.named_rates:
        own: list[Expression] = []
        sticking = _replaced(rate, moving, partial(_none_of, own, name))
        slope = differentiate(sticking, "v")
        if len(own) != 1 or moving & set(symbols(slope)) or sticking != multiply(slope, Symbol("v")):
            return None
        stiffness.append(slope)
        largest += own
    return Program([*stiffness, *largest], law.coefficients) if stiffness else None


def _ramp(passed: Expression, beyond: Expression, largest: Expression, way: Expression) -> Expression:
    """The ramp in place of the jump."""
    beyond_in_ramps = multiply(beyond, power(add(multiply(Number(_ROUNDED), largest), passed), -1))
    return multiply(Number(-0.5), call("max", Number(0.0), add(_ONE, beyond_in_ramps)), way)


def _none_of(
    largest: list[Expression], name: str, beyond: Expression, own: Expression, way: Expression
) -> Expression:
    """Nothing in place of the jump of a state; its largest size is put into `largest`."""
    forward = call("sign", multiply(Symbol(name), Symbol("v")))
    if name in symbols(beyond) and way == add(_ONE, forward):
        largest.append(own)
    return Number(0.0)


def _replaced(
    tree: Expression,
    moving: frozenset[str],
    corner: Callable[[Expression, Expression, Expression], Expression],
) -> Expression:
    """The tree with every jump of a slider replaced."""
    match tree:
        case Product((factor, Sum((Call("sign", (beyond,)), unit)), Sum((Call("sign", _), _)) as way)) if (
            factor == _HALVES and unit == _ONE
        ):
            largest = _largest(beyond, moving)
            return tree if largest is None else corner(beyond, largest, way)
        case Call():
            return tree
    return rebuilt(tree, [_replaced(below, moving, corner) for below in children(tree)])


def _largest(beyond: Expression, moving: frozenset[str]) -> Expression | None:
    """The largest size of a state in `abs(state) - largest`; None where it is not of this form."""
    match beyond:
        case Sum((Call("abs", (Symbol(),)), *rest)):
            largest = -add(*rest)
            return None if moving & set(symbols(largest)) else largest
    return None
