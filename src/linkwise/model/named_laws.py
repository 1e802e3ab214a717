"""Named laws: texts of laws from the literature, with and without memory, that a user sees and may edit.

A law is added by one entry of `NAMED_LAWS`. In a structure file the name stands in place of the law; it is replaced by
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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple, final

from linkwise.errors import StructureError
from linkwise.expression import (
    Call,
    Expression,
    Number,
    Power,
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
from linkwise.model.coefficient import Coefficient, as_coefficient
from linkwise.model.law import Law, LinkState, as_link_states
from linkwise.model.link import Link
from linkwise.registry import Registry


class LawText(NamedTuple):
    """A law as text, and the states beside it.

    Attributes
    ----------
    law : str
        The law.
    states : mapping of str to LinkState
        Its states by name; empty for a law without memory.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.model.named_law("dahl").text.law
    'q + c*v'
    """

    law: str
    states: Mapping[str, LinkState]


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
    formula : LawText or callable
        The law; for a family a function of its number of branches.
    branches : int, optional
        Number of branches by default of a family, such as the sliders of Iwan's law; 0 of a single law.
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
    formula: LawText | Callable[[int], LawText]
    branches: int = 0
    bounds: Mapping[str, tuple[float, float]] | None = None
    wider: str = ""

    @property
    def text(self) -> LawText:
        """The law and its states."""
        return self.formula if isinstance(self.formula, LawText) else self.formula(self.branches)

    @property
    def law(self) -> str:
        """The law as text."""
        return self.text.law

    @property
    def states(self) -> Mapping[str, LinkState]:
        """The states by name; empty for a law without memory."""
        return self.text.states

    def coefficient(self, name: str) -> Coefficient:
        """The coefficient of that name as an unknown within its bounds.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Coefficient
            The unknown.
        """
        return self.within_bounds(name, Coefficient.unknown())

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
        lower, upper = (self.bounds or {}).get(name, (-math.inf, math.inf))
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
        given = {key: self.coefficient(key) for key in law.coefficients}
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
    return replace(law, branches=count)


@lru_cache(maxsize=256)
def named_law_of(law: Law) -> NamedLaw | None:
    """The named law of which a law has the text and the states; None where the law is of one's own."""
    rates = {rate.name: rate.text for rate in law.rates}
    for named in map(NAMED_LAWS.lookup, NAMED_LAWS):
        for branches in range(1, _MOST_BRANCHES + 1) if named.branches and rates else (named.branches,):
            candidate = replace(named, branches=branches)
            states = {name: state.rate for name, state in candidate.states.items()}
            if candidate.law == law.text and states == rates:
                return candidate
    return None


def is_law_name(text: str) -> bool:
    """Whether a text in place of a law names one."""
    spelled = _SPELLED.fullmatch(text)
    return spelled is not None and spelled[1] in NAMED_LAWS


def _single(law: str, **rates: str | LinkState) -> LawText:
    return LawText(law, as_link_states(rates))


def _iwan(sliders: int) -> LawText:
    """Sliders over equal parts of the slip displacements up to the largest; their sums are F_S and K_T exactly."""
    largest = "FS*(1 + beta)/(KT*(beta + (chi + 1)/(chi + 2)))"
    states, force = {}, []
    for j in range(1, sliders + 1):
        upper, lower = f"({j}/{sliders})" if j < sliders else "1", f"({j - 1}/{sliders})"
        share = f"({upper}**(chi + 1) - {lower}**(chi + 1))" if j > 1 else f"{upper}**(chi + 1)"
        moment = f"({upper}**(chi + 2) - {lower}**(chi + 2))" if j > 1 else f"{upper}**(chi + 2)"
        slip = f"{largest}*(chi + 1)/(chi + 2)*{moment}/{share}"
        states[f"u{j}"] = LinkState(_stick_slip("v", f"u{j}", slip))
        force.append(f"{share}*u{j}")
    states["ub"] = LinkState(_stick_slip("v", "ub", largest))
    return LawText(f"KT/(1 + beta)*({' + '.join(force)} + beta*ub)", states)


def _stick_slip(sticking: str, state: str, largest: str) -> str:
    """A rate that is `sticking` until the state reaches its largest size, and 0 while it would exceed it."""
    return f"{sticking}*(1 - 0.25*(1 + sign(abs({state}) - {largest}))*(1 + sign({state}*v)))"


