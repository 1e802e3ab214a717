"""Maximum likelihood for links alone on a rig: from records of motion and force to an estimate.

The most likely unknowns are those of least squares, from starts that a regression along the motion finds. The scatter of the
sums that the minimum sets to zero comes from the noise of the load cells, which is white; from that of the displacement, which
smoothing correlates; and, where the laws are wrong, from what they leave, which follows the motion: its sums are compared
between parts of the records, as beside masses. What may be wrong beside noise is tested by its score: zero errors, a delay,
and terms that a law lacks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, bridged
from linkwise.display import format_percent, near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import Cause, NoiseEstimate, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import LinkMotion, extremes
from linkwise.likelihood.rigs.link_path import LinkPath
from linkwise.likelihood.rigs.problem import BASE_CHANNEL, Cell, RigProblem, cell_name
from linkwise.likelihood.search import BlockScores
from linkwise.likelihood.shooting.segmentation import require_same_channels
from linkwise.likelihood.starts.memory import MemorySearch, Start, unit_sizes
from linkwise.likelihood.tests.score_test import Hypothesis, Quadratic
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport
from linkwise.records.record import Record
from linkwise.verdict import Grade, Verdict

_SEARCHED = 4096  # samples of a record in which starts are searched for
_OF_PERIOD = 256  # of them in a period of the motion: more make the search longer, and show no more of a law
_LAST_STEPS = 300
# residual, relative to the forces, of a trial whose states run away or whose laws are not finite
_RUNAWAY = 1e6
_SINGULAR = 1e-13  # relative eigenvalue of the scaled normal matrix below which it is singular
_BLOCKS = (20, 10, 5)  # of records: the fewer, the longer the motion that they may be alike in
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_DRAWS = 32  # of the noise of the motion, for the size of what it does to the forces
_SEED = 7


@dataclass(frozen=True, eq=False)
class RigFit:
    """A rig at its unknowns (u,), with the links along its motions.

    After a search `cost` is the sum of the weighted squares of what load cells show beside the laws, and `ended` says whether
    that is a minimum.
    """

    problem: RigProblem
    unknowns: Floats
    paths: tuple[LinkPath, ...]
    cost: float = 0.0
    ended: bool = True

    @classmethod
    def at(cls, problem: RigProblem, unknowns: Floats, before: RigFit | None = None) -> RigFit:
        """A rig at some unknowns; the states of its links are sought near those `before`, or from rest where that fails."""
        paths = list[LinkPath]()
        for cell in problem.cells:
            link = problem.structure.links[cell.link]
            *own, shift, _ = (cell.from_unknowns @ unknowns).tolist()
            values = {key: coefficient.value or 0.0 for key, coefficient in link.coefficients.items()}
            values |= dict(zip(cell.free, own, strict=False))
            d, v = cell.sign * cell.motion.at_nodes
            last = before.paths[len(paths)] if before else None
            near = last.states if last and last.converged else None
            states = np.array(own[len(cell.free) :])
            paths.append(LinkPath.of(link.law, values, d + shift, v, cell.motion.step, states, near))
        fit = cls(problem, unknowns, tuple(paths))
        return fit if before is None or fit.converged else cls.at(problem, unknowns)

    @property
    def converged(self) -> bool:
        """Whether the search ended in a minimum, and all states were found."""
        return self.ended and all(path.converged for path in self.paths)

    @property
    def _pairs(self) -> Iterator[tuple[Cell, LinkPath]]:
        """Each load cell with the link that it shows, along the motion of its record."""
        return zip(self.problem.cells, self.paths, strict=True)

    @cached_property
    def residuals(self) -> Floats:
        """(R,) measured less modelled forces in N, 0 where a sample is missing."""
        shown = [path.force() + cell.from_unknowns[-1] @ self.unknowns for cell, path in self._pairs]
        return np.nan_to_num(self.problem.measured) - self.problem.at_samples(shown)

    @cached_property
    @np.errstate(invalid="ignore")  # of laws that are not finite
    def jacobian(self) -> Floats:
        """(R, u) derivatives of the modelled forces by the unknowns."""
        along = []
        for cell, path in self._pairs:
            slopes = path.by_unknowns(cell.free)
            along.append(np.column_stack([slopes, np.ones(len(slopes))]) @ cell.from_unknowns)
        return self.problem.at_samples(along)

    @cached_property
    def cells(self) -> Floats:
        """(R,) standard deviations in N of the noise of load cells alone."""
        cells, noise = self.problem.cells, self.problem.noise
        return np.concatenate([np.full(len(cell.measured), noise[cell.channel]) for cell in cells])

    @cached_property
    def by_motion(self) -> Floats:
        """(R,) standard deviations in N of the modelled forces by the noise of the motion."""
        rng = np.random.default_rng(_SEED)
        draws = {id(motion): motion.noise_draws(rng, _DRAWS) for motion in self.problem.motions}
        moved = [path.by_motion(draws[id(cell.motion)]) for cell, path in self._pairs]
        powers = [np.mean(changes**2, axis=1) for changes in moved]
        return np.asarray(np.nan_to_num(np.sqrt(self.problem.at_samples(powers))))

    @cached_property
    def deviations(self) -> Floats:
        """(R,) standard deviations in N of the residuals from the noise of load cells and motion."""
        return np.hypot(self.cells, self.by_motion)

    @cached_property
    def _freedom(self) -> int:
        """Samples, less unknowns."""
        return max(int(np.count_nonzero(self.residuals)) - self.problem.size, 1)

    @property
    def finer(self) -> RigFit | None:
        """The same in steps half as long; None where these are short enough for the residuals."""
        substeps = 2 * self.problem.motions[0].substeps
        if substeps > _MOST_SUBSTEPS or not any(path.law.states for path in self.paths):
            return None
        finer = RigFit.at(self.problem.with_substeps(substeps), self.unknowns)
        change = np.sqrt(np.mean((finer.residuals - self.residuals) ** 2))
        least = _DISCRETISED * np.sqrt(np.mean(self.residuals**2) / len(self.residuals))
        return finer if least < change < np.inf else None

    @property
    def chi_square(self) -> float:
        """Per degree of freedom, of noise alone."""
        return float(np.sum((self.residuals / self.deviations) ** 2)) / self._freedom

    @cached_property
    def model_force(self) -> float:
        """Standard deviation in N of what the laws leave beside noise, by which chi-square is 1; 0 where noise explains it."""
        if self.chi_square <= 1.0 + _CHI_SQUARE + _SIGMAS * np.sqrt(2.0 / self._freedom):
            return 0.0
        squares, variances = self.residuals**2, self.deviations**2
        most = float(np.sum(squares)) / self._freedom

        def missing(excess: float) -> float:
            return float(np.sum(squares / (variances + most * excess))) - self._freedom

        # at 1 nothing is missing, up to rounding, where deviations are next to nothing
        return float(np.sqrt(most * scipy.optimize.brentq(missing, 0.0, 2.0)))

    @property
    def weights(self) -> Floats:
        """(R,) one over the standard deviations of the residuals."""
        return 1.0 / np.hypot(self.deviations, self.model_force)

    @cached_property
    def free(self) -> Bools:
        """(u,) False at a bound."""
        (low, high), unknowns = self.problem.beforehand[:2], self.unknowns
        size = 1e-7 * (np.abs(unknowns) + np.where(np.isfinite(high - low), high - low, 0.0))
        return np.asarray((unknowns - low > size) & (high - unknowns > size), dtype=bool)

    @cached_property
    def weighted(self) -> Floats:
        """(R, f) derivatives of the modelled forces by free unknowns, in standard deviations of the residuals."""
        return self.weights[:, None] * self.jacobian[:, self.free]

    @cached_property
    def _inverse(self) -> tuple[Floats, bool]:
        """(f, f) that of the information on free unknowns, and whether the forces determine all of these."""
        normal = self.weighted.T @ self.weighted + self._known
        scale = np.sqrt(np.maximum(normal.diagonal(), 1e-300))
        values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
        inverse = (vectors / np.maximum(values, _SINGULAR * values[-1])) @ vectors.T / np.outer(scale, scale)
        return inverse, bool(values[0] > _SINGULAR * values[-1])

    @property
    def _known(self) -> Floats:
        """(f, f) the information that is known of free unknowns beforehand."""
        return np.diag(self.problem.beforehand[3, self.free] ** 2)

    @property
    def determined(self) -> bool:
        """Whether the forces determine all unknowns."""
        return self._inverse[1]

    @cached_property
    def covariance(self) -> Floats:
        """(u, u) that of the unknowns, 0 at a bound; errors of inexact laws hold how parts of the records differ."""
        inverse, inexact = self._inverse[0], self.model_force > 0.0
        scores = self.weights[:, None] * self.weighted
        cells = 1.0 / self.weights if inexact else self.cells
        sandwich = inverse @ (self.noise_of_sums(scores, cells) + self._known) @ inverse
        if inexact:
            by_parts = self.errors_by_parts(self.weighted, self.residuals, self._known)
            ratio = np.maximum(by_parts / np.sqrt(np.maximum(sandwich.diagonal(), 1e-300)), 1.0)
            sandwich = sandwich * np.outer(ratio, ratio)
        covariance = np.zeros((self.problem.size, self.problem.size))
        covariance[np.ix_(self.free, self.free)] = 0.5 * (sandwich + sandwich.T)
        return covariance

    @property
    def standard_errors(self) -> Floats:
        """(u,) of the unknowns; 0 at a bound."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    def noise_of_sums(self, rows: Floats, cells: Floats) -> Floats:
        """Covariance (f, f) of sums with weights (R, f) by noise of load cells, `cells` (R,), and of the motion."""
        white, row = cells[:, None] * rows, 0
        # by the noise of each displacement
        moved = np.zeros((self.problem.cells[-1].samples.stop, rows.shape[1]))
        for cell, path in self._pairs:
            spread = np.zeros((len(path.d), rows.shape[1]))
            spread[:: cell.motion.substeps] = rows[row : row + len(cell.measured)]
            row += len(cell.measured)
            moved[cell.samples] += cell.sign * cell.motion.noise_of(path.to_motion(spread))
        return np.asarray(white.T @ white + moved.T @ moved)

    def errors_by_parts(self, weighted: Floats, residuals: Floats, known: Floats) -> Floats:
        """(q,) standard errors of unknowns by the scores of parts of the records, the largest in 20, 10 or 5 of equal length.

        `weighted` (R, q) are derivatives by the unknowns in deviations of the `residuals` (R,) in N, `known` (q, q) is what is
        known of them beforehand.
        """
        cells = self.problem.cells
        places = np.concatenate([np.arange(cell.samples.start, cell.samples.stop) for cell in cells])
        parts = [places * _BLOCKS[0] // cells[-1].samples.stop == block for block in range(_BLOCKS[0])]
        rows = (self.weights * residuals)[:, None] * weighted
        blocks = BlockScores(
            np.stack([rows[part].sum(axis=0) for part in parts]),
            np.stack([weighted[part].T @ weighted[part] + known / len(parts) for part in parts]),
        )
        return np.asarray(np.max([blocks.merged(count).by_scores() for count in _BLOCKS], axis=0))


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> RigFit:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high, likely, certainty = problem.beforehand
    last: RigFit | None = None

    @lru_cache(maxsize=1)
    def at(*unknowns: float) -> RigFit:
        """The rig at some unknowns, its states sought near those asked for before."""
        nonlocal last
        last = RigFit.at(problem, np.array(unknowns), last)
        return last

    def residuals(unknowns: Floats) -> Floats:
        trial = at(*unknowns)
        left = np.where(weights > 0.0, trial.residuals, 0.0)
        if not (trial.converged and np.isfinite(left).all()):
            return np.full(len(weights) + len(likely), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (likely - unknowns)])

    def jacobian(unknowns: Floats) -> Floats:
        slopes = -weights[:, None] * at(*unknowns).jacobian
        return np.concatenate([np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0), -np.diag(certainty)])

    inside = np.clip(start, low, high)
    with np.errstate(all="ignore"):
        optimum = scipy.optimize.least_squares(
            residuals,
            inside,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            max_nfev=steps,
            xtol=1e-9,
            ftol=1e-9,
        )
        end = at(*optimum.x)
    return replace(end, cost=2.0 * float(optimum.cost), ended=bool(optimum.status > 0))


