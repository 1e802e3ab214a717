"""A discovered structure beside the true one, where there is one: which terms are right, which are missing, which are false.

Links are compared by their ends and terms by what they do, not by names: k*d of "m2-m1" is alpha*d of "nes1" if both are
between m1 and m2, whichever comes first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.expression import Expression, Number, Program, Sum, Symbol, multiply, substitute, to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure

_POINTS = 200
_DECADES = (-5.0, 1.0)  # of d in m and v in m/s at which terms are compared
_SAME = 1e-9  # of the largest value: rounding


@dataclass(frozen=True)
class TermScore:
    """Terms by name: `right` and `extra` ones of the structure that was found, `missing` ones of the true structure.

    `missing_links` and `extra_links` are those of which not a single term has a counterpart between the same ends.
    """

    right: tuple[str, ...]
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    missing_links: tuple[str, ...]
    extra_links: tuple[str, ...]

    @property
    def exact(self) -> bool:
        """Whether nothing is missing and nothing is false."""
        return not self.missing and not self.extra


@dataclass(frozen=True, eq=False)
class _Part:
    """`value` times a function of d and v, whose values at the points of comparison are `shape`; ends as wanted."""

    name: str
    link: str
    ends: frozenset[str]
    value: float
    basis: Expression
    shape: Floats


def term_score(found: Structure, truth: Structure) -> TermScore:
    """Compare `found` with `truth` term by term; a coefficient of 0 counts as no term.

    Raises StructureError where the masses have other names, or a coefficient is unknown.
    """
    _require_masses(found, truth)
    first = {frozenset(link.between): link.between for link in found.links}
    ours, theirs = (
        [part for link in each.links for part in _parts(link, first) if part.value != 0.0]
        for each in (found, truth)
    )
    right = [part for part in ours if any(_factor(part, other) is not None for other in theirs)]
    missing = [other for other in theirs if all(_factor(part, other) is None for part in ours)]
    extra = [part for part in ours if part not in right]
    return TermScore(
        right=tuple(part.name for part in right),
        missing=tuple(part.name for part in missing),
        extra=tuple(part.name for part in extra),
        missing_links=_without(truth, {part.ends for part in ours}),
        extra_links=_without(found, {part.ends for part in theirs}),
    )


def truth_beside(found: Structure, truth: Structure) -> Structure:
    """The true laws under the names, ends and coefficients of the links found; what these lack is added to their laws.

    A found link between whose ends there is none in truth gets coefficients of 0. Raises as `term_score` does.
    """
    _require_masses(found, truth)
    first = {frozenset(link.between): link.between for link in found.links}
    theirs = [part for link in truth.links for part in _parts(link, first) if part.value != 0.0]
    taken: set[frozenset[str]] = set()
    links = []
    for link in found.links:
        ends = frozenset(link.between)
        links.append(_true_link(link, [part for part in theirs if part.ends == ends and ends not in taken]))
        taken.add(ends)
    masses = tuple(truth.mass(name) for name in found.mass_names)
    return Structure(truth.name, masses, tuple(links))


def _true_link(link: Link, theirs: list[_Part]) -> Link:
    """`link` with true coefficients, and with the terms that it lacks."""
    values = dict.fromkeys(link.law.linear, 0.0) | {name: link.values[name] for name in link.law.nonlinear}
    ours = list(_parts(link, {}))
    text = link.law.text
    for part in theirs:
        matched = [(each, factor) for each in ours if (factor := _factor(each, part)) is not None]
        if matched:
            each, factor = matched[0]
            name = each.name.rpartition(".")[2]
            if name in values:  # else it is a number in the law
                values[name] += factor * part.value
                continue
        name = next(f"true{k}" for k in range(1, len(theirs) + 1) if f"true{k}" not in values)
        values[name] = part.value
        text += f" + {name}*({to_text(part.basis)})"
    numbers = {name: Coefficient.number(value) for name, value in values.items()}
    return Link(link.name, link.between, Law.parse(text), numbers)


def _parts(link: Link, first: dict[frozenset[str], tuple[str, str]]) -> Iterator[_Part]:
    """The terms of a link, seen from the ends that `first` gives for its pair."""
    numbers: dict[str, Expression] = {name: Number(value) for name, value in link.values.items()}
    nonlinear = {name: numbers[name] for name in link.law.nonlinear}
    terms = [
        (name, link.values[name], substitute(link.law.basis[name], nonlinear)) for name in link.law.linear
    ]
    rest = substitute(link.law.remainder, numbers)
    pieces = rest.parts if isinstance(rest, Sum) else (() if rest == Number(0.0) else (rest,))
    terms += [(to_text(piece), 1.0, piece) for piece in pieces]
    ends = frozenset(link.between)
    turned = first.get(ends, link.between) != link.between
    for name, value, basis in terms:
        seen = _turned(basis) if turned else basis
        yield _Part(f"{link.name}.{name}", link.name, ends, value, seen, _shape(seen))


def _turned(basis: Expression) -> Expression:
    """The same force as it is seen with the ends exchanged."""
    minus = {name: multiply(Number(-1.0), Symbol(name)) for name in VARIABLES}
    return multiply(Number(-1.0), substitute(basis, minus))


def _shape(basis: Expression) -> Floats:
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(*_DECADES, size=(2, _POINTS))
    d, v = sizes * rng.choice([-1.0, 1.0], size=(2, _POINTS))
    values = np.asarray(Program([basis], VARIABLES)(d, v)[0], dtype=float)
    return np.broadcast_to(values, (_POINTS,))


def _factor(ours: _Part, theirs: _Part) -> float | None:
    """What 1 of the true term is in units of ours; None where they are different terms."""
    size = float(ours.shape @ ours.shape)
    if ours.ends != theirs.ends or size == 0.0:
        return None
    factor = float(ours.shape @ theirs.shape) / size
    off = float(np.abs(theirs.shape - factor * ours.shape).max())
    return factor if factor != 0.0 and off <= _SAME * float(np.abs(theirs.shape).max()) else None


def _without(structure: Structure, ends: set[frozenset[str]]) -> tuple[str, ...]:
    return tuple(link.name for link in structure.links if frozenset(link.between) not in ends)


def _require_masses(found: Structure, truth: Structure) -> None:
    lost = [name for name in found.mass_names if name not in truth.mass_names]
    if lost:
        raise StructureError(
            f"the true structure has no mass {', '.join(lost)}, so nothing can be compared; it has "
            f"{', '.join(truth.mass_names)}"
        )
