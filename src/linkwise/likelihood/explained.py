"""What explains a record that laws as stated leave more than noise of: one thing after another that the diagnosis names.

Errors of inputs and sensors are taken into the model by themselves: samples at the end of a range, spikes and hums that the
records show, noise of inputs at the level that their channels show, then what the diagnosis names first, as long as it is one
of a sensor or an input. Terms and links that are missing are a
second answer beside the one as stated, with what else is off beside the first of them. Either counts where it leaves nothing
but noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import process_time
from typing import TypeVar

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import format_percent
from linkwise.errors import IdentificationError, LinkwiseError
from linkwise.estimates.causes import (
    AMBIENT,
    CAUSE_KINDS,
    CLIPPED,
    CLOCK,
    EVENT,
    GAIN_DRIFT,
    HARMONIC,
    HIGH_PASS,
    HITS,
    HUM,
    NONLINEARITY,
    SPIKES,
    Cause,
)
from linkwise.estimates.estimate import Estimate
from linkwise.inspection.inspect import mark_missing, marked_samples, without_copies
from linkwise.likelihood.admitted import distinct_error
from linkwise.likelihood.checks.recording import (
    EXCHANGES,
    copied_samples,
    corrected,
    exchanges,
    likeliest_errors,
)
from linkwise.likelihood.checks.slips import slips
from linkwise.likelihood.harmonics import MAY_FADE, harmonic_forces
from linkwise.likelihood.options import (
    LikelihoodOptions,
    is_admissible,
    with_error,
)
from linkwise.likelihood.random_forces import ALL, noise_of_channels, random_forces
from linkwise.likelihood.remarks import with_added
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.terms import (
    PPM,
    Delay,
    Disturbance,
    Gain,
    Hum,
    accelerating_base,
    known_to_within,
    late_beside_clocks,
    of_kind,
)
from linkwise.likelihood.tests.diagnosis import AS_LIKELY, likeliest_first
from linkwise.likelihood.tests.score_test import MEMORY_TERMS
from linkwise.likelihood.widened import FREED, with_cause, with_saturation
from linkwise.model.coefficient import Coefficient
from linkwise.model.structure import Structure
from linkwise.progress import part, until
from linkwise.records.channel import BASE
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.signals.force_window import COARSE, UNDERSAMPLED, coarse_hits, coarseness, without_hits
from linkwise.units import base_exponents
from linkwise.verdict import Grade, Verdict

_ERRORS = 4  # that are added at most: with more, a term is missing rather
_TERMS = 2  # the same of terms, and what is off beside one: with more, the laws are of another form
_ALIKE = 0.5  # of what the likeliest cause explains: a term that may be what is missing explains as much
_NEARLY = 0.9  # of it: an error of a sensor that may stand for the term, or the term for it
# relative: what sensors are off by, of which the record does not tell which, to the first order
_CALIBRATED = 0.2
WHITE = 1.25  # chi-square a sample of white noise, with the scatter of some hundred samples
# standard deviations of an impulse by few samples: a scale that is off by more is no matter of these
_BY_HITS = 3.0
_SCALES = ("mass", "force gain", "gain")
_TRIED = 3  # causes that are as likely
_HIDDEN = ("delay", CLOCK, HIGH_PASS, HARMONIC, HUM)  # by noise of inputs, which follows what they leave
_OF_STIFFNESS = 0.0, -2.0  # the powers of the length and of the time in N/m at a known mass
_STEPS = 40  # of a fit whose laws may be wrong; right ones take a quarter of it
# of processor time for all that is tried, or this many times what the answer as stated took: what explains a record took 20 s
_SECONDS, _TIMES = 200.0, 3.0

_FEW = 4  # masses, beside forces on which all terms are tested in some seconds
_SATURATES = (0.03, 0.3)  # of the deviation of a motion: friction, and springs that yield

OF_HITS = "as of hits of"
"""How the remark on a force begins whose hits have too few samples to tell their impulse."""

ENDED_EARLY = (
    "The search for what explains the rest ended at its limit of processor time, and the answer is that of the laws "
    "as stated. State errors of sensors that are known, or identify a shorter part of the record."
)
"""What is said of an answer beside which the processor time for others came to its end."""

Rung = TypeVar("Rung")


def explained(stated: Rung, beside: Callable[[Rung], Rung | None], most: int) -> Rung:
    """The last of answers from that as stated on, each `beside` what the one before lacks, of which `most` are added.

    There is none beside an answer that lacks nothing, or nothing which can be added.
    """
    current = stated
    for _ in range(most):
        wider = beside(current)
        if wider is None:
            break
        current = wider
    return current


Answered = Callable[[Structure, LikelihoodOptions, Sequence[Record]], Estimate]


@dataclass(frozen=True, eq=False)
class _Model:
    """A structure, options and records with what was `added` to those stated, the `answer` to them, and what gives it."""

    answered: Answered
    structure: Structure
    options: LikelihoodOptions
    records: Sequence[Record]
    answer: Estimate
    added: tuple[Cause, ...] = ()

    def beside(
        self,
        *causes: Cause,
        structure: Structure | None = None,
        options: LikelihoodOptions | None = None,
        records: Sequence[Record] | None = None,
    ) -> _Model | None:
        """The model in which `causes` are taken into one of these; None where they are not told from what is there."""
        asked = structure or self.structure, options or self.options, records or self.records
        try:
            answer = self.answered(*asked)
        except (LinkwiseError, np.linalg.LinAlgError):
            return None
        return _Model(self.answered, *asked, answer, (*self.added, *causes))

    def with_error(self, cause: Cause) -> _Model | None:
        """The model with the error that a cause names as an unknown; None where none can be, or it is not told."""
        options = with_error(self.options, cause, self.records[0])
        return None if options is None else self.beside(cause, options=options)

    @property
    def quick(self) -> _Model:
        """The model whose laws may be wrong: its fits end early, and show no progress, as the search itself is done."""
        bar = part(self.options.progress, 1.0, 1.0)
        return replace(self, options=replace(self.options, progress=bar, steps=_STEPS))

    @property
    def reported(self) -> Estimate:
        """Its answer, whose message begins with what was added, with sizes as they were found, and what clocks and a base
        leave open in its covariance.
        """
        changes = self._of_open_scales
        wider = replace(self.answer, covariance=self.answer.covariance + changes.T @ changes)
        return with_added(wider, self.added)

    @property
    def is_explained(self) -> bool:
        """Whether noise alone is left, and beside what was added white noise: correlated noise may hold what is missing."""
        white = not self.added or (self.answer.chi_square_per_sample or 0.0) < WHITE
        return white and self.answer.grade is Grade.EXPLAINED

    @property
    def is_nearly_explained(self) -> bool:
        """Whether a model error is left beside what was added, and nothing that would explain it."""
        answer = self.answer
        settled = answer.fit_verdicts[0] in (Verdict.CONVERGED, Verdict.MODEL_ERROR_NEEDED)
        approximate = settled and answer.grade is Grade.APPROXIMATE
        return bool(self.added) and approximate and not answer.diagnosis

    @property
    def _of_open_scales(self) -> Floats:
        """(2, p) what coefficients change by where another of the clocks that run apart is the right one, and where the motion
        of the base has an error and sensors are right.

        A coefficient goes with the powers of time and length in its unit, and with time in the length that the sensors tell.
        """
        apart = max(
            (abs(cause.size) for cause in self.added if cause.kind == CLOCK and cause.remark), default=0.0
        )
        base = [str(name) for name in self.records[0].inputs if name.place == BASE]
        longer = max((cause.known_within for cause in self.added if cause.where in base), default=0.0)
        channels = (channel for channel in self.records[0].channels if channel.is_motion)
        order = max((channel.order for channel in channels), default=0)
        powers = np.array([_powers(parameter.unit) for parameter in self.answer.parameters])
        of_clock = PPM * apart * (powers[:, 1] + order * powers[:, 0])
        return np.where(self.answer.free, (of_clock, longer * powers[:, 0]), 0.0) * self.answer.values

    @property
    def misfit(self) -> float:
        """What the answer leaves, in -2 log likelihood."""
        return (self.answer.chi_square_per_sample or 0.0) * self.answer.samples


def _powers(unit: str) -> tuple[float, float]:
    """The powers of the length and of the time in the unit of a coefficient."""
    try:
        _, length, time, _ = base_exponents(unit)
    except LinkwiseError:  # of a law that does not determine it
        return _OF_STIFFNESS
    return float(length), float(time)


def explained_answer(
    stated: Estimate,
    answered: Answered,
    structure: Structure,
    options: LikelihoodOptions,
    records: Sequence[Record],
    seconds: float,
) -> Estimate:
    """The answer as `stated`, that beside errors of inputs and sensors, or the former with one of other laws beside it.

    The latter two where they leave nothing but noise. `answered` gives the answer to a structure by some options from records;
    the one as stated took `seconds` of processor time.
    """
    end = process_time() + max(_SECONDS, _TIMES * seconds)
    limited = replace(options, progress=until(end, options.progress, ENDED_EARLY))
    first = _Model(answered, structure, limited, records, stated)
    if first.is_explained:
        beside = _by_hits(first)
        return stated if beside is None else beside.reported
    settled = stated.fit_verdicts[0] is not Verdict.NOT_CONVERGED
    for rung in LADDER:
        found = rung(first) if settled or rung in (_by_alerts, _by_copies, _by_channel) else None
        if process_time() > end:  # what was not tried would count as what explains nothing
            return replace(stated, remarks=(*stated.remarks, ENDED_EARLY))
        if found is not None and found.is_explained:
            answer = found.reported
            if _are_as_stated(answer, records[0]):
                return answer
            if not any(cause.rivals and not cause.known_within for cause in answer.added):
                return replace(stated, alternative=answer)
        nearly = rung is _with_errors and found is not None and found.is_nearly_explained
        if found is not None and nearly and stated.grade is Grade.REFUSED:
            return found.reported
    return stated


def _are_as_stated(answer: Estimate, record: Record) -> bool:
    """Whether what was added to laws and sensors is what leaves an answer one to them as stated."""
    base = accelerating_base(record)
    return all(
        cause.is_instrument
        and cause.kind not in (*FREED, AMBIENT, GAIN_DRIFT, NONLINEARITY)
        and cause.remark != MAY_FADE
        and not (cause.kind == "gain" and cause.where in base and not cause.known_within)
        and (cause.kind != "force gain" or cause.remark.startswith(OF_HITS))
        for cause in answer.added
    )


def _by_alerts(model: _Model) -> _Model | None:
    """Clipped samples, spikes and hums that the records show by themselves, and errors of sensors and inputs beside them.

    Readings at an end of a range are bounds, spikes are missing, and hums of sensors unknown.
    """
    alerts = [alert for alert in model.answer.alerts if alert.channel in model.records[0].responses]
    faults = sorted({alert.kind for alert in alerts} & {CLIPPED, SPIKES})
    refused = model.records[0].responses if model.options.random else ()
    stated = (*refused, *(hum.channel for hum in of_kind(model.options.errors, Hum)))
    lines = {a.channel: a.frequencies for a in alerts if a.kind == HUM and a.channel not in stated}
    records = [mark_missing(record, faults) for record in model.records] if faults else model.records
    marked = {
        (alert.kind, alert.channel): sum(marked_samples(record).get(alert.channel, 0) for record in records)
        for alert in alerts
        if alert.kind in faults
    }
    causes = [Cause(*what, float(count), "1", 0.0, 0.0) for what, count in marked.items() if count]
    hums = [Hum(name, hz) for name, several in lines.items() for hz in several]
    causes += [Cause(HUM, hum.channel, hum.frequency, "Hz", 0.0, 0.0) for hum in hums]
    if not causes:
        return None
    options = replace(model.options, errors=(*model.options.errors, *hums))
    beside = model.beside(*causes, options=options, records=records)
    return None if beside is None else _with_errors(beside)


def _by_copies(first: _Model) -> _Model | None:
    """The parts of the records before and behind samples that were written twice, and errors of sensors beside that."""
    twice = copied_samples(first.records)
    parts = [part for record in first.records for part in without_copies(record)[0]] if twice else []
    beside = first.beside(*twice, records=parts) if parts else None
    return None if beside is None else _with_errors(beside)


def _by_channel(first: _Model) -> _Model | None:
    """Another sign, unit, place or reference of a channel, or a high pass, and errors of sensors and inputs beside it."""
    named = [alert.channel for alert in first.answer.alerts if alert.kind == "unit"]
    for error in likeliest_errors(first.records, first.structure, named):
        beside = _beside_channel(first, error)
        last = None if beside is None else _with_errors(beside)
        if last is None or not last.is_explained:
            continue
        swapped = any(cause.kind == "swapped" for cause in last.added)
        # a term may stand for masses that are alike
        return None if swapped and explained(first, _beside_cause, 1).is_explained else last
    return None


def _by_slip(first: _Model) -> _Model | None:
    """Samples that one channel lost or doubled, or the clock that looks like them where that leaves less."""
    if len(first.records) > 1 or not first.answer.diagnosis:
        return None
    names = (parameter.name for parameter in first.answer.parameters)
    values = dict(zip(names, first.answer.values.tolist(), strict=True))
    found = (
        first.beside(cause, records=[record])
        for cause, record in slips(first.records[0], first.structure, values)
    )
    without = (model for model in found if model is not None and model.is_explained)
    slipped = min(without, key=lambda model: model.misfit, default=None)
    if slipped is None or not any(cause.kind == CLOCK for cause in first.answer.diagnosis[:1]):
        return slipped
    rival = _with_errors(first, most=1)
    return rival if rival.is_explained and rival.misfit < slipped.misfit else slipped


def _by_event(first: _Model) -> _Model | None:
    """The parts of a record before and behind an event as two records, and errors of sensors beside that.

    Where the error of a sensor that is named behind it leaves noise alone, that: the fastest motion shows most of it.
    """
    event = next((cause for cause in first.answer.diagnosis[:1] if cause.kind == EVENT), None)
    if event is None or len(first.records) > 1:
        return None
    errors = (error for error in first.answer.diagnosis[1:2] if is_admissible(error))
    alone = (first.with_error(error) for error in errors if not error.kind.endswith("gain"))
    if by_error := next((model for model in alone if model and model.is_explained), None):
        return by_error
    [record] = first.records
    before, behind = event.size - event.standard_error, event.size + event.standard_error
    if before < record.start or behind > record.start + record.duration:
        return None
    parts = [record.between(record.start, before), record.between(behind, np.inf)]
    off = format_percent(abs(event.share))
    remark = "the parts before and behind it are taken as two records"
    remark += f", and intervals allow for gains that are off by {off} behind it" if event.share else ""
    model = first.beside(replace(event, remark=remark), records=parts)
    last = None if model is None else _with_errors(model)
    if last is None or not (event.share and last.is_explained):
        return last
    scale = np.where([name.is_input for name in record.channels], 1.0, 1.0 + event.share)
    scaled = last.beside(records=[parts[0], replace(parts[1], values=parts[1].values / scale)])
    if scaled is None or scaled.misfit > last.misfit + AS_LIKELY:
        return last
    change = scaled.answer.values - last.answer.values
    wider = last.answer.covariance + np.outer(change, change)
    return replace(last, answer=replace(last.answer, covariance=wider))


def _by_hits(first: _Model) -> _Model | None:
    """The gains of forces whose hits have too few samples to tell their impulse, or the records between these hits, and errors
    of sensors beside either; None without such hits, where a scale is off by more than these leave open, or more is left.

    Beside an answer that is explained only those of so few samples count that they move coefficients before residuals show it.
    """
    shortest: dict[str, int] = {}
    fewer = UNDERSAMPLED if first.is_explained else COARSE
    for record in first.records:
        shortest |= {name: min(n, shortest.get(name, n)) for name, n in coarse_hits(record, fewer).items()}
    scales = [abs(cause.size) for cause in first.answer.diagnosis if cause.kind in _SCALES]
    open_ = not any(isinstance(one, Gain | Delay) and one.channel in shortest for one in first.options.errors)
    coarsest = max(map(coarseness, shortest.values()), default=0.0)
    if not (shortest and open_) or max(scales, default=0.0) > _BY_HITS * coarsest:
        return None
    scaling = (Gain(name, coarseness(samples)) for name, samples in shortest.items())
    options = replace(first.options, errors=(*first.options.errors, *scaling))
    gains = (
        Cause("force gain", name, 0.0, "1", 0.0, 0.0, remark=f"{OF_HITS} {samples} samples")
        for name, samples in shortest.items()
    )
    scaled = first.beside(*gains, options=options)
    if scaled is not None and scaled.is_explained:
        return scaled
    # noise of the force would explain the shape of a pulse next, and coefficients be off
    pieces = [piece for record in first.records for piece in without_hits(record, shortest)]
    hits = (Cause(HITS, name, float(samples), "1", 0.0, 0.0) for name, samples in shortest.items())
    between = first.beside(*hits, records=pieces) if pieces else None
    tried = (_with_errors(model) for model in (between, scaled) if model is not None)
    return next((model for model in tried if model.is_explained), None)


def _by_high_pass(first: _Model) -> _Model | None:
    """A high pass that the diagnosis names behind what resembles it to the first order, and that alone leaves noise.

    None where a term or another error explains as much.
    """
    diagnosis = first.answer.diagnosis
    for cause in [cause for cause in diagnosis[1:] if cause.kind == HIGH_PASS][:_TRIED]:
        passed = first.with_error(cause)
        if passed is not None and passed.is_explained:
            rivals = (explained(first, _beside_cause, 1), _with_errors(first, most=1))
            alike = (one.is_explained and one.misfit < passed.misfit + AS_LIKELY for one in rivals)
            return None if any(alike) else passed
    return None


def _by_base(first: _Model) -> _Model | None:
    """A scale of an accelerating base, and a delay beside it, where the diagnosis names either; the sensors count as right.

    None beside delays, each fit of which takes a search.
    """
    options, record, diagnosis = first.options, first.records[0], first.answer.diagnosis
    base = [str(name) for name in accelerating_base(record)]
    named = {cause.kind: cause for cause in reversed(diagnosis) if cause.where in base}
    freed: list[Cause] = []
    is_named = {"gain", "delay"} & {*named} and not late_beside_clocks(options.errors)
    for kind in ("gain", "delay") if is_named else ():
        cause = named.get(kind, Cause(kind, base[0], 0.0, CAUSE_KINDS[kind].unit, 0.0, 0.0))
        freed.append(replace(cause, rivals=()))  # which are errors of sensors
        wider = with_error(options, freed[-1], record)
        if wider is None:
            return None
        options = wider
        model = first.beside(*freed, options=options)
        if model is not None and model.is_explained:
            return model
    return None


def _with_errors(first: _Model, most: int = _ERRORS) -> _Model:
    """Noise of inputs, and errors of sensors and inputs that the diagnosis names first, one after another.

    The last of these alone, where it leaves as little: those before it stood for it.
    """
    last = explained(first, partial(_beside_error, first), most)
    errors = [cause for cause in last.added[len(first.added) :] if is_admissible(cause)]
    if len(errors) < 2 or not last.is_explained or any(cause.known_within for cause in errors):
        return last
    beside = [cause for cause in last.added[len(first.added) :] if cause.kind == "input noise"]
    given = replace(first.options, random=last.options.random, harmonics=last.options.harmonics)
    options = with_error(given, errors[-1], first.records[0])
    alone = None if options is None else first.beside(*beside, errors[-1], options=options)
    as_likely = alone is not None and alone.is_explained and alone.misfit < last.misfit + AS_LIKELY
    return alone if alone is not None and as_likely else last


def _by_causes(first: _Model) -> _Model | None:
    """Terms and links that laws lack, masses and scales of which one is off: a second answer."""
    return explained(first.quick, _beside_cause, _TERMS)


def _by_saturation(first: _Model) -> _Model | None:
    """A force that saturates, as friction does, in the link of the term that comes first, from where it starts to as well.

    A second answer, where no sum of terms leaves noise.
    """
    modes = first.structure.modes
    causes = (cause for cause in first.answer.diagnosis if cause.kind == "term" and cause.where not in modes)
    cause = next(causes, None)
    if cause is None or first.structure.hosts or first.answer.diagnosis[0].is_instrument:
        return None
    for begins in _SATURATES:
        saturated = with_saturation(first.structure, cause, first.answer, begins)
        if saturated is None:
            return None
        structure, form = saturated
        beside = first.quick.beside(replace(cause, term=form, share=0.0), structure=structure)
        if beside is not None and beside.is_explained:
            return beside
    return None


def _by_ambient(first: _Model) -> _Model | None:
    """White forces on masses that nobody recorded, where laws leave more than noise that nothing else explains: a second
    answer, as a law of another form may leave the like.
    """
    answer, options = first.answer, first.options
    unnamed = answer.fit_verdicts[0] is Verdict.MODEL_ERROR_NEEDED and not answer.diagnosis
    beside = options.errors or options.random or options.harmonics or first.structure.hosts
    if not unnamed or beside or first.structure.size > _FEW or not isinstance(options.loss, Gaussian):
        return None
    random = random_forces((ALL,), (), first.records[0], first.structure)
    forced = first.beside(options=replace(options, random=random))
    if forced is None:
        return None
    added = (
        Cause(AMBIENT, force.where, force.spectral_density, f"{force.unit}/sqrt(Hz)", 0.0, 0.0)
        for force in forced.answer.random_forces
        if force.deviation > 0.0
    )
    return replace(forced, added=(*forced.added, *added))


LADDER: tuple[Callable[[_Model], _Model | None], ...] = (
    _by_copies,
    _by_alerts,
    _by_channel,
    _by_slip,
    _by_event,
    _by_hits,
    _by_high_pass,
    _with_errors,
    _by_causes,
    _by_base,
    _by_saturation,
    _by_ambient,
)
"""What is tried in turn where laws as stated leave more than noise; of a search that does not converge two."""


def beside_exchange(
    answered: Answered,
    structure: Structure,
    options: LikelihoodOptions,
    records: Sequence[Record],
    refusal: IdentificationError,
) -> Estimate:
    """The answer to records with another sign, unit or place of a channel, of which there is none to those as they stand.

    Parameters
    ----------
    answered : callable
        Gives the answer to a structure by some options from records.
    structure, options, records
        As of `explained_answer`.
    refusal : IdentificationError
        Why there is no answer to the records as they stand.

    Returns
    -------
    Estimate
        The answer, with the error among what was added.

    Raises
    ------
    IdentificationError
        The `refusal`, where no such error explains by far most; with the error named where more than noise is left without it,
        and with all that the equations of motion cannot tell apart.
    """
    error = next(iter(likeliest_errors(records, structure)), None)
    if error is None or error.kind not in EXCHANGES:
        alike = " or ".join(one.description for one in exchanges(records, structure))
        left = (
            f"without {alike} the equations of motion leave far less of the record: correct the record first"
        )
        raise IdentificationError(f"{refusal}; {left}") if alike else refusal
    exchanged = [corrected(record, error) for record in records]
    try:
        answer = answered(structure, options, exchanged)
        last = _with_errors(_Model(answered, structure, options, exchanged, answer, (error,)))
    except IdentificationError:
        last = None
    if last is None or not last.is_explained:
        raise IdentificationError(
            f"{refusal}; without {error.description} the equations of motion leave far less of the record, and more is off "
            "beside it: correct the record first"
        ) from refusal
    return last.reported


def _beside_channel(model: _Model, error: Cause) -> _Model | None:
    """The model from records with another sign, unit or place of a channel, or with a high pass that is all that is off."""
    if error.kind in EXCHANGES:
        return model.beside(error, records=[corrected(record, error) for record in model.records])
    passed = model.with_error(error)
    return passed if passed is not None and (passed.is_explained or passed.is_nearly_explained) else None


def _beside_error(first: _Model, model: _Model) -> _Model | None:
    """The model with noise of inputs, or with the error of a sensor or an input that its diagnosis names first.

    Where noise would hide that error it comes second, as where no fit settles the error, which noise of a hit resembles.
    """
    if model.is_explained:
        return None
    named = model.answer.diagnosis[:1]
    rungs = [_noise(model.options, model.records, first.answer), _first_error(model)]
    if any(cause.kind.endswith(_HIDDEN) for cause in named):
        rungs.reverse()
    fits = (model.beside(*rung[1], options=rung[0]) for rung in rungs if rung is not None)
    return next((fit for fit in fits if fit is not None), None)


def _beside_scale(model: _Model) -> _Model | None:
    """The model with all masses, and gains of the forces, known to within what one of them is off by; None where more is left.

    Laws with unknown coefficients determine ratios of masses and forces, and not which of them is off; nor, where a gain of a
    sensor comes first, whether it is the sensor, or the motion of a base.
    """
    first, structure, record = next(iter(model.answer.diagnosis), None), model.structure, model.records[0]
    if model.added or first is None or first.kind not in _SCALES or abs(first.size) > _CALIBRATED:
        return None
    most = abs(first.size)
    named = {(cause.kind, cause.where): cause for cause in reversed(model.answer.diagnosis)}
    known = {mass.name: mass.mass.value for mass in structure.masses if mass.mass.known and mass.mass.value}
    forces = [name for name in record.inputs if name.kind == "force"]
    sensors = list(record.responses) if forces or first.kind == "gain" else []
    masses = [
        replace(mass, mass=Coefficient.unknown(start=value, sigma=most * abs(value)))
        if (value := known.get(mass.name)) is not None
        else mass
        for mass in structure.masses
    ]
    errors = known_to_within(model.options.errors, dict.fromkeys((*forces, *sensors), most))
    if errors is None:
        return None
    open_ = [("mass", name) for name in known] + [("force gain", name) for name in forces]
    open_ += [("gain", name) for name in sensors]
    open_ += [("gain", name) for name in record.inputs if sensors and name.place == BASE]
    added = tuple(
        replace(named.get(key, replace(first, kind=key[0], where=key[1], size=0.0)), known_within=most)
        for key in open_
    )
    options = replace(model.options, errors=errors)
    scaled = model.beside(*added, structure=replace(structure, masses=tuple(masses)), options=options)
    return scaled if scaled is not None and scaled.is_explained else None


def _beside_cause(model: _Model) -> _Model | None:
    """The model with the first of the terms and links that the diagnosis of its answer names, or next to it any other cause.

    Of those that are as likely, and an error that a term hardly exceeds, the one that explains most; None where another one
    explains as much. That the records contradict stated values alone is said of the answer.
    """
    if (scaled := _beside_scale(model)) is not None:
        return scaled
    causes = () if model.is_explained else model.answer.diagnosis
    named = [c for c in causes if _can_be_added(c) and (model.added or not c.is_instrument)]
    least = max(_ALIKE * causes[0].gain, -likeliest_first(named[0]) - AS_LIKELY) if named else 0.0
    tried = [cause for cause in named if -likeliest_first(cause) > least][:_TRIED]
    if tried and not model.added:
        errors = (cause for cause in causes if is_admissible(cause) and _can_be_added(cause))
        near = min(_NEARLY * causes[0].gain, causes[0].gain - AS_LIKELY)
        tried += [cause for cause in errors if cause.gain > near][:1]
    fits = (_with(cause, model) for cause in tried)
    likeliest = sorted(
        (richer for richer in fits if richer is not None),
        key=lambda richer: (not richer.is_explained, richer.misfit),
    )
    rivals = [rival for rival in likeliest[1:] if rival.is_explained]
    if rivals and rivals[0].misfit < likeliest[0].misfit + AS_LIKELY:
        return None
    if not likeliest:
        return None
    best, alone = likeliest[0], {richer.added[-1].name for richer in likeliest}
    *before, last = best.added
    untried = tuple(rival for rival in last.rivals if rival not in alone)
    return replace(best, added=(*before, replace(last, rivals=untried)))


def _can_be_added(cause: Cause) -> bool:
    """Whether laws can have it: a term or a link, a stated value that becomes unknown, or an error of a sensor.

    A delay, which takes many fits to find, is none.
    """
    if not cause.is_instrument:
        return cause.term not in MEMORY_TERMS
    return cause.kind in FREED or (is_admissible(cause) and not cause.kind.endswith(("delay", CLOCK)))


def _with(cause: Cause, model: _Model) -> _Model | None:
    if is_admissible(cause):
        return model.with_error(cause)
    return model.beside(cause, structure=with_cause(model.structure, cause))


_Rung = tuple[LikelihoodOptions, tuple[Cause, ...]]


def _noise(options: LikelihoodOptions, records: Sequence[Record], stated: Estimate) -> _Rung | None:
    """Noise of the inputs at the level of their channels; None beside what excludes it, or where there is none."""
    robust = not isinstance(options.loss, Gaussian)
    drifting = [one for one in options.errors if isinstance(one, Disturbance)]
    beside = (*late_beside_clocks(options.errors), *drifting, *options.random)
    of_links = any(channel.of_link for channel in records[0].channels)
    structure = stated.given_structure
    levels = noise_of_channels(records, structure)
    levels = {name: level for name, level in levels.items() if not name.startswith("signal:")}
    if not levels or robust or beside or of_links or structure.hosts:
        return None
    try:
        random = random_forces((), levels, records[0], structure)
    except IdentificationError:
        return None
    gains = {cause.where: cause.gain for cause in reversed(stated.diagnosis) if cause.kind == "input noise"}
    causes = (
        Cause("input noise", name, level, unit_in(structure, name), gains.get(name, 0.0), 0.0)
        for name, level in levels.items()
    )
    return replace(options, random=random), tuple(causes)


def _first_error(model: _Model) -> _Rung | None:
    """The error of a sensor or a force that the diagnosis names first; None where that is something else, or has rivals."""
    options, records, current = model.options, model.records, model.answer
    line = current.diagnosis[0] if current.diagnosis else None
    if line is not None and line.kind == HUM:
        return replace(options, errors=(*options.errors, Hum(line.where, line.size))), (line,)
    if line is not None and line.kind == HARMONIC:
        more = harmonic_forces({line.where: (line.size,)}, records[0], current.given_structure)
        known = tuple(replace(force, amplitudes=()) for force in options.harmonics)
        return replace(options, harmonics=(*known, *more)), (line,)
    is_open = any(cause.known_within for cause in model.added)
    gains = () if is_open else _shared_gain(current.diagnosis, records[0])
    most = abs(line.size) if line is not None else 0.0
    sigmas = dict.fromkeys([gain.where for gain in gains], most)
    calibrated = known_to_within(options.errors, sigmas) if gains else None
    if calibrated is not None:
        return replace(options, errors=calibrated), tuple(replace(gain, known_within=most) for gain in gains)
    first = distinct_error(current.diagnosis)
    if first is None or first is not line or first.kind.endswith("gain"):
        return None  # a scale is that of a sensor, a force or a mass: none of them is told from the others
    if options.random and first.kind.endswith("delay"):
        return None  # delays are not estimated then
    if first.kind == CLOCK:  # that of an input counts as right
        alike = [
            cause
            for cause in current.diagnosis
            if cause.kind == CLOCK and cause.gain > first.gain - AS_LIKELY
        ]
        of_sensors = [cause for cause in alike if cause.where not in records[0].inputs] or alike
        rivals = dict.fromkeys(cause.where for cause in (*of_sensors, *alike))
        if len(records[0].channels) == 2:  # of which none outvotes the other
            rivals |= dict.fromkeys(map(str, records[0].channels))
        named = " or ".join(name for name in rivals if name != of_sensors[0].where)
        first = replace(
            of_sensors[0],
            remark=f"or that of {named} the other way, for which intervals allow" if named else "",
        )
    wider = with_error(options, first, records[0])
    return None if wider is None else (wider, (first,))


def _shared_gain(diagnosis: Sequence[Cause], record: Record) -> tuple[Cause, ...]:
    """The gains of all sensors where that of one comes first: one that is off leaves the others no better known; none where a
    mass or an input may be off, of which a single sensor beside a force is not told.
    """
    first = next(iter(diagnosis), None)
    if first is None or first.kind != "gain" or abs(first.size) > _CALIBRATED:
        return ()
    if any(cause.kind == GAIN_DRIFT and cause.gain > first.gain - AS_LIKELY for cause in diagnosis):
        return ()
    if first.where not in record.responses or (len(record.responses) == 1 and record.inputs):
        return ()
    others = (
        cause for cause in diagnosis if cause.kind in ("mass", "force gain") or cause.where in record.inputs
    )
    if any(cause.gain > _ALIKE * first.gain for cause in others if cause.kind.endswith(("mass", "gain"))):
        return ()
    named = {cause.where: cause for cause in reversed(diagnosis) if cause.kind == "gain"}
    return tuple(named.get(name, replace(first, where=name, size=0.0)) for name in record.responses)
