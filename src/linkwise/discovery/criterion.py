"""The penalty on the size of a model: the extended Bayesian information criterion, on links and terms.

Schwarz's criterion costs ln N for each coefficient; with hundreds of candidates some false ones then enter by chance, so the
extended criterion adds the cost of the choice itself. Here a term costs the choice of one among the terms of its link. A link
costs, on top of its first term, another ln N and the choice of one among all pairs, so that a second term on a link costs less
than a new link.

References
----------
G. Schwarz, "Estimating the dimension of a model", Ann. Statist. 6 (1978).
J. Chen and Z. Chen, "Extended Bayesian information criteria for model selection with large model spaces", Biometrika 95
(2008).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Indices
from linkwise.discovery.candidates import Candidates


@dataclass(frozen=True, eq=False)
class Penalty:
    """The penalties of a `term` and of a `link`, in units of -2 log likelihood.

    `pair` (p,) is the number of the pair that each coefficient belongs to, -1 for coefficients that are not selected and cost
    nothing; the links of `stated` pairs cost nothing either.
    """

    term: float
    link: float
    pair: Indices
    stated: frozenset[int]

    @classmethod
    def of(cls, candidates: Candidates, names: tuple[str, ...], samples: int) -> Penalty:
        """The penalty for coefficients called `names` and records of `samples` samples in all."""
        by_name = candidates.by_name
        pairs = [by_name[name].pair if name in by_name else -1 for name in names]
        return cls(
            term=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.terms), 1))),
            link=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.pairs), 1))),
            pair=np.array(pairs, dtype=np.intp),
            stated=frozenset(number for number, pair in enumerate(candidates.pairs) if pair.stated),
        )

    def total(self, chosen: list[int]) -> float:
        """The penalty of a model with the coefficients `chosen`, by number."""
        pairs = self.pair[chosen]
        links = set(pairs.tolist()) - {-1} - self.stated
        return self.term * int(np.sum(pairs >= 0)) + self.link * len(links)

    def pairs_of(self, chosen: Iterable[int]) -> set[int]:
        """The numbers of the pairs that the coefficients `chosen` belong to."""
        return {int(self.pair[k]) for k in chosen} - {-1}
