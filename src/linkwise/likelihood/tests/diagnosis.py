"""What could explain what a fit leaves: score tests for errors of sensors, masses and applied forces, and for missing terms.

Each hypothesis is one more column in the linearised equations at the optimum, and its gain is what its best size would take
off -2 log likelihood, all coefficients fitted anew to first order (Rao 1948). A gain follows chi-square with one degree of
freedom where the cause is not there. Motion that is exactly that of the laws is tested in longer segments, at a part of the
cost.

Coefficients make up for nearly all of an error of a mass: with them, it scales all forces on it, and no more than the reaction
on its neighbours tells. Its score may then be too small to be significant among all that is tested, while coefficients are
dozens of standard errors off. There are few masses, so that a smaller score than among all causes says something. Where it
does not, the intervals hold what every mass to which it points would make of the coefficients, alone: masses look alike, as
one that is too heavy and another that is too light.

Where the error of a law is taken for white noise, evidence is overstated by as much as scores of blocks scatter more than
their information says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.estimates.causes import CAUSE_KINDS, CLOCK, GAIN_DRIFT, HIGH_PASS, NONLINEARITY, Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.search import BLOCKS, EQUAL, FEWEST, BlockScores, Optimum
from linkwise.likelihood.shooting.minimise import AnnealingSchedule
from linkwise.likelihood.shooting.normal_equations import block_ends, block_information
from linkwise.likelihood.shooting.residuals import LongerSegments
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.terms import PPM
from linkwise.likelihood.tests.columns import (
    Added,
    FittedMotion,
    TestedColumns,
    base_errors,
    damping_between_modes,
    errors_of_sensors,
    inertia_and_inputs,
    shape_errors,
    terms_along,
)
from linkwise.likelihood.tests.score_test import (
    BETWEEN_MODES,
    FILTER,
    MEMORY_TERMS,
    PRICE_OF_REACH,
    CandidateForce,
    Hypothesis,
    Lacking,
    Quadratic,
    SingleTests,
    candidate_forces,
    determinant_slopes,
    forces_along,
    missing_links,
    missing_terms,
    unit_of,
)
from linkwise.model.coefficient import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread


@dataclass(frozen=True, eq=False)
class TestedCauses:
    """What may explain what a fit leaves, and the cost at its optimum with a column for each.

    `quadratic` is in the p scaled parameters and, after them, in the sizes of the `hypotheses`, of which `units` (h,) are in
    their own; `attenuation` is what a filter of unit size takes off the gain of a channel. Its model is in the segments of
    `longer`, by which blocks of the records scatter; `structure` has the values there. `beside` is the cost in the parameters
    and in sizes of what else was asked for, if anything was.
    """

    __test__ = False  # no test of pytest

    hypotheses: Sequence[Hypothesis]
    units: Floats
    quadratic: Quadratic
    attenuation: float
    longer: Optimum
    structure: Structure
    beside: Quadratic | None = None

    def which(self, wanted: Callable[[Hypothesis], bool]) -> Indices:
        """The numbers of the hypotheses that are wanted."""
        return np.flatnonzero([wanted(one) for one in self.hypotheses])

    @cached_property
    def of_laws(self) -> Indices:
        """The numbers of usual terms, and of damping between modes."""
        return self.which(lambda one: one.is_usual or one.kind == BETWEEN_MODES)

    def stated_masses(self) -> Indices:
        """The numbers of the errors of masses that are stated, not estimated."""
        unknowns = self.longer.segments.system.parameters.names
        return self.which(lambda one: one.kind == MASS and f"{one.where}.{MASS}" not in unknowns)

    @cached_property
    def block_scores(self) -> BlockScores | None:
        """Those of the optimum; None where its model is not in blocks."""
        model = self.quadratic.model
        if model is None or not model.in_blocks:
            return None
        return BlockScores(*block_information(model, self.longer.q))

    @cached_property
    # a candidate may be infinite somewhere; it is then not tested
    @np.errstate(over="ignore", invalid="ignore")
    def tests(self) -> SingleTests:
        """Of each hypothesis alone; of a clock beside the delay of its channel, with what both gain where it gains more than
        by chance.
        """
        p = len(self.quadratic.slope) - len(self.hypotheses)
        tests = self.quadratic.tests(p)
        told = [(k, one) for k, one in enumerate(self.hypotheses) if tests.gains[k] > 0.0]
        delays = {one.where: k for k, one in told if one.kind.endswith("delay")}
        clocks = {k: delays[one.where] for k, one in told if one.kind == CLOCK and one.where in delays}
        numbers = np.array([*clocks.values(), *clocks], dtype=int)
        some = self.quadratic.within([*range(p), *(p + numbers)]).without(np.arange(p)) if clocks else None
        for place, (clock, delay) in enumerate(clocks.items()):
            assert some is not None
            own = some.within([place, place + len(clocks)]).tests(1)
            both = own.gains[0] > _CHANCE_OF_CLOCK * self.longer.noise**2
            late = own.changes[0, 0] / tests.sizes[delay] + both
            changes = own.sizes[0] / tests.sizes[clock] * tests.changes[:, clock]
            tests.changes[:, clock] = changes + late * tests.changes[:, delay]
            tests.gains[clock] = own.gains[0] + both * tests.gains[delay]
            tests.sizes[clock], tests.deviations[clock] = own.sizes[0], own.deviations[0]
        return tests


LARGEST = 0.2  # relative error up to which the first order describes a gain, a mass or a clock; more is none of a calibration

_MASS_CHANCE = 12.0  # with twice the logarithm of the number of masses: normal scores give one in 2000 fits
_HINT = 6.25  # the same: one in 80, as of usual terms
_USUAL_ERRORS = ("gain", GAIN_DRIFT, NONLINEARITY, "force gain", "offset", "delay", "force delay")
_AS_MUCH = 0.9  # of the gain of a term: an error of a sensor that gains as much may be what is there instead
_SHARE_OF_LARGEST = 0.5  # of the largest gain: another mass that gains more may be the one that is off
_FELT = 1.0  # standard errors: the least change of a coefficient of which something is said


Hint = tuple[dict[str, Floats], str]
"""What is added to the covariance (p, p) of the coefficients, by what makes it wider, and at what the residuals hint."""


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere
def hinted_errors(fit: LikelihoodFit, tested: TestedCauses, beside: float = np.inf) -> Hint | None:
    """The masses and the errors of sensors to which the residuals of laws that leave only noise point, each alone.

    Those that gain as much as chance gives to one of its group in one fit of 80, and others of it nearly as likely, which
    would change a coefficient by more than its standard error; of sensors those alone that coefficients resemble, so that
    they change by more than the error is significant, and also those nearly as likely as what gains so much `beside` them.
    None without any.
    """
    optimum, tests = fit.optimum, tested.tests
    moves = tests.changes * optimum.scales.theta[: len(fit.values), np.newaxis]
    moves = np.where(fit.free[:, np.newaxis], moves, 0.0)
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    shifts = np.max(np.abs(moves) / deviations[:, np.newaxis], axis=0, initial=0.0)
    gains = tests.gains / (optimum.noise * beyond_white(fit)) ** 2
    sensors = tested.which(lambda one: one.kind in _USUAL_ERRORS)
    added, words = dict[str, Floats](), list[str]()
    for what, among, resemblance in (("masses", tested.stated_masses(), 0.0), ("sensors", sensors, 1.0)):
        resembled = among[shifts[among] > resemblance * np.sqrt(gains[among])]
        largest = float(np.max(gains[resembled], initial=0.0))
        as_much = _AS_MUCH * beside if what == "sensors" else np.inf
        if not largest > min(_HINT + 2.0 * np.log(max(len(resembled), 1)), as_much):
            continue
        likely = list[int]()
        for k in resembled[np.argsort(-gains[resembled])].tolist():
            one, size = tested.hypotheses[k], float(tests.sizes[k] * tested.units[k])
            is_small = not CAUSE_KINDS[one.kind].relative or abs(size) < LARGEST
            if is_small and shifts[k] > _FELT and gains[k] > _SHARE_OF_LARGEST * largest:
                cause = Cause(one.kind, one.where, size, unit_of(one, tested.structure), 0.0, 0.0)
                words.append(cause.description)
                likely.append(k)
        if likely:
            added[what] = moves[:, likely] @ moves[:, likely].T
    return (added, " or ".join(words)) if added else None


def beyond_white(fit: LikelihoodFit) -> float:
    """By how much scores scatter more than white noise makes them, beside a model error that follows the motion."""
    if fit.model_error == 0.0 or fit.error_ratios is None:
        return 1.0
    return max(1.0, float(np.max(fit.error_ratios)))


_LINKS = 0.25  # of -2 log likelihood, of which a coefficient gains 1 by chance: what links cost at most, and gains change by
_AMONG = 40  # masses that share this cost: of more of them it grows with their number, and of each it remains as small
_BLOCK_SHIFT = 1 / 15  # of a block, by which its ends are shifted at most


def in_longer_segments(fit: LikelihoodFit) -> Optimum:
    """The optimum of a fit in longer segments, where the motion is exactly that of the laws; as it is where the links inside
    these, which they leave out, cost anything.
    """
    optimum = fit.optimum
    exact = optimum.q <= AnnealingSchedule.final_q and optimum.coloured is None
    longer = LongerSegments.of(optimum.segments) if exact else None
    if longer is None:
        return optimum
    misfit = longer.misfit(optimum.misfit)
    left_out = (optimum.misfit.continuity - misfit.continuity) / optimum.q**2
    most = _LINKS * max(1.0, len(optimum.segments.system.incidence) / _AMONG)
    if not left_out < most * optimum.noise**2:
        return optimum
    return replace(optimum, misfit=misfit)


def blocks_in(longer: Segments, shorter: Segments) -> int:
    """The number of blocks in which longer segments scatter as the shorter ones do; 1 where they have no such blocks.

    Their ends are the same, or there are so many segments in each that one more or less hardly matters.
    """
    blocks, joined = BLOCKS[0], len(longer.samples) // len(shorter.samples)
    if longer.count >= EQUAL * blocks:
        return blocks
    count, together = shorter.count, -(-shorter.count // joined)
    before, after = (np.array(block_ends(size, blocks))[:-1] for size in (count, together))
    same = np.max(np.abs(joined * after - before)) <= _BLOCK_SHIFT * count / blocks
    return blocks if same and together >= FEWEST * blocks else 1


@dataclass(frozen=True, eq=False)
class Overdispersion:
    """By what `factor` scores of blocks scatter more than their information says, at least 1, in the median of all.

    `scatters`, of (p + f, p + f) each, are the covariances of the slope by the parameters and the amplitudes of the candidates
    that they give, in the units of these.
    """

    factor: float
    scatters: tuple[Floats, ...]


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere
def overdispersion(optimum: Optimum, forces: Sequence[CandidateForce]) -> Overdispersion | None:
    """How scores by the parameters of `optimum` and by candidate `forces` scatter; None for too few segments.

    Log likelihoods are divided by the factor (quasi-likelihood: Wedderburn, Biometrika 61, 1974).
    """
    segments = optimum.segments
    if segments.count < FEWEST * BLOCKS[0]:
        return None
    candidates, units = candidate_forces(segments, optimum.misfit, forces)
    scores = optimum.block_scores(BLOCKS[0], candidates)
    if scores is None:
        return None
    parameters = segments.system.parameters.size
    own = parameters + len(forces)
    in_blocks = [scores.merged(blocks) for blocks in BLOCKS]
    ratios = [blocks.single_ratios(parameters)[:own] / optimum.noise**2 for blocks in in_blocks]
    unit = np.concatenate([optimum.scales.theta[:parameters], units]) * optimum.noise**2
    return Overdispersion(
        factor=max(1.0, float(np.median(np.max(ratios, axis=0)))),
        scatters=tuple(_scatter(blocks, own) / np.outer(unit, unit) for blocks in in_blocks),
    )


def _scatter(scores: BlockScores, own: int) -> Floats:
    """(own, own) covariance of the sum of the scores by the first `own` unknowns, the others following them."""
    whole, pull = scores.information.sum(axis=0), scores.scores
    follow = np.linalg.lstsq(whole[own:, own:], whole[own:, :own], rcond=None)[0]
    left = pull[:, :own] - pull[:, own:] @ follow
    left -= left.mean(axis=0)
    blocks = len(left)
    return np.asarray(left.T @ left * blocks / (blocks - 1))


_NO_SLOPE = ("sign(v)", *MEMORY_TERMS)
"""What the log determinant does not see: a jump, and forces with memory."""

# samples: the first order says nothing of a longer delay, as that of all channels of a free decay
_LATEST = 20.0
_HALF = 0.1  # of a sample, by which a delay may differ from a half and still look like one
# of a sample squared: what straight lines take off a motion is its second derivative times it
_STRAIGHT = 1.0 / 12.0
_NEAR = 0.2  # relative, by which a filter may differ from that and still look like it
# with twice the logarithm of the number of causes: normal scores give one cause in 20 000 fits
_CHANCE = 16.0
_CHANCE_OF_FILTER = 9.0  # one cause, of one sign, which chance gives in one fit of 700
# beside a delay, which a clock that is added has as well, so that one too many costs little
_CHANCE_OF_CLOCK = 9.0
_SHIFTED = 3.0  # standard errors that it, or a mass, changes a coefficient by: amplitudes of 1 % are 2 % of a cubic spring
_FROM_ZERO = 2.0  # standard errors by which a coefficient differs from zero, or changes
_LISTED = 3  # hypotheses in a sentence
_NOTHING_TESTED = " Errors of sensors and missing terms were not tested: at these values the equations for them are singular."
PRICES = {
    **dict.fromkeys(MEMORY_TERMS, PRICE_OF_REACH),
    **dict.fromkeys(("d*abs(d)", GAIN_DRIFT, NONLINEARITY), 9.0),
}
"""Of -2 log likelihood, that a cause loses beside a smooth function: by three standard errors these are told apart."""
AS_LIKELY = 9.0
"""Of -2 log likelihood: three standard errors, by which causes are told apart, and one exceeds those that are less likely."""
_CONTRADICTED = 16.0  # square of the standard errors by which records may differ from a stated value by chance: 1 in 16 000


Beside = Callable[[Optimum], Iterable[Added]]
"""What is asked of the equations in which causes are tested beside these, at an optimum in longer segments."""


def diagnose(
    fit: LikelihoodFit,
    identified: Structure,
    channels: Sequence[Channel],
    *,
    terms: bool,
    beside: Beside | None = None,
) -> Diagnosis:
    """The causes that are significant, the likeliest first, and terms that are nearly as likely as the error of a sensor which
    is; `channels` are those of the record.

    All missing terms and links are tested where `terms` is true, and where one of the others is significant, which may
    stand for one of them.
    """
    causes: tuple[Cause, ...] = ()
    tested, remark = None, ""
    try:
        with one_blas_thread():
            for every in (True,) if terms else (False, True):
                tested = tested_causes(fit, identified, channels, terms=every, beside=beside)
                causes, remark = _significant(tested, fit), _not_tested(tested)
                if not causes:
                    break
    except np.linalg.LinAlgError:
        remark = _NOTHING_TESTED
    conflicts = tuple(_prior_conflicts(fit, identified))
    # which is the same error of a sensor, told as what it contradicts
    stated = {conflict.where for conflict in conflicts}
    others = [
        cause for cause in causes if f"{cause.kind.removeprefix('force ')} of {cause.where}" not in stated
    ]
    # of a mass that is known to within a sigma both are one, and rounding must not tell which comes first
    of_masses = {f"{cause.where}.{MASS}": cause.gain for cause in others if cause.kind == MASS}
    conflicts = tuple(replace(one, gain=min(one.gain, of_masses.get(one.where, np.inf))) for one in conflicts)
    tested = None if _are_ambient(fit) else tested
    return Diagnosis(tuple(sorted((*others, *conflicts), key=likeliest_first)), tested, remark)


def _are_ambient(fit: LikelihoodFit) -> bool:
    """Whether forces that nobody recorded act, beside which errors of sensors and of masses are not tested."""
    return any(force.ambient for force in fit.random_forces)


def likeliest_first(cause: Cause) -> float:
    """By gain; a force with memory, whose reach is free beside its size, one with a kink, which no spring has that is
    not preloaded, and a gain that drifts, as what any law lacks of a decay may look, come after what gains nearly as much.
    """
    return PRICES.get(cause.term or cause.kind, 0.0) - cause.gain


def least_gain(causes: int) -> float:
    """What the gain of one among so many `causes` exceeds where it is significant."""
    return _CHANCE + 2.0 * float(np.log(max(causes, 1)))


def _prior_conflicts(fit: LikelihoodFit, identified: Structure) -> Iterator[Cause]:
    """What was known beforehand of a parameter, or of an error of a sensor, and the records contradict."""
    segments, point = fit.segments, fit.optimum.point
    if segments.prior is None:
        return
    names = [
        *zip(segments.system.parameters.names, segments.system.parameters.units, strict=True),
        *(
            (f"{term.kind} of {term.channel}", term.unit or unit_in(identified, term.channel))
            for term in (one.term for one in fit.found for _ in one.sizes)
        ),
    ]
    limit = _CONTRADICTED + 2.0 * np.log(max(segments.prior.count, 1))
    for number in np.flatnonzero(fit.prior_conflicts > limit).tolist():
        where, unit = names[number]
        yield Cause(
            kind="prior",
            where=where,
            size=float(point.border[number] - segments.prior.mean[number]),
            unit=unit,
            gain=float(fit.prior_conflicts[number]),
            standard_error=float(segments.prior.deviation[number]),
        )


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The significant `causes`, that with the largest gain first, and all that were `tested`.

    The latter is None beside ambient forces, and where the equations are singular. `remark` says what could not be tested.
    """

    causes: tuple[Cause, ...]
    tested: TestedCauses | None
    remark: str = ""


