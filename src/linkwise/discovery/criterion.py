"""What a model costs beside its misfit: the extended Bayesian information criterion, on links and terms.

Schwarz (1978) asks ln N of every coefficient; with hundreds of candidates something false then gets in by chance, so the
choice itself has to be paid for as well (Chen and Chen 2008): a term costs the naming of one among its link's, a link the
naming of one among all pairs and, being more than its first term, another ln N. So a second term on a link costs less than a
new link, and a damper belongs where a spring stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Indices
from linkwise.discovery.candidates import Candidates


@dataclass(frozen=True, eq=False)
class Penalty:
    """`term` and `link` in units of -2 log likelihood; `pair` (p,) the pair of each coefficient, -1 for what is not chosen.

    `stated` pairs have a link whatever is chosen.
    """

    term: float
    link: float
    pair: Indices
    stated: frozenset[int]

    @classmethod
    def of(cls, candidates: Candidates, names: tuple[str, ...], samples: int) -> Penalty:
        """For coefficients of these names, those that are no candidates being free, and a record of so many samples."""
        by_name = candidates.by_name
        pairs = [by_name[name].pair if name in by_name else -1 for name in names]
        return cls(
            term=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.terms), 1))),
            link=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.pairs), 1))),
            pair=np.array(pairs, dtype=np.intp),
            stated=frozenset(number for number, pair in enumerate(candidates.pairs) if pair.stated),
        )

    def total(self, chosen: list[int]) -> float:
        """Of a choice, by numbers of its coefficients."""
        pairs = self.pair[chosen]
        links = set(pairs.tolist()) - {-1} - self.stated
        return self.term * int(np.sum(pairs >= 0)) + self.link * len(links)
