"""The terms that any link may have: functions of d and v, written out, named by family, or offered with a law with memory.

A family, "cubic" or "friction(0.01)", stands for a list of terms: a new one is an entry of `FAMILIES`. Of a named law with
memory, such as "bouc-wen", the summands that contain a state are the part with memory, which links are offered as a whole; the
others are terms like any other: they join the list, and are selected one by one.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import Expression, Number, symbols
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.named_laws import NAMED_LAWS, NamedLaw, is_law_name, named_law
from linkwise.registry import Registry

#: Tried where no selection of terms leaves only noise, and none was named: slip that yields smoothly, friction, relaxation.
USUAL = ("bouc-wen", "dahl", "zener")
_TERM = re.compile(r"\w+\*(.+)")
DEFAULT = "v, d, d**2, d**3"
_SAMPLES = 200  # points (d, v) at which terms are compared: more than any list has terms
_LARGEST = 1e100  # points at which a term, such as an exponential, is larger are not compared
_DEPENDENT = 1e-9  # of a term's norm: a residual below it is rounding
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_VALUE = re.compile(r"\b[dv]_\w")  # in the terms of a family
_POWER = re.compile(r"([dv])\*\*(\d+)")
_COEFFICIENTS = {"v": "c", "d": "k", "v*abs(v)": "c2", "1": "f0", "sign(v)": "fc"}


@dataclass(frozen=True)
class TermFamily:
    """What a name in a list of terms stands for.

    `terms` is the list, in which names such as v_f stand for values that the discovery finds, or for the number that is given
    in brackets. `argument` says what that is, and `symbol` stands for it in a list of all families. `meaning` is for those who
    do not read it in the terms.
    """

    terms: str
    meaning: str = ""
    argument: str = ""
    symbol: str = ""


FAMILIES: Registry[TermFamily] = Registry(
    "family",
    {
        "linear": TermFamily("v, d"),
        "cubic": TermFamily("v, d, d**2, d**3"),
        "bistable": TermFamily("v, d, d**3"),
        "quintic": TermFamily("v, d, d**2, d**3, d**4, d**5"),
        "quadratic-damping": TermFamily("v*abs(v)"),
        "friction": TermFamily(
            "tanh(v/v_f)",
            "dry friction that saturates at S m/s",
            argument="the rate in m/s at which it saturates",
            symbol="S",
        ),
        "stribeck": TermFamily(
            "exp(-(v/v_s)**2)*sign(v)",
            "friction that falls with the rate over S m/s",
            argument="the rate in m/s beyond which the added friction vanishes",
            symbol="S",
        ),
        "contact": TermFamily(  # both signs, since the user does not choose which end comes first
            "max(d - d_c, 0), min(d + d_t, 0)",
            "one-sided stops at G m, either way",
            argument="the elongation in m, of either sign, at which it closes",
            symbol="G",
        ),
        "gap": TermFamily(
            "max(d - d_g, 0) + min(d + d_g, 0)",
            "a stop at G m on either side",
            argument="the elongation in m at which either side closes",
            symbol="G",
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
        f"{head:{width}s}  {_VALUE.sub(family.symbol, family.terms)}{family.meaning and f', {family.meaning}'}"
        for head, family in zip(heads, FAMILIES.values(), strict=True)
    ]


def _is_positive(text: str) -> bool:
    try:
        return 0.0 < float(text) < float("inf")
    except ValueError:
        return False


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
    summands = _split(law.law, " + ")
    matches = (_TERM.fullmatch(summand) for summand in summands if not _remembers(summand, law))
    return [match[1] for match in matches if match is not None]


def link_with_memory(name: str, between: tuple[str, str], law: str, reserved: Collection[str]) -> Link:
    """A link with the part of a named law that contains its states.

    Coefficients are unknown, and have other names where theirs are `reserved`.
    """
    named = named_law(law)
    text = " + ".join(summand for summand in _split(named.law, " + ") if _remembers(summand, named))
    state = next(iter(named.states))
    coefficients = Law.parse(text, named.states).coefficients
    renamed = {old: f"{old}_{state}" for old in coefficients if old in reserved}
    states = {key: replace(own, rate=_with_names(own.rate, renamed)) for key, own in named.states.items()}
    return Link(
        name,
        between,
        Law.parse(_with_names(text, renamed), states),
        {renamed.get(old, old): named.within_bounds(old, Coefficient.unknown()) for old in coefficients},
        states,
    )


def _with_names(text: str, names: Mapping[str, str]) -> str:
    """A function with other names, or numbers, in place of some."""
    return _NAME.sub(lambda match: names.get(match[0], match[0]), text)


def _remembers(summand: str, law: NamedLaw) -> bool:
    return not set(symbols(Law.parse(summand).expression)).isdisjoint(law.states)


@dataclass(frozen=True)
class Term:
    """A function of the elongation d, its rate v and recorded signals that a link may have in its law.

    Parameters
    ----------
    text : str
        The function without its coefficient, "d**3"; other names, as in "tanh(v/v_f)", are `parameters`.
    coefficient : str
        The name of the coefficient that multiplies it, "k3".
    signals : tuple of (str, str), optional
        Names of recorded signals that it may have, and their units.

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
    signals: tuple[tuple[str, str], ...] = ()
    law: Law = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "law", Law.parse(self.text, signals=dict(self.signals)))

    @property
    def _with_coefficient(self) -> Law:
        return Law.parse(self.product, signals=dict(self.signals))

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
        numbers = {name: _number(value) for name, value in values.items() if name in self.parameters}
        return Term(_with_names(self.text, numbers), self.coefficient, self.signals)

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
        renamed = {name: f"{name}_added" for name in (self.coefficient, *self.parameters) if name in taken}
        if not renamed:
            return self
        coefficient = renamed.get(self.coefficient, self.coefficient)
        return Term(_with_names(self.text, renamed), coefficient, self.signals)

    @property
    def unit(self) -> str:
        """The SI unit of the coefficient."""
        return self._with_coefficient.units[self.coefficient]

    @property
    def angular_unit(self) -> str:
        """The SI unit of the coefficient in a link between rotations."""
        return replace(self._with_coefficient, angular=True).units[self.coefficient]

    @property
    def parameter_units(self) -> Mapping[str, str]:
        """The SI units of the `parameters`; an empty one for exponents, "?" for what the function leaves open."""
        units = self._with_coefficient.units
        return {name: units[name] for name in self.parameters}

    @property
    def is_constant(self) -> bool:
        """Whether the term is the constant 1, a force that does not depend on the motion."""
        return self.law.expression == Number(1.0)

    @property
    def is_damping(self) -> bool:
        """Whether the term takes energy from every motion, as v, v*abs(v) and tanh(v/0.1) do, whatever a signal is."""
        if self.law.signals or "v" not in symbols(self.law.expression):
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


