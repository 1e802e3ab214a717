"""From the records of a modal test to a host whose modes are known to within their standard errors, as priors of a later
identification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.signal import welch

from linkwise.arrays import Bools, Floats
from linkwise.display import (
    JudgedView,
    format_both,
    format_duration,
    format_error,
    format_value,
    paragraph,
    remark_lines,
    table,
    text_of,
)
from linkwise.errors import IdentificationError, RecordError
from linkwise.likelihood.whiteness import is_white
from linkwise.modal.measurement import ModalMeasurement
from linkwise.modal.output_error import ModalFit, modal_fit
from linkwise.modal.pursuit import PursuedModes, doubled_mode, pursued_modes, shadow_mode
from linkwise.model.coefficient import Coefficient
from linkwise.model.host import Host, HostMode
from linkwise.model.link import ANGLE, LENGTH
from linkwise.progress import Progress, part, silent
from linkwise.records.channel import BAND_LIMITED, BASE
from linkwise.records.joining import check_distinct, record_list
from linkwise.records.record import Record
from linkwise.records.timeline import PASSBAND
from linkwise.runtime import one_blas_thread
from linkwise.verdict import Verdict


@dataclass(frozen=True, repr=False)
class HostEstimate(JudgedView):
    """A host that was identified from the records of a modal test.

    Attributes
    ----------
    host : Host
        Its modes; frequencies, damping, also between modes, and shapes are known to within their standard errors.
    faint : tuple of str
        Modes that hardly stand above the noise, such as ``"beam.mode7"``: each may stand for several, or for what modes above
        the band give, and its values are stated as known to within wide bounds.
    chi_square_per_sample : float
        Power of the residuals over that of the noise.
    samples : int
        Number of samples.
    verdicts : tuple of Verdict
        What can be said of it.
    remarks : tuple of str
        Sentences on what the records do not determine.
    seconds : float
        Computing time in s.

    See Also
    --------
    identify_host : Identifies it.

    Examples
    --------
    >>> import linkwise as lw
    >>> known = lw.Coefficient.number
    >>> wing = lw.Host("wing", (lw.model.HostMode(known(5.2), known(0.01), {"tip": 1.0, "joint": 0.62}),))
    >>> record = lw.simulate(
    ...     lw.Structure("test", (), (), (wing,)),
    ...     forces={"wing.tip": "5*exp(-((t - 0.1)/0.02)**2)"},
    ...     duration=2.0,
    ...     rate=200.0,
    ...     sensors=["a:wing.tip", "a:wing.joint"],
    ... )
    >>> found = lw.modal.identify_host(record.with_noise(30.0, seed=1))
    >>> found.trusted, len(found.host.modes)
    (True, 1)
    """

    host: Host
    faint: tuple[str, ...]
    chi_square_per_sample: float
    samples: int
    verdicts: tuple[Verdict, ...]
    remarks: tuple[str, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "modes" with frequencies in Hz, damping as a part of the critical one and shapes in 1/sqrt(kg), each with its
            standard error; where damping couples modes, "damping" with the entry of each pair in N s/m; the fit, verdicts and
            remarks.
        """
        names = self.host.coordinates

        def known(one: Coefficient) -> dict[str, Any]:
            return {"value": one.value, "standard_error": one.sigma}

        between = [
            {"modes": [names[first - 1], names[second - 1]], **known(entry)}
            for (first, second), entry in self.host.entries.items()
        ]
        return {
            "method": "identify_host",
            **self._judgement(),
            "message": " ".join(verdict.value for verdict in self.verdicts),
            "seconds": self.seconds,
            "fit": {"chi_square_per_sample": self.chi_square_per_sample, "samples": self.samples},
            "host": self.host.name,
            "modes": [
                {
                    "name": name,
                    "faint": name in self.faint,
                    "frequency": known(mode.frequency),
                    "damping": known(mode.damping),
                    "shape": {
                        point: {"value": size, "standard_error": mode.shape_sigma.get(point, 0.0)}
                        for point, size in mode.shape.items()
                    },
                }
                for name, mode in zip(names, self.host.modes, strict=True)
            ],
            **({"damping": between} if between else {}),
            "remarks": list(self.remarks),
        }

    def __str__(self) -> str:
        host = self.host
        status = " ".join(verdict.value for verdict in self.verdicts)
        head = f"{host.name}: {len(host.modes)} modes at {len(host.points)} points, {self.grade.trust}"
        numbers = f"{self.samples} samples, chi-square {self.chi_square_per_sample:.3f}"
        summary = f"{status} ({numbers}, {format_duration(self.seconds)})"
        points = tuple(host.modes[0].shape)[:_POINTS]
        title = ("", "frequency [Hz]", "std. error", "damping [%]", "std. error", *points, "std. error")
        rows: list[tuple[str, ...]] = [title]
        for name, mode in zip(host.coordinates, host.modes, strict=True):
            frequency, damping = mode.frequency, mode.damping
            errors = [mode.shape_sigma.get(point, 0.0) for point in points]
            hz = format_both(frequency.value or 0.0, frequency.sigma)
            percent = format_both(100.0 * (damping.value or 0.0), 100.0 * damping.sigma)
            shape = (
                format_value(mode.shape[point], error) for point, error in zip(points, errors, strict=True)
            )
            rows.append((name, *hz, *percent, *shape, f"up to {format_error(max(errors))}"))
        between = [
            (name, *format_both(entry.value or 0.0, entry.sigma))
            for name, entry in zip(host.damping_links.values(), host.entries.values(), strict=True)
            if abs(entry.value or 0.0) > _SHOWN * entry.sigma
        ]
        counts = f"{len(host.damping)} pairs are free, {len(between)} of them stand out"
        of_pairs = [f"damping between modes: {counts}"] if host.damping else []
        of_pairs += table([("", "damping [N s/m]", "std. error"), *between])
        remarks = ([remark_lines(remark)] for remark in self.remarks)
        return text_of([head, paragraph(summary)], table(rows), of_pairs, *remarks)


