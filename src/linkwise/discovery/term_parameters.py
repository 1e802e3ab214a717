"""Parameters inside terms, such as the rate at which friction saturates or a gap: their values link by link.

Terms have values from the motion of their link to begin with. The parameters of those that a selection keeps join the unknowns
of the fit. Where no selection explains the records so, those of all terms on the links of the first subset do at once, from
one value after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.screen import Measured
from linkwise.discovery.selection import Selection, TermSearch, best_of, select_structure
from linkwise.discovery.terms import Term
from linkwise.errors import IdentificationError, LinkwiseError
from linkwise.units import base_exponents

# of the largest elongation, or rate, one after another until a fit leaves no more than noise
_FRACTIONS = (0.2, 0.6, 0.03)
_EXPONENTS = (1.5, 2.5, 0.5)
_PEAK = 99.0  # percentile that stands for the largest: the largest itself may be an outlier
_PER_PERIOD = 8.0  # of the fastest motion: samples over which a rate is a difference
_ROUNDING = 1e-3  # of chi-square: by which one more unknown may seem to worsen it


def _largest_motion(measured: Measured, ends: Sequence[int]) -> tuple[float, float]:
    """The largest elongation in m and rate in m/s between two ends, by differences over a fraction of the fastest period."""
    elongations, rates = [], []
    for record, motion in measured:
        d = np.subtract(*motion.displacements[ends])
        lag = max(1, min(int(record.rate / motion.bandwidth / _PER_PERIOD), len(d) // 2))
        change = (d[lag:] - d[:-lag]) * (record.rate / lag)
        elongations.append(float(np.percentile(np.abs(d - np.median(d)), _PEAK)))
        rates.append(float(np.percentile(np.abs(change), _PEAK)))
    return max(elongations), max(rates)


def _value(term: Term, parameter: str, motion: tuple[float, float], attempt: int) -> float:
    """A value of a parameter in a motion, another for each attempt; IdentificationError if it determines none.

    A quantity with a unit of metres and seconds has a size in this motion, unless it did not move.
    """
    unit, (elongation, rate) = term.parameter_units[parameter], motion
    if not unit:
        return _EXPONENTS[attempt]
    try:
        kilogram, metre, second, ampere = (float(exponent) for exponent in base_exponents(unit))
    except LinkwiseError:  # no unit, but any
        kilogram = np.nan
    if kilogram or ampere or not min(motion) > 0.0:
        raise IdentificationError(
            f"the parameter {parameter!r} of the term {term.text!r} has the unit {unit}, whose size the motion does not "
            "determine; write a number in its place"
        )
    scale = elongation**metre * (elongation / rate) ** second
    return float(f"{_FRACTIONS[attempt] * scale:.3g}")  # of three digits, which laws and figures show


def first_values(candidates: Candidates, measured: Measured, attempt: int = 0) -> Candidates:
    """The candidates with a value for each parameter, from the motion of their links; each `attempt` gives others.

    Raises IdentificationError for a parameter whose size the motion does not determine.
    """
    values = {}
    for entry in candidates.entries:
        if entry.offered.parameters:
            motion = _largest_motion(measured, candidates.rows(entry.pair))
            own = {name: _value(entry.offered, name, motion, attempt) for name in entry.offered.parameters}
            values[entry.name] = own
    return replace(candidates, values=values)


def select_with_parameters(
    search: TermSearch, chosen: frozenset[str], measured: Measured
) -> tuple[TermSearch, Selection]:
    """The subset that no candidate improves, with the values of parameters that the records prefer.

    The search has these values; where terms with parameters were kept, they are unknowns of the fit.
    """
    selection = select_structure(search, chosen)
    if not any(entry.offered.parameters for entry in search.candidates.entries):
        return search, selection
    best = _freed(search, selection)
    for attempt in range(len(_FRACTIONS)):
        if best[1].is_exact or best[1].interrupted:
            break
        try:
            values = first_values(search.candidates, measured, attempt)
            trial = _freed_at_once(replace(search, candidates=values), chosen)
        except IdentificationError:
            continue
        if trial[1].interrupted or _is_better(trial[1], best[1]):
            best = trial
    return best


def _is_better(selection: Selection, reference: Selection) -> bool:
    """Whether a selection leaves only noise and the other does not, or has the lower criterion."""
    if selection.is_exact != reference.is_exact:
        return selection.is_exact
    return best_of([reference, selection]) is selection


def _freed(search: TermSearch, selection: Selection) -> tuple[TermSearch, Selection]:
    """The search and the selection with the parameters of the terms kept among the unknowns, those of the strongest first.

    A term on a wrong link may stand in for the wrong value of another, and goes once that has its own. Terms whose parameters
    no fit finds keep numbers.
    """
    tried: set[str] = set()
    while left := (_open_terms(search.candidates) & selection.chosen) - search.candidates.free - tried:
        z = {entry.name: abs(selection.coefficients[k][1]) for k, entry in selection.entries.items()}
        strongest = max(sorted(left), key=z.__getitem__)
        tried.add(strongest)
        deviations = np.sqrt(np.maximum(selection.fit.covariance.diagonal(), 0.0))
        free = search.candidates.free | {strongest}
        freed = _with_free(search, free).starting_at(selection.structure, selection.fit.values, deviations)
        for others in (left, {strongest}):
            try:
                fitted = select_structure(freed, selection.chosen - (left - others))
            except IdentificationError:  # the records do not determine all its parameters
                continue
            if fitted.interrupted:
                return freed, fitted
            exact = fitted.is_exact and fitted.fit.chi_square < selection.fit.chi_square + _ROUNDING
            if exact or _is_better(fitted, selection):
                search, selection = freed, fitted
                break
    return search, selection


def _freed_at_once(search: TermSearch, chosen: frozenset[str]) -> tuple[TermSearch, Selection]:
    """The search and its selection from all terms with parameters on the links of `chosen`, these among the unknowns.

    For records that no set of terms explains before these have their values.
    """
    opened = _open_terms(search.candidates) & search.candidates.on_links_of(chosen)
    everything = chosen | opened
    structure = search.candidates.structure(everything)
    values, spread = search.start(structure)
    spread = np.abs(values) if spread is None else spread
    freed = _with_free(search, opened).starting_at(structure, values, spread)
    return freed, select_structure(freed, everything)


def without_values(selection: Selection) -> tuple[str, ...]:
    """The candidates chosen whose parameters kept the numbers that they began with, since no fit found them."""
    return tuple(sorted((_open_terms(selection.candidates) & selection.chosen) - selection.candidates.free))


def _open_terms(candidates: Candidates) -> frozenset[str]:
    return frozenset(entry.name for entry in candidates.entries if entry.offered.parameters)


def _with_free(search: TermSearch, free: frozenset[str]) -> TermSearch:
    """The search with the parameters of the `free` candidates among the unknowns."""
    return replace(search, candidates=replace(search.candidates, free=free))
