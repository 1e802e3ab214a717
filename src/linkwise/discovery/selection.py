"""Selection by likelihood: fit, test every candidate on a local quadratic model, change the subset, and fit again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.stepwise import Move, best_subset, local_search, ranked_moves
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.optima.restarts import fit_with_restarts
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.score_test import CandidateForce, LocalQuadratic, local_quadratic
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part
from linkwise.records.record import Record

#: Start values (p,) of the parameters of a structure, and their standard deviations (p,) where they are known.
Start = Callable[[Structure], tuple[Floats, Floats | None]]

_ROUNDS = 12
_STEPS = 40  # of a fit whose laws may still be wrong; right ones take a quarter of it
_TIGHT = 1e-4  # q up to which the local quadratic model is exact; a looser one only ranks the next terms
# chi-square at which a fit stops tightening: a term is missing, and can already be identified
_CEILING = 1.05


@dataclass(frozen=True, eq=False)
class Selection:
    """The `structure` of the `chosen` candidates, its `fit`, and a local model of the cost in all candidates tested.

    `settled` is False if the search ended without a subset that no move improves, after `rounds` rounds. `needless` are the
    names of terms that the criterion would have and prediction has no need of, `of_departures` those, with their functions,
    that it would have only where the motion may depart from the laws.
    """

    chosen: frozenset[str]
    structure: Structure
    fit: LikelihoodFit
    quadratic: QuadraticModel
    penalty: Penalty
    settled: bool
    rounds: int
    needless: tuple[str, ...] = ()
    of_departures: tuple[str, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether the fit converged at a q for which the local quadratic model is exact."""
        return _converged(self.fit)

    @property
    def is_exact(self) -> bool:
        """Whether the laws leave no more than noise, or the search was interrupted before that could be said."""
        return leaves_only_noise(self.fit) or self.fit.status is AnnealingStatus.INTERRUPTED

    def has_fewer_links(self, rival: Selection) -> bool:
        """Whether it settled on fewer links than another one, where links may stand in for terms that were not offered."""
        return self.settled and len(self.structure.links) < len(rival.structure.links)

    @cached_property
    def neighbours(self) -> tuple[Move, ...]:
        """All moves to other subsets, exchanges among them, the best first."""
        inside = list(range(len(self.structure.parameters)))
        return tuple(ranked_moves(self.quadratic, self.penalty, inside, swaps=True))

    def quadratic_beside(self, local: LocalQuadratic, names: Sequence[str]) -> QuadraticModel:
        """A model about the same fit in its parameters and in what `names` call, on the scale of `quadratic`.

        Raises numpy.linalg.LinAlgError where the latter is singular.
        """
        p = len(self.structure.parameters)
        ratios = local.curvature[:p, :p] @ np.linalg.inv(self.quadratic.h[:p, :p])
        factor = float(np.trace(ratios)) / p  # of overdispersion
        scatter = None if local.scatter is None else local.scatter / factor**2
        names = (*self.quadratic.names[:p], *names)
        return QuadraticModel(names, local.curvature / factor, local.slope / factor, scatter)

    @property
    def noise(self) -> Floats:
        """(C,) the standard deviations of the noise of the channels that the fit went by, which it may have lowered."""
        return self.fit.optimum.scales.sigma * self.fit.optimum.noise

    def criterion(self, noise: Floats) -> float:
        """Cost with a `noise` (C,) plus penalty; infinite if the fit did not converge."""
        if not self.converged:
            return np.inf
        return cost_of(self.fit, noise) + self.penalty.total(list(range(len(self.structure.parameters))))


def leaves_only_noise(fit: LikelihoodFit) -> bool:
    """Whether a fit converged at a tight q, and its residuals are no more than noise."""
    return _converged(fit) and not fit.chi_square_off


def cost_of(fit: LikelihoodFit, noise: Floats) -> float:
    """-2 log likelihood of a fit at the relaxation where it ended, if the channels have a `noise` (C,)."""
    misfit, optimum = fit.misfit, fit.optimum
    squares = np.sum(misfit.residuals**2, axis=(0, 2)) * (optimum.scales.sigma / noise) ** 2
    return float(np.sum(squares)) + (misfit.cost(optimum.q) - misfit.data) / optimum.noise**2


def best_of(selections: Sequence[Selection]) -> Selection:
    """The selection with the lowest criterion, the first of those that are as low.

    All are compared at the same noise, the least that any of them found: residuals are no less than noise, whatever the laws.
    Where none converged at a tight q, it is the first that converged at all, else the first.
    """
    converged = [selection for selection in selections if selection.converged]
    if converged:
        noise = np.min([selection.noise for selection in converged], axis=0)
        return min(converged, key=lambda selection: selection.criterion(noise))
    ended = (selection for selection in selections if selection.fit.status is AnnealingStatus.CONVERGED)
    return next(ended, selections[0])


