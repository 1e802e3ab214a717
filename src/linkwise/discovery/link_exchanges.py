"""Links that could as well be between other ends: all terms of one exchanged for those of another.

Two points near each other move nearly alike, and so may points of a host whose modes a record does not excite. Of masses, two
links of the same mass may share what is one link's. An exchange of one term at a time does not show that, since the terms of a
link belong together.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import Selection

_NAMED = 3
_MOST_TERMS = 150  # of a selection: exchanges of links in larger ones take longer than their fit


@dataclass(frozen=True)
class LinkExchange:
    """A `link` found whose `terms`, by number, the `rival` link may have in its place, and the `excess` of the criterion."""

    link: str
    rival: str
    terms: tuple[int, ...]
    excess: float

    def remark(self) -> str:
        """A sentence for the user."""
        change = f"only {self.excess:.1f} higher" if self.excess >= 0.0 else f"{-self.excess:.1f} lower"
        return (
            f"This record hardly distinguishes the link {self.link} from {self.rival}: with that in its place the criterion "
            f"is {change}. Excite modes, or measure points, in which both differ."
        )


def link_exchanges(selection: Selection, candidates: Candidates) -> tuple[LinkExchange, ...]:
    """The exchanges of a whole link that would raise the criterion by less than `CERTAIN`, the least first.

    Beside hosts for any other link; else for one of the selected ones that shares a mass with it.
    """
    quadratic, penalty = selection.quadratic, selection.penalty
    count = len(selection.structure.parameters)
    chosen = list(range(count))
    pair_of = penalty.pair
    selected = quadratic.cost(chosen) + penalty.total(chosen)
    selected_pairs = set(pair_of[:count].tolist()) - {-1} - penalty.stated
    text = {
        number: candidates.by_name[name].term.text
        for number, name in enumerate(quadratic.names)
        if name in candidates.by_name
    }
    exchanges = []
    for pair in sorted(selected_pairs) if count <= _MOST_TERMS else ():
        own = np.flatnonzero(pair_of[:count] == pair).tolist()
        rest = [number for number in chosen if number not in own]
        others = set(pair_of[count:].tolist()) - {-1} - selected_pairs if candidates.hosts else set()
        for rival in sorted(others | _neighbours(pair, selected_pairs, candidates)):
            terms = {text[number]: number for number in np.flatnonzero(pair_of == rival).tolist()}
            if not {text[number] for number in own} <= terms.keys():
                continue
            model = sorted({*rest, *(terms[text[number]] for number in own)})
            if model == rest:  # the link is left out, which the margins of its terms tell
                continue
            try:
                excess = quadratic.cost(model) + penalty.total(model) - selected
            except np.linalg.LinAlgError:
                continue
            if excess < CERTAIN:
                names = candidates.pairs[pair].name, candidates.pairs[rival].name
                exchanges.append(LinkExchange(*names, tuple(own), float(excess)))
    return tuple(sorted(exchanges, key=lambda exchange: exchange.excess))


def _neighbours(pair: int, pairs: Collection[int], candidates: Candidates) -> set[int]:
    """Those of some pairs that end at a mass at which a pair ends as well."""
    masses = {mass.name for mass in candidates.masses}.intersection(candidates.pairs[pair].between)
    return {
        rival for rival in pairs if rival != pair and not masses.isdisjoint(candidates.pairs[rival].between)
    }


def link_exchange_remarks(exchanges: Sequence[LinkExchange]) -> tuple[str, ...]:
    """Sentences on the exchanges, and how many more there are."""
    more = len(exchanges) - _NAMED
    remarks = tuple(exchange.remark() for exchange in exchanges[:_NAMED])
    return remarks if more <= 0 else (*remarks, f"{more} more exchanges of a link would cost as little.")
