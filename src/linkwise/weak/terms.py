"""The laws of links, evaluated on a record: functions of the noisy elongations, ready to meet a test function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.weak.layout import Group, Layout, Plan
from linkwise.weak.weak_form import WeakPart


@dataclass(frozen=True, eq=False)
class Atoms:
    """sign * int kernel h(d) of one `part` of a law at all of `links` (m,), the terms `at` of a layout.

    `chain` is [h, h', h'', ...]: arrays (m, N) over all samples, numbers where constant.
    """

    part: WeakPart
    links: Indices
    at: slice
    chain: tuple[Floats | float, ...]

    @property
    def slope(self) -> Floats | float:
        """h'."""
        return self.chain[1] if len(self.chain) > 1 else 0.0


def link_atoms(
    plan: Plan,
    layout: Layout,
    values: Floats,
    *,
    elongations: Callable[[Indices], Floats],
    rates: Callable[[Floats], Floats],
    variance: Callable[[Indices], Floats],
) -> list[Atoms]:
    """The atoms of all links of `layout`: of their `elongations` (m, N), whose noise has `variance` (m,), and smoothed `rates`
    of those, at the parameters `values` (p,), NaN where they have no value.

    Elongations and rates are only asked for where a law needs them. Raises IdentificationError for an unknown that enters its
    law nonlinearly and has no start.
    """
    evaluated = []
    for group in layout.groups:
        inside = {name: group.coefficients[name].at(values)[:, None] for name in group.weak.inside}
        _require_starts(plan, group, inside)
        d = elongations(group.links) if group.weak.curved else np.zeros((len(group.links), 1))
        v = rates(d) if group.weak.needs_rate else 0.0
        evaluated.append(iter(group.weak.evaluate(d, v, variance(group.links)[:, None], inside)))
    return [
        Atoms(each.part, layout.groups[each.group].links, each.at, tuple(next(evaluated[each.group])))
        for each in layout.parts
    ]


def _require_starts(plan: Plan, group: Group, inside: dict[str, Floats]) -> None:
    law = group.weak.law
    for name in (name for name in law.nonlinear if name in inside):
        for lost in np.flatnonzero(np.isnan(inside[name])):
            raise IdentificationError(
                f'link "{plan.structure.links[group.links[lost]].name}": {name} enters the law {law.text} nonlinearly, so its '
                f"search needs a start: write {name} = {{ start = ... }} among its coefficients"
            )