def link_motions(selection: Selection) -> dict[str, tuple[Floats, Floats]]:
    """Elongations and rates of each link along the fitted motion, at the ends of the steps of the flow, in m and m/s."""
    optimum, structure = selection.fit.optimum, selection.structure
    misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    order = optimum.segments.system.order.tolist()
    motion = misfit.trajectories.links
    return {structure.links[link].name: (motion[:, 0, k], motion[:, 1, k]) for k, link in enumerate(order)}


def _converged(fit: LikelihoodFit) -> bool:
    tight = fit.optimum.q <= _TIGHT or bool(fit.random_forces)  # beside which the flow is tight enough
    return fit.status is AnnealingStatus.CONVERGED and tight


_SINGULAR = (
    "the fit of the terms that the search starts from ({}) does not converge: its equations became singular. Sample faster, "
    "record for longer or with less noise, or state links that are known in a structure file"
)


@dataclass(frozen=True, eq=False)
class TermSearch:
    """What all rounds share: the records, the candidates, the names of those `tested`, and where a fit starts.

    `sensors` has the errors of sensors that every fit finds beside the terms. `restarts` says that starting states follow from
    the laws, so that where a fit fails they are computed again from its values.
    """

    records: Sequence[Record]
    candidates: Candidates
    tested: frozenset[str]
    start: Start
    progress: Progress
    sensors: LikelihoodOptions
    restarts: bool = False

    def within(self, names: Collection[str]) -> TermSearch:
        """The same search among the candidates `names` only."""
        return replace(self, tested=self.tested & frozenset(names))

    def first_fit(
        self, structure: Structure, *, ceiling: float = _CEILING, steps: int = _STEPS
    ) -> LikelihoodFit:
        """A fit from the start that the search has for `structure`, as tight as its laws allow."""
        theta, spread = self.start(structure)
        options = replace(self.options(self.progress, self.sensors.nodes), ceiling=ceiling, steps=steps)
        return likelihood_fit(self.records, structure, theta, spread=spread, options=options)

    def options(self, progress: Progress, nodes: Floats | None) -> LikelihoodOptions:
        """Those of a fit that may lack terms and starts from `nodes`."""
        return replace(
            self.sensors, progress=progress, nodes=nodes, model_error=False, ceiling=_CEILING, steps=_STEPS
        )

    def fit(
        self, structure: Structure, theta: Floats, spread: Floats | None, options: LikelihoodOptions
    ) -> LikelihoodFit:
        """A fit from `theta`, or one from states that are computed again where that fails and they follow from the laws."""
        fitted = partial(likelihood_fit, self.records, structure)
        fit = fitted(theta, spread=spread, options=options)
        stopped = fit.status is AnnealingStatus.INTERRUPTED
        if not self.restarts or stopped or (_converged(fit) and not fit.chi_square_off):
            return fit
        again = fit_with_restarts(fitted, theta, replace(options, nodes=None))
        return again if again.chi_square < fit.chi_square else fit

    def additions(
        self, structure: Structure, chosen: frozenset[str]
    ) -> tuple[list[str], list[CandidateForce]]:
        """The names of the candidates tested beside the `chosen` ones, and their forces in `structure`."""
        index = structure.topology.index
        added = [entry for entry in self.candidates.entries if entry.name in self.tested - chosen]
        ends = [self.candidates.pairs[entry.pair].between for entry in added]
        return [entry.name for entry in added], [
            CandidateForce(index[first], index[second], entry.term.law)
            for entry, (first, second) in zip(added, ends, strict=True)
        ]

    def local_model(
        self, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]
    ) -> tuple[QuadraticModel, Penalty]:
        """The cost about the fit in its parameters and, after them, the other candidates tested; and the penalty."""
        added, forces = self.additions(structure, chosen)
        local = local_quadratic(fit.optimum, forces)
        names = (*(p.name for p in structure.parameters), *added)
        samples = sum(
            int(np.isfinite(record.select(record.responses).values).sum()) for record in self.records
        )
        model = QuadraticModel(names, local.curvature, local.slope, local.scatter)
        return model, Penalty.of(self.candidates, names, samples)


