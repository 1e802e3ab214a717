"""The laws of links, evaluated on a record: functions of the noisy elongations, ready to meet a test function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.weak.layout import PatchLayout, StructureLayout, WeakLawGroup
from linkwise.weak.weak_form import WeakPart


@dataclass(frozen=True, eq=False)
class LawTerms:
    """sign * int kernel h(d) of one `part` of a law at all of `links` (m,), the terms `terms` of a layout.

    `derivatives` is [h, h', h'', ...]: arrays (m, N) over all samples, numbers where constant.
    """

    part: WeakPart
    links: Indices
    terms: slice
    derivatives: tuple[Floats | float, ...]

    @property
    def slope(self) -> Floats | float:
        """h'."""
        return self.derivatives[1] if len(self.derivatives) > 1 else 0.0


def law_terms(
    structure_layout: StructureLayout,
    layout: PatchLayout,
    values: Floats,
    *,
    elongations: Callable[[Indices], Floats],
    rates: Callable[[Floats], Floats],
    variance: Callable[[Indices], Floats],
) -> list[LawTerms]:
    """The atoms of all links of `layout`: of their `elongations` (m, N), whose noise has `variance` (m,), and smoothed `rates`
    of those, at the parameters `values` (p,), NaN where they have no value.

    Elongations and rates are only asked for where a law needs them. Raises IdentificationError for an unknown that enters its
    law nonlinearly and has no start.
    """
    evaluated = []
    for group in layout.groups:
        inside = {name: group.coefficients[name].at(values)[:, None] for name in group.weak_law.inside}
        _require_starts(structure_layout, group, inside)
        d = elongations(group.links) if group.weak_law.curved else np.zeros((len(group.links), 1))
        v = rates(d) if group.weak_law.needs_rate else 0.0
        evaluated.append(iter(group.weak_law.evaluate(d, v, variance(group.links)[:, None], inside)))
    return [
        LawTerms(each.part, layout.groups[each.group].links, each.terms, tuple(next(evaluated[each.group])))
        for each in layout.group_terms
    ]


def _require_starts(
    structure_layout: StructureLayout, group: WeakLawGroup, inside: dict[str, Floats]
) -> None:
    law = group.weak_law.law
    for name in (name for name in law.nonlinear if name in inside):
        for lost in np.flatnonzero(np.isnan(inside[name])):
            raise IdentificationError(
                f'link "{structure_layout.structure.links[group.links[lost]].name}": {name} enters the law {law.text} '
                f"nonlinearly, so its search needs a start: write {name} = {{ start = ... }} among its coefficients"
            )