def starts(problem: RigProblem, given: Mapping[str, float]) -> tuple[Start, ...]:
    """Values of the parameters from which little of the forces is left, the best first; `given` starts by name are kept near.

    They are searched for in the samples in a row of the first record that move most, without the means of the forces where a
    zero is unknown.
    """
    motion, forces = problem.motions[0], problem.forces[0]
    d, v = motion.at_samples
    period = int(2.0 * np.pi * float(np.std(d)) / (float(np.std(v)) or 1.0) * motion.spline.rate)
    thinned = max(period // _OF_PERIOD, 1)
    count = min(_SEARCHED * thinned, len(d))
    power = np.append(0.0, np.cumsum(v**2))
    first = int(np.argmax(power[count:] - power[:-count]))
    searched = slice(first, first + count, thinned)
    d, v = (np.outer(own[searched], problem.structure.base_incidence) for own in (d, v))
    shown: dict[str, Floats] = {
        cell_name(problem.structure, link): bridged(force)[searched] for link, force in forces.items()
    }
    slow = int(bool(problem.offsets))
    step = thinned / motion.spline.rate
    return MemorySearch(problem.structure, step, d, v, shown, given, {}, slow, sharp=True).minima()


_MOST_SUBSTEPS = 32
_DISCRETISED = 0.5  # of the residuals over the root of their number: what finer steps may change, far below errors of noise
_REWEIGHTED = 3
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a search
_WHOLE_STEPS = 60  # of a search from each


def rig_fit(problem: RigProblem, given: Mapping[str, float], progress: Progress) -> RigFit:
    """Fit a rig; `given` are starts by name."""
    found, beside = starts(problem, given), np.zeros(problem.size - len(problem.parameters))
    near = [np.append(one.values, beside) for one in found if one.misfit <= _NEAR * found[0].misfit]
    fit = _lowest(problem, near, progress, "searching from several starts")
    if fit is not None and fit.model_force > 0.0:
        fit = _lowest(problem, _from_sizes(fit), progress, "searching from other sizes", fit)
    rounds = _REWEIGHTED
    while fit is not None and rounds:
        fit = minimise(fit.problem, fit.unknowns, fit.weights)
        finer = fit.finer
        fit, rounds = (fit, rounds - 1) if finer is None else (finer, _REWEIGHTED)
    if fit is None or not np.isfinite(fit.jacobian).all():
        names = ", ".join(problem.structure.links[link].name for link in problem.links)
        raise IdentificationError(
            f"no values were found with which the law of {names} and its derivatives are finite along the recorded motion; "
            "give starting values with which they are, or bounds of its coefficients"
        )
    return fit


def _lowest(
    problem: RigProblem, proposed: Sequence[Floats], progress: Progress, what: str, best: RigFit | None = None
) -> RigFit | None:
    """The lowest of the minima near unknowns (u,) that are proposed, all samples weighing alike, unless one is known that is
    the `best`; None if none is finite.
    """
    weights = np.full(len(problem.measured), 1.0 / _level(problem))
    for number, unknowns in enumerate(proposed, start=1):
        own = minimise(problem, unknowns, weights, steps=_WHOLE_STEPS)
        if np.isfinite(own.residuals).all() and (best is None or own.cost < best.cost):
            best = own
        progress(ProgressReport(number / len(proposed), what))
    return best


def _level(problem: RigProblem) -> float:
    """The size of the forces in N."""
    return max(float(np.nanstd(problem.measured)), np.finfo(float).tiny)


def _from_sizes(fit: RigFit) -> list[Floats]:
    """The unknowns (u,) with one parameter, in which forces are not linear, at the size that its unit implies: what a start
    does not depend on may be decades off.
    """
    problem = fit.problem
    d, v = problem.motions[0].at_nodes
    sizes = unit_sizes(problem.parameters, d, v, _level(problem))
    return [
        np.where(np.arange(problem.size) == number, sizes[parameter.name], fit.unknowns)
        for number, parameter in enumerate(problem.parameters)
        if any(key not in problem.structure.links[link].law.linear for link, key in parameter.members)
    ]


_LARGEST_ERROR = 0.1
"""Of the forces: the largest model error that is trusted, as for structures with masses."""


def judged(fit: RigFit, causes: Sequence[Cause]) -> tuple[Verdict, str, float]:
    """Verdict, explanation, and the part of the forces that laws leave beside noise."""
    if not fit.converged:
        advice = "The values are the best so far; give better starts, or a law whose force does not jump."
        return Verdict.NOT_CONVERGED, f"The search did not converge. {advice}", 0.0
    share, verdict, words = fit.model_force / _level(fit.problem), Verdict.CONVERGED, "."
    if not fit.determined:
        verdict = Verdict.HARDLY_DETERMINED
        words = ", but the forces do not determine all unknowns: hold some at known values, or record another motion."
    elif share > _LARGEST_ERROR:
        verdict, words = Verdict.UNEXPLAINED_FORCES, "; a term or a state is missing."
    elif causes and not causes[0].is_instrument:
        verdict = Verdict.SYSTEMATIC_MISFIT
        words = (
            f", but {causes[0].description} is missing: with it a coefficient would differ by {causes[0].shift:.2g} of its "
            "standard errors. Offer the term, or a law with memory."
        )
    elif causes:
        verdict = Verdict.MEASUREMENT_ERROR
        words = (
            f", but {causes[0].description} would lower -2 log likelihood by {causes[0].gain:.3g}. Coefficients would be "
            "wrong by more than intervals of exact laws say: correct it, or estimate it with the other unknowns."
        )
    elif share > 0.0:
        how = "as it follows the motion, parts of the record are compared for that."
        verdict, words = Verdict.MODEL_ERROR_NEEDED, f", a model error that all intervals include; {how}"
    to_within = format_percent(share) if share > 0.0 else "the noise of force and displacement"
    return verdict, f"The laws explain the forces to within {to_within}{words}", share


_GAIN = 25.0  # in -2 log likelihood: five standard deviations
_OF_SHIFTS = 16.0 + 2.0 * np.log(
    10.0
)  # of what also moves a coefficient: four deviations, the largest of about ten causes
_OFFSET_GAIN = 10.0  # of gain, by which an offset of the displacement must be the better explanation
_SHIFT = 3.0  # standard errors by which a term or a delay must move a coefficient to count
_TERMS = ("d", "d**2", "d**3", "d**5", "v", "v*abs(v)", "v**3", "d**2*v")
_SATURATING = 0.1  # of the largest rate, at which the friction that is tested saturates


def rig_causes(fit: RigFit) -> tuple[Cause, ...]:
    """What would explain a part of the residuals, the largest gain first.

    Offsets of any significant size, and of terms and delays those that would move a coefficient by three standard errors.
    """
    hypotheses, forces = zip(*_hypotheses(fit), strict=True)
    columns, f = np.stack(forces, axis=1), int(fit.free.sum())
    weighted = np.column_stack([fit.weighted, fit.weights[:, None] * columns])
    scatter = fit.noise_of_sums(fit.weights[:, None] * weighted, fit.cells)
    curvature, slope = weighted.T @ weighted, weighted.T @ (fit.weights * fit.residuals)
    tests = Quadratic(curvature, slope, scatter).tests(f)
    of_laws = np.flatnonzero(fit.free) < len(fit.problem.parameters)
    deviations = fit.standard_errors[fit.free][of_laws]
    determined = deviations > 0.0
    causes = []
    for number, hypothesis in enumerate(hypotheses):
        if not tests.gains[number] > 0.0:
            continue
        size, error, changes = tests.sizes[number], tests.deviations[number], tests.changes[:, number]
        if fit.model_force > 0.0:
            beside = (weighted[:, f + number] + weighted[:, :f] @ (changes / size))[:, None]
            left = fit.residuals - size * beside[:, 0] / fit.weights
            by_parts = float(fit.errors_by_parts(beside, left, np.zeros((1, 1)))[0])
            error = max(error, float(beside[:, 0] @ beside[:, 0]) ** -0.5, by_parts)
        gain = float((size / error) ** 2)
        shift = float(np.max(np.abs(changes[of_laws][determined]) / deviations[determined], initial=0.0))
        if gain > _GAIN if hypothesis.kind == "offset" else gain > _OF_SHIFTS and shift > _SHIFT:
            unit = float(np.sqrt(np.mean(columns[:, number] ** 2))) if hypothesis.kind == "term" else 1.0
            causes.append(
                Cause(
                    hypothesis.kind, hypothesis.where, float(size) * unit, hypothesis.unit, gain,
                    float(error) * unit, term=hypothesis.term, shift=shift,
                )
            )  # fmt: skip
    return tuple(sorted(causes, key=lambda cause: (cause.where == BASE_CHANNEL) * _OFFSET_GAIN - cause.gain))


def _hypotheses(fit: RigFit) -> Iterator[tuple[Hypothesis, Floats]]:
    """What may be wrong, and the forces (R,) in N that it adds where its size is 1: offsets of sensors that are not among the
    unknowns, and of each link forms of force that its law may lack, and a delay of its load cell, to first order.
    """
    problem, paths = fit.problem, fit.paths
    every = replace(fit, problem=replace(problem, offsets=problem.sensors)).jacobian
    for number, channel in enumerate(problem.sensors, start=len(problem.parameters)):
        if channel not in problem.offsets:
            yield Hypothesis("offset", channel, unit=channel.unit), every[:, number]
    fastest = max(float(np.max(np.abs(motion.at_samples[1]))) for motion in problem.motions)
    rubbing = {"tanh(v)": f"tanh(v/{_SATURATING * fastest!r})"} if fastest > 0.0 else {}
    for link in problem.links:
        for name, text in ({term: term for term in _TERMS} | rubbing).items():
            force = Law.parse(text).force
            with np.errstate(all="ignore"):
                column = _column(fit, link, [force(path.d, path.v, {}) for path in paths])
            yield Hypothesis("term", problem.structure.links[link].name, name, unit="N"), column
    for link in problem.links:
        late = _column(fit, link, [-np.gradient(path.force()) / path.step for path in paths])
        yield Hypothesis("delay", cell_name(problem.structure, link), unit="s"), late


def _column(fit: RigFit, link: int, along: Sequence[Floats]) -> Floats:
    """(R,) forces along all paths, at the samples of one link among those of all; 0 for others, and where one is missing."""
    own = [force * (cell.link == link) for cell, force in zip(fit.problem.cells, along, strict=True)]
    return np.asarray(np.nan_to_num(fit.problem.at_samples(own)))


def rig_estimate(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    progress: Progress,
    *,
    offsets: Sequence[str],
    finds_more: bool,
) -> Estimate:
    """Estimate the unknowns of links between the base and the ground, whose forces load cells show.

    `given` are starts by name, and `offsets` channels with an unknown constant error, beside which it `finds_more`: those that
    the diagnosis names.
    """
    require_same_channels(records)
    problem = RigProblem.of(records, structure)
    for name in offsets:
        if name not in problem.sensors:
            offered = (BASE_CHANNEL, *problem.sensors[:-1])
            raise IdentificationError(
                f"no offset of {name} can be found{near_miss(name, offered)}; on a rig choose from {', '.join(offered)}"
            )
    asked = set(offsets)
    while True:
        problem = replace(problem, offsets=tuple(name for name in problem.sensors if name in asked))
        fit = rig_fit(problem, given, progress)
        causes = rig_causes(fit)
        likeliest = causes[0].where if causes and causes[0].kind == "offset" else None
        if not finds_more or likeliest is None or likeliest in asked:
            return _estimate(fit, records, causes)
        asked.add(likeliest)


def _estimate(fit: RigFit, records: Sequence[Record], causes: tuple[Cause, ...]) -> Estimate:
    problem, unknowns = fit.problem, fit.unknowns
    structure, p = problem.structure, len(problem.parameters)
    names = (parameter.name for parameter in problem.parameters)
    identified = structure.with_values(dict(zip(names, unknowns.tolist(), strict=False)))
    verdict, message, share = judged(fit, causes)
    approximate = verdict.grade is Grade.APPROXIMATE and 0.0 < share < 1.0
    found = zip(problem.offsets, unknowns[p:].tolist(), fit.standard_errors[p:].tolist(), strict=False)
    errors = tuple(SensorErrorEstimate(one, "offset", size, error, one.unit) for one, size, error in found)
    sigma = {BASE_CHANNEL: problem.motions[0].sigma, **problem.noise}
    return Estimate(
        method="ml",
        fit_verdicts=(verdict,),
        message=message,
        seconds=0.0,
        given_structure=structure,
        parameters=problem.parameters,
        values=unknowns[:p],
        covariance=fit.covariance[:p, :p],
        free=fit.free[:p],
        noise={name: NoiseEstimate.of(records[0], name, value) for name, value in sigma.items()},
        chi_square_per_sample=fit.chi_square,
        samples=int(np.count_nonzero(fit.residuals)),
        compute_motion=partial(_motion, fit, identified, tuple(records)),
        record=records[0],
        more_records=tuple(records[1:]),
        remarks=tuple(error.description for error in errors),
        sensor_errors=errors,
        model_error=share,
        diagnosis=causes,
        approximate=approximate,
    )


def _motion(fit: RigFit, identified: Structure, records: Sequence[Record]) -> LinkMotion:
    """The links along the recorded motion, at the samples of all records."""
    base = np.concatenate([motion.at_samples for motion in fit.problem.motions], axis=1)
    d, v = base[:, :, None] * identified.base_incidence
    force, measured = np.full((2, *d.shape), np.nan)
    for cell, path in zip(fit.problem.cells, fit.paths, strict=True):
        place, every = (cell.samples, cell.link), cell.motion.substeps
        d[place], force[place] = path.d[::every], path.force()[::every]
        measured[place] = cell.measured - cell.from_unknowns[-1] @ fit.unknowns
    return LinkMotion(
        structure=identified,
        time=np.concatenate([record.time for record in records]),
        d=d,
        v=v,
        d_range=extremes(d),
        compute_residual=_nothing,
        identified_force=force,
        measured_force=measured,
    )


def _nothing() -> Floats | None:
    """There is no mass whose equation leaves a residual."""
    return None
