"""Models beside the selected one: those that survive with their weights, those on the path over sizes, and the next best.

Where a margin is small, another model explains the record nearly as well, and an answer that reports the selected one alone is
too sure of it. Each model has the weight exp(-criterion / 2) of its Bayesian information, with the penalties of the selection
as its prior. Models are those that single moves reach: from the selected one, and again from each that survives, whose
criterion is less than that of decisions that are certain (Occam's window). With a model error the quadratic model has been
divided by the overdispersion of blocks, and so are the weights discounted. Memory in a link has evidence of its own kind.

References
----------
D. Madigan and A. E. Raftery, J. Am. Stat. Assoc. 89, 1535 (1994).

J. A. Hoeting, D. Madigan, A. E. Raftery and C. T. Volinsky, Stat. Sci. 14, 382 (1999).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import nan
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.selection import Selection
from linkwise.estimates.link_estimate import NORMAL_95, LinkEstimate
from linkwise.model.coefficient import Name
from linkwise.model.law import Law
from linkwise.verdict import Decision

_MOST = 60  # models that survive
_POINTS = 41  # at which forces of models are compared
_SAME = 1e-3  # of the force of a link: models that differ by less agree


@dataclass(frozen=True, eq=False)
class ModelAverage:
    """The models that survive a selection, the selected one first.

    Attributes
    ----------
    models : tuple of tuple of str
        The names of the terms of each of m models.
    weights : array of shape (m,)
        Their weights, of sum one.
    probabilities : mapping of str to float
        Of every candidate that was tested: the sum of the weights of the models with it, of all that single moves reach.
    coefficients : tuple of Name
        The names of the u coefficients that one of the models has.
    values : array of shape (m, u)
        Their values in each model, 0 where it has not the term.
    covariances : array of shape (m, u, u)
        Their covariances, beside the terms of the model alone.
    laws : mapping of str to Law
        The function of d and v of each of the terms, by name.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> average = lw.discover(record, {"m1": 1.0, "m2": 0.01}).average
    >>> bool(average.weights[0] == max(average.weights)), round(float(sum(average.weights)), 12)
    (True, 1.0)
    """

    models: tuple[tuple[str, ...], ...]
    weights: Floats
    probabilities: Mapping[str, float]
    coefficients: tuple[Name, ...]
    values: Floats
    covariances: Floats
    laws: Mapping[str, Law]

    def force_band(self, link: LinkEstimate, d: Floats) -> tuple[Floats, Floats, Floats]:
        """Stiffness force of a link, averaged over the models, with its 95 % band.

        Parameters
        ----------
        link : LinkEstimate
            The link of the selected model.
        d : array
            Elongations in m.

        Returns
        -------
        force, lower, upper : array of the shape of `d`
            Mean of the forces in N, and ends of the band: variances within models, which are at least those of the estimate
            beside its terms, and between them. NaN where the estimate has no band.
        """
        force, lower, _ = link.force_band(d)
        gradient, shifts = self._gradient(link, d.ravel()), self.shifts(link, d.ravel())
        mean = self.weights @ shifts
        within = np.einsum("ud,muv,vd->md", gradient, self.covariances, gradient)
        between = self.weights @ (shifts - mean) ** 2
        half = NORMAL_95 * np.sqrt(np.maximum(self.weights @ within + between, 0.0)).reshape(d.shape)
        averaged = force + mean.reshape(d.shape)
        missing = np.where(np.isfinite(lower), 0.0, np.nan)
        return averaged, averaged - half + missing, averaged + half + missing

    def shifts(self, link: LinkEstimate, d: Floats) -> Floats:
        """Stiffness forces of a link in each model, minus that of the selected one.

        Parameters
        ----------
        link : LinkEstimate
            The link of the selected model.
        d : array of shape (D,)
            Elongations in m.

        Returns
        -------
        array of shape (m, D)
            The differences in N.
        """
        return np.asarray((self.values - self.values[0]) @ self._gradient(link, d))

    def departing(self, links: Sequence[LinkEstimate]) -> str | None:
        """The link in whose force the models differ most, relative to its size; None if all agree.

        Parameters
        ----------
        links : sequence of LinkEstimate
            The links of the selected model.

        Returns
        -------
        str or None
            Its name.
        """
        spreads = {}
        for link in links:
            d = np.linspace(*link.d_range, _POINTS)
            size = float(np.max(np.abs(link.force_band(d)[0])))
            spread = np.sqrt(self.weights @ self.shifts(link, d) ** 2)
            spreads[link.link.name] = float(np.max(spread)) / size if size > 0.0 else 0.0
        name = max(spreads, key=lambda link: spreads[link], default=None)
        return None if name is None or spreads[name] < _SAME else name

    def _gradient(self, link: LinkEstimate, d: Floats) -> Floats:
        """(u, D) of the force of a link by the coefficients."""
        law = link.link.law
        slopes = law.partials(d, 0.0, {**link.link.values, **link.link.zero_states}).by_coefficient
        gradient = np.zeros((len(self.coefficients), len(d)))
        for row, name in zip(gradient, self.coefficients, strict=True):
            if name.owner == link.link.name and name.key in slopes:
                row[:] = slopes[name.key]
            elif name.owner == link.link.name and name in self.laws:
                row[:] = self.laws[name].force(d, 0.0, {})
        return gradient


def model_average(selection: Selection, errors: Floats) -> ModelAverage:
    """The models around a selection that survive, and the probabilities of all terms that were tested.

    `errors` (p,) are the standard errors of the estimate beside the terms selected, which may be larger than those of the
    quadratic model: errors of the other models are as much larger.
    """
    quadratic, entries = selection.quadratic, selection.entries
    every = _rises(selection).items()
    rises = {own: rise for own, rise in every if rise >= CERTAIN or quadratic.determines(sorted(own))}
    weights = np.exp(-0.5 * (np.array(list(rises.values())) - min(rises.values())))
    weights /= weights.sum()
    contained = np.zeros((len(rises), len(quadratic.names)))
    for row, subset in zip(contained, rises, strict=True):
        row[list(subset)] = 1.0
    included = weights @ contained
    surviving = [number for number, rise in enumerate(rises.values()) if rise < CERTAIN]
    surviving = [surviving[0], *sorted(surviving[1:], key=lambda number: -weights[number])][:_MOST]
    members = np.flatnonzero(contained[surviving].any(axis=0))
    values = np.zeros((len(surviving), len(members)))
    covariances = np.zeros((len(surviving), *2 * members.shape))
    for place, number in enumerate(surviving):
        inside = np.flatnonzero(contained[number])
        among = np.searchsorted(members, inside)
        values[place, among] = quadratic.solve(inside).values
        covariances[place][np.ix_(among, among)] = quadratic.covariance(inside)
    factors = np.ones(len(members))
    own = np.sqrt(np.maximum(covariances[0].diagonal()[: len(errors)], 0.0))
    factors[: len(errors)] = np.maximum(np.divide(errors, own, out=np.ones_like(own), where=own > 0.0), 1.0)
    if len(errors):
        factors[len(errors) :] = np.median(factors[: len(errors)])
    models = (np.flatnonzero(contained[number]) for number in surviving)
    return ModelAverage(
        models=tuple(tuple(quadratic.names[k] for k in model if k in entries) for model in models),
        weights=weights[surviving] / weights[surviving].sum(),
        probabilities={entry.name: float(included[k]) for k, entry in entries.items()},
        coefficients=tuple(Name.parse(quadratic.names[number]) for number in members),
        values=values,
        covariances=covariances * np.outer(factors, factors),
        laws={entries[k].name: entries[k].term.law for k in members.tolist() if k in entries},
    )


def _rises(selection: Selection) -> dict[frozenset[int], float]:
    """By how much the criterion of each model that moves reach is above that of the selected one, which is the first."""
    chosen, left = frozenset(selection.inside), set[frozenset[int]]()
    rises = {chosen: 0.0}
    for _ in range(_MOST):
        surviving = [subset for subset, rise in rises.items() if rise < CERTAIN and subset not in left]
        if not surviving:
            break
        current = min(surviving, key=lambda subset: rises[subset])
        left.add(current)
        try:
            moves = selection.quadratic.moves(sorted(current), swaps=False)
        except np.linalg.LinAlgError:  # its columns depend on each other
            del rises[current]
            continue
        for move in selection.neighbours if current == chosen else moves:
            subset = frozenset(k for k in (*current, move.added) if k is not None and k != move.dropped)
            rise = rises[current] - move.gain
            if np.isfinite(rise):
                rises[subset] = min(rise, rises.get(subset, rise))
    return rises


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


@dataclass(frozen=True)
class MemoryEvidence:
    """The evidence that a link has memory, by a named law.

    Margins are on the scale of -2 log likelihood. A fit that stops before it converges, since it leaves too much, gives a
    lower bound of one.

    Attributes
    ----------
    link : str
        The name of the link, "m2-m1".
    between : tuple of str
        Its ends.
    law : str
        The name of the law, "bouc-wen".
    kept : bool
        Whether the discovered structure has this law; the others explain the records as well.
    coefficients : tuple of str
        The names of the coefficients of the part with memory, "m2-m1.F".
    over_links : float
        By how much the criterion rises if the best other link has memory in its place; infinite if there is no other.
    over_laws : float
        By how much it rises with the best other law on this link; infinite if no other was tried, below zero for a law that
        was not kept.
    over_none : float
        By how much it rises if no link has memory, whatever usual forms of d and v this link has in place of it.
    unambiguous : bool
        Whether the fit can be trusted.

    References
    ----------
    R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), for the scale of the margins.

    Examples
    --------
    >>> import linkwise as lw
    >>> evidence = lw.discovery.MemoryEvidence(
    ...     "m1-ground", ("m1", "ground"), "dahl", True, ("m1-ground.Fc",), 250.0, 3.0, 120.0, True
    ... )
    >>> evidence.decision is lw.discovery.Decision.CERTAIN, evidence.law_certain
    (True, False)
    """

    link: str
    between: tuple[str, str]
    law: str
    kept: bool
    coefficients: tuple[str, ...]
    over_links: float
    over_laws: float
    over_none: float
    unambiguous: bool

    @property
    def decision(self) -> Decision:
        """How firm it is that this link has memory, whatever the law."""
        firm = self.unambiguous and min(self.over_links, self.over_none) > CERTAIN
        return Decision.CERTAIN if firm else Decision.DOUBTFUL

    @property
    def certain(self) -> bool:
        """Whether it is certain that this link has memory."""
        return self.decision is Decision.CERTAIN

    @property
    def law_certain(self) -> bool:
        """Whether no other law that was tried explains the records as well."""
        return self.certain and self.over_laws > CERTAIN

    @property
    def margin(self) -> float:
        """The least of the margins over other links and over no memory."""
        return min(self.over_links, self.over_none)

    def to_dict(self) -> dict[str, Any]:
        """The evidence as plain data.

        Returns
        -------
        dict
            The attributes, and "decision".
        """
        plain = asdict(self)
        plain["between"], plain["coefficients"] = list(self.between), list(self.coefficients)
        return {**plain, "decision": self.decision.value, "law_certain": self.law_certain}