def _not_tested(tested: TestedCauses) -> str:
    """A sentence on the hypotheses whose effect is not finite, which have no score; empty where all have one."""
    names = [
        f"{hypothesis.term or hypothesis.kind} in {hypothesis.where}"
        for hypothesis, is_finite in zip(tested.hypotheses, tested.tests.finite, strict=True)
        if not is_finite
    ]
    listed = (
        f"{', '.join(names[:_LISTED])}{f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''}"
    )
    return f" Not tested, since the motion makes them infinite: {listed}." if names else ""


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere
def tested_causes(
    fit: LikelihoodFit,
    identified: Structure,
    channels: Sequence[Channel],
    *,
    terms: bool,
    beside: Beside | None = None,
) -> TestedCauses:
    """Missing terms, errors of masses and inputs, of sensors, of the base and of hosts; all terms, and missing links, only
    where `terms` is true. Beside ambient forces missing terms alone.

    Raises numpy.linalg.LinAlgError where the equations are singular.
    """
    optimum = in_longer_segments(fit)
    motion = FittedMotion(optimum, identified, channels)
    errors: tuple[Iterable[Added], ...] = ()
    if _are_ambient(fit):
        there = [f"{link.name}.{name}" for link in identified.links for name in link.coefficients]
        lacking = missing_terms(identified, there)
    else:
        lacking = missing_terms(identified, optimum.segments.system.parameters.names)
        lacking = (
            lacking + missing_links(identified) if terms else [each for each in lacking if each[0].is_usual]
        )
        of_hosts = (shape_errors(motion), damping_between_modes(motion)) if identified.hosts else ()
        errors = (inertia_and_inputs(motion), errors_of_sensors(motion), base_errors(motion), *of_hosts)
    if fit.random_forces:
        lacking = [each for each in lacking if each[0].term not in _NO_SLOPE]
    lines = beside(optimum) if beside and errors else ()  # which have no place, and come last
    columns = TestedColumns.of(chain(terms_along(motion, lacking), *errors, lines))
    whole = columns.quadratic(optimum, blocks_in(optimum.segments, fit.segments))
    unknowns, h = np.arange(len(whole.slope)), sum(bool(one.where) for one in columns.hypotheses)
    p, others = len(unknowns) - len(columns.hypotheses), h < len(columns.hypotheses)
    quadratic = whole.within(unknowns[: p + h]) if others else whole
    if fit.random_forces:
        quadratic = _with_determinants(quadratic, fit, identified, lacking, columns, channels)
    own = columns.hypotheses[:h], columns.units[:h]
    asked = whole.within(np.r_[:p, p + h : len(unknowns)])
    return TestedCauses(*own, quadratic, motion.attenuation, optimum, identified, asked if others else None)


