"""Models beside the selected one: those on the path over their size, and the next best."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan


@dataclass(frozen=True)
class PathPoint:
    """A model on the path: the best of its size, one term away from the one before.

    Costs are those of the quadratic model at the selected point: exact there, and rough far from it.

    Attributes
    ----------
    terms : int
        The number of terms.
    cost : float
        -2 log likelihood above that of the largest model on the path.
    criterion : float
        Cost plus penalty, above that of the selected model.
    step : str
        The term added ("+ m2-m1.k3") or dropped ("- m2-m1.c") on the way from the selected model.
    chosen : bool
        Whether this is the selected model.
    prediction : float
        What the model pays more than the selected one for pieces of the records that both were not fitted to, in -2 log
        likelihood: each of ten pieces is left out in turn. NaN where the records are too short.
    scatter : float
        Standard error of that, from how far the pieces disagree.
    share : float
        The force of the term of `step` over that of its link, as root mean squares along the motion; NaN where no such link
        was found.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> chosen = next(point for point in discovery.path if point.chosen)
    >>> chosen.terms == len(discovery.kept), chosen.criterion
    (True, 0.0)
    """

    terms: int
    cost: float
    criterion: float
    step: str
    chosen: bool
    prediction: float = nan
    scatter: float = nan
    share: float = nan


@dataclass(frozen=True)
class RunnerUp:
    """A model that differs from the selected one by one term.

    Attributes
    ----------
    change : str
        The difference in words, "without m2-m1.c".
    margin : float
        By how much its criterion is higher.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> margins = [model.margin for model in discovery.runners_up]
    >>> margins == sorted(margins)
    True
    """

    change: str
    margin: float
