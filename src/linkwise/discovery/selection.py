"""Selection by likelihood: fit, test every candidate on a local quadratic model, change the subset, and fit again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates, CandidateTerm
from linkwise.discovery.criterion import Move, Penalty, QuadraticModel, Subset
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.optima.restarts import fit_with_restarts
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.diagnosis import link_forces
from linkwise.likelihood.tests.score_test import Quadratic, candidate_forces, local_quadratic
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread

#: Start values (p,) of the parameters of a structure, and their standard deviations (p,) where they are known.
Start = tuple[Floats, Floats | None]

_STEPS = 40  # of a fit whose laws may still be wrong; right ones take a quarter of it
_TIGHT = 1e-4  # q up to which the local quadratic model is exact; a looser one only ranks the next terms
# chi-square at which a fit stops tightening: a term is missing, and can already be identified
_CEILING = 1.05


@dataclass(frozen=True, eq=False)
class Selection:
    """The `structure` of the `chosen` ones of some `candidates`, its `fit`, and the criterion in all candidates tested.

    In that, `quadratic`, the parameters of the fit come first. `settled` is False if the search ended without a subset that no
    move improves, after `rounds` rounds. `needless` are the names of terms that the criterion would have and prediction has
    no need of, `of_departures` those, with their functions, that it would have only where the motion may depart from the laws.
    """

    candidates: Candidates
    chosen: frozenset[str]
    structure: Structure
    fit: LikelihoodFit
    quadratic: QuadraticModel
    settled: bool
    rounds: int
    needless: tuple[str, ...] = ()
    of_departures: tuple[str, ...] = ()

    @property
    def inside(self) -> list[int]:
        """The numbers of the parameters of the fit."""
        return list(range(len(self.structure.parameters)))

    @cached_property
    def entries(self) -> dict[int, CandidateTerm]:
        """The candidates by the numbers of their coefficients."""
        by_name = self.candidates.by_name
        return {k: by_name[name] for k, name in enumerate(self.quadratic.names) if name in by_name}

    @cached_property
    def coefficients(self) -> dict[int, tuple[float, float]]:
        """Values and z scores of all coefficients, by number: those of the fit, and each of the others added alone."""
        inside, others = self.quadratic.solve(self.inside), self.quadratic.additions(self.inside)
        numbers = [*self.inside, *others.numbers.tolist()]
        values, z = (np.concatenate(parts).tolist() for parts in zip(inside, others[1:], strict=True))
        return dict(zip(numbers, zip(values, z, strict=True), strict=True))

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the fit."""
        return self.fit.status is AnnealingStatus.INTERRUPTED

    @property
    def is_exact(self) -> bool:
        """Whether the laws leave no more than noise, or the search was interrupted before that could be said."""
        return leaves_only_noise(self.fit) or self.interrupted

    @cached_property
    def neighbours(self) -> tuple[Move, ...]:
        """All moves to other subsets, exchanges among them, the best first."""
        return tuple(self.quadratic.moves(self.inside, swaps=True))

    def quadratic_beside(
        self, local: Quadratic, pairs: Sequence[int], names: Sequence[str]
    ) -> QuadraticModel:
        """The criterion about the same fit in its parameters and in what `names` call, on the scale of `quadratic`.

        The latter are terms of `pairs`, by number, or nothing to be selected (-1).
        """
        p, penalty, factor = len(self.inside), self.quadratic.penalty, self.quadratic.overdispersion
        return QuadraticModel(
            (*self.quadratic.names[:p], *names),
            local.curvature / factor,
            local.slope / factor,
            replace(penalty, pair=np.append(penalty.pair[:p], np.array(pairs, dtype=np.intp))),
            None if local.scatter is None else local.scatter / factor**2,
        )

    @property
    def noise(self) -> Floats:
        """(C,) the standard deviations of the noise of the channels that the fit went by, which it may have lowered."""
        return self.fit.optimum.scales.sigma * self.fit.optimum.noise

    def criterion(self, noise: Floats) -> float:
        """Cost with a `noise` (C,) plus penalty; infinite if the fit did not converge."""
        total = cost_of(self.fit, noise) + self.quadratic.penalty.total(self.inside)
        return total if _converged(self.fit) else np.inf

    def excess(self, chosen: Iterable[int]) -> float:
        """By how much the criterion with the coefficients `chosen`, by number, is higher; infinite where it has no least."""
        try:
            return self.quadratic.criterion(sorted(chosen)) - self.quadratic.criterion(self.inside)
        except np.linalg.LinAlgError:
            return np.inf

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # a term may be infinite somewhere
    def unit_shares(self) -> dict[int, float]:
        """The force of each term on a link found per unit of its coefficient over that of the link, by number.

        Both are root mean squares along the fitted motion; the unit is the reciprocal of that of the coefficient.
        """
        optimum, of_links = self.fit.optimum, dict[frozenset[str], float]()
        ends = {k: frozenset(self.candidates.pairs[entry.pair].between) for k, entry in self.entries.items()}
        with one_blas_thread():
            sizes = link_forces(optimum, self.structure)
            for link in self.structure.links:
                between = frozenset(link.between)
                of_links[between] = of_links.get(between, 0.0) + sizes[link.name]
            found = [k for k in ends if ends[k] in of_links]
            forces = self.candidates.forces([self.entries[k] for k in found], self.structure)
            _, units = candidate_forces(optimum.segments, optimum.misfit, forces)
        ratios = (units * [of_links[ends[k]] for k in found]).tolist()
        return {k: 1.0 / ratio if ratio > 0.0 else np.inf for k, ratio in zip(found, ratios, strict=True)}

    def link_motions(self) -> dict[str, tuple[Floats, Floats]]:
        """Elongations and rates of each link along the fitted motion, at the ends of the steps of the flow, in m and m/s."""
        optimum, links = self.fit.optimum, self.structure.links
        order = optimum.segments.system.order.tolist()
        motion = optimum.misfit.trajectories.links
        return {links[link].name: (motion[:, 0, k], motion[:, 1, k]) for k, link in enumerate(order)}


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
    converged = [selection for selection in selections if _converged(selection.fit)]
    if converged:
        noise = np.min([selection.noise for selection in converged], axis=0)
        return min(converged, key=lambda selection: selection.criterion(noise))
    ended = (selection for selection in selections if selection.fit.status is AnnealingStatus.CONVERGED)
    return next(ended, selections[0])