def _with_determinants(
    quadratic: Quadratic,
    fit: LikelihoodFit,
    identified: Structure,
    lacking: Lacking,
    columns: TestedColumns,
    channels: Sequence[Channel],
) -> Quadratic:
    """The cost of the marginal likelihood beside random forces, in which missing forces follow the parameters, and after them
    the errors of masses and gains among `columns`.
    """
    optimum, forces, p = fit.optimum, [force for _, force in lacking], len(fit.values)
    _, norms = forces_along(optimum.segments, optimum.misfit, forces)
    responses = [str(channel) for channel in channels if not channel.is_input]
    named = enumerate(columns.hypotheses)
    errors = [k for k, one in named if one.kind == MASS or (one.kind == "gain" and one.where in responses)]
    numbers, units = [*range(len(forces)), *errors], np.append(norms, columns.units[errors])
    candidates: list[CandidateForce | Hypothesis] = [*forces, *(columns.hypotheses[k] for k in errors)]
    deviations = (quadratic.tests(p).deviations[numbers] * units).tolist()
    masses = [force.where.removeprefix("force:") for force in fit.random_forces]
    slope = quadratic.slope.copy()
    slope[p + np.array(numbers, dtype=int)] += units * determinant_slopes(
        optimum, identified, masses, list(zip(candidates, deviations, strict=True)), responses
    )
    return replace(quadratic, slope=slope)


