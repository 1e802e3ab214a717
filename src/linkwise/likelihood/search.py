"""The search for an optimum: annealing, also through gaps, from better states, and what explains the residuals at its end.

States are better where, near the record, the laws allow them while their coefficients are held. Smoothing gives poor rates of
a fast motion of few samples, and states that are far from any motion of the structure lead a search for states and
coefficients together astray. With coefficients that are roughly right the states alone are found safely. Residuals are
explained by the noise that was expected, coloured noise of sensors, or a model error.

What separate blocks of the records say of the unknowns (`BlockScores`) is found at the optimum. Around an optimum each block b
of segments pulls the unknowns by its score g_b (p,), with the information H_b (p, p), where the states follow the unknowns as
the whole record determines. The scores of all blocks sum to zero at the optimum. Where the error of a law moves with the
motion, they scatter more than the information says, which white noise would not do: the variance of an unknown is then that of
the estimates with one block left out (jackknife over blocks), as in the covariance of White (1982) and its form for clustered
data (Bell and McCaffrey, Survey Methodology 28, 2002).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.coloured_noise import ColouredNoise, with_coloured_noise
from linkwise.likelihood.marginal import did_not_converge, is_long, relaxation, search_long_record
from linkwise.likelihood.noise import (
    ModelErrorCandidate,
    lag_one_autocorrelation,
    with_model_error,
    with_noise_from_misfit,
    with_noise_of_residuals,
)
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import ShootingProblem
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.minimise import (
    Annealer,
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    freedom,
)
from linkwise.likelihood.shooting.normal_equations import FactoredModel, block_information
from linkwise.likelihood.shooting.residuals import (
    Gaussian,
    LongerSegments,
    Loss,
    Misfit,
    evaluate,
)
from linkwise.likelihood.shooting.segments import (
    Iterate,
    Scales,
    Segments,
    carry_through_gaps,
    split_at_gaps,
)
from linkwise.likelihood.shooting.system import MANY
from linkwise.likelihood.shooting.tangents import CandidateForces

# numbers that are tried: short blocks are many, long ones hold what residuals remember; each divides the one before
BLOCKS = 20, 10
FEWEST = 5  # segments in the shortest block
EQUAL = 15  # segments in the shortest block, from which on one more or less hardly matters
_LEVEL = 0.975
_SHARED = 0.25  # of the information of a direction: what other blocks hold of it at least, else they tell nothing of it
_FEWEST = 3.0  # degrees of freedom: with less the scatter of blocks is no measure of an error
# times that segments are joined, of a few masses by four: 80 samples, which is mostly a period
_JOINED_FAR = 2
_COLLINEAR = 1e-6  # of its own information: what is left of an unknown beside the others


@dataclass(frozen=True, eq=False)
class Optimum:
    """The optimum of a search, of which profiles, score tests and later searches start.

    Attributes
    ----------
    misfit : Misfit
        Residuals and defects at the optimum.
    q : float
        Relaxation of the continuity of the segments.
    noise : float
        Factor on the standard deviations in `scales`.
    coloured : ColouredNoise or None
        The noise where it is coloured; the cost takes it for white.
    of_white : array of shape (p, p) or None
        The covariance that the cost alone gives, where the noise is coloured.
    """

    misfit: Misfit
    q: float
    noise: float
    coloured: ColouredNoise | None = None
    of_white: Floats | None = None

    @cached_property
    def segments(self) -> Segments:
        """The records in segments."""
        return self.misfit.segments

    @cached_property
    def scales(self) -> Scales:
        """Units of the unknowns."""
        return self.misfit.scales

    @cached_property
    def loss(self) -> Loss:
        """Loss of a residual."""
        return self.misfit.loss

    @cached_property
    def point(self) -> Iterate:
        """The unknowns."""
        return self.misfit.point

    @cached_property
    def runs_away(self) -> bool:
        """Whether motion by the laws, run on from states along the records, leaves more of a channel than unrelated motion."""
        segments, point = self.segments, self.point
        for _ in range(_JOINED_FAR):
            longer = LongerSegments.of(segments)
            if longer is None:
                return False
            segments, point = longer.segments, longer.point(point)
        left = evaluate(segments, point, self.scales, self.loss).residuals
        shown = moved(segments) / segments.deviations(self.scales)
        with np.errstate(over="ignore", invalid="ignore"):
            power = np.sum(left**2, axis=(0, 2))
        of_noise = segments.observed.sum(axis=(0, 2))
        return not bool(np.all(power <= _UNRELATED * np.sum(shown**2, axis=(0, 2)) + of_noise))

    def searched(self, q: float, steps: int, start: Iterate | None = None) -> AnnealingFit:
        """The search at one relaxation, from this optimum or another `start`."""
        schedule = AnnealingSchedule(initial_q=q, final_q=q, max_steps=steps)
        return Annealer()(self.misfit.at(start or self.point), schedule)

    @cached_property
    def scores(self) -> BlockScores | None:
        """Those of as many blocks as are tried, which several checks ask for."""
        return self.block_scores(BLOCKS[0])

    def block_scores(self, blocks: int, candidates: CandidateForces | None = None) -> BlockScores | None:
        """Scores of so many consecutive blocks of segments; None where the equations are singular.

        The amplitudes of `candidates` follow theta among the unknowns.
        """
        linear = linear_model(self.misfit, candidates, blocks=blocks)
        factor = linear.equations(self.q).factor()
        if factor is None:
            return None
        return BlockScores(*block_information(FactoredModel(linear, factor), self.q))


@dataclass(frozen=True, eq=False)
class BlockScores:
    """`scores` (B, p) and `information` (B, p, p) of consecutive blocks, in scaled unknowns (theta, offsets, gains)."""

    scores: Floats
    information: Floats

    def merged(self, blocks: int) -> BlockScores:
        """The same in fewer blocks of about equal length."""
        label = np.arange(len(self.scores)) * blocks // len(self.scores)
        firsts = np.searchsorted(label, np.arange(blocks))
        return BlockScores(np.add.reduceat(self.scores, firsts), np.add.reduceat(self.information, firsts))

    def within(self, chosen: Indices | Bools) -> BlockScores:
        """Those of some of the unknowns alone."""
        return BlockScores(self.scores[:, chosen], self.information[:, chosen][:, :, chosen])

    def ratios(self, free: Bools, noise: float, deviations: Callable[[BlockScores], Floats]) -> Floats:
        """(p,) standard errors by blocks over those of white `noise`, the larger in either number; 1 where not `free`."""
        own, ratios = self.within(free), np.ones(len(free))
        inverse = np.linalg.inv(own.information.sum(axis=0))
        white = noise * np.sqrt(np.maximum(inverse.diagonal(), np.finfo(float).tiny))
        ratios[free] = np.max([deviations(own.merged(blocks)) for blocks in BLOCKS], axis=0) / white
        return ratios

    def deviations(self) -> Floats:
        """(p,) standard errors by leaving out one block at a time, widened to normal quantiles."""
        blocks = len(self.scores)
        moved = np.einsum("bij,bj->bi", self._inverses_without_each, self.scores)
        variance = (blocks - 1) / blocks * np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
        return np.asarray(_normal_quantiles(blocks - 1) * np.sqrt(variance))

    def by_scores(self) -> Floats:
        """(p,) standard errors by the scores of blocks at the common optimum, widened to normal quantiles. One block that
        holds nearly all information, as a hit of a hammer does, does not inflate them.

        The optimum follows the blocks that hold much of the information, whose scores are less there: each is enlarged to what
        white noise gives it without that, and few such blocks have few degrees of freedom (Bell and McCaffrey 2002); not where
        hardly more than one tells an unknown.
        """
        blocks, (unit, _, weights), degrees = len(self.scores), self._enlarged, self.degrees
        pull = (self.scores - self.scores.mean(axis=0)) @ unit.T
        plain = blocks / (blocks - 1) * np.sum((pull @ unit) ** 2, axis=0)
        enlarged = np.sum(np.einsum("bci,bi->bc", weights, pull) ** 2, axis=0)
        few = degrees < _FEWEST
        variance = np.where(few, plain, enlarged)
        return np.asarray(_normal_quantiles(np.where(few, blocks - 1, degrees)) * np.sqrt(variance))

    @property
    def degrees(self) -> Floats:
        """(p,) degrees of freedom of the standard errors by scores: how many blocks tell an unknown."""
        _, shares, weights = self._enlarged
        rows = weights.transpose(1, 0, 2)  # (p, b, i)
        followed = np.einsum("cbi,bij->cbj", rows, shares)
        covariance = -followed @ followed.transpose(0, 2, 1)
        covariance[:, np.arange(len(shares)), np.arange(len(shares))] += np.sum(followed * rows, axis=2)
        return _degrees(covariance)

    def told(self, free: Bools) -> Bools:
        """(p,) whether enough blocks hold information on an unknown, in either number, for their scatter to be its error;
        False where not `free`.
        """
        degrees, own = np.zeros((len(BLOCKS), len(free))), self.within(free)
        degrees[:, free] = [own.merged(blocks).degrees for blocks in BLOCKS]
        return np.asarray((degrees >= _FEWEST).all(axis=0))

    @cached_property
    def _enlarged(self) -> tuple[Floats, Floats, Floats]:
        """The unit (p, p) in which the information is 1, the shares (B, p, p) of blocks in it, and what their scores in that
        unit move the unknowns by, enlarged, (B, p, p).
        """
        unit = np.linalg.inv(np.linalg.cholesky(self.information.sum(axis=0)))
        shares = unit @ self.information @ unit.T
        sizes, axes = np.linalg.eigh(shares)
        enlarged = 1.0 / np.sqrt(np.maximum(1.0 - sizes, _SHARED))
        return unit, shares, unit.T @ (axes * enlarged[:, None, :]) @ axes.transpose(0, 2, 1)

    def chances(self, noise: float) -> Floats:
        """(p,) probabilities that noise alone scatters estimates without one block so far.

        Scores of noise have the covariance that the information says, times `noise` squared, and sum to zero; the sum of
        squares is taken for a multiple of chi-square with its mean and variance (Satterthwaite, Biometrics Bulletin 2, 1946).
        """
        inverses, parts = self._inverses_without_each, self.information
        moved = np.einsum("bij,bj->bi", inverses, self.scores) / noise
        squares = np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
        # of each unknown c, from the scores of each block b
        followed = (parts @ inverses.transpose(0, 2, 1)).transpose(2, 0, 1)
        covariance = -(followed @ np.linalg.inv(parts.sum(axis=0)) @ followed.transpose(0, 2, 1))
        own = np.einsum("bcu,cbu->cb", inverses, followed)
        covariance[:, np.arange(len(parts)), np.arange(len(parts))] += own
        covariance -= covariance.mean(axis=1, keepdims=True)
        covariance -= covariance.mean(axis=2, keepdims=True)
        mean, degrees = np.trace(covariance, axis1=1, axis2=2), _degrees(covariance)
        return np.asarray(scipy.special.chdtrc(degrees, degrees * squares / mean))

    @cached_property
    def _inverses_without_each(self) -> Floats:
        """(B, p, p) inverses of the information with one block left out."""
        return np.linalg.inv(self.information.sum(axis=0) - self.information)

    def single_ratios(self, parameters: int) -> Floats:
        """(p,) squared ratios of the scatter of the blocks to what the information says, one unknown at a time.

        The first `parameters` are tested beside each other, each other one beside these alone.
        """
        whole, own = self.information.sum(axis=0), slice(0, parameters)
        scale = 1.0 / np.sqrt(np.maximum(whole.diagonal(), np.finfo(float).tiny))
        scaled = whole * np.outer(scale, scale)
        inverse = np.linalg.pinv(scaled[own, own], rcond=1e-12, hermitian=True)
        beside = np.eye(len(whole))  # what of the scores is left of each unknown
        beside[own, own] = inverse / np.where(inverse.diagonal() > 0.0, inverse.diagonal(), 1.0)
        beside[own, parameters:] = -inverse @ scaled[own, parameters:]
        left = np.einsum("ij,ij->j", beside, scaled @ beside)
        tested = left > _COLLINEAR
        pulls = np.var(self.scores * scale @ beside, axis=0, ddof=1) * len(self.scores)
        return np.where(tested, pulls / np.where(tested, left, 1.0), 1.0)


def _degrees(covariance: Floats) -> Floats:
    """(p,) degrees of freedom of sums of squares of normal numbers with covariances (p, B, B) (Satterthwaite 1946)."""
    squares = np.sum(covariance**2, axis=(1, 2))
    whole = np.trace(covariance, axis1=1, axis2=2) ** 2
    return np.asarray(np.where(squares > 0.0, whole / np.where(squares > 0.0, squares, 1.0), 1.0))


def _normal_quantiles(degrees: Floats | float) -> Floats:
    """What a standard error with so many degrees of freedom is to be multiplied by, so that normal quantiles hold."""
    return np.asarray(scipy.special.stdtrit(degrees, _LEVEL) / scipy.special.ndtri(_LEVEL))


@dataclass(frozen=True, eq=False)
class BlockScatter:
    """How far blocks of the records disagree.

    Attributes
    ----------
    ratios : array of shape (p + o + g,)
        Standard errors by blocks over those of white noise, at least 1.
    chance : float
        The probability that noise alone scatters any parameter so far, in either number of blocks.
    """

    ratios: Floats
    chance: float

    def added(self, white: Floats) -> Floats:
        """(p, p) what the scatter adds to the covariance of p parameters that `white` noise gives."""
        ratios = self.ratios[: len(white)]
        return white * (np.outer(ratios, ratios) - 1.0)


# times the standard errors of white noise, as without a block that alone tells an unknown: a decay that is soon at rest
_ALONE = 100.0


def block_scatter(optimum: Optimum, free: Bools, scores: BlockScores | None = None) -> BlockScatter | None:
    """How far the scatter of blocks exceeds what white noise gives them; None for too few segments.

    `free` is False where an unknown was stopped by its bound; `scores`, in `blocks_of_scatter`, are known of the optimum.
    """
    if blocks_of_scatter(optimum.segments) == 1:
        return None
    scores = scores or optimum.scores
    if scores is None:
        return None
    p = optimum.segments.system.parameters.size
    try:
        ratios = scores.ratios(free, optimum.noise, BlockScores.deviations)
        if np.max(ratios) > _ALONE:
            ratios = scores.ratios(free, optimum.noise, BlockScores.by_scores)
        ratios = np.maximum(ratios, 1.0)
        own = scores.within(np.flatnonzero(free))
        chances = np.fmin(*(own.merged(blocks).chances(optimum.noise) for blocks in BLOCKS))
    except np.linalg.LinAlgError:
        return None
    tested = int(np.count_nonzero(free[:p]))
    lowest = float(np.min(chances[:tested], initial=1.0))
    return BlockScatter(ratios, min(1.0, len(BLOCKS) * tested * lowest))


def blocks_of_scatter(segments: Segments) -> int:
    """The blocks in which a linear model tells how far blocks scatter; 1 where there are too few segments."""
    return BLOCKS[0] if segments.count >= FEWEST * BLOCKS[0] else 1


_ROUGH = 3.0  # cost per sample at q = 1 beyond which states are no motion: their noise leaves 1 or 2
_SCHEDULE = AnnealingSchedule(initial_q=10.0, final_q=0.1, max_steps=30)
_UNRELATED = (
    2.0  # times the power of the samples: residuals of a motion as large that has nothing to do with them
)


def states_by_held_laws(start: Misfit, annealer: Annealer) -> Misfit:
    """Fit the states alone, the parameters held, where the states of a start are no motion of the laws.

    Parameters
    ----------
    start : Misfit
        That of states and parameters, the latter near the truth.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    Misfit
        That of the same parameters, with the states of a motion near the record.
    """
    segments = start.segments
    if not _ROUGH * int(segments.observed.sum()) < start.cost(1.0) < np.inf:
        return start
    system, theta = segments.system, start.point.theta
    fixed_system = replace(system, parameters=replace(system.parameters, lower=theta, upper=theta))
    held = replace(start, segments=replace(segments, system=fixed_system))
    fit = annealer(held, _SCHEDULE)
    return start.at(replace(start.point, nodes=fit.point.nodes))


_WHITE = 0.1  # autocorrelation of the residuals beyond which they are not noise of another size
_LEAST_ROBUST = 0.5  # of the cost of normal noise; Student's t with 3 degrees of freedom leaves 0.80 to 0.92
_ROUNDED = 1.0 + 1e-9
_LARGEST_EXCESS = 2.0  # coloured residual power over the noise that no model error explains
_SMALL = 0.005  # of what each channel shows: coloured residuals that blocks can judge, a tenth of what a free run may leave


@dataclass(frozen=True, eq=False)
class ExplainedFit:
    """A fit and its errors.

    Attributes
    ----------
    fit : AnnealingFit
        The optimum.
    covariance : array of shape (P, P)
        Of parameters, offsets, gains and delays.
    chi_square, chi_square_off : float, bool
        Chi-square per degree of freedom, and whether it is far from 1.
    model_error, noise : float
        The relaxation q that stands for a model error, else 0, and the factor on the noise.
    error_ratios : array of shape (P,) or None
        With a model error, the factor on the standard errors over those of white model error; None for too short records.
    coloured : ColouredNoise or None
        The noise where it is coloured.
    noise_from_misfit : bool
        Whether the noise is what the laws leave: beside that which was stated or found no search ended.
    """

    fit: AnnealingFit
    covariance: Floats
    chi_square: float
    chi_square_off: bool
    model_error: float = 0.0
    noise: float = 1.0
    error_ratios: Floats | None = None
    coloured: ColouredNoise | None = None
    noise_from_misfit: bool = False


def explained_fit(
    start: Iterate, fit: AnnealingFit, annealer: Annealer, *, lowest: Floats, options: LikelihoodOptions
) -> ExplainedFit:
    """`fit`, or, where noise as expected does not explain it, the likelier of fits with coloured noise and with model error.

    Parameters
    ----------
    start : Iterate
        Where the search for `fit` started.
    fit : AnnealingFit
        The fit with white noise and exact laws.
    annealer : Annealer
        Fits again.
    lowest : array of shape (C,)
        The least deviations of the noise that residuals may show, infinite where it is stated.
    options : LikelihoodOptions
        The options: what it may resort to, and whether a model error is known.

    Returns
    -------
    ExplainedFit
        The fit and its errors.
    """
    any_stated, limit = bool(np.isinf(lowest).any()), _limit(fit.samples)
    off = _is_off(fit, lowest)
    inexact, known = (
        options.model_error and fit.misfit.segments.random is None,
        options.relaxation is not None,
    )
    white_alone = known or not (inexact and options.coloured_noise)
    coloured = None if white_alone else with_coloured_noise(fit, annealer)
    unreached = did_not_converge(fit) and fit.misfit.data > (1.0 + limit) * fit.samples
    unlimited = inexact and not options.is_trial
    off_by_laws = off and fit.chi_square > 1.0 and _is_coloured(fit)
    is_sought = inexact and (known or unreached or off_by_laws)
    found = with_model_error(fit, start, annealer) if is_sought else None
    candidate = None if found is not None and found.surpassed else found
    if coloured is not None and (candidate is None or coloured.cost < candidate.cost):
        stated = any_stated and off
        return ExplainedFit(
            coloured.fit, coloured.covariance, coloured.chi_square, stated, coloured=coloured.noise
        )
    if candidate is not None and candidate.exact:
        fit = with_noise_of_residuals(candidate.fit, annealer, lowest)
        off = _is_off(fit, lowest)
    elif candidate is not None:
        return _with_model_error(candidate, any_stated)
    elif unlimited and unreached and (noisier := with_noise_from_misfit(start, fit, annealer)):
        power = (
            np.square(noisier.misfit.residuals).sum(axis=2) * (noisier.scales.sigma / fit.scales.sigma) ** 2
        )
        chi_square = float(power.sum()) / freedom(fit.misfit.segments)
        relaxed = None if found is None else _with_model_error(found, any_stated)
        # of motion between wells, exact laws beside noise as large as their misfit may end in another optimum
        if relaxed is not None and fit.misfit.segments.prior is None and relaxed.chi_square < chi_square:
            return relaxed
        return ExplainedFit(
            noisier, noisier.covariance, chi_square, chi_square_off=True, noise_from_misfit=True
        )
    elif found is not None and unreached:
        return _with_model_error(found, any_stated)
    return ExplainedFit(fit, fit.covariance, fit.chi_square, off)


def _is_off(fit: AnnealingFit, lowest: Floats) -> bool:
    """Whether chi-square is not that of the noise.

    Where outliers make up a part of it, a robust loss leaves less. Channels with hardly any noise leave nothing: whether
    chi-square is too small the others tell.
    """
    limit, robust = _limit(fit.samples), not isinstance(fit.misfit.loss, Gaussian)
    if fit.chi_square > 1.0 + limit:
        return True
    stated = np.isinf(lowest)
    least = 1.0 - limit if stated.any() or not robust else min(_LEAST_ROBUST, 1.0 - limit)
    noisy = stated | (fit.scales.sigma > lowest * _ROUNDED)
    if noisy.all():
        return not fit.chi_square >= least
    samples = fit.misfit.segments.observed[:, noisy].sum()
    power = float(np.sum(fit.misfit.residuals[:, noisy] ** 2)) / max(samples, 1)
    return bool(samples) and not power >= least


def _with_model_error(candidate: ModelErrorCandidate, stated: bool) -> ExplainedFit:
    fit, factor = candidate.fit, candidate.noise
    chi_square = factor**2
    ratios: Floats | None = np.ones(len(fit.covariance))
    if not did_not_converge(fit):
        optimum = Optimum(fit.misfit, fit.q, factor)
        scatter = block_scatter(optimum, ~fit.at_bound)
        ratios = None if scatter is None else scatter.ratios
    judged = ratios is not None and _are_small(fit)
    unexplained = chi_square > _LARGEST_EXCESS and _is_coloured(fit) and not judged
    p = fit.misfit.segments.system.parameters.size
    widened = np.full(len(fit.covariance), factor)
    if ratios is not None:
        widened[:p] *= ratios[:p]  # sensors: those of white model error
    return ExplainedFit(
        fit,
        fit.covariance * np.outer(widened, widened),
        chi_square,
        bool(unexplained or (stated and abs(chi_square - 1.0) > _limit(fit.samples))),
        fit.q,
        factor,
        ratios,
    )


def _are_small(fit: AnnealingFit) -> bool:
    """Whether the residuals are a small part of how far each channel moves from its mean."""
    motion = moved(fit.misfit.segments)
    residuals = fit.misfit.residuals * fit.scales.sigma[:, None]
    return bool(np.all(np.sum(residuals**2, axis=(0, 2)) <= _SMALL**2 * np.sum(motion**2, axis=(0, 2))))


def moved(segments: Segments) -> Floats:
    """(M, C, K) how far each channel is from its mean; zero where it has no sample."""
    count = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    mean = segments.samples.sum(axis=(0, 2)) / count
    return np.where(segments.observed, segments.samples - mean[:, None], 0.0)


def _is_coloured(fit: AnnealingFit) -> bool:
    """Whether the search converged to residuals that are correlated from one sample to the next."""
    return fit.status is AnnealingStatus.CONVERGED and lag_one_autocorrelation(fit.misfit) > _WHITE


# from a start with known deviations: the weak fit's
_NEAR = AnnealingSchedule(initial_q=0.1, smallest_factor=0.01, trust_per_sample=10.0)
# of many masses: the mean of all hides that the quadratic model is wrong for one
_FAR_OF_MANY = AnnealingSchedule(smallest_factor=0.1, trust_per_sample=1.0)
_NEAR_OF_MANY = replace(_FAR_OF_MANY, initial_q=0.1)
_HELD = 1e-3  # of what is known of a gain beforehand
# from the states of a fit to nearly the same laws
_WARM = AnnealingSchedule(initial_q=0.01, smallest_factor=0.003, trust_per_sample=10.0)
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_NEARLY = 2.0  # times the noise, in power: a search that ended there without converging was on its way
_TIGHTER = 9.0  # factor below a known model error from which it is looked for again: two points of its grid
_JOINING = 30  # steps that linking the sides of a gap may take


def searched(
    problem: ShootingProblem, spread: Floats | None, options: LikelihoodOptions, annealer: Annealer
) -> tuple[Iterate, AnnealingFit]:
    """The optimum of a problem.

    Long gaps break the chain of segments at first; its parts are linked where the laws and the samples allow it.

    Parameters
    ----------
    problem : ShootingProblem
        The problem.
    spread : array of shape (p,) or None
        Standard deviations of the starting values, where known.
    options : LikelihoodOptions
        The options of the fit.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    tuple of (Iterate, AnnealingFit)
        The start and the result of annealing.
    """
    segments = split_at_gaps(problem.segments)
    many = len(segments.system.incidence) >= MANY
    if options.nodes is None:
        start = carry_through_gaps(segments, problem.start)
    else:
        beside = problem.start.nodes[len(options.nodes) :]  # random forces, which another fit may not have
        start = replace(problem.start, nodes=np.concatenate([options.nodes, beside]))
    misfit, schedule = evaluate(segments, start, problem.scales, options.loss), _WARM
    if options.nodes is None:
        fit = _of_long_record(problem, misfit, options, annealer)
        if fit is not None:
            return misfit.point, fit
        schedule = _FAR_OF_MANY if many else AnnealingSchedule()
        if spread is not None:
            misfit = states_by_held_laws(misfit, annealer)
            schedule = _NEAR_OF_MANY if many else _NEAR
    start = misfit.point
    if options.relaxation is not None:
        tight = max(options.relaxation / _TIGHTER, AnnealingSchedule.final_q)
        schedule = AnnealingSchedule(initial_q=options.relaxation, final_q=tight)
    schedule = replace(
        schedule,
        cost_ceiling=options.ceiling,
        max_steps=min(schedule.max_steps, options.steps),
        final_q=max(schedule.final_q, options.tightest),
    )
    if segments.random is not None:
        tight = relaxation(misfit)
        schedule = replace(schedule, initial_q=max(schedule.initial_q, tight), final_q=tight)
    held = _with_held_scale(segments)
    # whose prior counts the same at the start
    fit = annealer(replace(misfit, segments=held or segments), schedule)
    if held is not None:
        fit = replace(fit, misfit=misfit.at(fit.point))
        if fit.status is not AnnealingStatus.INTERRUPTED:
            released = annealer(fit.misfit, _loosened(schedule))
            fit = replace(released, path=(*fit.path, *released.path))
    if not options.is_trial and did_not_converge(fit) and fit.misfit.data < _NEARLY * fit.samples:
        fit = _resumed(fit, schedule, annealer)
    if problem.segments.chains < segments.chains:
        joined = _joined(problem.segments, fit, annealer)
        if joined is not None:
            return start, joined
    return start, fit


def _with_held_scale(segments: Segments) -> Segments | None:
    """Segments with one gain held; None unless all channels have gains, each known beforehand.

    Laws with unknown coefficients hardly determine the scale that all channels share: with looser links a search leaves for
    another one, and comes back along a valley that bends.
    """
    sensors, prior = segments.sensors, segments.prior
    if prior is None or not sensors.gains or not sensors.gain.any(axis=1).all():
        return None
    first = len(prior.deviation) - sensors.delays - sensors.gains
    deviation = prior.deviation.copy()
    if not np.isfinite(deviation[first : first + sensors.gains]).all():
        return None
    deviation[first] *= _HELD
    return replace(segments, prior=replace(prior, deviation=deviation))


def _of_long_record(
    problem: ShootingProblem, start: Misfit, options: LikelihoodOptions, annealer: Annealer
) -> AnnealingFit | None:
    """The fit to a long record without long gaps; None where it is not searched so, or leads to no optimum."""
    limited = options.is_trial or options.tightest > AnnealingSchedule.final_q
    if limited or options.relaxation is not None or options.ceiling < np.inf:
        return None
    segments = start.segments
    if problem.segments.chains < segments.chains or not is_long(segments):
        return None
    return search_long_record(start, annealer, _limit(int(segments.observed.sum())))


def _limit(samples: int) -> float:
    """By how much chi-square of so many samples may differ from 1 by chance."""
    return _CHI_SQUARE + _SIGMAS * float(np.sqrt(2.0 / samples))


def _loosened(schedule: AnnealingSchedule) -> AnnealingSchedule:
    """The schedule of a search that is taken up again, with looser links at first."""
    return replace(
        _WARM,
        initial_q=max(_WARM.initial_q, schedule.final_q),
        final_q=schedule.final_q,
        cost_ceiling=schedule.cost_ceiling,
        max_steps=schedule.max_steps,
    )


def _resumed(fit: AnnealingFit, schedule: AnnealingSchedule, annealer: Annealer) -> AnnealingFit:
    """A search that ended before it converged, taken up again from its values and states with looser links.

    Close to its end it may creep along a bend of the likelihood, which looser links straighten. Where the second search does
    not converge either, the one with the lower cost at the tighter of their links is returned.
    """
    again = annealer(fit.misfit, _loosened(schedule))
    path = (*fit.path, *again.path)
    tight = min(fit.q, again.q)
    if again.status is AnnealingStatus.CONVERGED or again.misfit.cost(tight) <= fit.misfit.cost(tight):
        return replace(again, path=path)
    interrupted = again.status is AnnealingStatus.INTERRUPTED
    return replace(fit, status=again.status if interrupted else fit.status, path=path)


def _joined(whole: Segments, fit: AnnealingFit, annealer: Annealer) -> AnnealingFit | None:
    """The fit with both sides of every long gap linked, None if laws and samples do not determine how."""
    if fit.status is not AnnealingStatus.CONVERGED:
        return None
    start = replace(fit.misfit, segments=whole).at(carry_through_gaps(whole, fit.point))
    joined = annealer(start, AnnealingSchedule(max_steps=_JOINING))
    limit = fit.chi_square + _limit(fit.samples)
    settled = joined.status is AnnealingStatus.CONVERGED and joined.chi_square < limit
    return joined if settled else None
