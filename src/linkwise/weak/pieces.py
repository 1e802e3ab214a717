"""Whether pieces of a record agree on the coefficients: a term that the laws lack acts otherwise where the motion is smaller.

Friction beside a damper looks like more damping the smaller the motion is, and quadratic damping like less. Terms that are
nonlinear in the rate have no score without bias, since they would need a smoothed rate. So the laws as they are stated are
fitted to pieces of the record, with the noise found in the whole of it: halves of the record, of its first half and of its
first quarter, since a motion that decays is soon hidden by noise, and quarters. The squares of what the pieces differ by,
over their variances, follow chi-square where the laws are right (Cochran 1954).

References
----------
W. G. Cochran, Biometrics 10, 101 (1954), for the combination of estimates from different experiments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.fit import SIGNIFICANT, WeakFit

_CUTS = ((0.0, 0.125, 0.25), (0.0, 0.25, 0.5), (0.0, 0.5, 1.0), (0.0, 0.25, 0.5, 0.75, 1.0))
_TWICE = 2.0  # the significance that a whole record needs: below, errors of some pieces were a third of what they should be
_LARGEST = 48  # masses of a structure whose pieces are compared
_FALSE_ALARM = 1e-4  # probability that pieces differ so much by chance, over all coefficients and cuts

Search = Callable[[Record], tuple[tuple[str, ...], WeakFit] | None]
"""The names of the parameters and the fit of a piece of a record, None where none converges."""


@dataclass(frozen=True)
class Disagreement:
    """A coefficient of which pieces of the record give different values, between `lowest` and `highest`."""

    name: str
    lowest: float
    highest: float


def disagreement(
    record: Record, structure: Structure, noise: Mapping[str, float], search: Search
) -> Disagreement | None:
    """The coefficient on which pieces of a record agree least.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    noise : mapping of str to float
        Standard deviations of the noise by channel, found in the whole record.
    search : callable
        Fits a piece of the record.

    Returns
    -------
    Disagreement or None
        The coefficient; None where chance explains all differences, or the structure has too many masses, or an unknown one,
        which is hardly distinguished from zero in some pieces.
    """
    if structure.size > _LARGEST or not all(mass.mass.known for mass in structure.masses):
        return None
    stated = {name: sigma for name, sigma in noise.items() if sigma > 0.0 and name in record.channels}
    whole = replace(record, noise={**stated, **record.noise})
    fits: dict[tuple[float, float], tuple[tuple[str, ...], Floats, Floats] | None] = {}
    differences: list[tuple[float, Disagreement]] = []
    for cuts in _CUTS:
        for ends in pairwise(cuts):
            if ends not in fits:
                fits[ends] = _fitted(whole, ends, search)
        pieces = [piece for ends in pairwise(cuts) if (piece := fits[ends]) is not None]
        if len(pieces) > 1:
            values, weights = (np.stack([piece[part] for piece in pieces]) for part in (1, 2))
            differences += _differences(pieces[0][0], values, weights)
    if not differences:
        return None
    chance, worst = min(differences, key=lambda pair: pair[0])
    return worst if chance * len(differences) < _FALSE_ALARM else None


def _fitted(
    whole: Record, ends: tuple[float, float], search: Search
) -> tuple[tuple[str, ...], Floats, Floats] | None:
    """Names, values and weights (p,) of the parameters from a piece; weight 0 for what it hardly determines."""
    first, last = (round(end * len(whole)) for end in ends)
    try:
        fitted = search(whole[first:last])
    except (LinkwiseError, np.linalg.LinAlgError):  # too short, or no motion left
        return None
    if fitted is None:
        return None
    names, fit = fitted
    variance = np.asarray(fit.covariance.diagonal()) * max(fit.excess, 1.0)
    determined = fit.free & (fit.significance > _TWICE * SIGNIFICANT) & (variance > 0.0)
    return names, fit.values, np.where(determined, 1.0 / np.where(determined, variance, 1.0), 0.0)


def _differences(
    names: tuple[str, ...], values: Floats, weights: Floats
) -> Iterator[tuple[float, Disagreement]]:
    """For each parameter that two of the pieces (b, p) determine, the probability of their differences."""
    for number, name in enumerate(names):
        determined = weights[:, number] > 0.0
        own, weight = values[determined, number], weights[determined, number]
        if len(own) > 1:
            squares = float(np.sum(weight * (own - np.average(own, weights=weight)) ** 2))
            chance = float(scipy.special.gammaincc(0.5 * (len(own) - 1), 0.5 * squares))
            yield chance, Disagreement(name, float(own.min()), float(own.max()))
