"""What a change of the a of an eliminated state adds to weak equations.

Under psi = -phi' - a phi the balance B of a mass, without the state, is int psi B + int phi p g0 = 0 (`elements`). Its
derivative with respect to a is - int phi B: minus the same terms under phi and its derivatives, with their present
coefficients. These sums are rows like others, with the noise of what they are sums of, so that products of them and of others
lose their bias by the same map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.patch_layout import PatchLayout
from linkwise.weak.terms import LawTerms
from linkwise.weak.weak_form import INNER


@dataclass(frozen=True, eq=False)
class BalanceChange:
    """The terms of a patch and those under phi of which the derivatives by a are sums.

    Attributes
    ----------
    layout : PatchLayout
        The q terms, and behind them t that are some of these once more, under phi and its derivatives.
    twins : array of int, shape (t,)
        The terms that these are.
    sums : array of shape (e, t)
        The e derivatives as sums of them.
    """

    layout: PatchLayout
    twins: Indices
    sums: Floats

    @classmethod
    def of(cls, layout: PatchLayout, numbers: Floats, slopes: dict[int, float]) -> BalanceChange:
        """The change of the equations of a patch.

        Parameters
        ----------
        layout : PatchLayout
            Its q terms.
        numbers : array of shape (q,)
            Their present coefficients.
        slopes : dict of int to float
            The derivatives of a by number of the parameter.

        Returns
        -------
        BalanceChange
            The change.
        """
        own = np.arange(layout.eliminating.start, layout.eliminating.stop)
        acting = layout.signs[:, own].T @ (layout.signs * np.nan_to_num(numbers))
        acting *= layout.kernel + INNER == layout.kernel[own, None]
        acting[:, own] = 0.0
        twins = np.flatnonzero(acting.any(axis=0))
        by_parameter = np.array([slopes[number] for number in layout.coefficients.parameter[own].tolist()])
        wide = replace(
            layout,
            kernel=np.append(layout.kernel, layout.kernel[twins] + INNER),
            incidence=np.concatenate([layout.incidence, layout.incidence[twins]]),
        )
        return cls(wide, twins, -by_parameter[:, None] * acting[:, twins])

    def terms(self, evaluated: Sequence[LawTerms]) -> list[LawTerms]:
        """The terms of laws among those under phi: each part of a law at the links that have one.

        Parameters
        ----------
        evaluated : sequence of LawTerms
            The terms of the equations.

        Returns
        -------
        list of LawTerms
            The terms.
        """
        first, chosen_terms = len(self.layout.kernel) - len(self.twins), []
        for terms in evaluated:
            start, stop = np.searchsorted(self.twins, [terms.terms.start, terms.terms.stop]).tolist()
            if start < stop:
                chosen = self.twins[start:stop] - terms.terms.start
                chosen_terms.append(
                    replace(
                        terms,
                        part=replace(terms.part, kernel=terms.part.kernel + INNER),
                        links=terms.links[chosen],
                        terms=slice(first + start, first + stop),
                        derivatives=tuple(_chosen(part, chosen) for part in terms.derivatives),
                        rate_slope=None if terms.rate_slope is None else terms.rate_slope[chosen],
                    )
                )
        return chosen_terms

    def joined(self, bias: Floats) -> Floats:
        """(q, q) sums of the products (q + t, q + t) of all terms, of the terms of the equations."""
        return np.asarray(self._map @ bias @ self._map.T)

    @property
    def _map(self) -> Floats:
        """(q, q + t): the terms of the equations as sums of all."""
        count = len(self.layout.kernel) - len(self.twins)
        whole = np.eye(count, len(self.layout.kernel))
        whole[self.layout.eliminating] = 0.0
        whole[self.layout.eliminating, count:] = self.sums
        return whole

    def slopes(self, slopes: Floats) -> Floats:
        """Slopes of the derivatives by the displacement of their own mass.

        Parameters
        ----------
        slopes : array of shape (q, K)
            Slopes of the terms.

        Returns
        -------
        array of shape (e, K)
            The slopes.
        """
        own = self.layout.incidence[self.layout.eliminating] @ self.layout.incidence[self.twins].T
        return np.asarray((self.sums * own) @ slopes[self.twins])


def _chosen(part: Floats | float, rows: Indices) -> Floats | float:
    return part if isinstance(part, float) else part[rows]