@np.errstate(over="ignore", invalid="ignore")  # as in `tested_causes`
def _significant(tested: TestedCauses, fit: LikelihoodFit) -> tuple[Cause, ...]:
    """The causes that chance hardly gives, as large as the first order describes, and where the likeliest is no term or link
    those of these that are not told apart from it.
    """
    optimum, tests, causes, others = fit.optimum, tested.tests, list[Cause](), list[Cause]()
    gains, sizes = tests.gains / optimum.noise**2, tests.sizes * tested.units
    deviations = tests.deviations * optimum.noise * tested.units
    masses, limit, forces = np.zeros(len(gains), dtype=bool), least_gain(len(gains)), dict[str, float]()
    numbers = tested.which(lambda one: one.kind == MASS)
    if len(numbers) and int(np.argmax(gains)) in numbers:  # no other cause gains as much
        masses[numbers] = gains[numbers] > _MASS_CHANCE + 2.0 * np.log(len(numbers))
    sample = float(optimum.segments.step[0]) * optimum.segments.refine
    relative = np.where([one.kind == FILTER for one in tested.hypotheses], tested.attenuation, 1.0) * sizes
    small = [
        _is_small(one, float(size), sample) for one, size in zip(tested.hypotheses, relative, strict=True)
    ]
    for number, hypothesis in enumerate(tested.hypotheses):
        size, is_filter = float(sizes[number]), hypothesis.kind == FILTER
        beyond = gains[number] > (_CHANCE_OF_FILTER if is_filter else limit - AS_LIKELY) or masses[number]
        if not (beyond and small[number]):
            continue
        forces = forces or link_forces(optimum, tested.structure)
        force = forces.get(hypothesis.where, 0.0) if hypothesis.term else 0.0
        of_frequency = hypothesis.kind == "frequency"  # half the relative error of a stiffness
        scale = 0.5 / force if of_frequency and force > 0.0 else 1.0
        cause = Cause(
            kind=hypothesis.kind,
            where=hypothesis.where,
            size=scale * size,
            unit=unit_of(hypothesis, tested.structure),
            gain=float(gains[number]),
            standard_error=scale * float(deviations[number]),
            term="" if of_frequency else hypothesis.term,
            source=hypothesis.source,
            share=abs(scale * size) / force if force > 0.0 else 0.0,
            remark=_remark(hypothesis, size, optimum, sample),
        )
        alike = np.flatnonzero(_are_rivals(tested, fit, number, gains) & small)
        names = tuple(tested.hypotheses[rival].name for rival in alike.tolist())
        cause = replace(_with_changes(cause, fit, tests.changes[:, number]), rivals=names)
        is_beyond = cause.gain > limit or ((is_filter or masses[number]) and cause.shift > _SHIFTED)
        (causes if is_beyond else others).append(cause)
    first = min(causes, key=likeliest_first, default=None)
    least = first.gain - AS_LIKELY if first is not None and first.is_instrument else np.inf
    return (*causes, *(cause for cause in others if cause.term and cause.gain > least))