def _fractional(branches: int) -> LawText:
    """A fractional derivative as a sum over relaxation rates, evenly spaced in their logarithm (Diethelm 2008)."""
    states, force = {}, []
    for j in range(branches):
        ratio = repr(float(f"{_DECADES**j:.12g}"))
        states[f"q{j + 1}"] = LinkState(f"v - {ratio}*w*q{j + 1}")
        force.append(f"{ratio}**a*q{j + 1}")
    return LawText(f"2*K*sin(pi*a)/pi*({' + '.join(force)})", states)


_POSITIVE = (0.0, math.inf)
_SHARE = (0.0, 1.0)
_VOLTAGE = LinkState("(-theta*v - V/R)/C", unit="V")
_CURRENT = LinkState("(g*v - R*i)/L", unit="A")
_SPRING = {"k": "stiffness", "c": "damping"}
_WELLS = {"alpha": "linear stiffness, negative", "beta": "cubic stiffness", "c": "damping"}
_PIEZO = {"theta": "electromechanical coupling", "C": "capacitance", "R": "resistance of the load"}
_COIL = {"g": "electromechanical coupling", "L": "inductance", "R": "resistance of coil and load"}
_BOUC_WEN = {**_SPRING, "F": "largest hysteretic force", "x0": "elongation at which it yields", "s": "shape"}

