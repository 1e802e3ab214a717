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
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.selection import Selection
from linkwise.estimates.link_estimate import NORMAL_95, LinkEstimate
from linkwise.model.coefficient import Name
from linkwise.model.law import Law

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