def _random_signals(term: Term) -> dict[str, Floats]:
    """Values of the signals of a term, of either sign, at the points at which terms are compared."""
    names = dict(term.signals)
    values = np.random.default_rng(1).normal(size=(len(names), _SAMPLES))
    return dict(zip(names, values, strict=True))


def with_signals(terms: str | Sequence[str], signals: Collection[str]) -> str | Sequence[str]:
    """The list of terms with those that `signals` give where it is the list by default: a force, a stiffness and a damping."""
    more = [text for name in signals for text in (name, f"{name}*d", f"{name}*v")]
    return ", ".join([DEFAULT, *more]) if terms == DEFAULT else terms


def possible_signals(terms: str | Sequence[str]) -> dict[str, str]:
    """The names in a list of terms that are signals if a record has them, with no units yet."""
    functions = (function for part in _parts(terms) for function in _expand(part))
    return {name: "" for function in functions for name in Law.parse(function).linear}


def parse_terms(
    text: str | Sequence[str], signals: Mapping[str, str] = MappingProxyType({})
) -> tuple[Term, ...]:
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
    signals : mapping of str to str, optional
        Recorded signals that terms may have, as in "u*v", and their units.

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
            name = _coefficient_name(function, len(terms), signals)
            term = Term(function, name, tuple(signals.items()))
            _require_function_of_motion(term)
            terms.setdefault(term.law.expression, term)
    if not terms:
        raise IdentificationError(f'the list of terms is empty; write a list such as "{DEFAULT}"')
    _require_independent([term for term in terms.values() if not term.parameters])
    names = [term.coefficient for term in terms.values()]
    repeated = {name for name in names if names.count(name) > 1}
    named = tuple(
        replace(term, coefficient=f"{term.coefficient}_{number}") if term.coefficient in repeated else term
        for number, term in enumerate(terms.values(), start=1)
    )
    _require_own_names(named)
    return named


def _require_own_names(terms: Sequence[Term]) -> None:
    """IdentificationError if a parameter has the name of one of another term, or of a coefficient."""
    names = {term.coefficient for term in terms}
    for term in terms:
        if shared := names & set(term.parameters):
            name = min(shared)
            raise IdentificationError(
                f"the name {name!r} in the term {term.text!r} is that of a coefficient, or of a parameter of another "
                f"term; choose another, as in {_with_names(term.text, {name: f'{name}_2'})!r}"
            )
        names |= set(term.parameters)


def _number(value: float) -> str:
    """A number as an expression has it."""
    return repr(float(value)) if value >= 0.0 else f"({float(value)!r})"