def _are_rivals(tested: TestedCauses, fit: LikelihoodFit, number: int, gains: Floats) -> Bools:
    """(h,) which hypotheses are as likely as one, to within three standard errors, and change a coefficient otherwise."""
    likely = gains - [PRICES.get(one.term or one.kind, 0.0) for one in tested.hypotheses]
    changes = tested.tests.changes[fit.free] * fit.optimum.scales.theta[: len(fit.values)][fit.free, None]
    own = changes[:, number]
    variances = fit.covariance.diagonal()[fit.free] + own**2 / gains[number]
    apart = np.abs(changes - own[:, None]) / np.sqrt(np.maximum(variances, np.finfo(float).tiny))[:, None]
    return np.asarray((likely > likely[number] - AS_LIKELY) & (np.max(apart, axis=0, initial=0.0) > _SHIFTED))


def _is_small(hypothesis: Hypothesis, size: float, sample: float) -> bool:
    """Whether the first order describes an error of a size, that of a filter as a gain, by the distance of samples in s."""
    if hypothesis.kind == FILTER:
        return 0.0 < size < LARGEST
    if hypothesis.kind.endswith("delay"):
        return abs(size) < _LATEST * sample
    if hypothesis.kind == HIGH_PASS:
        return size > 0.0
    if hypothesis.kind == CLOCK:
        return PPM * abs(size) < LARGEST
    return not CAUSE_KINDS[hypothesis.kind].relative or abs(size) < LARGEST


