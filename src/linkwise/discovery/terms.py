"""The terms that any link may have: functions of d and v, written out or named by family."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.memory_terms import memory_laws, names_memory, plain_terms
from linkwise.discovery.term_families import FAMILIES, family_terms
from linkwise.errors import IdentificationError
from linkwise.expression import Expression, Number, symbols
from linkwise.model.law import Law

DEFAULT = "v, d, d**2, d**3"

_SAMPLES = 200  # points (d, v) at which terms are compared: more than any list has terms
_LARGEST = 1e100  # points at which a term, such as an exponential, is larger are not compared
_DEPENDENT = 1e-9  # of a term's norm: a residual below it is rounding
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_POWER = re.compile(r"([dv])\*\*(\d+)")
_COEFFICIENTS = {"v": "c", "d": "k", "v*abs(v)": "c2", "1": "f0", "sign(v)": "fc"}


@dataclass(frozen=True)
class Term:
    """A function of the elongation d and its rate v that a link may have in its law.

    Parameters
    ----------
    text : str
        The function without its coefficient, "d**3"; other names, as in "tanh(v/v_f)", are `parameters`.
    coefficient : str
        The name of the coefficient that multiplies it, "k3".

    Attributes
    ----------
    law : Law
        The function as a law.

    Examples
    --------
    >>> import linkwise as lw
    >>> [term.product for term in lw.discovery.parse_terms("d, d**3")]
    ['k*d', 'k3*d**3']
    """

    text: str
    coefficient: str
    law: Law = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "law", Law.parse(self.text))

    @property
    def product(self) -> str:
        """The term with its coefficient, as a law has it: "k3*d**3"."""
        is_factor = re.fullmatch(r"[\w*()./]+", self.text) and not re.search(r"[+-]", self.text)
        return f"{self.coefficient}*{self.text}" if is_factor else f"{self.coefficient}*({self.text})"

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names inside the function whose values a discovery finds, such as a velocity scale or a gap."""
        return self.law.coefficients

    def at(self, values: Mapping[str, float]) -> Term:
        """The term with numbers in place of its parameters.

        Parameters
        ----------
        values : mapping of str to float
            Values of the `parameters` in SI units.

        Returns
        -------
        Term
            The same function of d and v, with the same coefficient.
        """
        if not self.parameters:
            return self
        return Term(
            _NAME.sub(lambda name: _number(values.get(name[0]), name[0]), self.text), self.coefficient
        )

    def beside(self, taken: Collection[str]) -> Term:
        """The term for a law that has names already.

        Parameters
        ----------
        taken : collection of str
            Names of coefficients.

        Returns
        -------
        Term
            The same function, its coefficient and parameters named otherwise where theirs are taken.
        """
        text = _NAME.sub(
            lambda name: f"{name[0]}_added" if name[0] in {*taken} & {*self.parameters} else name[0],
            self.text,
        )
        coefficient = f"{self.coefficient}_added" if self.coefficient in taken else self.coefficient
        return self if (text, coefficient) == (self.text, self.coefficient) else Term(text, coefficient)

    @property
    def unit(self) -> str:
        """The SI unit of the coefficient."""
        return Law.parse(self.product).units[self.coefficient]

    @property
    def angular_unit(self) -> str:
        """The SI unit of the coefficient in a link between rotations."""
        return replace(Law.parse(self.product), angular=True).units[self.coefficient]

    @property
    def parameter_units(self) -> Mapping[str, str]:
        """The SI units of the `parameters`; an empty one for exponents, "?" for what the function leaves open."""
        units = Law.parse(self.product).units
        return {name: units[name] for name in self.parameters}

    @property
    def is_constant(self) -> bool:
        """Whether the term is the constant 1, a force that does not depend on the motion."""
        return self.law.expression == Number(1.0)

    @property
    def is_damping(self) -> bool:
        """Whether the term takes energy from every motion, as v, v*abs(v) and tanh(v/0.1) do."""
        if "v" not in symbols(self.law.expression):
            return False
        rng = np.random.default_rng(0)
        d, v = rng.choice([-1.0, 1.0], (2, _SAMPLES)) * 10.0 ** rng.uniform(-3.0, 0.0, (2, _SAMPLES))
        with np.errstate(all="ignore"):
            power = v * self.law.force(d, v, dict.fromkeys(self.parameters, 1.0))
        return bool(np.all(power >= 0.0) and np.any(power > 0.0))

    @property
    def elastic(self) -> bool:
        """Whether the term does not depend on v."""
        return "v" not in symbols(self.law.expression)


def parse_terms(text: str | Sequence[str]) -> tuple[Term, ...]:
    """Read a list of candidate terms for `discover`.

    Parameters
    ----------
    text : str or sequence of str
        Functions of the elongation d (m) and its rate v (m/s), and families of them, separated by commas or as a
        sequence; "1" is a constant force on each mass, from the ground or the base. Families are named, as "cubic" is, some
        with a number in brackets, such as "friction(RATE)" with the rate in m/s at which the friction saturates; the message
        about an unknown name lists them. The name of a law with memory, such as "bouc-wen", stands for its terms in d and v.
        Another name in a function, as in "tanh(v/v_f)", is a parameter whose value is found
        for each link, as it is for "friction" without a number.

    Returns
    -------
    tuple of Term
        Each function once, in the order given, with a name for its coefficient.

    Raises
    ------
    IdentificationError
        If the list is empty, or a term is constant, is linear in a parameter of its own, is a linear combination of the terms
        before it, or is undefined for negative d or v.
    LawError
        If a term is not a valid expression.

    Examples
    --------
    >>> import linkwise as lw
    >>> [term.product for term in lw.discovery.parse_terms("linear, d**3, friction(0.01)")]
    ['c*v', 'k*d', 'k3*d**3', 'F*tanh(v/0.01)']
    """
    parts = _parts(text)
    terms: dict[Expression, Term] = {}
    for part in parts:
        for function in _expand(part):
            _require_nonlinear(function)
            _require_function_of_motion(function)
            expression = Law.parse(function).expression
            terms.setdefault(expression, Term(function, _coefficient_name(function, len(terms))))
    if not terms:
        raise IdentificationError(f'the list of terms is empty; write a list such as "{DEFAULT}"')
    _require_independent([term for term in terms.values() if not term.parameters])
    names = [term.coefficient for term in terms.values()]
    repeated = {name for name in names if names.count(name) > 1}
    named = tuple(
        Term(term.text, f"{term.coefficient}_{number}") if term.coefficient in repeated else term
        for number, term in enumerate(terms.values(), start=1)
    )
    _require_own_names(named)
    return named


