"""Masses and the links between them.

A link joins two masses, or a mass and the ground or the moving base. Its elongation is d = x_first - x_second; its law is
the force in N on the first end with reversed sign (METHODS section 1): m_first x'' = -f(d, d') + ...
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import LinkwiseError, StructureError, expect, located
from linkwise.model.coefficient import Coefficient, as_coefficient, by_constructor
from linkwise.model.law import Law, LinkState
from linkwise.units import to_si

ANGLE, LENGTH = "rad", "m"
"""Units of displacements: of what turns about an axis, and of what moves along a line."""
GROUND = "ground"
"""The end of a link that is fixed in space."""
BASE = "base"
"""The end of a link that moves with a recorded or stated base motion."""

MASS_UNITS = {LENGTH: "kg", ANGLE: "kg m^2"}
"""Units of masses by those of their displacements."""

LONGEST_NAME = 200  # bytes: the name of a link is part of the names of its files, which have at most 255
_FORBIDDEN = set("[]:=/\\")  # reserved in channel names, file names and name=value pairs


@dataclass(frozen=True)
class Mass:
    """A rigid body that moves along one axis, or turns about it.

    Parameters
    ----------
    name : str
        Name of the mass.
    mass : Coefficient, float or str
        Mass in kg, or moment of inertia in kg m^2 of what turns; positive. A number is known, as is a text with a unit such as
        ``"120 g"``; an unknown mass, also written ``"unknown"``, is bounded below by 0.
    unit : {"m", "rad"}, optional
        Unit of its displacement: ``"rad"`` for a body that turns. Forces on it are moments in N m.

    Raises
    ------
    StructureError
        If the name is reserved or invalid, the mass is not positive, or there is no such unit.
    TypeError
        If the mass is neither a `Coefficient`, a number nor a text.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.Mass("sink", "120 g")
    Mass('sink', 0.12)
    >>> lw.Mass("disc", 0.02, unit="rad").mass_unit
    'kg m^2'
    """

    name: str
    mass: Coefficient
    unit: str

    def __init__(self, name: str, mass: Coefficient | float | str, unit: str = LENGTH) -> None:
        own = as_coefficient(mass, f'mass "{name}"', MASS_UNITS.get(unit, "kg"))
        vars(self).update(name=name, mass=own, unit=unit)
        check_name(self.name, "mass")
        if self.name in (GROUND, BASE):
            raise StructureError(f'"{self.name}" is reserved as an end of links; choose another name', "mass")
        where = f'mass "{self.name}"'
        if self.unit not in (LENGTH, ANGLE):
            raise StructureError(
                f'unit: a mass is displaced in "m" or, where it turns, in "rad", got {self.unit!r}; a record may be in other '
                f"units, such as x:{self.name}[deg]",
                where,
            )
        value = self.mass.value
        if value is not None and not value > 0.0:
            role = "mass" if self.mass.known else "start of the unknown mass"
            raise StructureError(f"the {role} must be positive, got {value!r} {self.mass_unit}", where)
        if not self.mass.upper > 0.0:
            got = f"{self.mass.upper!r} {self.mass_unit}"
            raise StructureError(f"the upper bound must be positive, got {got}", where)

    def __repr__(self) -> str:
        unit = "" if self.unit == LENGTH else f", unit={self.unit!r}"
        return f"Mass({self.name!r}, {_shown(self.mass)!r}{unit})"

    @property
    def mass_unit(self) -> str:
        """SI unit of its mass, which is a moment of inertia where it turns."""
        return MASS_UNITS[self.unit]


@dataclass(frozen=True)
class Link:
    """A force law between two ends.

    Parameters
    ----------
    name : str
        Name of the link.
    between : tuple of two str
        First and second end: names of masses, ``"ground"`` or ``"base"``. The elongation is d = x_first - x_second.
    law : Law or str
        Force in N on the first end, with reversed sign; a text is parsed.
    coefficients : mapping of str to Coefficient, float or str
        One coefficient for each name in the law and in the rates of its states; a number is known, and a text is read as in a
        structure file: ``"30 kN/m"``, ``"unknown"``, or ``"=nes1.alpha"`` for one that is equal to another.
    states : mapping of str to LinkState or str, optional
        The states of a link with memory, such as ``{"z": "(v - abs(v)*z)/x0"}``: the rate of each, or a `LinkState` with its
        initial value and unit too. By default those that `law` was parsed with.

    Raises
    ------
    StructureError
        If coefficients are missing or unknown to the law, or the ends are equal or no masses.
    LawError
        If the law or the rate of a state is not valid.
    TypeError
        If `between`, the law or a coefficient has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.Link("spring", ("m1", "ground"), "k*d + c*v", {"k": "30 N/mm", "c": "unknown"})
    Link('spring', ('m1', 'ground'), 'k*d + c*v', {'k': 30000.0, 'c': 'unknown'})
    """

    name: str
    between: tuple[str, str]
    law: Law
    coefficients: Mapping[str, Coefficient] = field(hash=False)
    __reduce__ = by_constructor

    def __init__(
        self,
        name: str,
        between: tuple[str, str],
        law: Law | str,
        coefficients: Mapping[str, Coefficient | float | str],
        states: Mapping[str, LinkState | str] = MappingProxyType({}),
    ) -> None:
        check_name(name, "link")
        where = f'link "{name}"'
        expect(f"{where}: law", law, Law, str)
        expect(f"{where}: coefficients", coefficients, Mapping)
        expect(f"{where}: states", states, Mapping)
        parsed = Law.parse(law) if isinstance(law, str) else law
        if states:
            with located(where):
                own = Law.parse(parsed.text, states, signals=dict(parsed.signal_units))
            parsed = replace(own, angular=parsed.angular)
        vars(self).update(name=name, between=between, law=parsed, coefficients=coefficients)
        expect(f"{where}: between", self.between, tuple, list)  # a name would be taken letter by letter
        object.__setattr__(self, "between", tuple(self.between))
        if len(self.between) != 2:
            raise StructureError(f"`between` must name two ends, got {list(self.between)}", where)
        if self.between[0] == self.between[1]:
            raise StructureError(f'both ends are "{self.between[0]}"; a link needs two different ends', where)
        missing = [name for name in self.law.coefficients if name not in self.coefficients]
        if missing:
            lines = ", ".join(f'{name} = "unknown"' for name in missing)
            missed = f"coefficients of the law {self.law.text} are missing"
            raise StructureError(f"{missed}: add {lines} (or a number)", where)
        extra = [name for name in self.coefficients if name not in self.law.coefficients]
        if extra and extra[0] in self.law.signals:
            raise StructureError(f"{extra[0]} is a coefficient and a signal; rename one of the two", where)
        if extra:
            raise StructureError(
                f"unknown coefficient {_list(extra)}; the law {self.law.text} has the coefficients "
                f"{_list(self.law.coefficients)}{near_miss(extra[0], self.law.coefficients)}",
                where,
            )
        units = self.law.units if any(isinstance(given, str) for given in coefficients.values()) else {}
        ordered = {
            key: as_coefficient(coefficients[key], f"{where}, coefficient {key}", units.get(key, ""))
            for key in self.law.coefficients
        }
        object.__setattr__(self, "coefficients", MappingProxyType(ordered))

    def __repr__(self) -> str:
        coefficients = {name: _shown(coefficient) for name, coefficient in self.coefficients.items()}
        rates = {rate.name: rate.text for rate in self.law.rates}
        memory = f", {rates!r}" if rates else ""
        return f"Link({self.name!r}, {self.between!r}, {self.law.text!r}, {coefficients!r}{memory})"

    @property
    def states(self) -> dict[str, LinkState]:
        """The states of a link with memory, by name."""
        return {rate.name: LinkState(rate.text, rate.initial, rate.unit) for rate in self.law.rates}

    @property
    def rate_texts(self) -> tuple[str, ...]:
        """The rate of each state of a link with memory, such as "z' = v - z/tau"."""
        return tuple(f"{rate.name}' = {rate.text}" for rate in self.law.rates)

    @property
    def zero_states(self) -> dict[str, float]:
        """A value of 0 for each state and signal: what `force` and `Law.partials` take for the elastic part of a law."""
        return dict.fromkeys(self.law.variables[2:], 0.0)

    def initial_state(self, name: str) -> float:
        """Initial value of a state.

        Parameters
        ----------
        name : str
            The state.

        Returns
        -------
        float
            Its initial value in SI units.

        Raises
        ------
        StructureError
            If it is unknown.
        """
        initial = self.states[name].initial
        if initial is None:
            message = f"the initial value of state {name} is unknown; give it a number, or release state:{self.name}.{name}"
            raise StructureError(message, f'link "{self.name}"')
        return initial

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of each coefficient, or the start value of an unknown. Raises StructureError if there is neither."""
        values = {}
        for name, coefficient in self.coefficients.items():
            if coefficient.value is None:
                message = f"coefficient {name} is unknown and has no start value; give it a number, or identify it first"
                raise StructureError(message, f'link "{self.name}"')
            values[name] = coefficient.value
        return values

    def force(
        self, d: ArrayLike, v: ArrayLike = 0.0, states: Mapping[str, ArrayLike] | None = None
    ) -> Floats:
        """Force of the link.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.
        states : mapping of str to array, optional
            The states of a link with memory and the signals that its law names, in SI units.

        Returns
        -------
        array
            Force in N, of the broadcast shape of d and v.

        Raises
        ------
        LawError
            If a state or a signal is not given.
        """
        return _full(self.law.force(d, v, {**self.values, **(states or {})}), d, v)

    def stiffness(self, d: ArrayLike) -> Floats:
        """Tangent stiffness at rest (v = 0).

        Parameters
        ----------
        d : array
            Elongation in m.

        Returns
        -------
        array
            Derivative of the force by d in N/m, in the shape of `d`.
        """
        return self.tangent(d)[0]

    def tangent(self, d: ArrayLike, v: ArrayLike = 0.0) -> tuple[Floats, Floats]:
        """Tangent stiffness and damping, at states and signals of 0.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.

        Returns
        -------
        tuple of two arrays
            Derivatives of the force by d in N/m and by v in N s/m, each of the broadcast shape of d and v.
        """
        partials = self.law.partials(d, v, {**self.values, **self.zero_states})
        return _full(partials.by_d, d, v), _full(partials.by_v, d, v)

    def potential(self, d: ArrayLike) -> Floats:
        """Energy stored by the law at v = 0.

        Parameters
        ----------
        d : array
            Elongation in m.

        Returns
        -------
        array
            Energy in J, zero at d = 0, in the shape of `d`.
        """
        return _full(self.law.potential(d, self.values), d, 0.0)


