"""Terms of the laws of links, evaluated on a record: functions of the noisy elongations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.weak.layout import StructureLayout
from linkwise.weak.patch_layout import PatchLayout, WeakLawGroup
from linkwise.weak.weak_form import WeakPart


@dataclass(frozen=True, eq=False)
class LawTerms:
    """sign * int kernel h(d) of one part of a law, at m links.

    Attributes
    ----------
    part : WeakPart
        The part.
    links : array of int, shape (m,)
        Indices of the links.
    terms : slice
        The terms in the layout.
    derivatives : tuple
        h, h', h'', ... without their factors: arrays of shape (m, N) over all samples, numbers where constant.
    factors : tuple of float
        What these are to be multiplied by; 1 for numbers.
    rate_slope : array of shape (m, N) or None
        The mean slope of h with respect to a noisy v; None for parts that need no rate.
    """

    part: WeakPart
    links: Indices
    terms: slice
    derivatives: tuple[Floats | float, ...]
    factors: tuple[float, ...]
    rate_slope: Floats | None = None

    @property
    def slope(self) -> Floats | float:
        """First derivative h' without its factor."""
        return self.derivatives[1] if len(self.derivatives) > 1 else 0.0

    @property
    def signed(self) -> tuple[float, ...]:
        """The factors times the sign of the part."""
        return tuple(self.part.sign * factor for factor in self.factors)


def law_terms(
    structure_layout: StructureLayout,
    layout: PatchLayout,
    values: Floats,
    *,
    elongations: Callable[[Indices], Floats],
    rates: Callable[[Floats], Floats],
    variance: Callable[[Indices], Floats],
    rate_noise: float,
) -> list[LawTerms]:
    """Evaluate the laws of all links of a layout.

    Parameters
    ----------
    structure_layout : StructureLayout
        Layout of the structure.
    layout : PatchLayout
        The terms.
    values : array of shape (p,)
        The parameters; NaN where they have no value.
    elongations : callable
        Elongations (m, N) in m of m links; called only where a law needs them.
    rates : callable
        Smoothed rates (m, N) in m/s from elongations; called only where a law needs them.
    variance : callable
        Variances (m,) in m^2 of the elongations of m links.
    rate_noise : float
        Standard deviation in 1/s of smoothed rates over that of elongations.

    Returns
    -------
    list of LawTerms
        The terms, in the order of `layout.group_terms`.

    Raises
    ------
    IdentificationError
        If an unknown enters its law nonlinearly and has no start.
    """
    evaluated, rate_slopes, factors = [], [], []
    for group in layout.groups:
        inside = {name: group.coefficients[name].at(values)[:, None] for name in group.weak_law.inside}
        _require_starts(structure_layout, group, inside)
        d = elongations(group.links) if group.weak_law.curved else np.zeros((len(group.links), 1))
        v = rates(d) if group.weak_law.needs_rate else np.zeros(())
        noise = variance(group.links)[:, None]
        evaluated.append(iter(group.weak_law.evaluate(d, v, noise, inside)))
        factors.append(iter(group.weak_law.factors))
        deviation = np.where(
            noise > 0.0, rate_noise * np.sqrt(noise), 1.0
        )  # without noise slopes do not count
        by_rate = (
            group.weak_law.rate_slopes(d, v, noise, deviation, inside) if group.weak_law.needs_rate else ()
        )
        rate_slopes.append(iter(by_rate))
    return [
        LawTerms(
            terms.part,
            layout.groups[terms.group].links,
            terms.terms,
            tuple(next(evaluated[terms.group])),
            next(factors[terms.group]),
            next(rate_slopes[terms.group], None),
        )
        for terms in layout.group_terms
    ]


def _require_starts(
    structure_layout: StructureLayout, group: WeakLawGroup, inside: dict[str, Floats]
) -> None:
    law = group.weak_law.law
    for name in (name for name in law.nonlinear if name in inside):
        for row in np.flatnonzero(np.isnan(inside[name])):
            link = structure_layout.structure.links[structure_layout.elements[group.links[row]].link]
            raise IdentificationError(
                f'link "{link.name}": {name} enters the law {law.text} '
                f"nonlinearly and needs a start: write {name} = {{ start = ... }} among its coefficients"
            )
