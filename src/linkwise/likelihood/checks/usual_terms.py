"""Terms that exact laws may lack, none of them significant: what residuals hint at, and what no test sees.

Chi-square sees an error of the laws only where it exceeds several percent of the noise in power. Two tests see a smaller one:
the scores of terms that laws lack most often, and the scatter of blocks of the records, as a law that lacks a term is fitted
by other values to each motion that it meets (a test of homogeneity: Cochran, Biometrics 10, 1954). For exact laws the two are
nearly independent, and their product says more than either (Fisher, "Statistical methods for research workers", 1932).
Where they doubt the laws, intervals are as wide as blocks scatter, and hold what usual terms would make of the coefficients.

Terms are added to the linearised equations one at a time, always the likeliest beside those before it.
With values c_D of the terms D so found the coefficients move by G c_D, and G c_D c_D' G' is added to their covariance: the
second moment of the c_D about the zero that the laws as stated give them (Berk et al., Ann. Statist. 41, 2013).

The score test of a term bounds its size. A term that resembles those of the law moves their coefficients by many standard
errors before its own score is significant, so that intervals hold for the law as stated only. No interval of reasonable width
could hold what no test of the records sees; it is reported instead. Stated masses may be off likewise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.display import enumerated
from linkwise.estimates.causes import GAIN_DRIFT, UnseenTerm
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.checks.judgement import LARGEST_SHIFT
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.search import BLOCKS, EQUAL, BlockScatter, block_scatter
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.tests.columns import largest_damping
from linkwise.likelihood.tests.diagnosis import (
    LARGEST,
    PRICES,
    Hint,
    TestedCauses,
    beyond_white,
    in_longer_segments,
    link_forces,
)
from linkwise.likelihood.tests.score_test import (
    ASYMMETRY,
    BETWEEN_MODES,
    MEMORY_TERMS,
    PRICE_OF_REACH,
    Hypothesis,
    linear_terms,
)
from linkwise.likelihood.tests.variances import free_of_bounds
from linkwise.model.coefficient import MASS
from linkwise.model.host import in_words

_SINGULAR = 1e-12
_MOST = 6  # terms at which residuals hint; of more, each makes a small part of what the first ones do
_MOST_DOUBTED = 24  # the same where the laws are doubted; those of more links are as many decisions
_LIKELY = 1.0
"""Standard errors from zero beyond which usual terms are counted: as for a term of a regression (Theil 1961), those that are
nearer to zero than their own error say no more of the coefficients than their absence does."""

_HINT = 2.5
"""A normal score, on either side, beyond which intervals of exact laws hold a usual term: one in 80 by chance, so that nearly
all stay as they are. To hold what terms with a smaller score may do, all would have to be several times as wide."""

_POWERS = ("d**3", "d**5")
_HINT_OF_POWER = 2.0
"""The same of a power of the elongation: one in 22 by chance. What the coefficients make up for it depends on the amplitude:
those of 10 s of random motion differ from those of an endless record by about as many standard errors as the score says, and
beside missing damping by a third of that. Of several powers each has a higher limit, as chance gives more of them."""


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def _hinted(fit: LikelihoodFit, tested: TestedCauses, *, doubted: bool) -> Hint | None:
    """What usual terms, none of them significant, add to the covariance of a fit that leaves only noise; None if none does.

    Damping between modes of hosts counts as one. Those at which the residuals hint; where it is `doubted` that the laws are
    exact, those of one link that are farther from zero than their standard error, of more links fewer, as chance gives more of
    them (Foster and George, Ann. Statist. 22, 1994). Each is the likeliest beside those before it, up to a number.
    """
    numbers, optimum, p = tested.of_laws, fit.optimum, len(fit.values)
    hypotheses = [tested.hypotheses[number] for number in numbers]
    least = _limits(hypotheses, doubted=doubted)
    if not np.any(tested.tests.gains[numbers] > least * optimum.noise**2):
        return None
    quadratic = tested.quadratic.within([*range(p), *(p + numbers)])
    prices = np.array([PRICES.get(hypothesis.term, 0.0) for hypothesis in hypotheses])
    terms, others = list[int](), list(range(len(hypotheses)))
    for added in range(p, p + min(_MOST_DOUBTED if doubted else _MOST, len(hypotheses))):
        gains = quadratic.within([*range(p), *(p + np.array([*terms, *others]))]).tests(added).gains
        beyond = np.where(np.isfinite(gains), gains, 0.0) / optimum.noise**2
        enough = beyond > least[others]
        if not enough.any():
            break
        terms.append(others.pop(int(np.argmax(np.where(enough, beyond - prices[others], -np.inf)))))
    if not terms:
        return None
    chosen = quadratic.within([*range(p), *(p + np.array(terms))])
    scale = 1.0 / np.sqrt(np.maximum(chosen.curvature.diagonal(), np.finfo(float).tiny))
    curvature = chosen.curvature * np.outer(scale, scale)
    values = np.linalg.lstsq(curvature, chosen.slope * scale, rcond=_SINGULAR)[0][p:]
    moves = np.linalg.lstsq(curvature[:p, :p], curvature[:p, p:], rcond=_SINGULAR)[0] * values
    moves = np.where(fit.free[:, None], moves * (scale[:p] * optimum.scales.theta[:p])[:, None], 0.0)
    moved, first = moves.sum(axis=1), hypotheses[terms[0]]
    force = f"a force like {first.term} in {first.where}"
    likeliest = f"damping {in_words(first.where)}" if first.kind == BETWEEN_MODES else force
    return {"terms": np.outer(moved, moved)}, likeliest


def _limits(hypotheses: Sequence[Hypothesis], *, doubted: bool) -> Floats:
    """(h,) what each gains at least where the residuals of exact laws hint at it, and by chance beside its size.

    A force with memory has a reach as well: beside a stiff link it hardly differs from a damper, whose interval it would make
    many times as wide. Damping between modes is one of many pairs.
    """
    terms = [hypothesis.term for hypothesis in hypotheses]
    between = np.array([hypothesis.kind == BETWEEN_MODES for hypothesis in hypotheses])
    powers, memory = np.isin(terms, _POWERS), np.isin(terms, list(MEMORY_TERMS))
    of_power = _HINT_OF_POWER**2 + 2.0 * np.log(max(int(np.count_nonzero(powers)), 1))
    least = np.where(powers, min(of_power, _HINT**2), _HINT**2)
    if doubted:
        links = {hypothesis.where for hypothesis in hypotheses if hypothesis.kind != BETWEEN_MODES}
        least = np.minimum(_LIKELY**2 + 2.0 * np.log(max(len(links), 1)), least)
    of_pair = 2.0 * np.log(max(int(np.count_nonzero(between)), 1))
    return np.asarray(least + of_pair * between + PRICE_OF_REACH * memory)


_DOUBT = 0.02
"""Probability of so large scores and so much scatter by chance, below which exact laws are doubted: one record in 50 has wider
intervals for nothing."""


def doubt(fit: LikelihoodFit, tested: TestedCauses | None, *, searched: bool) -> Hint | None:
    """What intervals of exact laws hold where residuals hint at missing terms, none of them significant.

    None where nothing says that the laws are not exact. Where they were `searched` in these records, the search weighs each
    term by its standard error, so that blocks do not widen it.
    """
    if tested is None:
        return None
    gains = tested.tests.gains[tested.which(lambda one: one.is_usual)]
    scores = np.sqrt(gains[gains > 0.0]) / fit.optimum.noise  # of each alone, without sign
    scatter = None if searched else scatter_of_blocks(fit, tested)
    if scatter is not None:
        beyond = float(scipy.special.ndtr(-np.max(scores, initial=0.0)))
        product = scatter.chance * min(1.0, 2.0 * max(len(scores), 1) * beyond)
        if product * (1.0 - np.log(max(product, np.finfo(float).tiny))) < _DOUBT:
            by_blocks = {"blocks": scatter.added(fit.covariance)}
            added, hint = _hinted(fit, tested, doubted=True) or (
                {},
                "a difference between parts of the records",
            )
            return by_blocks | added, hint
    return _hinted(fit, tested, doubted=False)


@np.errstate(over="ignore", invalid="ignore")  # a trial beyond what is finite gives no scatter
def scatter_of_blocks(fit: LikelihoodFit, tested: TestedCauses | None) -> BlockScatter | None:
    """The scatter of blocks of the records.

    None where they are too short for blocks, or where a robust loss, what is known beforehand, coloured noise or a random
    force weighs the samples otherwise than the scores say.
    """
    optimum, segments = fit.optimum, fit.segments
    weighed = segments.prior is not None or segments.random is not None or optimum.coloured is not None
    if weighed or not isinstance(optimum.loss, Gaussian):
        return None
    scores = tested.block_scores if tested else None
    if scores is None:
        longer = in_longer_segments(fit)
        # short ones make more equal blocks
        optimum = longer if longer.segments.count >= EQUAL * BLOCKS[0] else optimum
    scatter = block_scatter(optimum, free_of_bounds(fit), scores)
    return None if scatter is None or not np.isfinite(scatter.ratios).all() else scatter


_NEGLIGIBLE = 0.01
"""Of a coefficient: what the calibration of sensors leaves open anyway, and intervals do not hold unless it is stated. The
gain of an accelerometer is known to 1 % as a rule."""


_LARGEST_DRIFT = 0.05
"""Of a gain, along a record: what one drifts by at most whose amplifier was not let warm, or whose battery runs down."""
_REPEATED = (
    0.002  # of damping, to which no calibration is needed: what free decays of one structure hardly agree to
)


def unseen_terms(
    fit: LikelihoodFit, tested: TestedCauses | None, covariance: Floats, *, terms: bool
) -> tuple[UnseenTerm, ...]:
    """The usual terms, damping between modes, stated masses and gains that drift which the records do not bound well.

    The farthest move comes first.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that is trusted.
    tested : TestedCauses or None
        What was tested at the fit, usual terms among it; None where nothing was.
    covariance : array of shape (p, p)
        That of the coefficients as it is reported.
    terms : bool
        Whether terms are looked for beside masses and drifts: where the fit leaves only noise, without a significant cause.

    Returns
    -------
    tuple of UnseenTerm
        Those which, as large as the records let them be, would change a coefficient by more than an interval can hold, and
        by more than is negligible; of each the coefficient that it would change most.
    """
    if tested is None:
        return ()
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    of_laws = tested.of_laws if terms else np.empty(0, dtype=int)
    estimated = {term.channel for term in fit.terms if term.kind == GAIN_DRIFT}
    drifts = tested.which(lambda one: one.kind == GAIN_DRIFT and one.where not in estimated)
    numbers = np.append(of_laws, tested.stated_masses())
    unseen = chain(
        _bounded(fit, tested, numbers, deviations),
        _bounded(fit, tested, drifts, deviations, least=_REPEATED),
    )
    return tuple(sorted((term for term, _ in unseen), key=lambda term: -term.standard_errors))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a candidate that is infinite is not taken
def _bounded(
    fit: LikelihoodFit,
    tested: TestedCauses,
    numbers: Indices,
    deviations: Floats,
    *,
    most: float = np.inf,
    least: float = _NEGLIGIBLE,
) -> Iterator[tuple[UnseenTerm, Floats]]:
    """Those of these numbers that change coefficients by more than `deviations` (p,) hold, and the changes (p,) by each.

    Each is as large as the records let it be, and changes the coefficient that it changes farthest by at `most` a part of it,
    and one by more than at `least` one.
    """
    if not (len(numbers) and fit.free.any()):
        return
    optimum, p, tests = fit.optimum, len(fit.values), tested.tests
    beyond_noise = NORMAL_95 * optimum.noise * beyond_white(fit)
    wholes = _wholes(fit, tested, numbers)
    for number, (whole, largest) in zip(numbers, wholes, strict=True):
        hypothesis, size = tested.hypotheses[number], abs(float(tests.sizes[number]))
        move = np.where(fit.free, tests.changes[:, number] * optimum.scales.theta[:p] / size, 0.0)
        if not (size > 0.0 and whole > 0.0 and np.isfinite(move).all()):
            continue
        shifts = np.divide(np.abs(move), deviations, out=np.zeros(p), where=fit.free & (deviations > 0.0))
        relative = np.abs(np.divide(move, fit.values))
        is_told = tests.gains[number] > 0.0  # else the coefficients leave nothing of it, whatever its size
        seen = size + beyond_noise * float(tests.deviations[number]) if is_told else np.inf
        limit = min(seen, largest * whole, most / float(relative[np.argmax(shifts)]))
        beyond = (limit * shifts > LARGEST_SHIFT) & (limit * relative > least)
        if not (np.isfinite(limit) and beyond.any()):
            continue
        farthest = int(np.argmax(np.where(beyond, shifts, 0.0)))
        yield (
            UnseenTerm(
                link=hypothesis.where,
                term=hypothesis.kind if hypothesis.kind in (MASS, GAIN_DRIFT) else hypothesis.term or "v",
                share=float(limit / whole),
                coefficient=fit.names[farthest],
                change=float(limit * move[farthest]),
                standard_errors=float(limit * shifts[farthest]),
                relative_change=float(limit * relative[farthest]),
            ),
            limit * move,
        )


_ASYMMETRY = 0.1
"""Of a coefficient: the change by asymmetry that intervals hold at most. Wells whose forces differ by a tenth move those of a
symmetric law by half of that."""


_ONE_SIDE = 0.9
"""Of the time, more on one side of d = 0 than on the other."""


_OF_WELLS = 0.005
"""Of a coefficient, the same at least: wells whose forces differ by 1 %, which nobody calls symmetric, move it by that."""


@np.errstate(divide="ignore", invalid="ignore")  # of laws without a stiffness at d = 0
def asymmetry(fit: LikelihoodFit, tested: TestedCauses) -> Hint | None:
    """What asymmetry that the records leave open adds to the covariance of a fit that leaves only noise; None where none is.

    In one well the rest position and the frequency are two facts, and with a term in d**2 a law has three coefficients for
    them: the residuals stay noise, and those of a symmetric law are off by many standard errors. Wells that are crossed for a
    part of the record tell little more: coefficients were nine errors off beside a score of one. Motion on both sides of a
    single place of rest tells an asymmetry of itself.
    """
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    links, d = tested.structure.links, fit.misfit.trajectories.links[:, 0]
    leaning = np.abs(np.sign(d).mean(axis=(0, 2)))[np.argsort(fit.segments.system.order)]
    open_ones = {
        link.name
        for link, side in zip(links, leaning, strict=False)  # behind them are those of random forces
        if (side > _ONE_SIDE or (link.law.is_plain and float(link.stiffness(0.0)) < 0.0))
        and ASYMMETRY not in linear_terms(link)
    }
    numbers = tested.which(lambda one: one.term == ASYMMETRY and one.is_usual and one.where in open_ones)
    held = list(_bounded(fit, tested, numbers, deviations, most=_ASYMMETRY, least=_OF_WELLS))
    if not held:
        return None
    changes = np.column_stack([change / NORMAL_95 for _, change in held])
    return {"asymmetry": changes @ changes.T}, enumerated(
        [f"a force like {ASYMMETRY} in {term.link}" for term, _ in held]
    )


def _wholes(fit: LikelihoodFit, tested: TestedCauses, numbers: Indices) -> Iterator[tuple[float, float]]:
    """Of each hypothesis of these numbers what its share is taken of, in its scale, and the largest share that is possible."""
    forces = link_forces(fit.optimum, tested.structure)
    damping = largest_damping(tested.structure)
    for number in numbers:
        hypothesis, unit = tested.hypotheses[number], float(tested.units[number])
        if hypothesis.kind == BETWEEN_MODES:
            yield damping[hypothesis.where] / unit, 1.0
        elif hypothesis.kind == MASS:
            yield 1.0 / unit, LARGEST
        elif hypothesis.kind == GAIN_DRIFT:
            yield 1.0 / unit, _LARGEST_DRIFT
        else:
            yield forces.get(hypothesis.where, 0.0), np.inf