def select_structure(search: TermSearch, chosen: Collection[str]) -> Selection:
    """The subset, searched from `chosen`, that no candidate tested improves.

    If it has links that `chosen` had not, the best subset on the links of `chosen` alone is searched as well, and the better
    of both is taken: terms on false links may substitute for a term that the local model did not show. If the rounds run out,
    or the search returns to a subset that it had left, `settled` is False and the result the best subset visited. The progress
    of `search` is called with the number of the round and each step of its fit. Beside hosts the search begins with the stated
    links alone where these leave only noise: a screen without displacements may take others for them.
    """
    stated = _fit_of_stated_links(search)
    if stated is not None and (leaves_only_noise(stated) or stated.status is AnnealingStatus.INTERRUPTED):
        return _descend(search, frozenset(), 1, stated)
    first = _descend(search, frozenset(chosen), 1)
    own = search.candidates.on_links_of(chosen)
    if first.fit.status is AnnealingStatus.INTERRUPTED or first.chosen <= own:
        return first
    second = _descend(search.within(own), own & search.tested, first.rounds + 1)
    if second.fit.status is AnnealingStatus.INTERRUPTED or best_of([first, second]) is first:
        return replace(first, rounds=second.rounds)
    quadratic, penalty = search.local_model(second.fit, second.structure, second.chosen)
    return replace(second, quadratic=quadratic, penalty=penalty)


def _fit_of_stated_links(search: TermSearch) -> LikelihoodFit | None:
    """The fit of the stated links of a structure with hosts; None where there are none, or they cannot be fitted alone."""
    if not (search.candidates.hosts and any(pair.stated for pair in search.candidates.pairs)):
        return None
    try:
        structure = search.candidates.structure(())
        theta, spread = search.start(structure)
        options = search.options(round_progress(search.progress, 1), search.sensors.nodes)
        return search.fit(structure, theta, spread, options)
    except (
        IdentificationError,
        np.linalg.LinAlgError,
    ):  # a mass without a link, or laws with which the motion runs away
        return None


def _descend(
    search: TermSearch, chosen: frozenset[str], number: int, known: LikelihoodFit | None = None
) -> Selection:
    """Rounds of fit and change, from the round `number` on, until the subset does not change.

    The fit of the `chosen` is made here unless it is `known`.
    """
    visited: dict[frozenset[str], Selection] = {}
    structure = search.candidates.structure(chosen)
    theta, spread = search.start(structure) if known is None else (known.values, None)
    nodes = search.sensors.nodes
    last = number + _ROUNDS - 1
    while True:
        inside = list(range(len(structure.parameters)))
        progress = round_progress(search.progress, number)
        try:
            fit = known or search.fit(structure, theta, spread, search.options(progress, nodes))
            progress(ProgressReport(1.0, f"testing {len(search.tested)} candidates"))
            quadratic, penalty = search.local_model(fit, structure, chosen)
            after = local_search(quadratic, penalty, inside) if fit.optimum.q > _TIGHT else inside
            if after == inside:
                after = best_subset(quadratic, penalty, inside)
            quadratic.solve(after)
        except (IdentificationError, np.linalg.LinAlgError) as error:
            # the motion runs away from where the last round led, or the fit to where the record says nothing of a parameter
            if visited:
                return replace(best_of([*visited.values()]), rounds=number)
            if isinstance(error, IdentificationError):
                raise
            raise IdentificationError(_SINGULAR.format(", ".join(sorted(chosen)))) from None
        names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
        selection = Selection(chosen, structure, fit, quadratic, penalty, names == chosen, number)
        if selection.settled or fit.status is AnnealingStatus.INTERRUPTED:
            return selection
        visited[chosen] = selection
        if names in visited or number == last:
            return replace(best_of([*visited.values()]), rounds=number)
        chosen, structure = names, search.candidates.structure(names)
        theta, spread = starts_of(quadratic, after, structure, fit)
        nodes, number, known = fit.optimum.point.nodes, number + 1, None


def starts_of(
    quadratic: QuadraticModel, chosen: Sequence[int], structure: Structure, fit: LikelihoodFit
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` that the model's coefficients `chosen` predict, and their deviations (p,).

    A mass that would not be positive stays as in the `fit` that the model is of.
    """
    solution = quadratic.solve(chosen)
    deviations = np.abs(solution.values / solution.z)
    starts = dict(
        zip([quadratic.names[k] for k in chosen], zip(solution.values, deviations, strict=True), strict=True)
    )
    for parameter in structure.parameters:  # those of terms have starts of their own
        if parameter.start is not None:
            starts.setdefault(parameter.name, (parameter.start, abs(parameter.start)))
    theta, spread = np.array([starts[p.name] for p in structure.parameters]).T
    fitted = dict(zip(quadratic.names, fit.values, strict=False))  # its parameters come first
    masses = {f"{mass.name}.mass" for mass in structure.masses}
    for number, parameter in enumerate(structure.parameters):
        if parameter.name in masses and theta[number] <= 0.0:
            theta[number] = fitted[parameter.name]
    return theta, spread


def round_progress(progress: Progress, number: int) -> Progress:
    """The progress of one round: each takes half of what is left."""
    start, stop = 1.0 - 0.5 ** (number - 1), 1.0 - 0.5**number

    def named(report: ProgressReport, /) -> None:
        progress(replace(report, activity=f"round {number}: {report.activity}"))

    return part(named, start, stop)