_FAINT = 10.0
"""Power of a mode over that of the noise, 10 dB, in its best channel: a mode below it may stand for several."""
# bounds to which such a mode is known, relative
_FAINT_FREQUENCY, _FAINT_DAMPING, _FAINT_SHAPE = (0.02, 0.5, 0.2)
_LONG = 16_000  # samples: a search in more takes minutes
_SEGMENT = 1024  # samples of a spectrum of the force
# of the power of a force: beyond the frequency above which lies no more, it moves nothing
_HARDLY_EXCITED = 1e-4
_BEYOND = 1.5  # times the highest frequency excited, up to which modes bend the response below it
_UNSCALED = 0.2  # standard error of a shape relative to its largest value: its scale is not determined
_CHI_SQUARE, _SIGMAS = 0.08, 5.0  # by what the power of the residuals may differ from that of the noise


def identify_host(
    record: Record | Sequence[Record],
    *,
    modes: int | None = None,
    name: str | None = None,
    masses: Mapping[str, float] = MappingProxyType({}),
    progress: Progress = silent,
) -> HostEstimate:
    """Identify the modes of a linear structure from a test at a low level: hits of a hammer, a shaker, or free decays.

    Frequencies, damping and mass-normalised shapes at the points of sensors and forces maximise the likelihood of the samples.
    They come with standard errors, as priors that `identify` counts when it finds links from records at higher levels.

    Parameters
    ----------
    record : Record or sequence of Record
        One or several records with applied forces (N) and displacements, velocities or accelerations (m, m/s, m/s2) at
        points ``"HOST.POINT"``, one of them where a force acts. The structure must move linearly, by vibrating modes. Without
        a force they are free decays, from their first sample on.
    modes : int, optional
        Number of modes; by default as many as the records show by the Bayesian information criterion. A mode that hardly
        stands above the noise and only moves like its neighbour is left out.
    name : str, optional
        Name of the host; by default the part before the dot that all channels share. Where channels have one, no other is
        taken, since no channel would be at the points of the host.
    masses : mapping of str to float
        Of free decays, masses in kg by point: where they are all that moves, they set the scale of the shapes. Without them
        shapes are 1 where they are largest, and the answer is refused, since forces of links have no scale.
    progress : Progress
        Called with a `ProgressReport` at every mode.

    Returns
    -------
    HostEstimate
        The host, and whether it is to be trusted.

    Raises
    ------
    IdentificationError
        If the records have no force or no motion, no motion at a point of a force, too few samples, or channels of a host of
        another name.
    RecordError
        If two records hold the same samples.
    TypeError
        If something else than records is given.

    See Also
    --------
    HostMatrices : A host from matrices.

    Examples
    --------
    >>> import linkwise as lw
    >>> known = lw.Coefficient.number
    >>> wing = lw.Host("wing", (lw.model.HostMode(known(5.2), known(0.01), {"tip": 1.0, "joint": 0.62}),))
    >>> record = lw.simulate(
    ...     lw.Structure("test", (), (), (wing,)),
    ...     forces={"wing.tip": "5*exp(-((t - 0.1)/0.02)**2)"},
    ...     duration=2.0,
    ...     rate=200.0,
    ...     sensors=["a:wing.tip", "a:wing.joint"],
    ... )
    >>> found = lw.modal.identify_host(record.with_noise(30.0, seed=1))
    >>> round(found.host.modes[0].frequency.value, 2), found.host.points
    (5.2, ('wing.tip', 'wing.joint'))
    """
    started = perf_counter()
    if modes is not None and modes < 1:
        raise IdentificationError(f"the number of modes must be positive, got {modes}")
    records = record_list(record, "identify_host(record): record")
    if not records:
        raise IdentificationError("a modal test needs at least one record, got none")
    check_distinct(records)
    records = [_in_excited_band(single) for single in records]
    measured = ModalMeasurement.of(records, name, masses=masses)
    with one_blas_thread():
        fit, faint = _modes_found(measured, modes, progress)
    _check_masses(measured, fit.frequencies[~faint])
    chi_square, samples = _chi_square(measured, fit)
    white = all(is_white(np.concatenate(rows)) for rows in zip(*fit.residuals, strict=True))
    inexact = chi_square > 1.0 + _deviation_by_chance(samples) or not white
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    open_scale = not len(measured.forced) and not masses
    unscaled = [] if open_scale else _unscaled(fit, errors, faint)
    if inexact:
        errors = errors * fit.block_ratios
    of_pairs = errors[len(errors) - len(fit.pairs) :]
    errors = errors[: len(errors) - len(fit.pairs)].reshape(len(faint), -1)
    if open_scale:
        errors[:, 2:] = np.abs(fit.shapes).max(axis=1, keepdims=True)
    host = replace(_host_of_fit(measured, fit, errors, faint), damping=_damping_between_modes(fit, of_pairs))
    host = host.with_units(_units_of_points(records, host))
    return HostEstimate(
        host=host,
        faint=tuple(name for name, is_faint in zip(host.coordinates, faint, strict=True) if is_faint),
        chi_square_per_sample=chi_square,
        samples=samples,
        verdicts=(_verdict(fit, chi_square, samples, unscaled=bool(unscaled), white=white),)
        if not open_scale or not fit.converged
        else (Verdict.HARDLY_DETERMINED,),
        remarks=(
            *_remarks(host, faint, unscaled, _unexplained_share(measured, fit) if inexact else 0.0),
            *((_OPEN_SCALE,) if open_scale else ()),
        ),
        seconds=perf_counter() - started,
    )


