"""Clipped samples: those at an end of the range of a sensor, beyond which the fitted motion goes.

Records whose samples are not evenly spaced in time, as they show by themselves: samples lost, held or written twice.

Errors of a whole channel: the wrong sign, another unit, the place of another channel, a high pass.

A score test says what a small error would explain, and of an error of -200 % it says anything. These are hypotheses of their
own: each is taken out of the records, and the weak form says how well the laws explain what is left, with coefficients of
their own. One is named where the records as they stand are not explained, and those without it are to within their noise,
which no other cause does.

Noise that is stated smaller than it is: residuals that are white, and larger than it.

Hosts that lack a mode in the band.

The modes of a host move alone under the forces on its points: those that are applied, and those of the links along the fitted
motion. A sensor on the host shows a sum of these motions and of free decays, in which a host that is stated as it should be
has only its own frequencies. A mode that is not stated leaves a peak, and one more frequency explains it. Amplitudes are free
at every sensor, so that no shape has to be known, nor any to be right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, zip_longest

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats
from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import DEGREES, Cause
from linkwise.inspection.channel_signal import RecordSignals
from linkwise.inspection.inspect import inspect
from linkwise.inspection.samples import rails
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.fit import LikelihoodFit, motion_of_links
from linkwise.likelihood.noise import is_white
from linkwise.modal.oscillators import SampledForce
from linkwise.model.host import Host
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.progress import silent
from linkwise.records.channel import BASE, KINDS, Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed_records
from linkwise.signals.noise import noise_sigma
from linkwise.verdict import Verdict
from linkwise.weak.displacements import with_displacements
from linkwise.weak.estimate import WeakForm, record_misfit

_BEYOND = 4.0  # standard errors, of the mean or of the power, which noise exceeds once in 30 000 and in 2 000 channels


def clipped_samples(fit: LikelihoodFit, records: Sequence[Record]) -> Iterator[Cause]:
    """The channels with samples at an end of their range that a fit contradicts: its motion goes on beyond it.

    The largest samples of a sensor that was not overloaded have noise to the outside, so that the motion is inside. A motion
    with a large model error follows the samples, and is beyond them by less than it misses them by.
    """
    responses = [name for name in records[0].channels if name not in records[0].inputs]
    ends: dict[str, set[tuple[float, float]]] = {}
    for record in records:
        for signal in RecordSignals.of(record).responses:
            ends.setdefault(signal.channel, set()).update(rails(signal))
    for number, name in enumerate(responses):
        samples, observed = fit.segments.samples[:, number], fit.segments.observed[:, number]
        residuals = fit.misfit.residuals[:, number] / fit.optimum.noise
        beyond = [-side * residuals[(samples == value) & observed] for value, side in ends.get(name, ())]
        outside = np.concatenate(beyond) if beyond else np.empty(0)
        count, total = len(outside), float(np.sum(outside))
        gain = float(np.sum(outside**2)) - count
        if total > _BEYOND * np.sqrt(count) or (total > 0.0 and gain > _BEYOND * np.sqrt(2.0 * count)):
            yield Cause("clipped", name, float(count), "1", gain, standard_error=0.0)


_MORE = 20.0  # times what any other cause explains: a mode that is lacking is no small error, as these are
_JUMPS = "jumps between two samples"  # of a channel that lacks samples, without a gap in the times
_SYSTEMATIC = (Verdict.MEASUREMENT_ERROR, Verdict.SYSTEMATIC_MISFIT, Verdict.UNEXPLAINED_FORCES)


def uneven_samples(of: Examined, before: Judgement) -> Judgement | None:
    """Whether samples were lost or written twice, which all causes of a diagnosis resemble.

    A step in time moves everything behind it, which gains and delays explain in part.
    """
    if of.fit.random_forces or before.verdict not in _SYSTEMATIC or not before.diagnosis:
        return None
    shown = {
        f"{alert.channel} {alert.message.partition(',' if alert.kind == 'dropped' else ':')[0]}"
        for alert in inspect(tuple(of.records)).alerts
        if alert.kind == "doubled" or (alert.kind == "dropped" and alert.message.startswith(_JUMPS))
    }
    if not shown:
        return None
    return replace(
        before,
        message=(
            f"The record shows by itself what comes before any cause below: {'; '.join(sorted(shown))}. Samples were lost or "
            "written twice, so that what follows is early or late. Mend that first, as the alerts say, and identify again. "
            f"As it stands: {before.message[:1].lower()}{before.message[1:]}"
        ),
    )


_LARGEST = 12  # masses up to which the weak form is fast enough for all hypotheses
_MOST = 60  # unknowns, likewise
# of a record, the part with the largest motion, which a whole channel shows as well as all of it
_SAMPLES = 20_000
_CONVINCING = 30.0  # of -2 log likelihood: chance gives one of 200 hypotheses that much in a million records
_ALIKE_MASSES = (
    0.1  # relative: by more, an exchange leaves more than noise in some record of a hundred samples
)
_PLACES, _SEED = 7, 20261129  # at which the symmetry of a law is looked at
_MAY_BE = 9.0  # the same of a high pass that the likelihood, which sees more of it, decides on: three standard errors
_ALIKE = 10.0  # of -2 log likelihood: "very strong" evidence between two errors (Kass and Raftery 1995)
_G = 9.80665  # m/s^2
_UNITS = {"x": (1e3, 1e-3), "v": (1e3, 1e-3), "a": (1.0 / _G, _G, 1e3, 1e-3), "force": (1e3, 1e-3)}
"""Times that values in mm told as m are too large, the usual error, and the reverse; of accelerations those in g as well."""
_ALL = {"x": "all displacements", "v": "all velocities", "a": "all accelerations"}
_ALL_CHANNELS = "all channels"
_ANGLES = (DEGREES, 1.0 / DEGREES)  # likewise those in deg told as rad
_CORNERS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Hz: AC coupling lies inside. What is best at an end is no high pass, but slow residuals or motion that any makes smaller."""
_HINT = 5.0  # of -2 log likelihood, from which a corner is looked for between these
_REFINED = 12  # records that are tried for it
_EXPLAINED = (Verdict.CONVERGED, Verdict.HARDLY_DETERMINED)
"""Verdicts of the weak form on laws that explain a record to within its noise."""