def _converged(fit: LikelihoodFit) -> bool:
    """Whether a fit converged at a q for which the local quadratic model is exact."""
    tight = fit.optimum.q <= _TIGHT or bool(fit.random_forces)  # beside which the flow is tight enough
    return fit.status is AnnealingStatus.CONVERGED and tight


def singular(names: Iterable[str]) -> IdentificationError:
    """The error of a search whose fit of the terms `names` does not tell them apart."""
    return IdentificationError(
        f"the fit of the terms {', '.join(sorted(names))} does not converge: its equations became singular. Sample faster, "
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
    start: Callable[[Structure], Start]
    progress: Progress
    sensors: LikelihoodOptions
    restarts: bool = False

    def starting_at(self, structure: Structure, values: Floats, spread: Floats | None = None) -> TermSearch:
        """The search that starts from values (p,) and deviations (p,) of `structure`; other parameters have their own."""
        names = [parameter.name for parameter in structure.parameters]
        known = dict(zip(names, zip(values, values if spread is None else spread, strict=True), strict=True))

        def start(trial: Structure) -> Start:
            begun, deviations = _started(trial, known)
            return begun, None if spread is None else deviations

        return replace(self, start=start)

    def first_fit(
        self, structure: Structure, *, ceiling: float = _CEILING, steps: int = _STEPS
    ) -> LikelihoodFit:
        """A fit from the start that the search has for `structure`, as tight as its laws allow."""
        sensors, (theta, spread) = self.sensors, self.start(structure)
        options = replace(sensors, progress=self.progress, model_error=False, ceiling=ceiling, steps=steps)
        return likelihood_fit(self.records, structure, theta, spread=spread, options=options)

    def fit(self, structure: Structure, start: Start, options: LikelihoodOptions) -> LikelihoodFit:
        """A fit from `start`, or one from states that are computed again where that fails and they follow from the laws."""
        fitted, (theta, spread) = partial(likelihood_fit, self.records, structure), start
        fit = fitted(theta, spread=spread, options=options)
        stopped = fit.status is AnnealingStatus.INTERRUPTED
        if not self.restarts or stopped or leaves_only_noise(fit):
            return fit
        again = fit_with_restarts(fitted, theta, replace(options, nodes=None))
        return again if again.chi_square < fit.chi_square else fit

    def added(self, chosen: frozenset[str]) -> list[CandidateTerm]:
        """The candidates tested beside the `chosen` ones."""
        return [entry for entry in self.candidates.entries if entry.name in self.tested - chosen]


@dataclass(eq=False)
class Rounds:
    """Rounds of fit and change until the subset stays; kinds differ in the fit, the criterion about it and the change."""

    search: TermSearch
    most: int = 12
    revisits = False  # whether a subset that was left may be visited again

    def options(self, number: int, before: LikelihoodFit | None) -> LikelihoodOptions:
        """Those of the fit in round `number`, from the states of the fit `before`."""
        nodes = self.search.sensors.nodes if before is None else before.optimum.point.nodes
        progress = round_progress(self.search.progress, number)
        return replace(self.search.sensors, progress=progress, nodes=nodes)

    def fit(self, structure: Structure, start: Start, options: LikelihoodOptions) -> LikelihoodFit:
        """The fit of a structure from `start`."""
        theta, spread = start
        return likelihood_fit(self.search.records, structure, theta, spread=spread, options=options)

    def model(self, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]) -> QuadraticModel:
        """The criterion about the fit in its parameters and, after them, the other candidates tested."""
        added, candidates = self.search.added(chosen), self.search.candidates
        local = local_quadratic(fit.optimum, candidates.forces(added, structure))
        names = (*(p.name for p in structure.parameters), *(entry.name for entry in added))
        shown = (record.select(record.responses).values for record in self.search.records)
        samples = sum(int(np.isfinite(values).sum()) for values in shown)
        penalty = Penalty.of(candidates, names, samples)
        return QuadraticModel(names, local.curvature, local.slope, penalty, local.scatter)

    def changed(self, quadratic: QuadraticModel, inside: list[int], fit: LikelihoodFit) -> list[int]:
        """The subset that the criterion prefers, by number."""
        return quadratic.best_subset(inside)

    def ends(self, fit: LikelihoodFit) -> bool:
        """Whether no round follows that of this fit."""
        return fit.status is not AnnealingStatus.CONVERGED

    def select(
        self,
        chosen: frozenset[str],
        number: int = 1,
        *,
        known: LikelihoodFit | None = None,
        before: LikelihoodFit | None = None,
    ) -> tuple[list[Selection], IdentificationError | np.linalg.LinAlgError | None]:
        """The selection of each round from `number` on, and the error that ended them, if one did.

        They end where the subset stays or was left before. The fit of `chosen` is made here unless it is `known`, from that
        `before` if there is one.
        """
        candidates, selections = self.search.candidates, list[Selection]()
        structure, first = candidates.structure(chosen), known or before
        start = self.search.start(structure) if first is None else (first.values, None)
        visited = {chosen}
        for count in range(number, number + self.most):
            try:
                options = self.options(count, before)
                fit = known or self.fit(structure, start, options)
                options.progress(ProgressReport(1.0, f"testing {len(self.search.tested)} candidates"))
                quadratic = self.model(fit, structure, chosen)
                after = self.changed(quadratic, list(range(len(structure.parameters))), fit)
                quadratic.solve(after)
            except (IdentificationError, np.linalg.LinAlgError) as error:
                return selections, error
            names = frozenset(quadratic.names[k] for k in after if quadratic.names[k] in candidates.by_name)
            stays = names == chosen
            selections.append(Selection(candidates, chosen, structure, fit, quadratic, stays, count))
            if stays or self.ends(fit) or (names in visited and not self.revisits):
                break
            visited.add(names)
            chosen, structure = names, candidates.structure(names)
            start = starts_of(quadratic, after, structure, fit)
            known, before = None, fit
        return selections, None