def _require_own_names(terms: Sequence[Term]) -> None:
    """IdentificationError if a parameter has the name of one of another term, or of a coefficient."""
    names = {term.coefficient for term in terms}
    for term in terms:
        shared = names & set(term.parameters)
        if shared:
            raise IdentificationError(
                f"the name {min(shared)!r} in the term {term.text!r} is that of a coefficient, or of a parameter of another "
                f"term; choose another, as in {_renamed(term.text, min(shared))!r}"
            )
        names |= set(term.parameters)


def _renamed(text: str, name: str) -> str:
    return _NAME.sub(lambda match: f"{name}_2" if match[0] == name else match[0], text)


def _number(value: float | None, name: str) -> str:
    """A number as an expression has it, or the name where there is none."""
    if value is None:
        return name
    return repr(float(value)) if value >= 0.0 else f"({float(value)!r})"


def _require_independent(terms: Sequence[Term]) -> None:
    """IdentificationError if a term is undefined for negative d or v, or a linear combination of the terms before it.

    Gram-Schmidt orthogonalisation of the terms' values at random points (d, v).
    """
    rng = np.random.default_rng(0)
    d, v = rng.choice([-1.0, 1.0], (2, _SAMPLES)) * 10.0 ** rng.uniform(-3.0, 3.0, (2, _SAMPLES))
    small = np.maximum(np.abs(d), np.abs(v)) < 1.0
    values = np.array([np.broadcast_to(term.law.force(d, v, {}), d.shape) for term in terms])
    for term, column in zip(terms, values, strict=True):
        if np.isnan(column[small]).any():
            raise IdentificationError(
                f"the term {term.text!r} is not a number for some negative d or v, and links move both ways; write it with "
                "abs and sign, as in sign(d)*sqrt(abs(d))"
            )
    values = values[:, np.all(np.abs(values) < _LARGEST, axis=0)]
    basis: list[Floats] = []
    for number, (term, column) in enumerate(zip(terms, values, strict=True)):
        residual = column
        for _ in range(2):  # the second pass removes the rounding error of the first
            residual = residual - sum(
                (vector * (vector @ residual) for vector in basis), start=np.zeros(len(column))
            )
        if np.linalg.norm(residual) <= _DEPENDENT * np.linalg.norm(column):
            before = ", ".join(earlier.text for earlier in terms[:number])
            raise IdentificationError(
                f"the term {term.text!r} is a linear combination of {before or 'no terms (it is zero)'}; leave it out"
            )
        basis.append(residual / np.linalg.norm(residual))


def offered_memory(text: str | Sequence[str]) -> tuple[str, ...]:
    """The named laws with memory in a list of candidate terms, each once."""
    return tuple(dict.fromkeys(part for part in _parts(text) if names_memory(part)))


def _parts(text: str | Sequence[str]) -> list[str]:
    return _split(text) if isinstance(text, str) else [part.strip() for part in text]


def _split(text: str) -> list[str]:
    """The parts of a list: between commas that are outside of brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def _expand(part: str) -> list[str]:
    """The terms of a family, those beside the states of a law with memory, or the term itself."""
    if names_memory(part):
        return plain_terms(part)
    family = family_terms(part)
    return [part] if family is None else _split(family)


def _require_function_of_motion(text: str) -> None:
    """IdentificationError if a term depends neither on d nor on v and is not the constant 1."""
    law = Law.parse(text)
    if not set(symbols(law.expression)) & {"d", "v"} and law.expression != Number(1.0):
        raise IdentificationError(
            f"the term {text!r} depends neither on d nor on v; write 1 for a constant force on the masses"
        )


def _require_nonlinear(text: str) -> None:
    """IdentificationError if a term is linear in one of its names: that would be a second coefficient."""
    linear = Law.parse(text).linear
    if linear:
        raise IdentificationError(
            f"the term {text!r} contains the name {linear[0]!r}: a term is a function of d and v alone, its coefficient is "
            "added; write a number, a name inside a function, as in tanh(v/v_0), or one of the families "
            f"{', '.join(FAMILIES)}, or one of the laws with memory {', '.join(memory_laws())}"
        )


def _coefficient_name(text: str, number: int) -> str:
    """The usual name of a term's coefficient; "a" and its number in the list for a term that has none."""
    compact = text.replace(" ", "")
    power = _POWER.fullmatch(compact)
    if power:
        return f"{'k' if power[1] == 'd' else 'c'}{power[2]}"
    if compact.startswith("tanh(v"):
        return "F"
    if compact.startswith(("max(d", "min(d")):
        return "kc" if compact.startswith("max") else "kn"
    return _COEFFICIENTS.get(compact, f"a{number + 1}")