EXCHANGES = frozenset({"sign", "unit", "swapped", "relative"})
"""Kinds of errors of a whole channel that a record can be freed of without loss."""


def recording_errors(records: Sequence[Record], structure: Structure) -> tuple[Cause, ...]:
    """The errors without which the records are explained to within their noise, the usual ones first.

    Several where the equations cannot tell them apart, as a displacement that is too large from another that is too small;
    none where the weak form does not apply. `structure` has its unknowns, all of the terms that were offered in a search.
    """
    parts = _loudest_parts(records)
    return tuple(
        error
        for error in _likeliest(parts, structure)
        if all(_is_explained(error, corrected(part, error), structure) for part in parts)
    )


def likeliest_error(
    records: Sequence[Record], structure: Structure, named: Sequence[str] = ()
) -> Cause | None:
    """The sign, the unit or the place of a channel that explains by far most, or the high pass that may explain something.

    None where there is none, or where another one explains as much. Of several units the one that is `named` by an alert
    counts, of several high passes the likeliest, and of several signs the first, as the others differ by the direction that is
    positive; but for laws that hold it, none of one sensor or an input, where no others outvote it.
    """
    likeliest = _likeliest(_loudest_parts(records), structure, _MAY_BE)
    signs = [error.where for error in likeliest if error.kind == "sign"]
    outvoted = len(signs) == 1 and signs[0] in records[0].responses and len(records[0].channels) > 2
    if signs and not outvoted and not all(map(_is_odd, structure.links)):
        return None
    if 1 < len(likeliest) == len(signs):
        likeliest = likeliest[:1]
    elif all(error.kind == "high pass" for error in likeliest):
        likeliest = sorted(likeliest, key=lambda error: -error.gain)[:1]
    elif len(likeliest) > 1:
        likeliest = [error for error in likeliest if error.where in named]
    if len(likeliest) != 1 or (likeliest[0].kind == "swapped" and _are_alike(likeliest[0], structure)):
        return None
    others = " or ".join(signs[1:]) or "all others"
    return replace(likeliest[0], remark=f"or of {others}, by the direction that is positive" if signs else "")


def _are_alike(swapped: Cause, structure: Structure) -> bool:
    """Whether the masses of two channels may be equal: laws that are stated at the other one look like an exchange then."""
    known = {mass.name: mass.mass.value if mass.mass.known else None for mass in structure.masses}
    places = (name.partition(":")[2] for name in (swapped.where, swapped.source))
    first, second = (known.get(place, np.inf) for place in places)
    return first is None or second is None or abs(first - second) < _ALIKE_MASSES * abs(first)


