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
from linkwise.likelihood.rigs.problem import BASE_CHANNEL, RigProblem, cell_name, cell_noise
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


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (u,) at a minimum, `cost` the sum of weighted squares there, the paths, and whether the search ended."""

    unknowns: Floats
    cost: float
    paths: tuple[LinkPath, ...]
    converged: bool


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> Minimum:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high, likely, certainty = problem.beforehand
    last: tuple[LinkPath, ...] | None = None

    @lru_cache(maxsize=1)
    def paths_at(*unknowns: float) -> tuple[LinkPath, ...]:
        """The links along the motions, sought near those asked for before."""
        nonlocal last
        last = problem.paths(np.array(unknowns), last)
        return last

    def residuals(unknowns: Floats) -> Floats:
        paths = paths_at(*unknowns)
        left = np.where(weights > 0.0, problem.residuals(unknowns, paths), 0.0)
        if not (all(path.converged for path in paths) and np.isfinite(left).all()):
            return np.full(len(weights) + len(likely), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (likely - unknowns)])

    def jacobian(unknowns: Floats) -> Floats:
        slopes = -weights[:, None] * problem.jacobian(paths_at(*unknowns))
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
        unknowns = np.asarray(optimum.x)
        end = paths_at(*unknowns)
    return Minimum(
        unknowns, 2.0 * float(optimum.cost), end, bool(optimum.status > 0) and all(p.converged for p in end)
    )


def starts(problem: RigProblem, given: Mapping[str, float]) -> tuple[Start, ...]:
    """Values of the parameters from which little of the forces is left, the best first; `given` starts by name are kept near.

    They are searched for in the liveliest part of the first record, without the means of the forces where a zero is unknown.
    """
    motion, forces = problem.motions[0], problem.forces[0]
    thinned = max(motion.period // _OF_PERIOD, 1)
    count = min(_SEARCHED * thinned, len(next(iter(forces.values()))))
    first = motion.liveliest(count)
    searched = slice(first, first + count, thinned)
    d, v = (
        np.outer(along[:: motion.substeps][searched], problem.structure.base_incidence)
        for along in (motion.d, motion.v)
    )
    shown: dict[str, Floats] = {
        cell_name(problem.structure, link): bridged(force)[searched] for link, force in forces.items()
    }
    slow = int(bool(problem.offsets))
    step = thinned * motion.step * motion.substeps
    return MemorySearch(problem.structure, step, d, v, shown, given, {}, slow, sharp=True).minima()


_SINGULAR = 1e-13  # relative eigenvalue of the scaled normal matrix below which it is singular
_BLOCKS = (20, 10, 5)  # of records: the fewer, the longer the motion that they may be alike in


_MOST_SUBSTEPS = 32
_DISCRETISED = 0.5  # of the residuals over the root of their number: what finer steps may change, far below errors of noise
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_REWEIGHTED = 3
_DRAWS = 32  # of the noise of the motion, for the size of what it does to the forces
_SEED = 7
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a search
_WHOLE_STEPS = 60  # of a search from each


@dataclass(frozen=True, eq=False)
class RigFit:
    """A minimum of the weighted squares of what load cells show beside the laws, and their `noise` in N by channel."""

    problem: RigProblem
    minimum: Minimum
    noise: Mapping[str, float]

    @cached_property
    def residuals(self) -> Floats:
        """(R,) measured less modelled forces in N."""
        return self.problem.residuals(self.minimum.unknowns, self.minimum.paths)

    @cached_property
    def cells(self) -> Floats:
        """(R,) standard deviations in N of the noise of load cells alone."""
        cells = self.problem.cells
        return np.concatenate([np.full(len(cell.measured), self.noise[cell.channel]) for cell in cells])

    @cached_property
    def deviations(self) -> Floats:
        """(R,) standard deviations in N of the residuals from the noise of load cells and motion."""
        return np.hypot(self.cells, motion_deviations(self.problem, self.minimum))

    @cached_property
    def model_force(self) -> float:
        """Standard deviation in N of what the laws leave beside noise, 0 where noise explains the residuals."""
        return _model_force(self.residuals, self.deviations, self.problem.size)

    @property
    def chi_square(self) -> float:
        """Per degree of freedom, of noise alone."""
        freedom = max(int(np.count_nonzero(self.residuals)) - self.problem.size, 1)
        return float(np.sum((self.residuals / self.deviations) ** 2)) / freedom

    @property
    def weights(self) -> Floats:
        """(R,) one over the standard deviations of the residuals."""
        return 1.0 / np.hypot(self.deviations, self.model_force)

    @cached_property
    def free(self) -> Bools:
        """(u,) False at a bound."""
        (low, high), unknowns = self.problem.beforehand[:2], self.minimum.unknowns
        size = 1e-7 * (np.abs(unknowns) + np.where(np.isfinite(high - low), high - low, 0.0))
        return np.asarray((unknowns - low > size) & (high - unknowns > size), dtype=bool)

    @cached_property
    def weighted(self) -> Floats:
        """(R, f) derivatives of the modelled forces by free unknowns, in standard deviations of the residuals."""
        return self.weights[:, None] * self.problem.jacobian(self.minimum.paths)[:, self.free]

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
        white, moved = cells[:, None] * rows, self.problem.noise_of_motion(self.minimum.paths, rows)
        return np.asarray(white.T @ white + moved.T @ moved)

    def errors_by_parts(self, weighted: Floats, residuals: Floats, known: Floats) -> Floats:
        """(q,) standard errors of unknowns by the scores of parts of the records, the largest in 20, 10 or 5 of equal length.

        `weighted` (R, q) are derivatives by the unknowns in deviations of the `residuals` (R,) in N, `known` (q, q) is what is
        known of them beforehand.
        """
        cells = self.problem.cells
        firsts = np.cumsum([0, *(len(motion.d[:: motion.substeps]) for motion in self.problem.motions)])
        at = np.concatenate([firsts[cell.record] + np.arange(len(cell.measured)) for cell in cells])
        parts = [at * _BLOCKS[0] // firsts[-1] == block for block in range(_BLOCKS[0])]
        rows = (self.weights * residuals)[:, None] * weighted
        blocks = BlockScores(
            np.stack([rows[part].sum(axis=0) for part in parts]),
            np.stack([weighted[part].T @ weighted[part] + known / len(parts) for part in parts]),
        )
        return np.asarray(np.max([blocks.merged(count).by_scores() for count in _BLOCKS], axis=0))


def rig_fit(
    problem: RigProblem, noise: Mapping[str, float], given: Mapping[str, float], progress: Progress
) -> RigFit:
    """Fit a rig; `noise` in N is that of load cells by channel, `given` starts by name."""
    found, beside = starts(problem, given), np.zeros(problem.size - len(problem.parameters))
    near = [np.append(one.values, beside) for one in found if one.misfit <= _NEAR * found[0].misfit]
    best = _lowest(problem, near, progress, "searching from several starts")
    if best is None:
        raise _not_finite(problem)
    fit = RigFit(problem, best, noise)
    if fit.model_force > 0.0:
        other = _lowest(problem, _from_sizes(problem, best.unknowns), progress, "searching from other sizes")
        fit = fit if other is None or best.cost <= other.cost else replace(fit, minimum=other)
    fit = refined(fit)
    for _ in range(_REWEIGHTED):
        fit = replace(fit, minimum=minimise(fit.problem, fit.minimum.unknowns, fit.weights))
    if not np.isfinite(fit.problem.jacobian(fit.minimum.paths)).all():
        raise _not_finite(problem)
    return fit


def _lowest(problem: RigProblem, proposed: Sequence[Floats], progress: Progress, what: str) -> Minimum | None:
    """The lowest of the minima near unknowns (u,) that are proposed, all samples weighing alike; None if none is finite."""
    weights, minima = np.full(len(problem.measured), 1.0 / _level(problem)), []
    for number, unknowns in enumerate(proposed, start=1):
        minima.append(minimise(problem, unknowns, weights, steps=_WHOLE_STEPS))
        progress(ProgressReport(number / len(proposed), what))
    finite = [own for own in minima if np.isfinite(problem.residuals(own.unknowns, own.paths)).all()]
    return min(finite, key=lambda minimum: minimum.cost, default=None)


def _level(problem: RigProblem) -> float:
    """The size of the forces in N."""
    return max(float(np.nanstd(problem.measured)), np.finfo(float).tiny)


def _from_sizes(problem: RigProblem, best: Floats) -> list[Floats]:
    """The unknowns (u,) with one parameter, in which forces are not linear, at the size that its unit implies: what a start
    does not depend on may be decades off.
    """
    motion = problem.motions[0]
    sizes = unit_sizes(problem.parameters, motion.d, motion.v, _level(problem))
    return [
        np.where(np.arange(problem.size) == number, sizes[parameter.name], best)
        for number, parameter in enumerate(problem.parameters)
        if any(key not in problem.structure.links[link].law.linear for link, key in parameter.members)
    ]


def _not_finite(problem: RigProblem) -> IdentificationError:
    names = ", ".join(problem.structure.links[link].name for link in problem.links)
    return IdentificationError(
        f"no values were found with which the law of {names} and its derivatives are finite along the recorded motion; give "
        "starting values with which they are, or bounds of its coefficients"
    )


def refined(fit: RigFit) -> RigFit:
    """The fit with as many steps between samples as the residuals call for."""
    while True:
        problem, minimum = fit.problem, fit.minimum
        size = float(np.sqrt(np.mean(fit.residuals**2)))
        level = np.hypot(fit.cells, max(size - float(np.mean(fit.cells)), 0.0))
        minimum = minimise(problem, minimum.unknowns, 1.0 / level)
        fit, substeps = replace(fit, minimum=minimum), 2 * problem.motions[0].substeps
        if substeps > _MOST_SUBSTEPS or not any(path.law.states for path in minimum.paths):
            return fit
        finer = problem.with_substeps(substeps)
        paths = finer.paths(minimum.unknowns)
        change = finer.residuals(minimum.unknowns, paths) - fit.residuals
        allowed = _DISCRETISED * size / np.sqrt(len(fit.residuals))
        if not allowed < np.sqrt(np.mean(change**2)) < np.inf:
            return fit
        fit = replace(fit, problem=finer, minimum=replace(minimum, paths=paths))


def motion_deviations(problem: RigProblem, minimum: Minimum) -> Floats:
    """(R,) standard deviations in N of the modelled forces by the noise of the motion."""
    rng = np.random.default_rng(_SEED)
    changes = [motion.noise_draws(rng, _DRAWS) for motion in problem.motions]
    rows = []
    for cell, path in zip(problem.cells, minimum.paths, strict=True):
        moved = path.tangents(tuple(cell.free)).by_motion(*changes[cell.record])
        moved = moved[:: cell.motion.substeps]
        rows.append(np.sqrt(np.mean(moved**2, axis=1)))
    return np.asarray(np.nan_to_num(np.concatenate(rows)))


def _model_force(residuals: Floats, deviations: Floats, unknowns: int) -> float:
    """Standard deviation beside `deviations` with which the residuals have a chi-square of 1; 0 where noise explains them."""
    is_measured = residuals != 0.0
    count = max(int(is_measured.sum()) - unknowns, 1)
    squares, variances = residuals[is_measured] ** 2, deviations[is_measured] ** 2
    if np.sum(squares / variances) / count <= 1.0 + _CHI_SQUARE + _SIGMAS * np.sqrt(2.0 / count):
        return 0.0
    most = float(np.sum(squares)) / count

    def missing(excess: float) -> float:
        return float(np.sum(squares / (variances + most * excess))) - count

    # at 1 nothing is missing, up to rounding, where deviations are next to nothing
    return float(np.sqrt(most * scipy.optimize.brentq(missing, 0.0, 2.0)))


_LARGEST_ERROR = 0.1
"""Of the forces: the largest model error that is trusted, as for structures with masses."""


def judged(fit: RigFit, causes: Sequence[Cause]) -> tuple[Verdict, str, float]:
    """Verdict, explanation, and the part of the forces that laws leave beside noise."""
    if not fit.minimum.converged:
        return (
            Verdict.NOT_CONVERGED,
            "The search did not converge. The values are the best so far; give better starts, or a law whose force does not "
            "jump.",
            0.0,
        )
    measured = float(np.nanstd(fit.problem.measured))
    share = fit.model_force / measured if fit.model_force > 0.0 else 0.0
    verdict, words = _found(fit, causes, share)
    to_within = format_percent(share) if share > 0.0 else "the noise of force and displacement"
    return verdict, f"The laws explain the forces to within {to_within}{words}", share


def _found(fit: RigFit, causes: Sequence[Cause], share: float) -> tuple[Verdict, str]:
    """The verdict on a search that converged, and what is said after how well laws explain the forces."""
    if not fit.determined:
        return Verdict.HARDLY_DETERMINED, (
            ", but the forces do not determine all unknowns: hold some at known values, or record another motion."
        )
    if share > _LARGEST_ERROR:
        return Verdict.UNEXPLAINED_FORCES, "; a term or a state is missing."
    if causes and not causes[0].is_instrument:
        return Verdict.SYSTEMATIC_MISFIT, (
            f", but {causes[0].description} is missing: with it a coefficient would differ by {causes[0].shift:.2g} of its "
            "standard errors. Offer the term, or a law with memory."
        )
    if causes:
        return Verdict.MEASUREMENT_ERROR, (
            f", but {causes[0].description} would lower -2 log likelihood by {causes[0].gain:.3g}. Coefficients would be "
            "wrong by more than intervals of exact laws say: correct it, or estimate it with the other unknowns."
        )
    if share > 0.0:
        return Verdict.MODEL_ERROR_NEEDED, (
            ", a model error that all intervals include; as it follows the motion, parts of the record are "
            "compared for that."
        )
    return Verdict.CONVERGED, "."


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
    problem, paths = fit.problem, fit.minimum.paths
    every = replace(problem, offsets=problem.sensors).jacobian(paths)
    for number, channel in enumerate(problem.sensors, start=len(problem.parameters)):
        if channel not in problem.offsets:
            yield Hypothesis("offset", channel, unit=channel.unit), every[:, number]
    fastest = max(float(np.max(np.abs(motion.v[:: motion.substeps]))) for motion in problem.motions)
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
    rows = [
        np.where(np.isfinite(cell.measured) & (cell.link == link), force[:: cell.motion.substeps], 0.0)
        for cell, force in zip(fit.problem.cells, along, strict=True)
    ]
    return np.asarray(np.nan_to_num(np.concatenate(rows)))


def rig_estimate(
    records: Sequence[Record],
    structure: Structure,
    *,
    offsets: Sequence[str],
    admitted: Sequence[str],
    starts: Mapping[str, float],
    progress: Progress,
) -> Estimate:
    """Estimate the unknowns of links between the base and the ground, whose forces load cells show.

    `offsets` are channels with an unknown constant error; with "offset" `admitted`, those that the diagnosis names are added.
    """
    require_same_channels(records)
    problem, noise = RigProblem.of(records, structure), cell_noise(records)
    for name in offsets:
        if name not in problem.sensors:
            offered = (BASE_CHANNEL, *problem.sensors[:-1])
            raise IdentificationError(
                f"no offset of {name} can be found{near_miss(name, offered)}; on a rig choose from {', '.join(offered)}"
            )
    asked = set(offsets)
    while True:
        problem = replace(problem, offsets=tuple(name for name in problem.sensors if name in asked))
        fit = rig_fit(problem, noise, starts, progress)
        causes = rig_causes(fit)
        likeliest = causes[0].where if causes and causes[0].kind == "offset" else None
        if "offset" not in admitted or likeliest is None or likeliest in asked:
            return _estimate(fit, records, causes)
        asked.add(likeliest)


def _estimate(fit: RigFit, records: Sequence[Record], causes: tuple[Cause, ...]) -> Estimate:
    problem, unknowns = fit.problem, fit.minimum.unknowns
    structure, parameters, p = problem.structure, problem.parameters, len(problem.parameters)
    identified = structure.with_values(
        {q.name: float(value) for q, value in zip(parameters, unknowns, strict=False)}
    )
    verdict, message, share = judged(fit, causes)
    approximate = verdict.grade is Grade.APPROXIMATE and 0.0 < share < 1.0
    found = zip(problem.offsets, unknowns[p:].tolist(), fit.standard_errors[p:].tolist(), strict=False)
    errors = tuple(
        SensorErrorEstimate(channel, "offset", value, error, channel.unit) for channel, value, error in found
    )
    sigma = {BASE_CHANNEL: problem.motions[0].sigma, **fit.noise}
    return Estimate(
        method="ml",
        fit_verdicts=(verdict,),
        message=message,
        seconds=0.0,
        given_structure=structure,
        parameters=parameters,
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
    problem = fit.problem
    base = np.concatenate([np.stack([m.d, m.v])[:, :: m.substeps] for m in problem.motions], axis=1)
    d, v = base[:, :, None] * identified.base_incidence
    force, measured = np.full((2, *d.shape), np.nan)
    cells = list(zip(problem.cells, fit.minimum.paths, strict=True))
    for link in problem.links:
        own = [(cell, path, cell.motion.substeps) for cell, path in cells if cell.link == link]
        d[:, link] = np.concatenate([path.d[::every] for _, path, every in own])
        force[:, link] = np.concatenate([path.force()[::every] for _, path, every in own])
        shown = np.concatenate([cell.measured for cell, _, _ in own])
        measured[:, link] = shown - problem.offset(own[0][0].channel, fit.minimum.unknowns)
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
