"""Compare a discovered structure with the true one: which terms are right, which are missing, which are false.

Links are compared by their ends and terms by their values, not by names: k*d of "m2-m1" is alpha*d of "nes1" if both are
between m1 and m2, in either order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.expression import (
    Expression,
    Number,
    Program,
    Sum,
    Symbol,
    multiply,
    substitute,
    symbols,
    to_text,
)
from linkwise.model.coefficient import Name
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import COMPARISON, Link, refuse_memory
from linkwise.model.structure import Structure

_POINTS = 200
_DECADES = (-5.0, 1.0)  # of d in m and v in m/s at which terms are compared
_EQUAL = 1e-9  # of the largest value: rounding
_NEAR = 0.1  # of it: a term whose parameter was found


@dataclass(frozen=True)
class TermScore:
    """How the terms of a discovered structure compare with those of the true one.

    Attributes
    ----------
    right : tuple of str
        Discovered terms that the true structure has, by the names of their coefficients ("m2-m1.k3").
    missing : tuple of str
        True terms that were not discovered.
    extra : tuple of str
        Discovered terms that the true structure has not.
    missing_links, extra_links : tuple of str
        True links of which no term was discovered, and discovered links between whose ends there is no true one.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> cubic = lw.Law.parse("k3*d**3")
    >>> link = lw.Link("m2-m1", ("m2", "m1"), cubic, {"k3": 1e6})
    >>> score = lw.discovery.term_score(lw.Structure("discovered", chain.masses, (link,)), chain)
    >>> score.right, score.exact, score.missing_links
    (('m2-m1.k3',), False, ('spring1',))
    """

    right: tuple[str, ...]
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    missing_links: tuple[str, ...]
    extra_links: tuple[str, ...]

    @property
    def exact(self) -> bool:
        """Whether no term is missing and none is extra."""
        return not self.missing and not self.extra


@dataclass(frozen=True, eq=False)
class _ComparedTerm:
    """`value` times the function `basis` of d and v, whose `samples` (200,) at fixed points are compared.

    `has_parameters` says that the basis has parameters that were found, such as a gap.
    """

    name: Name
    ends: frozenset[str]
    value: float
    basis: Expression
    samples: Floats
    has_parameters: bool = False


def term_score(discovered: Structure, truth: Structure) -> TermScore:
    """Compare a discovered structure with the true one, term by term.

    Parameters
    ----------
    discovered : Structure
        The discovered structure, every coefficient a number.
    truth : Structure
        The true structure, every coefficient a number. A coefficient of 0 counts as no term, in both.

    Returns
    -------
    TermScore
        Terms and links by name.

    Raises
    ------
    StructureError
        If the true structure lacks a mass of `discovered`, a coefficient is unknown, or a link has memory.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> linear = chain.with_values({"nes1.beta": 0.0})
    >>> lw.discovery.term_score(linear, chain).missing
    ('nes1.beta',)
    """
    ours, theirs = _compared(discovered, truth)
    right = [term.name for term in ours if any(_factor(term, true) is not None for true in theirs)]
    missing = [true.name for true in theirs if all(_factor(term, true) is None for term in ours)]
    return TermScore(
        right=tuple(right),
        missing=tuple(missing),
        extra=tuple(term.name for term in ours if term.name not in right),
        missing_links=_links_elsewhere(truth, ours),
        extra_links=_links_elsewhere(discovered, theirs),
    )


def align_truth(discovered: Structure, truth: Structure) -> Structure:
    """Write the true laws under the names, ends and coefficients of the links of a discovered structure.

    Parameters
    ----------
    discovered, truth : Structure
        As of `term_score`.

    Returns
    -------
    Structure
        The masses and laws of `truth` on the links of `discovered`. Terms that a link of it lacks are added to its law, and a
        link between whose ends there is no true one has coefficients of 0.

    Raises
    ------
    StructureError
        As of `term_score`.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> law, number = lw.Law.parse("k*d"), lw.Coefficient.number
    >>> ends = (("m1", "ground"), ("m2", "m1"))
    >>> links = tuple(lw.Link("-".join(pair), pair, law, {"k": number(1.0)}) for pair in ends)
    >>> lw.discovery.align_truth(lw.Structure("found", chain.masses, links), chain).link("m1-ground").law.text
    'k*d + true1*(v)'
    """
    _, theirs = _compared(discovered, truth)
    done: set[frozenset[str]] = set()
    links = []
    for link in discovered.links:
        if link.name in discovered.modes:
            links.append(truth.link(link.name))
            continue
        ends = frozenset(link.between)
        links.append(_true_link(link, [term for term in theirs if term.ends == ends and ends not in done]))
        done.add(ends)
    masses = tuple(truth.mass(name) for name in discovered.mass_names)
    return Structure(truth.name, masses, tuple(links), truth.hosts)


def _compared(discovered: Structure, truth: Structure) -> tuple[list[_ComparedTerm], list[_ComparedTerm]]:
    """The terms of both that are not 0, written for the order of ends of the discovered links; modes have none.

    Raises StructureError if the two cannot be compared.
    """
    refuse_memory((*discovered.links, *truth.links), COMPARISON)
    missing = [name for name in discovered.mass_names if name not in truth.mass_names]
    if missing:
        raise StructureError(
            f"the true structure does not have the mass {', '.join(missing)}, so the two cannot be compared; it has "
            f"{', '.join(truth.mass_names)}"
        )
    orientation = {frozenset(link.between): link.between for link in discovered.links}
    ours, theirs = (
        [term for link in _joints(structure) for term in _terms(link, orientation) if term.value != 0.0]
        for structure in (discovered, truth)
    )
    return ours, theirs


def _true_link(link: Link, theirs: list[_ComparedTerm]) -> Link:
    """`link` with the true coefficients, and with the true terms that it lacks."""
    values = dict.fromkeys(link.law.linear, 0.0) | {name: link.values[name] for name in link.law.nonlinear}
    ours = list(_terms(link, {}))
    text = link.law.text
    for term in theirs:
        matches = [(our, factor) for our in ours if (factor := _factor(our, term)) is not None]
        if matches:
            own, factor = matches[0]
            name = own.name.key
            if name in values:  # otherwise it is a number in the law
                values[name] += factor * term.value
                continue
        name = next(f"true{k}" for k in range(1, len(theirs) + 1) if f"true{k}" not in values)
        values[name] = term.value
        text += f" + {name}*({to_text(term.basis)})"
    return Link(link.name, link.between, Law.parse(text), values)


def _terms(link: Link, orientation: dict[frozenset[str], tuple[str, str]]) -> Iterator[_ComparedTerm]:
    """The terms of a link, written for the order of its ends that `orientation` gives."""
    numbers: dict[str, Expression] = {name: Number(value) for name, value in link.values.items()}
    nonlinear = {name: numbers[name] for name in link.law.nonlinear}
    bases = link.law.basis
    terms = [(name, link.values[name], substitute(bases[name], nonlinear)) for name in link.law.linear]
    with_parameters = {name for name in link.law.linear if symbols(bases[name]) & nonlinear.keys()}
    remainder = substitute(link.law.remainder, numbers)
    parts = remainder.parts if isinstance(remainder, Sum) else (remainder,)
    terms += [(to_text(part), 1.0, part) for part in parts if part != Number(0.0)]
    ends = frozenset(link.between)
    reversed_ = orientation.get(ends, link.between) != link.between
    for name, value, basis in terms:
        function = _reversed(basis) if reversed_ else basis
        own, samples = Name(link.name, name), _samples(function)
        yield _ComparedTerm(own, ends, value, function, samples, name in with_parameters)


def _reversed(basis: Expression) -> Expression:
    """The same force with the ends of its link exchanged: -f(-d, -v)."""
    minus = {name: multiply(Number(-1.0), Symbol(name)) for name in VARIABLES}
    return multiply(Number(-1.0), substitute(basis, minus))


def _samples(basis: Expression) -> Floats:
    """(200,) values of a function of d and v at fixed random points."""
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(*_DECADES, size=(2, _POINTS))
    d, v = sizes * rng.choice([-1.0, 1.0], size=(2, _POINTS))
    values = np.asarray(Program([basis], VARIABLES)(d, v)[0], dtype=float)
    return np.broadcast_to(values, (_POINTS,))


def _factor(ours: _ComparedTerm, theirs: _ComparedTerm) -> float | None:
    """The factor by which our function has to be multiplied to give theirs; None if they are different terms."""
    square = float(ours.samples @ ours.samples)
    if ours.ends != theirs.ends or square == 0.0:
        return None
    factor = float(ours.samples @ theirs.samples) / square
    error = float(np.abs(theirs.samples - factor * ours.samples).max())
    tolerance = _NEAR if ours.has_parameters or theirs.has_parameters else _EQUAL
    return factor if factor != 0.0 and error <= tolerance * float(np.abs(theirs.samples).max()) else None


def _joints(structure: Structure) -> list[Link]:
    """The links that are no modes."""
    return [link for link in structure.links if link.name not in structure.modes]


def _links_elsewhere(structure: Structure, terms: list[_ComparedTerm]) -> tuple[str, ...]:
    """The names of the links between whose ends there is none of some terms."""
    ends = {term.ends for term in terms}
    return tuple(link.name for link in _joints(structure) if frozenset(link.between) not in ends)