def _is_odd(link: Link) -> bool:
    """Whether motion the other way makes the force of a link the other way, by its law at a few places."""
    law = link.law
    if not law.is_plain:
        return True
    d, v = np.random.default_rng(_SEED).normal(size=(2, _PLACES))
    ones = dict.fromkeys(law.coefficients, 1.0)
    force = law.force(d, v, ones)
    return bool(
        np.allclose(law.force(-d, -v, ones), -force, rtol=1e-9, atol=1e-9 * float(np.abs(force).max()))
    )


def corrected(record: Record, error: Cause) -> Record:
    """A record without the wrong sign, unit, place or reference of a channel, or without a high pass.

    Parameters
    ----------
    record : Record
        The record.
    error : Cause
        A cause of the kind "sign", "unit", "swapped", "relative" or "high pass".

    Returns
    -------
    Record
        The record without it; itself where it lacks the channels.
    """
    values, places = record.values.copy(), {str(name): place for place, name in enumerate(record.channels)}
    of_all = {kinds: [name for name in record.responses if name.kind == kind] for kind, kinds in _ALL.items()}
    of_all[_ALL_CHANNELS] = [name for name in record.responses if f"{name.kind}:{BASE}" in places]
    for name in of_all.get(error.where, [name for name in record.channels if name == error.where]):
        column = places[name]
        match error.kind:
            case "sign":
                values[:, column] *= -1.0
            case "unit":
                values[:, column] /= error.size
            case "relative" if f"{name.kind}:{BASE}" in places:
                values[:, column] += record.channel(f"{name.kind}:{BASE}")
            case "swapped" if error.source in places:
                values[:, [column, places[error.source]]] = record.values[:, [places[error.source], column]]
            case "high pass":  # y' + w y = x' that was at rest: x = y + w times the integral of y
                integral = scipy.integrate.cumulative_trapezoid(
                    values[:, column], dx=record.step, initial=0.0
                )
                values[:, column] += 2.0 * np.pi * error.size * integral
    return replace(record, values=values, simulated=None)


def _likeliest(parts: Sequence[Record], structure: Structure, high_pass: float = _CONVINCING) -> list[Cause]:
    """The errors that explain most of what the weak form leaves of records; by more than that a `high_pass`."""
    hidden = not all(parts[0].motions_of(name) for name in structure.mass_names)
    if hidden or structure.size > _LARGEST or len(structure.parameters) > _MOST:
        return []

    def gain(error: Cause) -> float:
        try:
            return as_recorded - _misfit([corrected(part, error) for part in parts], structure)
        except (LinkwiseError, np.linalg.LinAlgError):
            return -np.inf

    try:
        as_recorded = _misfit(parts, structure)
    except (LinkwiseError, np.linalg.LinAlgError):
        return []
    errors = [*_exchanged(parts[0], structure), *_high_passes(parts, structure, gain)]
    errors = [replace(error, gain=gain(error)) for error in errors]
    least = max((error.gain for error in errors), default=-np.inf) - _ALIKE
    enough = {"high pass": high_pass}
    return [error for error in errors if error.gain > max(least, enough.get(error.kind, _CONVINCING))]


def _loudest_parts(records: Sequence[Record]) -> list[Record]:
    """The loudest part of each record, its noise not stated: it is found, as units change."""
    return [replace(record, noise={}, simulated=None)[_loudest_part(record)] for record in records]


