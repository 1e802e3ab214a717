"""Harmonic forces that were not recorded, as of a rotating machine, and hums of sensors: lines in what a fit leaves.

A force of unknown amplitudes and frequency on a mass is taken as a channel of the records, so that starts, searches and
checks need no case of their own. Between fits its unknowns follow from one linearisation, and what is not known of them is
added to the covariance of the others: both hold to first order at the common optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import uniform_filter1d

from linkwise.arrays import Floats, Indices
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import HARMONIC, HUM, Cause, SensorErrorEstimate
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.random_forces import HarmonicForce
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.minimise import AnnealingSchedule
from linkwise.likelihood.shooting.segments import Segments, SensorErrors
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.likelihood.terms import Hum, of_kind
from linkwise.likelihood.tests.columns import Added, TestedColumns
from linkwise.likelihood.tests.diagnosis import TestedCauses, in_longer_segments
from linkwise.likelihood.tests.score_test import Hypothesis, Quadratic, augmented_quadratic
from linkwise.likelihood.tests.variances import at_once
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread

_FITS = 8  # that refine a force, at most
_SETTLED = 0.1  # standard errors, by which a step changes its unknowns
_STEP = 0.25  # of a line's width, one over the duration, between frequencies that are tried
# frequencies on each side of a line of the motion, and the part of its width between them: on all masses, then on one
_NEARBY = ((4, 0.5), (8, 0.06))
_LONGEST = 40_000  # segments times masses of a fit, beyond which these take longer than some seconds
_AROUND = 8  # such steps on each side of a frequency that is stated
_GOES_ON = 0.5  # of the power of the third quarter of a record, which a line has in the fourth: that of a decay has less
_DRIVEN = 1.0  # of a line's width, within which a line of the motion is one of an input
_LINES, _OF_MOTION = 4, 2  # in what a fit leaves that are tested, and in the motion itself
_NEIGHBOURS = 61  # steps over which the level around a line is found
# times that level from which a line is tested: noise behind a resonance that is narrow hardly reaches it
_ABOVE = 20.0
MAY_FADE = "or a mode that the laws lack: the record does not show that it goes on; state it if it is known, or add a mass"
"""The remark on a line that may fade as fast as the lightest damped mode of a structure does."""
# damping ratio: welded and cast structures have 0.0005 and more, and what is held in a joint 0.002
_LIGHTEST = 3e-4
_SCREENED = 3.0  # times the mean there, below which no median is asked for: one in twenty of noise
# with twice the logarithm of all frequencies and masses: one record in 3000 gains as much by chance
_CHANCE = 16.0
_FINE = 17  # frequencies around a line at which a hum is looked for
_ALONE = 0.9  # of what hums of all sensors explain: a missing term leaves lines in several
_HIGHEST = 0.4  # of the sampling rate
_PERIODS = 10.0  # in a record, of a line at least: fewer are a drift


def harmonic_forces(
    harmonics: Mapping[str, Sequence[float]], record: Record, structure: Structure
) -> tuple[HarmonicForce, ...]:
    """The forces that a user asks for, by mass with frequencies in Hz.

    Raises IdentificationError for a mass that is none, and a frequency that the record does not show.
    """
    forces = []
    for mass, several in harmonics.items():
        for frequency in several:
            if mass not in structure.mass_names or mass in structure.modes:
                raise IdentificationError(
                    f"no harmonic force on {mass} can be estimated{near_miss(mass, structure.mass_names)}: the masses are "
                    f"{', '.join(structure.mass_names) or 'none'}",
                    arguments=("harmonics",),
                )
            if not 2.0 / record.duration <= frequency <= _HIGHEST * record.rate:
                raise IdentificationError(
                    f"the harmonic force on {mass} must have a frequency from {2.0 / record.duration:.3g} Hz, of which the "
                    f"record has two periods, to {_HIGHEST * record.rate:g} Hz, got {frequency:g} Hz",
                    arguments=("harmonics",),
                )
            forces.append(HarmonicForce.on(mass, frequency, structure))
    return tuple(forces)


def with_harmonics(
    search: Callable[[Sequence[Record], LikelihoodOptions], LikelihoodFit],
    records: Sequence[Record],
    options: LikelihoodOptions,
) -> tuple[list[Record], LikelihoodOptions]:
    """The records with channels of the harmonic forces of `options` as they were found, and the options with these.

    `likelihood` gives the fit at the end of a search. Raises IdentificationError where the forces do not settle.
    """
    forces = options.harmonics
    for _ in range(_FITS if forces else 0):
        options = replace(options, harmonics=forces)
        shown = [_driven(record, forces, number) for number, record in enumerate(records)]
        fit = search(shown, options)
        starting = not forces[0].amplitudes
        if starting:
            forces = tuple(_at_line(fit, records, force) for force in forces)
        step, found = _Unknowns.of(fit, fit.optimum, records, forces).refined()
        if not starting and np.all(np.abs(step) < _SETTLED):
            return shown, options
        forces = found
    if forces:
        names = ", ".join(f"{force.frequency:.4g} Hz on {force.mass}" for force in forces)
        raise IdentificationError(
            f"the harmonic force of {names} does not settle in {_FITS} fits: state a closer frequency, or fewer forces",
            arguments=("harmonics",),
        )
    return list(records), options


def estimated_harmonics(
    fit: LikelihoodFit, records: Sequence[Record]
) -> tuple[Floats | float, tuple[SensorErrorEstimate, ...], tuple[str, ...]]:
    """What harmonic forces add to the covariance of a fit, their frequencies, and sentences on their amplitudes."""
    forces = fit.options.harmonics
    if not forces or not forces[0].amplitudes or not fit.has_errors:
        return 0.0, (), ()
    unknowns = _Unknowns.of(fit, fit.optimum, records, forces)
    errors, sentences = [], []
    for force, deviations in zip(forces, unknowns.deviations, strict=True):
        sizes = np.hypot(*np.array(force.amplitudes).T)
        of_size = float(np.sqrt(np.mean(deviations[:-1] ** 2)))
        errors.append(SensorErrorEstimate(force.mass, HARMONIC, force.frequency, float(deviations[-1]), "Hz"))
        sentences.append(
            f"The harmonic force on {force.mass} at {force.frequency:.5g} Hz has an amplitude of "
            f"{', '.join(f'{size:.4g}' for size in sizes)} {force.unit} (estimated with the other unknowns, standard error "
            f"{of_size:.2g} {force.unit})."
        )
    return unknowns.covariance, tuple(errors), tuple(sentences)


def not_shown_to_go_on(fit: LikelihoodFit, records: Sequence[Record]) -> tuple[float, ...]:
    """Frequencies in Hz of the harmonic forces and hums of a fit that may fade, or grow, as fast as a mode of a structure.

    A mode that the laws lack acts on them as a harmonic force does, and shows in a sensor as a hum does: over a record that
    does not tell its decay it is neither of them. A rate of decay is tested beside all that is estimated.
    """
    forces, segments = fit.options.harmonics, fit.segments
    hums = [(one.term, one) for one in fit.found if isinstance(one.term, Hum)]
    lines = np.array([force.frequency for force in forces] + [hum.frequency for hum, _ in hums])
    if not len(lines) or not fit.has_errors or not tells_time(segments, records):
        return ()
    time, owner = _times(segments, records)
    fading = []
    for hum, one in hums:
        number, (a, b) = one.unknown.record or 0, one.sizes
        cosine, sine = _waves(hum.frequency, time, owner, len(records))[2 * number : 2 * number + 2]
        fading.append((0.5 * records[number].duration - time) * (a * cosine + b * sine))
    channels = np.array([records[0].responses.index(hum.channel) for hum, _ in hums])
    shown = SensorErrors(channels, fading) if hums else None
    rates, errors = _Unknowns.of(fit, fit.optimum, records, forces, shown, fading=True).rates
    may_fade = np.abs(rates) + 2.0 * errors > _LIGHTEST * 2.0 * np.pi * lines
    return tuple(dict.fromkeys(lines[may_fade].tolist()))


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines in what a `fit` to `records` leaves, of as many frequencies as `looked_at`, and what may be one of them: `forces`
    on masses, and behind these `hums`, a frequency in Hz in a channel each.
    """

    fit: LikelihoodFit
    records: Sequence[Record]
    lines: Sequence[_Line]
    looked_at: int
    forces: Sequence[HarmonicForce]
    hums: Sequence[tuple[float, int]]

    @classmethod
    def of(cls, fit: LikelihoodFit, structure: Structure, records: Sequence[Record]) -> Lines | None:
        """Those that no force or hum of the fit is; None without any, and beside hosts.

        A line is compared with the level of its neighbours (Fisher, Proc. R. Soc. A 125, 1929). That of a sensor is in its
        channel alone. Laws with a model error take up a force near a resonance, and what they leave has no line at it: there
        the motion is looked at as well, but at no line of an input: laws that answer it wrongly leave a force there.
        """
        if structure.hosts or not (fit.has_errors and tells_time(fit.segments, records)):
            return None
        found, looked_at = _lines(fit, records)
        known = [force.frequency for force in fit.options.harmonics]
        known += [hum.frequency for hum in of_kind(fit.options.errors, Hum)]
        width = 1.0 / records[0].duration
        loose = fit.model_error > 0.0 and not fit.random_forces
        is_short = fit.segments.count * structure.size <= _LONGEST
        going_on = _lines_of_motion(records) if loose and is_short else []
        refined = (_refined(fit, structure, records, line) for line in going_on)
        driven = _lines_of_inputs(records) if going_on else np.empty(0)
        found += [line for line in refined if not np.any(np.abs(driven - line.frequency) < _DRIVEN * width)]
        lines = [line for line in found if all(abs(line.frequency - one) > width for one in known)]
        exact, names, responses = _is_exact(fit), structure.mass_names, records[0].responses
        forces, hums = list[HarmonicForce](), list[tuple[float, int]]()
        for line in lines:
            channels = line.channels if exact else range(len(responses))
            places = [responses[channel].place for channel in line.channels]
            shown = [names[mass] for mass in line.masses] or [name for name in names if name in places]
            masses = shown if exact and shown else names
            forces += [HarmonicForce.on(name, line.frequency, structure) for name in masses]
            hums += [(line.frequency, channel) for channel in channels]
        return cls(fit, records, lines, looked_at, forces, hums) if lines else None

    def columns(self, optimum: Optimum) -> Iterator[Added]:
        """A cosine and a sine in each record of each force and each hum, of size one; none where the segments of an optimum do
        not tell their time.
        """
        if not tells_time(optimum.segments, self.records):
            return
        for force in self.forces:
            for wave in _columns(optimum, self.records, [force]).along:
                yield Added(Hypothesis(HARMONIC, ""), [(-1, force.number, wave)], unit=1.0)
        time, owner = _times(optimum.segments, self.records)
        for frequency, channel in self.hums:
            for wave in _waves(frequency, time, owner, len(self.records)):
                yield Added(Hypothesis(HUM, ""), samples=[(channel, wave)])

    def causes(self, tested: TestedCauses | None) -> Iterator[Cause]:
        """What would explain each line by its score: the harmonic force on the mass on which it explains most, or a hum.

        By the `columns` that were `tested` beside causes, if they were.
        """
        records, fit = self.records, self.fit
        limit = _CHANCE + 2.0 * np.log(self.looked_at * len(fit.segments.system.incidence))
        beside = None if tested is None else tested.beside
        if beside is None:
            with one_blas_thread():
                beside = TestedColumns.of(self.columns(fit.optimum)).quadratic(fit.optimum)
        information, score, _ = _eliminated(fit, beside)
        gains, sizes = _each_alone(information, score, 2 * len(records))
        width = 1.0 / max(record.duration for record in records)
        likeliest = []
        for line in self.lines:
            of_forces = [k for k, force in enumerate(self.forces) if force.frequency == line.frequency]
            of_hums = [len(self.forces) + k for k, hum in enumerate(self.hums) if hum[0] == line.frequency]
            likeliest.append((max(of_forces + of_hums, key=lambda k: gains[k]), line))
        told: list[float] = []
        for best, line in sorted(likeliest, key=lambda one: -gains[one[0]]):
            if gains[best] <= limit or any(abs(line.frequency - hz) < width for hz in told):
                continue
            if best >= len(self.forces) and not (line.masses or line.channels):
                continue  # what is left shows no line there, so that it is the motion, and no hum
            told.append(line.frequency)
            gain, error = float(gains[best]), float(width / np.sqrt(gains[best]))
            if best < len(self.forces):
                force = self.forces[best]
                source = f"{sizes[best]:.3g} {force.unit}"
                yield Cause(HARMONIC, force.mass, line.frequency, "Hz", gain, error, source=source)
                continue
            channel = self.hums[best - len(self.forces)][1]
            frequency, alone = _refined_hum(fit, records, line.frequency, channel)
            if alone:
                yield Cause(HUM, records[0].responses[channel], frequency, "Hz", gain, error)


