"""Families of terms by name, "cubic" and "friction(0.01)": a new one is an entry here."""

from __future__ import annotations

from dataclasses import dataclass

from linkwise.errors import IdentificationError
from linkwise.registry import Registry


@dataclass(frozen=True)
class TermFamily:
    """What a name in a list of terms stands for.

    `terms` is the list; {} in it is the number given in brackets. `argument` says what that number is, and `symbol` stands for
    it in a list of all families. `opened` is the list without a number: a name stands for a value that the discovery finds.
    `meaning` is for those who do not read it in the terms.
    """

    terms: str
    meaning: str = ""
    argument: str = ""
    symbol: str = ""
    opened: str = ""


FAMILIES: Registry[TermFamily] = Registry(
    "family",
    {
        "linear": TermFamily("v, d"),
        "cubic": TermFamily("v, d, d**2, d**3"),
        "bistable": TermFamily("v, d, d**3"),
        "quintic": TermFamily("v, d, d**2, d**3, d**4, d**5"),
        "quadratic-damping": TermFamily("v*abs(v)"),
        "friction": TermFamily(
            "tanh(v/{})",
            "dry friction that saturates at S m/s",
            argument="the rate in m/s at which it saturates",
            symbol="S",
            opened="tanh(v/v_f)",
        ),
        "stribeck": TermFamily(
            "exp(-(v/{})**2)*sign(v)",
            "friction that falls with the rate over S m/s",
            argument="the rate in m/s beyond which the added friction vanishes",
            symbol="S",
            opened="exp(-(v/v_s)**2)*sign(v)",
        ),
        "contact": TermFamily(  # both signs, since the user does not choose which end comes first
            "max(d - {}, 0), min(d + {}, 0)",
            "one-sided stops at G m, either way",
            argument="the elongation in m, of either sign, at which it closes",
            symbol="G",
            opened="max(d - d_c, 0), min(d + d_t, 0)",
        ),
        "gap": TermFamily(
            "max(d - {}, 0) + min(d + {}, 0)",
            "a stop at G m on either side",
            argument="the elongation in m at which either side closes",
            symbol="G",
            opened="max(d - d_g, 0) + min(d + d_g, 0)",
        ),
    },
    IdentificationError,
)
"""What a list of terms may name beside functions of d and v."""


def listed_families() -> list[str]:
    """A line for each family: its name, its terms and what they mean."""
    heads = [f"{name}({family.symbol})" if family.symbol else name for name, family in FAMILIES.items()]
    width = max(map(len, heads))
    return [
        f"{head:{width}s}  {family.terms.replace('{}', family.symbol)}{family.meaning and f', {family.meaning}'}"
        for head, family in zip(heads, FAMILIES.values(), strict=True)
    ]


def family_terms(text: str) -> str | None:
    """The list of terms that `text`, such as "friction(0.01)", stands for; None where it names no family.

    Raises IdentificationError if the family takes no number, or needs another one.
    """
    name, bracket, rest = text.partition("(")
    name, number = name.strip(), rest.removesuffix(")")
    if name not in FAMILIES:
        return None
    family = FAMILIES[name]
    if family.opened and not bracket:
        return family.opened
    if not family.argument:
        if bracket:
            raise IdentificationError(f"the family {name} takes no argument; got {text!r}")
        return family.terms
    if not rest.endswith(")") or not _is_positive(number):
        raise IdentificationError(
            f"the family {name} takes {family.argument}, a positive number in brackets, as in {name}(0.01); got {text!r}"
        )
    return family.terms.format(*[number] * family.terms.count("{}"))


def _is_positive(text: str) -> bool:
    try:
        return 0.0 < float(text) < float("inf")
    except ValueError:
        return False