def _shown(coefficient: Coefficient) -> Coefficient | float | str:
    """The shortest of what a coefficient is made from."""
    plain = coefficient.plain
    return coefficient if isinstance(plain, dict) else plain


def _full(values: ArrayLike, d: ArrayLike, v: ArrayLike) -> Floats:
    """`values` in the broadcast shape of `d` and `v`: a constant law gives a single number."""
    return np.array(np.broadcast_to(values, np.broadcast_shapes(np.shape(d), np.shape(v))), dtype=float)


def _list(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def in_units_of_ends(links: tuple[Link, ...], rotations: Collection[str]) -> tuple[Link, ...]:
    """Links whose laws are moments where their ends are among the `rotations`.

    Raises StructureError for a link between a rotation and what does not turn.
    """
    in_units = []
    for link in links:
        turning = [end for end in link.between if end in rotations]
        if differ_in_unit(link.between, rotations):
            other = next(end for end in link.between if end not in turning)
            raise StructureError(
                f'the end "{turning[0]}" turns, in rad, and "{other}" moves in m: no law joins them; link two rotations, or '
                "a rotation to the ground",
                f'link "{link.name}"',
            )
        same = link.law.angular == bool(turning)
        in_units.append(link if same else replace(link, law=replace(link.law, angular=bool(turning))))
    return tuple(in_units)


def differ_in_unit(ends: tuple[str, str], rotations: Collection[str]) -> bool:
    """Whether one of two ends turns and the other moves along a line."""
    turning = [end for end in ends if end in rotations]
    return bool(turning) and any(end not in (*turning, GROUND) for end in ends)


def mass_in_si(given: float | str) -> tuple[float, str]:
    """A mass in kg and "m", or where its text is a moment of inertia in kg m^2 and "rad"; a number is in kg."""
    unit = ANGLE if is_inertia(given) else LENGTH
    return to_si(given, MASS_UNITS[unit]), unit


def is_inertia(given: object) -> bool:
    """Whether a mass is a moment of inertia: a text such as "20 g m^2", or a table with one."""
    if isinstance(given, Mapping):
        return any(is_inertia(value) for value in given.values())
    if not isinstance(given, str) or not any(character.isdigit() for character in given):
        return False
    try:
        to_si(given, MASS_UNITS[ANGLE])
    except LinkwiseError:
        return False
    return True


def check_name(name: object, kind: str) -> None:
    if not isinstance(name, str) or not name:
        raise StructureError(f"a {kind} needs a name, got {name!r}", kind)
    if name != name.strip() or not name.isprintable() or _FORBIDDEN & set(name):
        raise StructureError(
            f"{name!r} is not a valid name: leading or trailing spaces, control characters and [ ] : = / \\ are not allowed",
            kind,
        )
    if (size := len(name.encode())) > LONGEST_NAME:
        raise StructureError(f"a name has at most {LONGEST_NAME} bytes, got {name[:20]}... of {size}", kind)


COMPARISON = "the comparison with a truth"  # of terms and forces of d and v


def with_term(link: Link, form: str, unknowns: Mapping[str, Coefficient]) -> Link:
    """The link with a force more, of a form in which {0}, {1} stand for unknowns, named otherwise where names are taken."""
    names = []
    for name in unknowns:
        while name in link.coefficients or name in link.law.variables:
            name += "_"
        names.append(name)
    text, declared = form.format(*names), dict(link.law.declared)
    if declared:  # as of a mode, whose law has numbers with units
        declared |= Law.parse(text).units
    signals = dict(link.law.signal_units)
    law = Law.parse(f"{link.law.text} + {text}", link.states, units=declared, signals=signals)
    return replace(
        link, law=law, coefficients={**link.coefficients, **dict(zip(names, unknowns.values(), strict=True))}
    )


def require_rest_at_zero(links: Sequence[Link], feature: str) -> None:
    """Raise StructureError if a law names a signal, or the states of a link do not rest at 0 while its ends rest, as `feature`
    needs.
    """
    refuse_signals(links, feature, "put its mean into the law as a coefficient")
    elongations = np.concatenate([-np.logspace(-9, 0, 10), [0.0], np.logspace(-9, 0, 10)])
    for link in links:
        if not link.law.states:
            continue
        with np.errstate(all="ignore"):
            rates = link.law.state_rates(elongations, 0.0, {**link.values, **link.zero_states})
        moving = [name for name, rate in zip(link.law.states, rates, strict=True) if np.any(rate != 0.0)]
        if moving:
            raise StructureError(
                f"the state {moving[0]} does not rest at 0 while the ends of the link are at rest, which is not "
                f"supported in {feature}",
                f'link "{link.name}"',
            )


def refuse_signals(links: Iterable[Link], feature: str, instead: str) -> None:
    """Raise StructureError if a law names a signal, which `feature` does not take, and say what to do `instead`."""
    for link in links:
        if link.law.signals:
            message = f"the law names a signal ({', '.join(link.law.signals)}), which is not supported in {feature}; {instead}"
            raise StructureError(message, f'link "{link.name}"')


def refuse_memory(links: Sequence[Link], feature: str, instead: str = "use a law of d and v alone") -> None:
    """Raise StructureError if a law has states or signals, which `feature` does not take, and say what to do `instead`."""
    refuse_signals(links, feature, instead)
    for link in links:
        if link.law.states:
            states = ", ".join(link.law.states)
            message = f"the law has memory (state {states}), which is not supported in {feature}; {instead}"
            raise StructureError(message, f'link "{link.name}"')