def _is_exact(fit: LikelihoodFit) -> bool:
    """Whether motion is that of the laws: defects are the slopes by forces on the masses, and residuals keep the hum of a
    sensor, so that what shows a line most clearly tells where it is. Other laws, and random forces, follow either.
    """
    return fit.optimum.q <= AnnealingSchedule.final_q and not fit.random_forces


def _driven(record: Record, forces: Sequence[HarmonicForce], number: int) -> Record:
    """The record number `number` with what the forces add to channels of applied forces."""
    for force in forces if forces[0].amplitudes else ():
        name = Channel("force", force.mass)
        acting = force.acting(record.time - record.start - 0.5 * record.duration, number)
        if name in record.channels:
            values = record.values.copy()
            values[:, record.channels.index(name)] += acting
            record = replace(record, values=values)
        else:
            values = np.column_stack([record.values, acting])
            record = replace(record, channels=(*record.channels, name), values=values)
    return record


@dataclass(frozen=True)
class _Line:
    """A line at a `frequency` in Hz, and the number of the mass and of the channel that show it most clearly, if any do."""

    frequency: float
    masses: Sequence[int]
    channels: Sequence[int]


def _lines(fit: LikelihoodFit, records: Sequence[Record]) -> tuple[list[_Line], int]:
    """The highest lines in residuals, defects and random forces, and how many frequencies were looked at."""
    segments, misfit = fit.optimum.segments, fit.misfit
    samples, n = len(segments.samples), len(segments.system.incidence)
    series = [(misfit.residuals.transpose(1, 2, 0).reshape(misfit.residuals.shape[1], -1), samples)]
    series.append((np.pad(misfit.defects[n : 2 * n], ((0, 0), (0, 1))), 1))
    if segments.random is not None:
        series.append((fit.optimum.point.nodes[segments.random.rows], 1))
    found: list[Floats] = []
    ends = np.cumsum([0, *(-(-len(record) // samples) for record in records)])
    count = 0
    for number, record in enumerate(records):
        spacing = _STEP / record.duration
        count += round(_HIGHEST * record.rate / spacing)
        for kind, (rows, per_segment) in enumerate(series):
            own = rows[:, ends[number] * per_segment : ends[number + 1] * per_segment]
            rate = record.rate * per_segment / samples
            size = max(round(rate / spacing), own.shape[1])
            row, at, ratio = _above_level(_spectrum(own, size))
            frequency = at * rate / size
            # at whose multiples a drift shows as well, as motion begins anew in each segment
            nodes = record.rate / samples
            slow = np.abs(frequency - nodes * np.rint(frequency / nodes)) < _PERIODS / record.duration
            high = (ratio >= _ABOVE) & ~slow & (frequency <= _HIGHEST * min(rate, record.rate))
            row, frequency, ratio = row[high], frequency[high], ratio[high]
            found.append(np.stack([ratio, frequency, np.full(len(row), kind), row]))
    return list(_highest(np.concatenate(found, axis=1), records[0].duration)), count


def _lines_of_motion(records: Sequence[Record]) -> list[_Line]:
    """The strongest frequencies in the second halves of records, in which a decay has become small, where they are lines that
    go on to the ends: what answers an input with all frequencies is none.
    """
    found = []
    for record in records:
        shown = np.nan_to_num(record.select(record.responses).values[len(record) // 2 :].T)
        shown -= shown.mean(axis=1, keepdims=True)
        size, middle = round(record.duration * record.rate / _STEP), shown.shape[1] // 2
        parts = shown, shown[:, :middle], shown[:, middle:]
        power, before, after = (_spectrum(part, size) for part in parts)
        row, at, ratio = _above_level(power)
        is_line = np.zeros(power.shape, dtype=bool)
        is_line[row[ratio >= _ABOVE], at[ratio >= _ABOVE]] = True
        frequency = np.arange(power.shape[1]) * record.rate / size
        power[:, (frequency < _PERIODS / record.duration) | (frequency > _HIGHEST * record.rate)] = 0.0
        power[~is_line | (after < _GOES_ON * before)] = 0.0
        power /= np.maximum(power.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        row, at = np.nonzero(power)
        found.append(np.stack([power[row, at], frequency[at], np.full(len(row), -1), row]))
    return list(islice(_highest(np.concatenate(found, axis=1), records[0].duration), _OF_MOTION))


def _lines_of_inputs(records: Sequence[Record]) -> Floats:
    """Frequencies in Hz at which inputs have lines."""
    found = [np.empty(0)]
    for record in records if records[0].inputs else ():
        size = round(record.duration * record.rate / _STEP)
        _, at, ratio = _above_level(_spectrum(record.select(record.inputs).values.T, size))
        found.append(at[ratio >= _ABOVE] * record.rate / size)
    return np.concatenate(found)


def _spectrum(series: Floats, size: int) -> Floats:
    """(R, F) powers of series (R, N) behind a window, at the frequencies of `size` samples; those that are missing are 0."""
    return np.asarray(np.abs(np.fft.rfft(np.nan_to_num(series) * np.hanning(series.shape[1]), size)) ** 2)


@np.errstate(over="ignore", invalid="ignore")
def _refined(fit: LikelihoodFit, structure: Structure, records: Sequence[Record], line: _Line) -> _Line:
    """The line at the frequency near its own at which a force on some mass explains most, if the equations tell any."""
    masses, frequency, width = structure.mass_names, line.frequency, 1.0 / records[0].duration
    for steps, spacing in _NEARBY:
        near = frequency + spacing * width * np.arange(-steps, steps + 1)
        tried = [HarmonicForce.on(mass, float(hz), structure) for mass in masses for hz in near]
        try:
            best = _likeliest(fit, fit.optimum, records, tried)
        except np.linalg.LinAlgError:
            return line
        masses, frequency = (best.mass,), best.frequency
    return replace(line, frequency=frequency)


def _likeliest(
    fit: LikelihoodFit, optimum: Optimum, records: Sequence[Record], tried: Sequence[HarmonicForce]
) -> HarmonicForce:
    """The force that alone explains most of what a fit leaves."""
    parts = at_once(len(tried), 4 * optimum.segments.samples[:, 0].size * len(records))
    unknowns = (_Unknowns.of(fit, optimum, records, tried[part]) for part in parts)
    alone = (_each_alone(some.information, some.score, 2 * len(records)) for some in unknowns)
    return tried[int(np.argmax(np.concatenate([gains for gains, _ in alone])))]


def _highest(found: Floats, duration: float) -> Iterator[_Line]:
    """The highest of lines (4, N): ratio, frequency, kind and number of the series that shows each."""
    order = np.argsort(-found[0], kind="stable")
    ratio, frequency, kind, number = found[:, order]
    for _ in range(_LINES):
        if not ratio.any():
            return
        highest = int(np.argmax(ratio))
        line = float(frequency[highest])
        away = np.abs(frequency - line) * duration
        near = (away < 2.0) & (ratio > 0.0)
        channels, masses = (number[near & (kind == own)][:1].astype(int).tolist() for own in (0, 1))
        yield _Line(line, masses, channels)
        ratio[away < 4.0] = 0.0


def _above_level(power: Floats) -> tuple[Indices, Indices, Floats]:
    """Where powers (R, F) are far above their mean, and how far above the median of their neighbours."""
    rows, at = np.nonzero(power > _SCREENED * uniform_filter1d(power, _NEIGHBOURS, mode="nearest"))
    padded = np.pad(power, ((0, 0), (_NEIGHBOURS // 2, _NEIGHBOURS // 2)), mode="edge")
    around = sliding_window_view(padded, _NEIGHBOURS, axis=1)[rows, at]
    level = np.partition(around, _NEIGHBOURS // 2, axis=1)[:, _NEIGHBOURS // 2]
    return rows, at, power[rows, at] / np.maximum(level, np.finfo(float).tiny)


def tells_time(segments: Segments, records: Sequence[Record]) -> bool:
    """Whether the segments of each record follow each other without a break."""
    return segments.count == sum(-(-len(record) // len(segments.samples)) for record in records)


def _times(segments: Segments, records: Sequence[Record]) -> tuple[Floats, Indices]:
    """Times (M, K) in s of the samples of all segments since the starts of their records, and the numbers (K,) of these."""
    samples = len(segments.samples)
    counts = [-(-len(record) // samples) for record in records]
    times = [record.step * np.arange(n * samples) for n, record in zip(counts, records, strict=True)]
    return np.concatenate(times).reshape(-1, samples).T, np.repeat(np.arange(len(records)), counts)


def _waves(frequency: float, time: Floats, owner: Indices, records: int) -> list[Floats]:
    """A cosine and a sine of a frequency in Hz at times (..., K) in s in each record, of those that `owner` (K,) says."""
    phase = 2.0 * np.pi * frequency * time
    return [wave(phase) * (owner == number) for number in range(records) for wave in (np.cos, np.sin)]


def _refined_hum(
    fit: LikelihoodFit, records: Sequence[Record], line: float, channel: int
) -> tuple[float, bool]:
    """The frequency in Hz near a line at which a sensor shows most in what is left, and whether hardly another shows it."""
    residuals = fit.misfit.residuals
    series = residuals.transpose(1, 2, 0).reshape(residuals.shape[1], -1)
    time, _ = _times(fit.segments, records)
    near = line + _STEP / max(record.duration for record in records) * np.linspace(-1.0, 1.0, _FINE)
    turns = -2j * np.pi * time.T.ravel()
    powers = np.array([np.abs(series @ np.exp(frequency * turns)) ** 2 for frequency in near])
    most = int(np.argmax(powers[:, channel]))
    return float(near[most]), bool(powers[most, channel] > _ALONE * powers[most].sum())


def _at_line(fit: LikelihoodFit, records: Sequence[Record], force: HarmonicForce) -> HarmonicForce:
    """The force at the frequency near its own that explains most, with its amplitudes still zero."""
    spacing = _STEP / max(record.duration for record in records)
    frequencies = force.frequency + spacing * np.arange(-_AROUND, _AROUND + 1)
    tried = [replace(force, frequency=float(one)) for one in frequencies if one > 4.0 * spacing]
    longer = in_longer_segments(fit)
    optimum = longer if tells_time(longer.segments, records) else fit.optimum
    return replace(_likeliest(fit, optimum, records, tried), amplitudes=((0.0, 0.0),) * len(records))


def _eliminated(fit: LikelihoodFit, quadratic: Quadratic) -> tuple[Floats, Floats, Floats]:
    """The information (h, h) and score (h,) of what follows the p parameters of a fit, which follow it by (p, h)."""
    optimum, p, free = fit.optimum, len(fit.values), np.flatnonzero(fit.free)
    curvature, slope = quadratic.curvature / optimum.noise**2, quadratic.slope / optimum.noise**2
    follow = np.zeros((p, len(slope) - p))
    follow[free] = np.linalg.lstsq(curvature[np.ix_(free, free)], curvature[free, p:], rcond=1e-12)[0]
    information = curvature[p:, p:] - curvature[p:, :p] @ follow
    return information, slope[p:] - follow.T @ slope[:p], follow * optimum.scales.theta[:p, None]


def _each_alone(information: Floats, score: Floats, each: int) -> tuple[Floats, Floats]:
    """What each force or hum of so many unknowns alone would take off -2 log likelihood, and its amplitude."""
    gains, sizes = [], []
    for own in np.arange(len(score)).reshape(-1, each):
        size = np.linalg.lstsq(information[np.ix_(own, own)], score[own], rcond=1e-9)[0]
        gains.append(float(score[own] @ size))
        sizes.append(float(np.hypot(*size[:2])))
    return np.array(gains), np.array(sizes)


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """The information (h, h) and score (h,) of the unknowns of `forces`, parameters eliminated, and how these `follow` (p, h).

    Of `each` force there are so many: a cosine and a sine in each record, and the frequency of one with amplitudes. Behind
    them come hums of sensors.
    """

    forces: Sequence[HarmonicForce]
    each: int
    information: Floats
    score: Floats
    follow: Floats

    @classmethod
    def of(
        cls,
        fit: LikelihoodFit,
        optimum: Optimum,
        records: Sequence[Record],
        forces: Sequence[HarmonicForce],
        hums: SensorErrors | None = None,
        *,
        fading: bool = False,
    ) -> _Unknowns:
        """Those at the optimum of a fit, in segments of any length; with the rates of forces that are `fading`."""
        with one_blas_thread():
            columns = _columns(optimum, records, forces, fading=fading)
            eliminated = _eliminated(fit, augmented_quadratic(optimum, columns, hums))
        found = bool(forces and forces[0].amplitudes)
        return cls(forces, 2 * len(records) + found * (1 + fading), *eliminated)

    @property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.pinv(self.information, rcond=1e-13, hermitian=True))

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """The rates in 1/s at which forces and hums fade, all else following, and the standard errors of these."""
        behind = len(self.forces) * self.each
        places = [*range(self.each - 1, behind, self.each), *range(behind, len(self.score))]
        inverse = self._inverse
        return (inverse @ self.score)[places], np.sqrt(inverse.diagonal()[places])

    @property
    def covariance(self) -> Floats:
        """(p, p) what they add to that of the parameters."""
        return np.asarray(self.follow @ self._inverse @ self.follow.T)

    @property
    def deviations(self) -> Floats:
        """(f, h / f) standard errors of the unknowns of each force."""
        return np.asarray(np.sqrt(self._inverse.diagonal()).reshape(len(self.forces), -1))

    def refined(self) -> tuple[Floats, tuple[HarmonicForce, ...]]:
        """The step of the unknowns in standard errors, and the forces after it; without amplitudes frequencies stay."""
        at = [k for k, value in enumerate(self.information.diagonal()) if value > 0.0]
        step = np.zeros(len(self.score))
        step[at] = np.linalg.lstsq(self.information[np.ix_(at, at)], self.score[at], rcond=1e-13)[0]
        forces = []
        for force, own in zip(self.forces, step.reshape(len(self.forces), -1), strict=True):
            pairs = np.array(force.amplitudes) + own[:-1].reshape(-1, 2)
            amplitudes = tuple((float(a), float(b)) for a, b in pairs)
            frequency = force.frequency + float(own[-1])
            forces.append(replace(force, frequency=frequency, amplitudes=amplitudes))
        deviations = np.maximum(self.deviations.ravel(), np.finfo(float).tiny)
        return step / deviations, tuple(forces)


def _columns(
    optimum: Optimum, records: Sequence[Record], forces: Sequence[HarmonicForce], *, fading: bool = False
) -> CandidateForces:
    """The forces of unit size of all unknowns along the segments.

    Behind the frequency of each comes the rate at which it is `fading`.
    """
    segments = optimum.segments
    every = segments.flow_steps_per_tangent
    tangents, step = segments.steps // every, segments.step * every
    since_start, owner = _times(segments, records)
    before = 0.5 * segments.step * segments.refine if segments.centred else 0.0
    middle = 0.5 * np.array([record.duration for record in records])[owner]
    first = since_start[0] - middle - before
    time, columns = first + 0.5 * step * np.arange(2 * tangents + 1)[:, None], []
    for force in forces:
        waves = _waves(force.frequency, time, owner, len(records))
        columns += waves
        if force.amplitudes:
            pairs = list(zip(force.amplitudes, waves[::2], waves[1::2], strict=True))
            turned = sum(b * cosine - a * sine for (a, b), cosine, sine in pairs)
            columns.append(2.0 * np.pi * time * turned)
            if fading:
                columns.append(-time * sum(a * cosine + b * sine for (a, b), cosine, sine in pairs))
    ends = np.repeat([force.number for force in forces], len(columns) // max(len(forces), 1)).astype(int)
    return CandidateForces(np.full(len(ends), -1), ends, columns)
