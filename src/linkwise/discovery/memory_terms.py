"""Laws with memory in a list of terms: a name such as "bouc-wen" offers its states to every link.

Of a named law the summands that contain a state are the part with memory. The others are terms like any other: they join the
list of terms, and are selected one by one.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from linkwise.discovery.term_families import FAMILIES
from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.named_laws import NAMED_LAWS, NamedLaw, is_law_name, named_law

#: Tried where no selection of terms leaves only noise, and none was named: slip that yields smoothly, friction, relaxation.
USUAL = ("bouc-wen", "dahl", "zener")

_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_TERM = re.compile(r"\w+\*(.+)")


def memory_laws() -> tuple[str, ...]:
    """The names of the laws with memory that a list of terms may contain."""
    return tuple(name for name in NAMED_LAWS if _is_offered(NAMED_LAWS.lookup(name)))


def _is_offered(law: NamedLaw) -> bool:
    """Whether a law has states, none of which is electrical: only a channel of such a state determines its scale."""
    return bool(law.states) and not any(state.unit for state in law.states.values())


def names_memory(text: str) -> bool:
    """Whether an entry of a list of terms names a law with memory.

    Raises IdentificationError where the law has an electrical state.
    """
    if text.partition("(")[0].strip() in FAMILIES or not is_law_name(text):
        return False
    law = named_law(text)
    if law.states and not _is_offered(law):
        raise IdentificationError(
            f"{text} has an electrical state, whose scale the motion does not determine; identify a structure "
            f"with that law, and with the channel of the state. Laws with memory that can be offered are "
            f"{', '.join(memory_laws())}"
        )
    return bool(law.states)


def plain_terms(name: str) -> list[str]:
    """The functions of d and v beside the states in a named law: "d" and "v" of "bouc-wen"."""
    law = named_law(name)
    matches = (_TERM.fullmatch(summand) for summand in _summands(law.law) if not _remembers(summand, law))
    return [match[1] for match in matches if match is not None]


def link_with_memory(name: str, between: tuple[str, str], law: str, reserved: Collection[str]) -> Link:
    """A link with the part of a named law that contains its states.

    Coefficients are unknown, and have other names where theirs are `reserved`.
    """
    named = named_law(law)
    text = " + ".join(summand for summand in _summands(named.law) if _remembers(summand, named))
    state = next(iter(named.states))
    coefficients = Law.parse(text, named.states).coefficients
    renamed = {old: f"{old}_{state}" for old in coefficients if old in reserved}
    states = {key: replace(value, rate=_renamed(value.rate, renamed)) for key, value in named.states.items()}
    return Link(
        name,
        between,
        Law.parse(_renamed(text, renamed), states),
        {renamed.get(old, old): named.within_bounds(old, Coefficient.unknown()) for old in coefficients},
        states,
    )


def _renamed(text: str, names: dict[str, str]) -> str:
    return _NAME.sub(lambda match: names.get(match[0], match[0]), text)


def _remembers(summand: str, law: NamedLaw) -> bool:
    return not set(symbols(Law.parse(summand).expression)).isdisjoint(law.states)


def _summands(text: str) -> Sequence[str]:
    """The summands of a law, without the brackets of others."""
    return tuple(_split_sum(text))


def _split_sum(text: str) -> Iterator[str]:
    depth = begin = 0
    for place, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0 and text.startswith(" + ", place):
            yield text[begin:place]
            begin = place + 3
    yield text[begin:]