def _modes_found(measured: ModalMeasurement, modes: int | None, progress: Progress) -> tuple[ModalFit, Bools]:
    """The most likely modes, `modes` of them or as many as there are, and which of them (n,) are faint."""
    pursued = pursued_modes(measured, modes, part(progress, 0.0, 0.5))
    if not len(pursued.frequencies):
        raise IdentificationError(
            "the response does not stand above the noise, so no mode can be found; hit the structure harder, "
            "or check the units and the channels of force and motion"
        )
    fit = modal_fit(measured, pursued, part(progress, 0.5, 1.0))
    while modes is None and (double := doubled_mode(fit.frequencies, fit.damping, fit.shapes)) is not None:
        fit = modal_fit(measured, _without_mode(double, measured, fit))
    faint = _powers_over_noise(measured, fit) < _FAINT
    while (shadow := shadow_mode(fit.frequencies, fit.damping, fit.shapes, faint)) is not None:
        fit = modal_fit(measured, _without_mode(shadow, measured, fit))
        faint = _powers_over_noise(measured, fit) < _FAINT
    return fit, faint


def _check_masses(measured: ModalMeasurement, frequencies: Floats) -> None:
    """Raise IdentificationError where masses at points are to scale more modes, of `frequencies` in Hz, than they can have."""
    stated = int(np.count_nonzero(measured.masses))
    if stated and len(frequencies) > stated:
        found = ", ".join(f"{hertz:.4g} Hz" for hertz in np.sort(frequencies))
        raise IdentificationError(
            f"masses at {stated} points cannot be all that moves in {len(frequencies)} modes ({found}): state the mass at "
            "every point that moves, with a sensor there; or identify two masses and links instead of a host"
        )