def _require_independent(terms: Sequence[Term]) -> None:
    """IdentificationError if a term is undefined for negative d or v, or a linear combination of the terms before it.

    By the QR factors of the terms' values at random points (d, v).
    """
    rng = np.random.default_rng(0)
    d, v = rng.choice([-1.0, 1.0], (2, _SAMPLES)) * 10.0 ** rng.uniform(-3.0, 3.0, (2, _SAMPLES))
    small = np.maximum(np.abs(d), np.abs(v)) < 1.0
    forces = (term.law.force(d, v, _random_signals(term)) for term in terms)
    values = np.array([np.broadcast_to(force, d.shape) for force in forces])
    for term, column in zip(terms, values, strict=True):
        if np.isnan(column[small]).any():
            raise IdentificationError(
                f"the term {term.text!r} is not a number for some negative d or v, and links move both ways; write it with "
                "abs and sign, as in sign(d)*sqrt(abs(d))"
            )
    values = values[:, np.all(np.abs(values) < _LARGEST, axis=0)]
    size = np.linalg.norm(values, axis=1, keepdims=True)
    left = np.abs(np.linalg.qr((values / np.where(size > 0.0, size, 1.0)).T).R.diagonal())
    for number in np.flatnonzero(left <= _DEPENDENT)[:1].tolist():
        before = ", ".join(earlier.text for earlier in terms[:number])
        raise IdentificationError(
            f"the term {terms[number].text!r} is a linear combination of {before or 'no terms (it is zero)'}; leave it out"
        )


def offered_memory(text: str | Sequence[str]) -> tuple[str, ...]:
    """The named laws with memory in a list of candidate terms, each once."""
    return tuple(dict.fromkeys(part for part in _parts(text) if names_memory(part)))


def _parts(text: str | Sequence[str]) -> list[str]:
    return _split(text) if isinstance(text, str) else [part.strip() for part in text]


def _split(text: str, separator: str = ",") -> list[str]:
    """The parts of a list: between separators that are outside of brackets."""
    parts: list[str] = []
    for piece in text.split(separator):
        is_open = bool(parts) and parts[-1].count("(") > parts[-1].count(")")
        parts = [*parts[:-1], parts[-1] + separator + piece] if is_open else [*parts, piece]
    return [part.strip() for part in parts if part.strip()]


def _expand(part: str) -> list[str]:
    """The terms of a family, as of "friction(0.01)", those beside the states of a law with memory, or the term itself.

    Raises IdentificationError if the family takes no number, or needs another one.
    """
    if names_memory(part):
        return plain_terms(part)
    name, bracket, rest = part.partition("(")
    name, number = name.strip(), rest.removesuffix(")")
    if name not in FAMILIES:
        return [part]
    family = FAMILIES[name]
    if not bracket:
        return _split(family.terms)
    if not family.argument:
        raise IdentificationError(f"the family {name} takes no argument; got {part!r}")
    if not rest.endswith(")") or not _is_positive(number):
        raise IdentificationError(
            f"the family {name} takes {family.argument}, a positive number in brackets, as in {name}(0.01); got {part!r}"
        )
    return _split(_VALUE.sub(number, family.terms))


def _require_function_of_motion(term: Term) -> None:
    """IdentificationError if a term is linear in one of its names, or depends neither on d nor on v nor on a signal.

    The former would be a second coefficient; the constant 1 is a term.
    """
    linear = term.law.linear
    if linear:
        raise IdentificationError(
            f"the term {term.text!r} contains the name {linear[0]!r}: a term is a function of d and v alone, its coefficient "
            "is added; write a number, a name inside a function, as in tanh(v/v_0), or one of the families "
            f"{', '.join(FAMILIES)}, or one of the laws with memory {', '.join(memory_laws())}, or record a channel "
            f"signal:{linear[0]}",
            arguments=("terms",),
        )
    if not (set(symbols(term.law.expression)) & set(term.law.variables) or term.is_constant):
        raise IdentificationError(
            f"the term {term.text!r} depends neither on d nor on v; write 1 for a constant force on the masses"
        )


def _coefficient_name(text: str, number: int, signals: Collection[str]) -> str:
    """The usual name of a term's coefficient; "a" and its number in the list for a term that has none."""
    compact = text.replace(" ", "")
    for signal in signals:
        if compact in (signal, f"{signal}*d", f"{signal}*v"):
            return f"{_COEFFICIENTS.get(compact.removeprefix(signal)[1:], 'g')}_{signal}"
    power = _POWER.fullmatch(compact)
    if power:
        return f"{'k' if power[1] == 'd' else 'c'}{power[2]}"
    if compact.startswith("tanh(v"):
        return "F"
    if compact.startswith(("max(d", "min(d")):
        return "kc" if compact.startswith("max") else "kn"
    return _COEFFICIENTS.get(compact, f"a{number + 1}")
