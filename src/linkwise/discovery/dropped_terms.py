"""What the terms that were dropped from the links found add to the errors of those kept.

A selection calls a term absent where the record does not show it, and the other coefficients then stand for what it did: their
errors beside the terms kept alone are too small. Here every candidate on a link that was found may still be there. With
columns D of those dropped, the local quadratic model of the cost has the values c_D that they would have, with covariance
C_D, and the coefficients kept move by -G c_D for G = H^-1 H_D. The second moment of the c_D about the zero that the selection
gave them, c_D c_D' + C_D, is theirs without a prior: G (c_D c_D' + C_D) G' is added to the covariance.

References
----------
R. Berk, L. Brown, A. Buja, K. Zhang and L. Zhao, "Valid post-selection inference", Ann. Statist. 41 (2013).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel, inverse_of
from linkwise.estimates.estimate import Estimate

# of a column's square: what the terms kept and the other ones dropped leave of it is rounding
_DEPENDENT = 1e-9
_MUCH_WIDER = 3.0  # times the error beside the terms kept alone, from which a coefficient is named
_NAMED = 3


@dataclass(frozen=True, eq=False)
class DroppedTerms:
    """The terms dropped from the links found, by `names` (d,), and what they add to the errors of the p coefficients kept.

    `covariance` (p, p) is to be added to that beside the terms kept alone; `shares` (p, d) are the parts of its diagonal that
    each term has by itself.
    """

    names: tuple[str, ...]
    covariance: Floats
    shares: Floats

    @classmethod
    def of(cls, quadratic: QuadraticModel, penalty: Penalty, count: int) -> DroppedTerms:
        """Those of a model whose first `count` coefficients are those of the selection.

        Raises numpy.linalg.LinAlgError if the columns of the selection are linearly dependent.
        """
        linked = set(penalty.pair[:count].tolist()) | penalty.stated
        others = range(count, len(quadratic.names))
        dropped = np.array([number for number in others if penalty.pair[number] in linked], dtype=np.intp)
        inside = np.arange(count)
        covariance = inverse_of(quadratic.h[:count, :count])
        follow = covariance @ quadratic.h[np.ix_(inside, dropped)]
        square = quadratic.h[dropped, dropped]
        scale = 1.0 / np.sqrt(np.where(square > 0.0, square, 1.0))
        left = quadratic.h[np.ix_(dropped, dropped)] - quadratic.h[np.ix_(dropped, inside)] @ follow
        size, vectors = np.linalg.eigh(left * np.outer(scale, scale))
        independent = size > _DEPENDENT
        root = scale[:, None] * vectors[:, independent] / np.sqrt(size[independent])
        values = root @ (root.T @ (quadratic.g[dropped] - follow.T @ quadratic.g[:count]))
        moment = np.outer(values, values)
        if quadratic.scatter is None:
            moment += root @ root.T
        else:
            both = np.concatenate([inside, dropped])
            influence = root @ (root.T @ np.hstack([-follow.T, np.eye(len(dropped))]))
            moment += influence @ quadratic.scatter[np.ix_(both, both)] @ influence.T
        of_selected = follow @ moment @ follow.T
        return cls(
            names=tuple(quadratic.names[number] for number in dropped),
            covariance=0.5 * (of_selected + of_selected.T),
            shares=follow**2 * moment.diagonal(),
        )


def widened(estimate: Estimate, covariance: Floats) -> Estimate:
    """The estimate with a `covariance` (p, p) more for terms that it lacks, which a profile would not allow for."""
    before = 0.0 if estimate.for_dropped_terms is None else estimate.for_dropped_terms
    return replace(
        estimate,
        covariance=estimate.covariance + covariance,
        for_dropped_terms=before + covariance,
        profile=None,
    )


def dropped_terms_remark(dropped: DroppedTerms, estimate: Estimate, alone: Floats) -> tuple[str, ...]:
    """A sentence on the coefficients whose errors are mostly due to a term dropped; `alone` (p,) are those without them.

    Those of links in doubt have no errors.
    """
    added = np.maximum(dropped.covariance.diagonal(), 0.0)
    wider = np.sqrt(1.0 + np.where(alone > 0.0, added / np.where(alone > 0.0, alone, 1.0) ** 2, 0.0))
    worst = [
        number
        for number in np.argsort(-wider).tolist()
        if wider[number] > _MUCH_WIDER
        and estimate.coefficient(estimate.parameters[number].name).standard_error is not None
    ][:_NAMED]
    if not worst:
        return ()
    effects = [
        f"{estimate.parameters[number].name} ({wider[number]:.2g} times as wide, mostly by "
        f"{dropped.names[int(np.argmax(dropped.shares[number]))]})"
        for number in worst
    ]
    return (
        "The intervals allow for terms that were dropped but could be there unseen; they are much wider for "
        f"{', '.join(effects)}. Excite these links more, record for longer, or state links that are known.",
    )