NAMED_LAWS: Registry[NamedLaw] = Registry(
    "law",
    {
        "bouc-wen": NamedLaw(
            title="smooth hysteresis, scaled: z is between -1 and 1",
            source="Bouc 1967; Wen, J. Eng. Mech. Div. 102, 249 (1976); scaled as by Ma et al., J. Appl. Mech. 71, 342 (2004)",
            coefficients=_BOUC_WEN,
            formula=_single("k*d + c*v + F*z", z="(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"),
            bounds={"x0": _POSITIVE, "s": _SHARE},
            wider="bouc-wen-classical",
        ),
        "bouc-wen-classical": NamedLaw(
            title="smooth hysteresis whose loops may level off, or stiffen where beta + gamma < 0: z is a length",
            source="Bouc 1967; Wen, J. Eng. Mech. Div. 102, 249 (1976), with A = 1, to which stiffness beside z is redundant",
            coefficients={
                **_SPRING,
                "kh": "stiffness of the hysteretic force at z = 0",
                "beta": "shape, by abs(v)*z",
                "gamma": "shape, by v*abs(z)",
            },
            formula=_single("k*d + c*v + kh*z", z="v - beta*abs(v)*z - gamma*v*abs(z)"),
        ),
        "bouc-wen-baber-noori": NamedLaw(
            title="smooth hysteresis with pinching and degradation by the dissipated energy e",
            source="Baber and Noori, J. Eng. Mech. 111, 1010 (1985); Foliente, J. Struct. Eng. 121, 1013 (1995)",
            coefficients={
                **_BOUC_WEN,
                "nu": "loss of strength",
                "eta": "loss of stiffness",
                "zs": "total slip of the pinching",
                "p": "rate of the slip",
                "q": "residual force of the pinching",
                "psi": "magnitude of the pinching",
                "dpsi": "its growth",
                "lam": "severity of the pinching",
            },
            formula=_single(
                "k*d + c*v + F*z",
                z="(1 - zs*(1 - exp(-p*e))*exp(-(z*sign(v) - q/(1 + nu*e))**2/((psi + dpsi*e)*(lam + zs*(1 - exp(-p*e))))**2))"
                "*(v - (1 + nu*e)*(s*abs(v)*z + (1 - s)*v*abs(z)))/(x0*(1 + eta*e))",
                e="z*v/x0",
            ),
            bounds={
                **dict.fromkeys(("x0", "nu", "eta", "p", "psi", "dpsi", "lam"), _POSITIVE),
                **dict.fromkeys(("s", "zs"), _SHARE),
            },
        ),
        "backlash-slip": NamedLaw(
            title="a spring with backlash in series with a slider, beside spring and damper: z is between -1 and 1",
            source="Wen, J. Eng. Mech. Div. 102, 249 (1976), with the exponent 4, behind a dead zone",
            coefficients={
                **_SPRING,
                "F": "force at which it slides",
                "x0": "elongation at which it slides",
                "g": "share of it that is backlash",
            },
            formula=_single(
                "k*d + c*v + F*(max(z - g, 0) + min(z + g, 0))/(1 - g)",
                z="v*(1 - 0.5*(1 + sign(z*v))*z**4)/x0",
            ),
            bounds={"x0": _POSITIVE, "g": (0.0, 0.95)},
        ),
        "band-brake": NamedLaw(
            title="as backlash-slip, by the friction of a band one end of which carries a mass: n is what its tension gains",
            source="Euler, Mem. Acad. Sci. Berlin 18, 265 (1762), for the force by the tension; Wen as of backlash-slip",
            coefficients={
                **_SPRING,
                "Fp": "force at which it slides forward",
                "Fm": "force at which it slides back",
                "x0": "elongation at which it slides",
                "g": "share of it that is backlash",
                "b": "tension gained as the band moves back by x0",
                "w": "angular frequency of the mass on the band",
                "h": "its damping ratio",
            },
            formula=_single(
                "k*d + c*v + (1 + n)*(Fp*max(z - g, 0) + Fm*min(z + g, 0))/(1 - g)",
                z="(v - 0.5*v*z**4 - 0.5*abs(v)*z**3*abs(z))/x0",
                n="q - b*min(v, 0)*(1 - 0.5*z**4 + 0.5*z**3*abs(z))/x0",
                q="-w**2*n - 2*h*w*q",
            ),
            bounds={**dict.fromkeys(("Fp", "Fm", "x0", "b", "w"), _POSITIVE), "g": (0.0, 0.95), "h": _SHARE},
        ),
        "dahl": NamedLaw(
            title="friction that yields before it slides",
            source="Dahl, Aerospace Corporation TOR-0158(3107-18)-1 (1968)",
            coefficients={
                "sigma": "stiffness before sliding",
                "Fc": "friction while sliding",
                "c": "damping",
            },
            formula=_single("q + c*v", q="sigma*(v - abs(v)*q/Fc)"),
            bounds={"sigma": _POSITIVE, "Fc": _POSITIVE},
        ),
        "lugre": NamedLaw(
            title="friction of bristles with the Stribeck effect",
            source="Canudas de Wit et al., IEEE Trans. Automat. Contr. 40, 419 (1995)",
            coefficients={
                "s0": "stiffness of the bristles",
                "s1": "their damping",
                "s2": "viscous damping",
                "Fc": "friction while sliding",
                "Fs": "friction at the onset of sliding",
                "vs": "Stribeck velocity",
            },
            formula=_single(
                "s0*z + s1*(v - s0*abs(v)*z/(Fc + (Fs - Fc)*exp(-(v/vs)**2))) + s2*v",
                z="v - s0*abs(v)*z/(Fc + (Fs - Fc)*exp(-(v/vs)**2))",
            ),
            bounds=dict.fromkeys(("s0", "Fc", "Fs", "vs"), _POSITIVE),
        ),
        "jenkins": NamedLaw(
            title="a spring in series with a dry slider",
            source="Iwan, J. Appl. Mech. 33, 893 (1966)",
            coefficients={"k": "stiffness while sticking", "Fs": "force at which it slides"},
            formula=_single("q", q=_stick_slip("k*v", "q", "Fs")),
            bounds=dict.fromkeys(("k", "Fs"), _POSITIVE),
        ),
        "iwan": NamedLaw(
            title="sliders in parallel with a power law of their slip forces",
            source="Segalman, J. Appl. Mech. 72, 752 (2005)",
            coefficients={
                "FS": "force at which the joint slides",
                "KT": "stiffness while it sticks",
                "chi": "power, -1 to 0",
                "beta": "share of the last slider",
            },
            formula=_iwan,
            branches=6,
            bounds={"FS": _POSITIVE, "KT": _POSITIVE, "chi": (-1.0, 0.0), "beta": _POSITIVE},
        ),
        "maxwell": NamedLaw(
            title="a spring in series with a damper",
            source="Maxwell, Phil. Trans. R. Soc. 157, 49 (1867)",
            coefficients=_SPRING,
            formula=_single("q", q="k*(v - q/c)"),
            bounds=dict.fromkeys(("k", "c"), _POSITIVE),
        ),
        "zener": NamedLaw(
            title="a spring beside a Maxwell element: the standard linear solid",
            source="Zener, Elasticity and Anelasticity of Metals (1948)",
            coefficients={"k": "stiffness at rest", "k1": "stiffness of the branch", "c1": "its damping"},
            formula=_single("k*d + q", q="k1*(v - q/c1)"),
            bounds=dict.fromkeys(("k1", "c1"), _POSITIVE),
        ),
        "fractional": NamedLaw(
            title="a fractional derivative of d of order a over the rates w to w*exp(2*n), by n Maxwell branches",
            source="Bagley and Torvik, J. Rheol. 27, 201 (1983); Diethelm, Numer. Algorithms 47, 361 (2008)",
            coefficients={
                "K": "stiffness at the rate w",
                "a": "order of the derivative",
                "w": "lowest relaxation rate",
            },
            formula=_fractional,
            branches=5,
            bounds={"a": _SHARE, "w": _POSITIVE},
        ),
        "stribeck": NamedLaw(
            title="friction that falls from rest to sliding",
            source="Stribeck, Z. VDI 46, 1341 (1902); Bo and Pavelescu, Wear 82, 277 (1982)",
            coefficients={
                "Fc": "friction while sliding",
                "Fs": "friction at rest",
                "vs": "Stribeck velocity",
                "c": "viscous damping",
            },
            formula=_single("(Fc + (Fs - Fc)*exp(-(v/vs)**2))*sign(v) + c*v"),
            bounds={"vs": _POSITIVE},
        ),
        "hertz": NamedLaw(
            title="elastic contact of curved bodies that touch at the elongation -gap, smooth within 0.1 micrometres of it",
            source="Hertz, J. reine angew. Math. 92, 156 (1882)",
            coefficients={"kh": "contact stiffness", "gap": "distance at rest"},
            formula=_single("-0.5*kh*(1 - sign(d + gap))*((d + gap)**2 + 1e-14)**0.75"),
            bounds={"kh": _POSITIVE},
        ),
        "piezo": NamedLaw(
            title="a piezoelectric transducer on a resistor: C V' + V/R + theta v = 0",
            source="Erturk and Inman, Piezoelectric Energy Harvesting (2011)",
            coefficients={**_SPRING, **_PIEZO},
            formula=_single("k*d + c*v - theta*V", V=_VOLTAGE),
            bounds=dict.fromkeys(("C", "R"), _POSITIVE),
        ),
        "coil": NamedLaw(
            title="a magnet in a coil: L i' + R i = g v",
            source="Stephen, J. Sound Vib. 293, 409 (2006)",
            coefficients={**_SPRING, **_COIL},
            formula=_single("k*d + c*v + g*i", i=_CURRENT),
            bounds=dict.fromkeys(("L", "R"), _POSITIVE),
        ),
        "piezo-harvester": NamedLaw(
            title="a bistable link with a piezoelectric transducer on a resistor",
            source="Erturk, Hoffmann and Inman, Appl. Phys. Lett. 94, 254102 (2009)",
            coefficients={**_WELLS, **_PIEZO},
            formula=_single("alpha*d + beta*d**3 + c*v - theta*V", V=_VOLTAGE),
            bounds=dict.fromkeys(("C", "R"), _POSITIVE),
        ),
        "coil-harvester": NamedLaw(
            title="a bistable link with a magnet in a coil",
            source="Mann and Owens, J. Sound Vib. 329, 1215 (2010)",
            coefficients={**_WELLS, **_COIL},
            formula=_single("alpha*d + beta*d**3 + c*v + g*i", i=_CURRENT),
            bounds=dict.fromkeys(("L", "R"), _POSITIVE),
        ),
    },
    StructureError,
)
"""The named laws; one entry each."""


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
        case Sum(parts):
            return add(*(_replaced(part, moving, corner) for part in parts))
        case Product((factor, Sum((Call("sign", (beyond,)), unit)), Sum((Call("sign", _), _)) as way)) if (
            factor == _HALVES and unit == _ONE
        ):
            largest = _largest(beyond, moving)
            return tree if largest is None else corner(beyond, largest, way)
        case Product(factors):
            return multiply(*(_replaced(factor, moving, corner) for factor in factors))
        case Power(base, exponent):
            return power(_replaced(base, moving, corner), exponent)
    return tree


def _largest(beyond: Expression, moving: frozenset[str]) -> Expression | None:
    """The largest size of a state in `abs(state) - largest`; None where it is not of this form."""
    match beyond:
        case Sum((Call("abs", (Symbol(),)), *rest)):
            largest = multiply(Number(-1.0), add(*rest))
            return None if moving & set(symbols(largest)) else largest
    return None
