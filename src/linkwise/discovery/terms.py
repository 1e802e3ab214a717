"""The terms that any link may have: functions of d and v, written out or named by family."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import Expression, symbols
from linkwise.model.law import Law

DEFAULT = "v, d, d**2, d**3"

#: What a name in a list of terms stands for; {} is the number given in brackets.
FAMILIES = {
    "linear": "v, d",
    "cubic": "v, d, d**2, d**3",
    "bistable": "v, d, d**3",
    "quintic": "v, d, d**2, d**3, d**4, d**5",
    "quadratic-damping": "v*abs(v)",
    "friction": "tanh(v/{})",
    "contact": "max(d - {}, 0), min(d + {}, 0)",  # which end comes first is not the user's choice, so both ways round
    "gap": "max(d - {}, 0) + min(d + {}, 0)",
}

_NEEDED = {
    "friction": "the rate in m/s at which it saturates",
    "contact": "the elongation in m, either way, at which it closes",
    "gap": "the elongation in m at which either side closes",
}
_PLACES = 200  # at which terms are compared, more than anybody has terms
_HUGE = 1e100  # where an exponential is beyond it nothing is compared
_DEPENDENT = 1e-9
_POWER = re.compile(r"([dv])\*\*(\d+)")
_COEFFICIENTS = {"v": "c", "d": "k", "v*abs(v)": "c2"}


@dataclass(frozen=True)
class Term:
    """A function of d and v, `text` without coefficients, and the name `coefficient` of what multiplies it."""

    text: str
    coefficient: str
    law: Law = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "law", Law.parse(self.text))

    @property
    def written(self) -> str:
        """As it stands in a law: "k3*d**3"."""
        plain = re.fullmatch(r"[\w*()./]+", self.text) and not re.search(r"[+-]", self.text)
        return f"{self.coefficient}*{self.text}" if plain else f"{self.coefficient}*({self.text})"

    @property
    def unit(self) -> str:
        """The SI unit of its coefficient."""
        return Law.parse(self.written).units[self.coefficient]

    @property
    def elastic(self) -> bool:
        """Whether it does not depend on v."""
        return "v" not in symbols(self.law.expression)


def parse_terms(text: str | Sequence[str]) -> tuple[Term, ...]:
    """The terms of a list such as "v, d, d**3" or "cubic, friction(0.01)"; families may be mixed with terms.

    Raises IdentificationError for an empty list, a name that is neither, a term that is constant, has a coefficient of its
    own, is a sum of others or no number for negative d or v, and LawError for one that cannot be read.
    """
    parts = _split(text) if isinstance(text, str) else [part.strip() for part in text]
    found: dict[Expression, Term] = {}
    for part in parts:
        for one in _expanded(part):
            _require_term(one)
            found.setdefault(Law.parse(one).expression, Term(one, _name(one, len(found))))
    if not found:
        raise IdentificationError(f'no terms are given; write a list such as "{DEFAULT}"')
    _require_independent(list(found.values()))
    names = [term.coefficient for term in found.values()]
    twice = {name for name in names if names.count(name) > 1}
    return tuple(
        Term(term.text, f"{term.coefficient}_{number}") if term.coefficient in twice else term
        for number, term in enumerate(found.values(), start=1)
    )


def _require_independent(terms: Sequence[Term]) -> None:
    """IdentificationError where one term is a sum of multiples of others, as 2*d is of d, or is no number below zero."""
    rng = np.random.default_rng(0)
    d, v = rng.choice([-1.0, 1.0], (2, _PLACES)) * 10.0 ** rng.uniform(-3.0, 3.0, (2, _PLACES))
    small = np.maximum(np.abs(d), np.abs(v)) < 1.0
    values = np.array([np.broadcast_to(term.law.force(d, v, {}), d.shape) for term in terms])
    for term, column in zip(terms, values, strict=True):
        if np.isnan(column[small]).any():
            raise IdentificationError(
                f"the term {term.text!r} is no number for some d or v below zero, and links move both ways: write it with "
                "abs and sign, as in sign(d)*sqrt(abs(d))"
            )
    values = values[:, np.all(np.abs(values) < _HUGE, axis=0)]
    columns: list[Floats] = []
    for number, (term, column) in enumerate(zip(terms, values, strict=True)):
        left = column
        for _ in range(2):  # the second time takes off what rounding left
            left = left - sum((each * (each @ left) for each in columns), start=np.zeros(len(column)))
        if np.linalg.norm(left) <= _DEPENDENT * np.linalg.norm(column):
            before = ", ".join(each.text for each in terms[:number])
            raise IdentificationError(
                f"the term {term.text!r} says nothing beside {before or 'nothing'}: it is a sum of multiples of them; "
                "leave it out"
            )
        columns.append(left / np.linalg.norm(left))


def _split(text: str) -> list[str]:
    """At the commas outside of brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def _expanded(part: str) -> list[str]:
    """A family's terms, or the term itself."""
    name, bracket, rest = part.partition("(")
    name, number = name.strip(), rest.removesuffix(")")
    if name not in FAMILIES:
        return [part]
    family = FAMILIES[name]
    if name in _NEEDED:
        if not rest.endswith(")") or not _positive(number):
            raise IdentificationError(
                f"the family {name} needs {_NEEDED[name]}, a positive number in brackets, as in {name}(0.01); got {part!r}"
            )
        return _split(family.format(*[number] * family.count("{}")))
    if bracket:
        raise IdentificationError(f"the family {name} takes no number; got {part!r}")
    return _split(family)


def _positive(text: str) -> bool:
    try:
        return 0.0 < float(text) < float("inf")
    except ValueError:
        return False


def _require_term(text: str) -> None:
    law = Law.parse(text)
    if law.coefficients:
        raise IdentificationError(
            f"the term {text!r} has the name {law.coefficients[0]!r} in it: a term is a function of d and v alone, its "
            f"coefficient is added; give a number in its place, or one of the families {', '.join(FAMILIES)}"
        )
    if not set(symbols(law.expression)) & {"d", "v"}:
        raise IdentificationError(
            f"the term {text!r} depends neither on d nor on v: a constant force is no link"
        )


def _name(text: str, place: int) -> str:
    bare = text.replace(" ", "")
    power = _POWER.fullmatch(bare)
    if power:
        return f"{'k' if power[1] == 'd' else 'c'}{power[2]}"
    if bare.startswith("tanh(v"):
        return "F"
    if bare.startswith(("max(d", "min(d")):
        return "kc" if bare.startswith("max") else "kn"
    return _COEFFICIENTS.get(bare, f"a{place + 1}")