@dataclass(eq=False)
class ExactRounds(Rounds):
    """Rounds with fits as tight as the laws allow: the first selection of every search."""

    def options(self, number: int, before: LikelihoodFit | None) -> LikelihoodOptions:
        return replace(super().options(number, before), model_error=False, ceiling=_CEILING, steps=_STEPS)

    def fit(self, structure: Structure, start: Start, options: LikelihoodOptions) -> LikelihoodFit:
        return self.search.fit(structure, start, options)

    def ends(self, fit: LikelihoodFit) -> bool:
        return fit.status is AnnealingStatus.INTERRUPTED


def select_structure(search: TermSearch, chosen: Collection[str]) -> Selection:
    """The subset, searched from `chosen`, that no candidate tested improves.

    If the rounds run out, or the search returns to a subset that it had left, `settled` is False and the result the best
    subset visited. The motion may run away from where a round led, or the fit to where the record says nothing of a parameter.
    """
    selections, error = ExactRounds(search).select(frozenset(chosen))
    if not selections:
        if isinstance(error, IdentificationError):
            raise error
        raise singular(chosen) from None
    last = selections[-1]
    if last.settled or last.interrupted:
        return last
    return replace(best_of(selections), rounds=last.rounds)


def starts_of(
    quadratic: QuadraticModel, chosen: Subset, structure: Structure, fit: LikelihoodFit
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` that the model's coefficients `chosen` predict, and their deviations (p,).

    A mass that would not be positive stays as in the `fit` that the model is of.
    """
    fitted = dict(zip(quadratic.names, fit.values, strict=False))  # its parameters come first
    masses = {f"{mass.name}.mass" for mass in structure.masses}
    known: dict[str, tuple[float, float]] = {}
    for k, value, z in zip(chosen, *quadratic.solve(chosen), strict=True):
        name = quadratic.names[k]
        known[name] = fitted[name] if name in masses and value <= 0.0 else value, abs(value / z)
    return _started(structure, known)


def _started(structure: Structure, known: Mapping[str, tuple[float, float]]) -> tuple[Floats, Floats]:
    """Values and deviations (p,) of parameters, those that are `known` by name; others, of terms, have starts of their own."""
    own = [(p.name, (p.start or 0.0, abs(p.start or 0.0))) for p in structure.parameters]
    values, deviations = np.array([known.get(name, pair) for name, pair in own]).T
    return values, deviations


def round_progress(progress: Progress, number: int) -> Progress:
    """The progress of one round: each takes half of what is left."""
    start, stop = 1.0 - 0.5 ** (number - 1), 1.0 - 0.5**number

    def named(report: ProgressReport, /) -> None:
        progress(replace(report, activity=f"round {number}: {report.activity}"))

    return part(named, start, stop)