def _in_excited_band(record: Record) -> Record:
    """A long record at the rate that the band needs in which its forces move the structure, or in which it decays."""
    whole = not record.missing.any() and not set(record.interpolation.values()) - {BAND_LIMITED}
    signals = record.forces or record.motions
    if len(record) <= _LONG or not signals or not whole:
        return record
    highest = max(_highest_frequency(record.channel(name), record.rate) for name in signals)
    factor = int(0.5 * PASSBAND * record.rate / (_BEYOND * highest))
    return record.decimate(factor) if factor > 1 else record


def _highest_frequency(signal: Floats, rate: float) -> float:
    """The frequency in Hz below which lies the power of a force, or of a motion."""
    frequency, power = welch(signal, rate, nperseg=_SEGMENT)
    below = np.cumsum(power) <= (1.0 - _HARDLY_EXCITED) * power.sum()
    return float(frequency[min(int(below.sum()), len(frequency) - 1)])


def _units_of_points(records: Sequence[Record], host: Host) -> dict[str, str]:
    """Units of the points whose channels state one. Raises RecordError for a point that is said to turn and to move."""
    units: dict[str, str] = {}
    stated = [(c, record.units[c]) for record in records for c in record.channels if c in record.units]
    for channel, unit in stated:
        if not channel.angular_unit or channel.place == BASE:
            continue
        point = channel.place.removeprefix(f"{host.name}.")
        turns = ANGLE if unit == channel.angular_unit else LENGTH
        if units.setdefault(point, turns) != turns:
            raise RecordError(
                f"is in {unit}, and another channel of {channel.place} says that it is displaced in {units[point]}: correct "
                "the unit of one of them",
                channel=channel,
            )
    return {point: unit for point, unit in units.items() if point in host.modes[0].shape}


def _without_mode(mode: int, measured: ModalMeasurement, fit: ModalFit) -> PursuedModes:
    """The modes of a fit without one."""
    residues = fit.shapes[:, measured.sensed, None] * fit.shapes[:, None, measured.forced]
    others = np.arange(len(residues)) != mode
    free = np.array([start[:, None] * fit.shapes[:, measured.sensed] for start in fit.starts])
    return PursuedModes(fit.frequencies[others], fit.damping[others], residues[others], free[:, others])


def _powers_over_noise(measured: ModalMeasurement, fit: ModalFit) -> Floats:
    """(n,) power of what each mode gives over that of the noise, or of what is left where it moves, in its best channel."""
    powers = np.zeros((len(fit.frequencies), len(measured.kinds)))
    for run, residuals, starts in zip(measured.runs, fit.residuals, fit.starts, strict=True):
        left = np.abs(np.fft.rfft(np.nan_to_num(residuals))) ** 2
        for mode, shape in enumerate(fit.shapes):
            motions = run.motions(float(fit.frequencies[mode]), float(fit.damping[mode]))
            start = [starts[mode].real, -starts[mode].imag] if not len(measured.forced) else [0.0, 0.0]
            motion = np.tensordot([*shape[measured.forced], *start], motions, axes=1)
            shown = shape[measured.sensed][:, None] * motion[measured.kinds]
            lines = np.abs(np.fft.rfft(shown)) ** 2
            peak = np.maximum(lines.max(axis=1, keepdims=True), np.finfo(float).tiny)
            beside = lines.sum(axis=1) / np.maximum(np.sum(left * lines / peak, axis=1), np.finfo(float).tiny)
            powers[mode] += np.minimum(np.mean(shown**2, axis=1) / run.noise**2, beside)
    return np.asarray(powers.max(axis=1) / len(measured.runs))


def _chi_square(measured: ModalMeasurement, fit: ModalFit) -> tuple[float, int]:
    """Power of the residuals over that of the noise in the samples, and the number of samples."""
    total, samples = 0.0, 0
    for run, left in zip(measured.runs, fit.residuals, strict=True):
        total += float(np.nansum((left / run.noise[:, None]) ** 2))
        samples += int(np.isfinite(left).sum())
    free = len(fit.covariance) + len(measured.runs) * (2 * len(fit.frequencies) + len(measured.kinds))
    return total / max(samples - free, 1), samples