def _with_changes(cause: Cause, fit: LikelihoodFit, scaled: Floats) -> Cause:
    """The cause with its effect on the coefficients, by their `scaled` changes (p,); those at a bound stay."""
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    determined = np.flatnonzero(fit.free & (errors > 0.0))
    if not len(determined):
        return cause
    errors, values = errors[determined], fit.values[determined]
    changes = scaled[determined] * fit.optimum.scales.theta[determined]
    shifts = np.abs(changes) / errors
    before, after = values / errors, (values + changes) / errors
    uncertain = (np.sign(before) * after < _FROM_ZERO) & (shifts > _FROM_ZERO)
    names = [fit.segments.system.parameters.names[number] for number in determined]
    return replace(
        cause,
        shift=float(np.max(shifts)),
        shifted=names[int(np.argmax(shifts))],
        overturned=tuple(names[k] for k in np.flatnonzero((np.abs(before) > _FROM_ZERO) & uncertain)),
    )


def _remark(hypothesis: Hypothesis, size: float, optimum: Optimum, sample: float) -> str:
    if hypothesis.kind == "force delay" and abs(size / sample - 0.5) < _HALF:
        return "half a sample, as of a force that is held between its samples"
    if hypothesis.kind == FILTER and abs(size / (_STRAIGHT * sample**2) - 1.0) < _NEAR:
        inputs = optimum.segments.inputs
        driven = any(part is not None for part in (inputs.force, inputs.base, inputs.frame, inputs.points))
        return "as of an input that runs in straight lines between its samples" if driven else ""
    if hypothesis.term in MEMORY_TERMS:
        return f"which laws with memory have, such as {MEMORY_TERMS[hypothesis.term]}"
    return ""


def link_forces(optimum: Optimum, structure: Structure) -> dict[str, float]:
    """Root mean square of the force in each link along the fitted motion, in N; random forces, which come last, left out."""
    mechanics, orbit = optimum.segments.system.at(optimum.point.theta), optimum.misfit.trajectories
    d, v = orbit.links[:, 0], orbit.links[:, 1]
    force, rates = np.empty(d.shape), np.empty(orbit.memory.shape)
    mechanics.force(d, v, orbit.memory, force, rates)
    power = np.mean(force**2, axis=(0, 2))
    sizes = np.empty(len(power))
    sizes[optimum.segments.system.order] = np.sqrt(power)
    return dict(zip((link.name for link in structure.links), sizes.tolist(), strict=False))