def _loudest_part(record: Record) -> slice:
    """The part of a long record in which its responses have the largest power; all of a short one."""
    if len(record) <= _SAMPLES:
        return slice(None)
    responses = np.nan_to_num(record.select(record.responses).values)
    power = np.sum((responses / np.maximum(np.std(responses, axis=0), np.finfo(float).tiny)) ** 2, axis=1)
    firsts = (*range(0, len(record) - _SAMPLES, _SAMPLES // 4), len(record) - _SAMPLES)
    first = max(firsts, key=lambda first: float(np.sum(power[first : first + _SAMPLES])))
    return slice(first, first + _SAMPLES)


def _misfit(records: Sequence[Record], structure: Structure) -> float:
    return sum(
        record_misfit(with_displacements(record, structure.masses), structure)
        for record in framed_records(records, structure, integrated=True)
    )


def _is_explained(error: Cause, record: Record, structure: Structure) -> bool:
    """Whether the weak form finds no more than noise in what the laws leave of a `record` that is without an error.

    Without a high pass, slow noise of the sensor is larger than before, and follows slow motion; there the power decides.
    """
    try:
        answer = WeakForm().estimate([record], structure, silent)
    except (LinkwiseError, np.linalg.LinAlgError):
        return False
    slow_noise = (Verdict.SYSTEMATIC_MISFIT,) if error.kind == "high pass" else ()
    return answer.fit_verdicts[0] in (*_EXPLAINED, *slow_noise)


def _exchanged(record: Record, structure: Structure) -> Iterator[Cause]:
    """Channels of the wrong sign, in another unit, in each other's place, or relative to the base; or all of them."""
    places = (*structure.mass_names, BASE)
    measured = [name for name in record.channels if name.kind in _UNITS and name.place in places]
    forces, motions = (
        [name for name in measured if (name.kind == "force") is force] for force in (True, False)
    )
    for name in (*forces, *motions):
        yield _error("sign", name)
    angular = {name for name in motions if unit_in(structure, name) == KINDS["x"].angular_unit}
    units = {
        name: (*_UNITS[name.kind], *(_ANGLES if name in angular else ())) for name in (*motions, *forces)
    }
    for usual in zip_longest(*units.values()):  # the most usual of all channels first
        yield from (_error("unit", name, times) for name, times in zip(units, usual, strict=True) if times)
    for kind, where in _ALL.items():
        if sum(name.kind == kind for name in record.responses) > 1:
            yield from (_error("unit", where, times) for times in _UNITS[kind])
    for first, second in combinations(measured, 2):
        if first.kind == second.kind:
            yield _error("swapped", first, source=second)
    for base in (name for name in motions if name.place == BASE):
        moved = [name for name in motions if name.kind == base.kind and name.place != BASE]
        for where in (*moved, *([_ALL_CHANNELS] if len(moved) > 1 else ())):
            yield _error("relative", where)


def _high_passes(
    records: Sequence[Record], structure: Structure, gain: Callable[[Cause], float]
) -> Iterator[Cause]:
    """Of each displacement without gaps the high pass of first order that explains most, if one of usual corners does."""
    for name in (f"x:{name}" for name in structure.mass_names):
        if not all(name in record.channels and np.isfinite(record.channel(name)).all() for record in records):
            continue
        gains = [gain(_error("high pass", name, corner, "Hz")) for corner in _CORNERS]
        best = int(np.argmax(gains))
        if gains[best] < _HINT or best in (0, len(_CORNERS) - 1):
            continue
        refined = scipy.optimize.minimize_scalar(
            lambda log_corner, name=name: -gain(_error("high pass", name, float(np.exp(log_corner)), "Hz")),
            bounds=np.log([_CORNERS[best - 1], _CORNERS[best + 1]]),
            method="bounded",
            options={"maxiter": _REFINED},
        )
        yield _error("high pass", name, float(np.exp(refined.x)), "Hz")


def _error(kind: str, where: str, size: float = 0.0, unit: str = "1", source: str = "") -> Cause:
    return Cause(kind, str(where), size, unit, 0.0, standard_error=0.0, source=str(source))


# times the noise: 1.44 in chi-square, which no number of samples that a fit has gives by chance
_EXCEEDED = 1.2
# times the noise: what neighbouring samples scatter by is noise within a few per cent where the motion is resolved
_SCATTERED = 100.0
_DOUBTED = (Verdict.NOT_CONVERGED, Verdict.NOISE_MISMATCH)


def understated_noise(of: Examined, before: Judgement) -> Judgement | None:
    """Whether the noise of channels is stated too small, and nothing else is wrong.

    What laws lack leaves residuals that follow the motion, from one sample to the next; those of noise are white.
    """
    fit, records, unsettled = of.fit, of.records, before.verdict is Verdict.NOT_CONVERGED
    if before.verdict not in _DOUBTED or fit.random_forces:
        return None
    if unsettled and (scattered := beyond_statement(records)):
        return replace(before, message=f"{before.message} {scattered}", is_final=True)
    if not np.isfinite(fit.chi_square):
        return None
    stated = {name for record in records for name in record.noise}
    exceeded = []
    parts = zip(fit.noise, fit.misfit.residuals.transpose(1, 2, 0), fit.optimum.scales.sigma, strict=True)
    for name, residuals, counted_as in parts:
        counted = residuals[residuals != 0.0]
        ratio = float(np.sqrt(np.mean(counted**2))) if len(counted) else 0.0
        ratio *= counted_as / records[0].noise.get(name, counted_as)
        if ratio <= _EXCEEDED:
            continue
        if name not in stated or not is_white(residuals.ravel()):
            return None
        exceeded.append(f"{ratio:.2g} times in {name}, {fit.noise[name]:.2g} {records[0].unit(name)}")
    if not exceeded:
        return None
    return replace(
        before,
        message=(
            f"The residuals exceed the noise that is stated ({' and '.join(exceeded)}), and are white, as noise is and what "
            f"laws lack is not: it is stated too small.{' The search did not converge with it.' if unsettled else ''} "
            "State what it is, or leave it out, so that it is found with the laws."
        ),
        is_final=True,
    )


def beyond_statement(records: Sequence[Record]) -> str:
    """Whether samples of responses scatter far more than the noise that is stated of them.

    Parameters
    ----------
    records : sequence of Record
        The records.

    Returns
    -------
    str
        A sentence on such channels; empty where there are none.
    """
    scatters: dict[Channel, tuple[float, float]] = {}
    for record in records:
        responses = record.select(record.responses)
        for name, sigma in zip(responses.channels, noise_sigma(responses.values).tolist(), strict=True):
            stated = record.noise.get(name, 0.0)
            ratio = sigma / stated if stated > 0.0 else 0.0
            if ratio > max(_SCATTERED, scatters.get(name, (0.0, 0.0))[0]):
                scatters[name] = ratio, sigma
    if not scatters:
        return ""
    which = " and ".join(
        f"{ratio:.2g} times in {name}, {sigma:.2g} {name.unit}" for name, (ratio, sigma) in scatters.items()
    )
    return (
        f"Before any law, neighbouring samples scatter by far more than the noise that is stated ({which}): state what it is, "
        "or leave it out, so that it is found with the laws."
    )


_MODES = 60  # modes of a host, and samples for each of its columns, that can be told apart
_DAMPING = (0.003, 0.01, 0.03)  # of a mode that is not stated
_PEAKS = 4  # of what is left that are tried
_APART = 0.08  # relative distance from a stated frequency, below which that is rather off
_NYQUIST = 0.45  # of the rate: frequencies up to which a mode is in the band
_JUDGED = 0.5  # of what is left in the sensors of the host: one more mode beside other causes explains less
_MODE_GAIN = 50.0  # of -2 log likelihood for each column that is added
_SEEN = 100.0  # of the noise in power: a mode that should be seen in the sensors
_NEEDED = 0.05  # of what a mode that should be seen takes off: less, and it is elsewhere
_TRIALS = 8  # frequencies about a peak
_STILL = 1e-3  # periods in a record of a motion that stands for a rigid one
_RANK = 1e-8  # of a column of unit length that others explain
_OFF = 4  # frequencies a little off the stated ones that may leave more than a mode that is lacking


def lacking_modes(fit: LikelihoodFit, identified: Structure, records: Sequence[Record]) -> tuple[Cause, ...]:
    """Modes that hosts lack, by what the forces on them leave in their sensors.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit whose laws do not explain the records.
    identified : Structure
        The structure with its values.
    records : sequence of Record
        The records, of which the first is looked at.

    Returns
    -------
    tuple of Cause
        For each host at most one; none on a moving base, and where a model error stands for what the laws lack.
    """
    record = records[0]
    if not fit.chi_square_off or any(channel.place == BASE for channel in record.channels):
        return ()
    start = record[: min(len(record), _SAMPLES)]
    forces = _forces_on_points(fit, identified, records, len(start))
    causes = []
    for host in identified.hosts:
        shown = _Shown.of(host, start, forces, fit.noise)
        cause = None if shown is None else shown.cause()
        if cause is not None:
            causes.append(cause)
    return tuple(causes)


def _forces_on_points(
    fit: LikelihoodFit, identified: Structure, records: Sequence[Record], samples: int
) -> dict[str, Floats]:
    """(N,) the force on each point of a host along the fitted motion, from the start of the first record."""
    record, motion = records[0], motion_of_links(fit, identified, records)
    points = {point for host in identified.hosts for point in host.points}
    totals: dict[str, Floats] = {}
    for number, link in enumerate(identified.links):
        if link.name in identified.modes or not points.intersection(link.between):
            continue
        force = None if motion.identified_force is None else motion.identified_force[:samples, number]
        if force is None or np.isnan(force).any():
            force = link.force(motion.d[:samples, number], motion.v[:samples, number], {})
        for point, sign in zip(link.between, (-1.0, 1.0), strict=True):
            if point in points:
                totals[point] = totals.get(point, 0.0) + sign * np.nan_to_num(force)
    for channel in record.forces:
        if (point := channel.place) in points:
            totals[point] = totals.get(point, 0.0) + np.nan_to_num(record.channel(channel)[:samples])
    return totals


@dataclass(frozen=True, eq=False)
class _Shown:
    """What the sensors of a host show, in units of their noise, and the forces on its points."""

    host: Host
    step: float
    forces: Mapping[str, SampledForce]
    kinds: tuple[int, ...]  # derivative that each of c sensors shows
    points: tuple[str, ...]
    units: tuple[float, ...]  # standard deviation of the noise of each sensor
    values: Floats  # (N, c)
    present: Bools  # (N,)

    @classmethod
    def of(
        cls, host: Host, record: Record, forces: Mapping[str, Floats], noise: Mapping[str, float]
    ) -> _Shown | None:
        """None where no sensor is on the host, no force acts, or there are too many modes for the samples."""
        sensors = [
            (channel, channel.order, channel.place)
            for channel in record.motions
            if channel.place in host.points
        ]
        acting = {point: SampledForce(force, record.step) for point, force in forces.items() if force.any()}
        acting = {point: force for point, force in acting.items() if point in host.points}
        values = [mode.frequency.value for mode in host.modes]
        columns = (len(values) + 1) * (len(acting) + 2)
        if not sensors or not acting or None in values or len(values) > _MODES:
            return None
        units = tuple(noise.get(name) or 1.0 for name, _, _ in sensors)
        stack = np.stack([record.channel(name) for name, _, _ in sensors], axis=1) / np.array(units)
        present = np.isfinite(stack).all(axis=1)
        if present.sum() < _MODES * columns / 10:
            return None
        kinds, points = zip(*((kind, point) for _, kind, point in sensors), strict=True)
        return cls(host, record.step, acting, kinds, points, units, np.nan_to_num(stack), present)

    def cause(self) -> Cause | None:
        """The mode that explains most of what is left, if it explains what no other cause does."""
        highest, slowest = _NYQUIST / self.step, _STILL / (self.step * len(self.values))
        stated = {
            name: (max(float(mode.frequency.value or 0.0), slowest), float(mode.damping.value or 0.0))
            for name, mode in zip(self.host.coordinates, self.host.modes, strict=True)
            if (mode.frequency.value or 0.0) <= highest
        }
        columns = [self._columns(*mode) for mode in stated.values()]
        first = float(np.sum(_Explained.by(self, columns).left ** 2))
        for _ in range(_OFF):
            explained = _Explained.by(self, columns)
            trials = [self._refined(explained, frequency) for frequency in self._peaks(explained.left)]
            if not trials:
                return None
            power, frequency, added = min(trials, key=lambda trial: trial[0])
            if not any(abs(frequency / f - 1.0) < _APART for f, _ in stated.values()):
                break
            columns.append(added)  # what a stated frequency that is a little off leaves
        else:
            return None
        count, before = len(self.kinds) * added.shape[2], float(np.sum(explained.left**2))
        gain = float(explained.left.size * np.log(before / max(power, 1.0)))
        share = (before - power) / first
        if share < _JUDGED or gain < _MODE_GAIN * count or self._moved(columns, list(stated), added):
            return None
        return Cause("mode", self.host.name, frequency, "Hz", gain, standard_error=0.0, share=share)

    def _columns(self, frequency: float, damping: float) -> Floats:
        """(3, N, f + 2) displacement, velocity and acceleration of a mode under each force, and of its free decay."""
        time = self.step * np.arange(len(self.values))
        w = 2.0 * np.pi * frequency
        pole = w * complex(-damping, np.sqrt(max(1.0 - damping**2, 1e-6)))
        decay = np.stack([pole**order * np.exp(pole * time) for order in range(3)]) / w
        moved = [force.motion(frequency, min(damping, 0.99)) for force in self.forces.values()]
        return np.stack([*moved, decay.real, decay.imag], axis=2)

    def _peaks(self, left: Floats) -> list[float]:
        """Frequencies in Hz at which most is left, apart from each other."""
        spectrum = np.sum(np.abs(scipy.fft.rfft(left, axis=0)) ** 2, axis=1)
        frequencies = scipy.fft.rfftfreq(len(left), self.step)
        spectrum[(frequencies < 2.0 * frequencies[1]) | (frequencies > _NYQUIST / self.step)] = 0.0
        peaks: list[float] = []
        for _ in range(_PEAKS):
            peak = float(frequencies[int(np.argmax(spectrum))])
            if peak == 0.0:
                break
            peaks.append(peak)
            spectrum[np.abs(frequencies - peak) < max(_APART * peak, 3.0 * frequencies[1])] = 0.0
        return peaks

    def _refined(self, explained: _Explained, near: float) -> tuple[float, float, Floats]:
        """The power that one more mode near a frequency leaves, its frequency, and its columns."""
        width = max(0.03 * near, 1.5 / (self.step * len(self.values)))
        best = (np.inf, near, np.zeros((3, len(self.values), 0)))
        for damping in _DAMPING:
            solved = scipy.optimize.minimize_scalar(
                lambda frequency, damping=damping: explained.power_with(self._columns(frequency, damping)),
                bounds=(max(near - width, 0.1 * near), near + width),
                method="bounded",
                options={"maxiter": _TRIALS},
            )
            if solved.fun < best[0]:
                best = (float(solved.fun), float(solved.x), self._columns(float(solved.x), damping))
        return best

    def _moved(self, columns: Sequence[Floats], stated: Sequence[str], added: Floats) -> bool:
        """Whether the sensors do not show a stated mode that they should: then it is another one, and none is lacking."""
        for number, name in enumerate(stated):
            shapes = np.array([self.host.shape(point)[name] for point in self.forces])
            driven = columns[number][:, :, : len(shapes)] @ shapes
            expected = np.stack(
                [
                    self.host.shape(point)[name] * driven[kind] / unit
                    for kind, point, unit in zip(self.kinds, self.points, self.units, strict=True)
                ],
                axis=1,
            )
            others = _Explained.by(self, [*columns[:number], *columns[number + 1 :], added])
            alone = float(np.sum(others.left_of(expected[self.present]) ** 2))
            needed = float(np.sum(others.left**2)) - others.power_with(columns[number])
            if alone > _SEEN * len(self.kinds) and needed < _NEEDED * alone:
                return True
        return False


@dataclass(frozen=True, eq=False)
class _Explained:
    """What columns of a host's motion leave of its sensors: orthonormal bases (N, q) by kind of sensor, and `left` (N, c)."""

    kinds: tuple[int, ...]
    present: Bools
    bases: dict[int, Floats]
    left: Floats

    @classmethod
    def by(cls, shown: _Shown, columns: Sequence[Floats]) -> _Explained:
        bases = {}
        for kind in sorted(set(shown.kinds)):
            parts = [part[kind] for part in columns] + [np.ones((len(shown.values), 1))]
            bases[kind] = _orthonormal(np.concatenate(parts, axis=1)[shown.present])
        own = cls(shown.kinds, shown.present, bases, shown.values[shown.present])
        return replace(own, left=own.left_of(own.left))

    def left_of(self, values: Floats) -> Floats:
        """(N, c) what the columns leave of other values of the sensors."""
        left = values.copy()
        for kind, basis in self.bases.items():
            own = np.equal(self.kinds, kind)
            left[:, own] -= basis @ (basis.T @ left[:, own])
        return left

    def power_with(self, added: Floats) -> float:
        """The power that is left where columns (3, N, p) are added."""
        power = float(np.sum(self.left**2))
        for kind, basis in self.bases.items():
            more = added[kind][self.present]
            more = more / np.maximum(np.linalg.norm(more, axis=0), np.finfo(float).tiny)
            more = _orthonormal(more - basis @ (basis.T @ more))
            power -= float(np.sum((more.T @ self.left[:, np.equal(self.kinds, kind)]) ** 2))
        return power


def _orthonormal(columns: Floats) -> Floats:
    """(N, q) a basis of columns (N, p), without those that the others leave nothing of."""
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    basis, root, _ = scipy.linalg.qr(columns / size, mode="economic", pivoting=True)
    return np.asarray(basis[:, np.abs(root.diagonal()) > _RANK])


def errors_of_records(of: Examined, before: Judgement) -> Judgement | None:
    """Whether samples are clipped, or a whole channel has the wrong sign, another unit or place, or a high pass.

    Without such an error one of the structures explains the records to within their noise, or the record itself shows it, and
    no other cause is likelier.
    """
    if of.fit.random_forces or not (before.verdict.forbids or before.diagnosis):
        return None
    clipped = tuple(clipped_samples(of.fit, of.records))
    unexplained = _is_unexplained(of.fit, before.verdict)
    of_channels = (recording_errors(of.records, structure) for structure in of.structures if unexplained)
    errors = (*clipped, *next(filter(None, of_channels), ()))
    if not errors:
        return None
    unsettled = before.verdict is Verdict.NOT_CONVERGED
    return replace(
        before,
        verdict=Verdict.NOT_CONVERGED if unsettled else Verdict.MEASUREMENT_ERROR,
        message=(f"{before.message} " if unsettled else "") + _explanation(errors, is_clipped=bool(clipped)),
        diagnosis=(*errors, *before.diagnosis),
        added={},
        is_final=True,
    )


def modes_of_hosts(of: Examined, before: Judgement) -> Judgement | None:
    """Whether hosts lack modes, before all other causes: errors of sensors look a little like them."""
    settled = before.verdict is not Verdict.NOT_CONVERGED  # else the forces of links are wrong
    if of.fit.random_forces or not (settled and _is_unexplained(of.fit, before.verdict)):
        return None
    most = max((cause.gain for cause in before.diagnosis), default=0.0)
    causes = lacking_modes(of.fit, of.identified, of.records) if of.identified.hosts else ()
    causes = tuple(cause for cause in causes if cause.gain > _MORE * most)
    if not causes:
        return None
    parts = [
        f"with {cause.description}, the forces on it explain {100.0 * cause.share:.3g} % of what its stated modes leave in "
        f"its sensors: {_ADVICE[cause.kind]}"
        for cause in causes
    ]
    return replace(
        before,
        verdict=Verdict.UNEXPLAINED_FORCES,
        message=f"The structure does not explain the record: {'; '.join(parts)}.",
        diagnosis=(*causes, *before.diagnosis),
        is_final=True,
    )


def _is_unexplained(fit: LikelihoodFit, verdict: Verdict) -> bool:
    """Whether the laws leave more than noise, and the answer is not to be trusted."""
    unsettled = verdict is Verdict.NOT_CONVERGED and fit.model_error == 0.0 and not fit.chi_square_off
    return verdict.forbids and not unsettled and verdict not in _LEAVES_NOISE


def _explanation(errors: Sequence[Cause], *, is_clipped: bool) -> str:
    """What the first of the errors means, and what mends it; the others look like it."""
    first, others = errors[0], errors[1:]
    advice = _ADVICE[first.kind].format(where=first.where, source=first.source, factor=_factor(first))
    if is_clipped:
        more = f" There is also {' and '.join(error.description for error in others)}." if others else ""
        return (
            f"The motion goes on beyond the range of {first.where}: {first.description} would lower -2 log likelihood by "
            f"{first.gain:.3g}.{more} Intervals of exact laws would not include that: {advice}."
        )
    alike = f" ({' or '.join(error.description for error in others)} would do the same)" if others else ""
    return (
        f"The laws do not explain the record as it stands, and explain it to within its noise but for one error: "
        f"{first.description}{alike}: {advice}, and identify again."
    )


def _factor(cause: Cause) -> str:
    return f"{1.0 / cause.size:g}" if cause.kind == "unit" else ""


_LEAVES_NOISE = (Verdict.SEVERAL_OPTIMA, Verdict.HARDLY_DETERMINED, Verdict.COVARIANCE_NOT_POSITIVE)
"""Verdicts on laws that leave only noise."""

_ADVICE = {
    "sign": "change the sign of {where}",
    "unit": "multiply {where} by {factor}, or state its unit",
    "swapped": "exchange {where} and {source}",
    "relative": "name {where} as relative, rel:x:MASS, or add the motion of the base",
    "high pass": "couple the sensor of {where} directly (DC), or integrate what it took off",
    "mode": "state that mode, or keep it of the matrices",
    "clipped": "mark these samples as missing (mark_missing), or measure with a larger range",
}