def _host_of_fit(measured: ModalMeasurement, fit: ModalFit, errors: Floats, faint: Bools) -> Host:
    """The modes as priors, with wide standard deviations for a faint one."""
    modes = []
    for number, shape in enumerate(fit.shapes):
        frequency, damping = float(fit.frequencies[number]), float(fit.damping[number])
        own = errors[number].copy()
        if faint[number]:
            largest = _FAINT_SHAPE * np.abs(shape).max()
            floor = [_FAINT_FREQUENCY * frequency, _FAINT_DAMPING * damping, *[largest] * len(shape)]
            own = np.maximum(own, floor)
        modes.append(
            HostMode(
                Coefficient.unknown(frequency, lower=0.0, sigma=float(own[0])),
                Coefficient.unknown(damping, lower=0.0, sigma=float(own[1])),
                dict(zip(measured.points, map(float, shape), strict=True)),
                {
                    point: float(sigma)
                    for point, sigma in zip(measured.points, own[2:], strict=True)
                    if sigma > 0.0
                },
            )
        )
    return Host(measured.host, tuple(modes))


def _damping_between_modes(fit: ModalFit, errors: Floats) -> dict[tuple[int, int], Coefficient]:
    """The damping between modes, counted from 1, as priors that are no wider than what dissipation allows."""
    least = np.minimum(errors, fit.sizes)
    return {
        (first + 1, second + 1): Coefficient.unknown(float(value), sigma=float(error))
        for (first, second), value, error in zip(fit.pairs, fit.between, least, strict=True)
    }


def _unscaled(fit: ModalFit, errors: Floats, faint: Bools) -> list[int]:
    """Modes above the noise whose shape has no scale by `errors` (p,): their motion where the force acts is not seen."""
    of_modes = errors[: len(errors) - len(fit.pairs)].reshape(len(faint), -1)
    relative = of_modes[:, 2:].max(axis=1) / np.abs(fit.shapes).max(axis=1)
    return [int(number) for number in np.flatnonzero((relative > _UNSCALED) & ~faint)]


def _deviation_by_chance(samples: int) -> float:
    """By how much chi-square a sample differs from 1 where noise explains the residuals."""
    return _CHI_SQUARE + _SIGMAS * float(np.sqrt(2.0 / samples))


def _unexplained_share(measured: ModalMeasurement, fit: ModalFit) -> float:
    """What the modes leave beside noise, as a part of the response, root mean square, in the channel where it is largest."""
    noise, power, samples = (np.zeros(len(fit.noise)) for _ in range(3))
    for run in measured.runs:
        known = np.isfinite(run.responses).sum(axis=1)
        noise += run.noise**2 * known
        power += np.nansum(run.responses**2, axis=1)
        samples += known
    beside_noise = np.maximum(fit.noise**2 * samples - noise, 0.0)
    return float(np.sqrt(np.max(beside_noise / np.maximum(power, np.finfo(float).tiny))))


def _verdict(fit: ModalFit, chi_square: float, samples: int, *, unscaled: bool, white: bool) -> Verdict:
    if not fit.converged:
        return Verdict.NOT_CONVERGED
    if abs(chi_square - 1.0) > _deviation_by_chance(samples):
        return Verdict.NOISE_MISMATCH
    if unscaled:
        return Verdict.HARDLY_DETERMINED
    return Verdict.CONVERGED if white else Verdict.COLOURED_RESIDUALS


def _remarks(host: Host, faint: Bools, unscaled: Sequence[int], left: float) -> tuple[str, ...]:
    remarks = []
    if left > 0.0:
        remarks.append(
            f"Linear modes leave {100.0 * left:.2g} % of the response beside noise. If the structure is not quite linear, "
            "they are those of this level, and may be others at a lower one: standard errors are those of the scatter between "
            "parts of the records."
        )
    names = [name for name, is_faint in zip(host.coordinates, faint, strict=True) if is_faint]
    if names:
        remarks.append(
            f"{', '.join(names)} hardly {'stands' if len(names) == 1 else 'stand'} above the noise and may stand for modes "
            "beyond the band that the force excites: stated as known to within wide bounds."
        )
    if unscaled:
        remarks.append(
            f"{', '.join(host.coordinates[number] for number in unscaled)} hardly moves where the force acts, so that the "
            "scale of its shape is not determined: apply a force at another point with a sensor as well."
        )
    return tuple(remarks)


_OPEN_SCALE = (
    "No force was recorded, so that shapes have no scale: they are 1 where they are largest. Frequencies, damping and ratios "
    "of shapes hold. State the masses that move, point by point, or record the force of a hit."
)
_POINTS = 6  # whose shapes are printed
_SHOWN = 3.0  # standard errors from which damping between modes is printed
