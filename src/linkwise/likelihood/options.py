"""Options of a maximum-likelihood fit, and how users type those that `identify` and `discover` share.

Errors of sensors that are estimated with the laws: calibrations by channel, delays of any length, and errors that the
diagnosis names and the user admits.

What is known beforehand of the errors of sensors: what the records state, and what the user asks for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf, isinf
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import CLOCK, HIGH_PASS, Cause
from linkwise.likelihood.random_forces import HarmonicForce, RandomForce
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.likelihood.shooting.minimise import AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.segments import PPM
from linkwise.progress import Progress, silent
from linkwise.records.channel import BAND_LIMITED, COMMON, FORCE, Channel, SensorUncertainty
from linkwise.records.joining import without_delays
from linkwise.records.record import Record

CALIBRATION = {"typed": "CHANNEL=PERCENT%", "unit": "%", "example": "x:m1=1%"}
ADMIT = {"typed": "gain,offset,..."}
CLOCKS = {"typed": "CHANNEL[=PPM]", "unit": "ppm", "example": "a:m1=20"}
HARMONICS = {"typed": "MASS=HZ", "unit": "Hz", "several": True, "example": "m1=4Hz"}
AMBIENT = {"typed": "MASS[=DENSITY]", "unit": "N/sqrt(Hz)", "example": "m1=0.5"}
INPUT_NOISE = {"typed": "CHANNEL[=SIGMA]", "unit": "channel", "example": "force:m1=0.5"}


@dataclass(frozen=True)
class LikelihoodOptions:
    """Options of `likelihood_fit`.

    Parameters
    ----------
    offsets, gains : sequence of str, optional
        Channels with an unknown constant error or factor; of factors also those of applied forces.
    calibration : mapping of str to float, optional
        Relative standard deviations to which gains are known beforehand, by channel; ``"common"`` is a factor of all.
    delays : sequence of str, optional
        Channels with an unknown delay, of 1.5 samples at most; of applied forces, too.
    offset_deviations, delay_deviations : mapping of str to float, optional
        Standard deviations to which offsets and delays are known beforehand, in SI units by channel.
    near : sequence of str, optional
        Channels of these whose delays a diagnosis tells, so that no shifts far away are tried.
    shifts : mapping of str to float, optional
        Parts in s of delays that have been taken out of the records.
    drifts : mapping of str to float or None, optional
        Channels with an unknown slow drift, and the lengths of its pieces in s.
    hums : mapping of str to sequence of float, optional
        Frequencies in Hz of hums of unknown amplitude and phase, by channel.
    corners : mapping of str to float or None, optional
        Channels behind a high pass, with its corner in Hz, or None for one to be found.
    clocks : mapping of str to float or None, optional
        Channels with a clock of their own, with its ratio in ppm, or None for one to be found.
    ratios, clocked : mapping of str to float, mapping of str to tuple of str, optional
        Of these what has been taken out of the records, and the sensors that tell what is left.
    denoised : mapping of str to sequence of array, optional
        What an earlier fit shows in these channels, by record.
    random : sequence of RandomForce, optional
        Random forces on masses.
    harmonics : sequence of HarmonicForce, optional
        Harmonic forces that were not recorded.
    loss : Loss, optional
        Loss of a residual.
    model_error : bool, optional
        Relax the flow by the most likely model error where the residuals are not noise.
    coloured_noise : bool, optional
        With `model_error`, allow for autoregressive noise of sensors where the residuals are that.
    progress : Progress, optional
        Called at every step.
    nodes : array of shape (2n + S, K), optional
        States of another fit to the same records to start from; estimated from the channels by default.
    ceiling : float, optional
        Cost per sample above which the laws are wrong and the continuity is not tightened further.
    steps : int, optional
        Largest number of steps.
    tightest : float, optional
        Relaxation at which the search ends; that of exact laws by default.
    """

    offsets: Sequence[str] = ()
    gains: Sequence[str] = ()
    calibration: Mapping[str, float] = field(default_factory=dict)
    delays: Sequence[str] = ()
    offset_deviations: Mapping[str, float] = field(default_factory=dict)
    delay_deviations: Mapping[str, float] = field(default_factory=dict)
    near: Sequence[str] = ()
    shifts: Mapping[str, float] = field(default_factory=dict)
    drifts: Mapping[str, float | None] = field(default_factory=dict)
    hums: Mapping[str, Sequence[float]] = field(default_factory=dict)
    corners: Mapping[str, float | None] = field(default_factory=dict)
    clocks: Mapping[str, float | None] = field(default_factory=dict)
    ratios: Mapping[str, float] = field(default_factory=dict)
    clocked: Mapping[str, Sequence[str]] = field(default_factory=dict)
    denoised: Mapping[str, Sequence[Floats]] = field(default_factory=dict, repr=False)
    random: Sequence[RandomForce] = ()
    harmonics: Sequence[HarmonicForce] = ()
    loss: Loss = field(default_factory=Gaussian)
    model_error: bool = True
    coloured_noise: bool = True
    progress: Progress = field(default=silent, repr=False)
    nodes: Floats | None = None
    relaxation: float | None = None
    ceiling: float = np.inf
    steps: int = AnnealingSchedule.max_steps
    tightest: float = AnnealingSchedule.final_q

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled, with the fit that it belongs to: all but the progress, which is for this process only."""
        return {**vars(self), "progress": silent}


ALL = "all"
_FIELDS = {
    "gain": "gains", "offset": "offsets", "delay": "delays", "drift": "drifts", HIGH_PASS: "corners", CLOCK: "clocks",
}  # fmt: skip
"""The field of `LikelihoodOptions` that has the channels with an error of each kind that can be admitted."""
ADMISSIBLE = tuple(_FIELDS)
OF_FORCE = "force "  # before the kind of an error of an applied force
_LARGEST = 0.5  # relative deviation of a calibration: the first order does not hold for a sensor that may show half or twice
_WHOLE = 0.6  # samples of delay from which a channel is shifted by whole ones
_BESIDE = 1.0  # samples of delay beyond which the shift beside stands for it: where a fit ends there, it is no optimum
_FAR = (
    -4,
    -2,
    2,
    4,
)  # samples by which a channel is shifted where the nearest ones do not explain the records
_NO_RATIO = 0.1  # standard errors
_NO_SLIP = 0.02  # samples, over a record
_SHRINKING = (
    0.5  # of a ratio that a fit finds, the most that the next one leaves: of right laws it is a few percent
)
_SHIFTS = 8  # of channels, at most: beyond the delays wander


class Fitted(Protocol):
    """What a search gives: how it ended, how well the laws fit, and the delays in s that it found by channel."""

    @property
    def status(self) -> AnnealingStatus: ...

    @property
    def chi_square(self) -> float: ...

    @property
    def chi_square_off(self) -> bool: ...

    @property
    def model_error(self) -> float: ...

    @property
    def delays(self) -> Mapping[str, float]: ...

    @property
    def clocks(self) -> Mapping[str, tuple[float, float]]: ...


class Diagnosed(Protocol):
    """An answer with a diagnosis of what it leaves."""

    @property
    def diagnosis(self) -> tuple[Cause, ...]: ...


Fit = TypeVar("Fit", bound=Fitted)
Answer = TypeVar("Answer", bound=Diagnosed)
Search: TypeAlias = Callable[[Sequence[Record], LikelihoodOptions], Fit]
Report: TypeAlias = Callable[[Fit, Sequence[Record], Mapping[str, float]], Answer]


def by_channel(
    calibration: Mapping[str, float], responses: Sequence[str], forces: Sequence[str] = ()
) -> dict[str, float]:
    """Relative deviations of gains by channel, and of that common to the responses; `ALL` stands for responses without one.

    Raises IdentificationError for a channel that is neither a response nor among the `forces`, or a deviation that is not
    small and positive.
    """
    channels = (*responses, *forces)
    for name, deviation in calibration.items():
        if name not in (*channels, ALL, COMMON):
            beside = f" and the forces {', '.join(forces)}" if forces else ""
            raise IdentificationError(
                f"no calibration of {name} can be stated{near_miss(name, channels)}: the record has the sensors "
                f'{", ".join(responses)}{beside}; "{ALL}" stands for each sensor and "{COMMON}" for a factor that they share',
                arguments=("calibration",),
            )
        if not 0.0 < deviation <= _LARGEST:
            raise IdentificationError(
                f"the calibration of {name} must be a relative standard deviation above 0 and up to {_LARGEST:g}, "
                f"got {deviation:g}",
                arguments=("calibration",),
            )
    defaults = dict.fromkeys(responses, calibration[ALL]) if ALL in calibration else {}
    return defaults | {name: deviation for name, deviation in calibration.items() if name != ALL}


def require_known_kinds(channels: Sequence[Sequence[str]], admitted: Sequence[str]) -> None:
    """Raise IdentificationError for a kind of error that cannot be admitted, and a channel named twice for one kind."""
    for named in channels:
        repeated = [name for name in dict.fromkeys(named) if list(named).count(name) > 1]
        if repeated:
            raise IdentificationError(f"{repeated[0]} is named twice; an error of a channel is one unknown")
    for kind in admitted:
        if kind not in ADMISSIBLE:
            raise IdentificationError(
                f'unknown error of a sensor "{kind}"{near_miss(kind, ADMISSIBLE)}; choose from {", ".join(ADMISSIBLE)}',
                arguments=("admit",),
            )


def late_channels(record: Record, channel: str) -> tuple[str, ...]:
    """The channels whose delays stand for that of a channel: all responses for the only input, late as they are early.

    That of one of several applied forces is its own. None for one that is not band-limited between its samples, for a base
    beside other inputs, and for a channel of a link.
    """
    if channel in record.inputs and len(record.inputs) > 1:
        is_smooth = record.interpolation.get(channel, BAND_LIMITED) == BAND_LIMITED
        return (channel,) if channel.startswith(FORCE) and is_smooth else ()
    stand_in = record.responses if channel in record.inputs else (channel,)
    return tuple(name for name in stand_in if Channel.parse(name).is_motion)


def beside_clocks(delays: Sequence[str], clocks: Collection[str], record: Record) -> tuple[str, ...]:
    """Channels with an unknown delay, among them those with a clock of their own, which the middle of a record may be late by.

    Raises IdentificationError for a channel whose clock cannot be told from those of other inputs.
    """
    for name in clocks:
        recorded = record.responses if len(record.inputs) > 1 else record.channels
        if name not in recorded or not late_channels(record, name):
            raise IdentificationError(
                f"no clock of {name} can be estimated{near_miss(name, recorded)}; clocks are those of sensors of masses, or "
                "of the only input. Name the sensors that another device recorded",
                arguments=("clocks",),
            )
    late = dict.fromkeys(late for name in clocks for late in late_channels(record, name))
    return (*delays, *(name for name in late if name not in delays))


def mean_by_precision(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The mean of values with standard errors, each weighted by its precision, and its own."""
    sizes, deviations = np.array(pairs).T
    weights = 1.0 / np.maximum(deviations, np.finfo(float).tiny) ** 2
    if not weights.any():
        return float(sizes.mean()), inf
    return float(sizes @ weights / weights.sum()), float(weights.sum() ** -0.5)


def clock_found(fit: Fitted, options: LikelihoodOptions, name: str) -> tuple[float, float]:
    """What a fit finds of the ratio of a clock in ppm, beside what was taken out, and its standard error.

    Sensors are late as their only input is early.
    """
    members = options.clocked[name]
    ratio, error = mean_by_precision([fit.clocks[member] for member in members])
    return (ratio if name in members else -ratio), error


def _bases(record: Record) -> tuple[str, ...]:
    """The inputs of which no gain can be found: motions of a base."""
    return tuple(channel for channel in record.inputs if not channel.is_force)


def is_admissible(cause: Cause) -> bool:
    """Whether a cause is an error of a sensor or of an applied force that can be estimated with the laws."""
    return cause.kind.removeprefix(OF_FORCE) in ADMISSIBLE


def with_error(options: LikelihoodOptions, cause: Cause, record: Record) -> LikelihoodOptions | None:
    """The options with the error of a sensor that a cause names as an unknown; None where none can be, or is one already."""
    kind, channel = cause.kind.removeprefix(OF_FORCE), cause.where
    named, present = _FIELDS[kind], getattr(options, _FIELDS[kind])
    more = late_channels(record, channel) if kind == "delay" else (channel,)
    bases = () if kind in ("delay", CLOCK) else _bases(record)
    if channel in (*bases, *present) or set(more) <= set(present):
        return None
    found: Any = (
        {**present, channel: None}
        if isinstance(present, Mapping)
        else tuple(dict.fromkeys((*present, *more)))
    )
    wider = replace(options, **{named: found})
    if kind == CLOCK:
        return replace(wider, delays=beside_clocks(options.delays, wider.clocks, record))
    return replace(wider, near=(*options.near, *more)) if kind == "delay" else wider


def with_delays(
    search: Search[Fit],
    records: Sequence[Record],
    options: LikelihoodOptions,
    report: Report[Fit, Answer],
    finish: Callable[[Fit, Sequence[Record]], Fit],
) -> tuple[Answer, bool]:
    """The `report` on the fit, once it is finished; channels that are late by more than a part of a sample are shifted by
    whole ones, and fitted again.

    Where the laws do not explain the records then, shifts further away are tried, since a delay has other optima about a part
    of a period away. Also whether an interrupt ended the search.
    """
    best = _on_one_clock(search, records, options)
    of_clocks = {late for name in options.clocks for late in late_channels(records[0], name)}
    if len({record.rate for record in records}) == 1:
        for name in options.delays:
            if name not in (*options.delay_deviations, *options.near, *of_clocks):  # known to be near
                best = _at_best_shift(best, name)
    shown = best.shifts.of(best.late)
    best = replace(best, fit=finish(best.fit, shown))
    return report(best.fit, shown, best.delays), _interrupted(best)


def _on_one_clock(
    search: Search[Fit], records: Sequence[Record], options: LikelihoodOptions
) -> _ShiftedFit[Fit]:
    """The fit at settled delays, in records out of which the ratios of clocks are taken that it finds.

    What a fit finds of them is small then, as its first order takes it for.
    """
    late: Mapping[str, int] = dict.fromkeys(options.delays, 0)
    ratios = {name: stated or 0.0 for name, stated in options.clocks.items()}
    timed = {name: late_channels(records[0], name) for name in options.clocks}
    clocked = {name: timed[name] for name, stated in options.clocks.items() if stated is None}
    before = dict.fromkeys(clocked, inf)
    for _ in range(_SHIFTS):
        slips = {
            member: ratios[name] if name in members else -ratios[name]
            for name, members in timed.items()
            for member in members
        }
        own = [without_delays(record, {}, clocks=slips) for record in records]
        options = replace(options, ratios=ratios, clocked=clocked)
        best = _settled(_Shifts(search, own, options), late)
        found = {name: clock_found(best.fit, options, name) for name in clocked}
        if _interrupted(best) or all(_is_small(*pair, own[0]) for pair in found.values()):
            return best
        if any(abs(ratio) > max(_SHRINKING * before[name], error) for name, (ratio, error) in found.items()):
            break
        late = best.late
        before = {name: abs(ratio) for name, (ratio, _) in found.items()}
        ratios = {name: ratio + found[name][0] if name in found else ratio for name, ratio in ratios.items()}
    raise IdentificationError(
        f"the clock of {', '.join(clocked)} does not settle: fits, in each of which the ratio of the last one was taken out, "
        "do not agree. State it (ppm), or take a shorter part of the record"
    )


@dataclass(frozen=True, eq=False)
class _Shifts(Generic[Fit]):
    """A search in records of which channels are shifted by whole samples, and the fits `known` by these."""

    search: Search[Fit]
    records: Sequence[Record]
    options: LikelihoodOptions
    known: dict[tuple[int, ...], Fit] = field(default_factory=dict)

    @property
    def step(self) -> float:
        return self.records[0].step

    def of(self, late: Mapping[str, int]) -> list[Record]:
        return [_shifted(record, late) for record in self.records]

    def fitted(self, late: Mapping[str, int]) -> _ShiftedFit[Fit]:
        shift = tuple(late.values())
        if shift not in self.known:
            taken_out = {name: samples * self.step for name, samples in late.items()}
            self.known[shift] = self.search(self.of(late), replace(self.options, shifts=taken_out))
        return _ShiftedFit(self, late, self.known[shift])


@dataclass(frozen=True, eq=False)
class _ShiftedFit(Generic[Fit]):
    """A fit with channels that are `late` by whole samples shifted."""

    shifts: _Shifts[Fit]
    late: Mapping[str, int]
    fit: Fit

    @property
    def delays(self) -> dict[str, float]:
        """All of the delays in s, by channel."""
        return {
            name: samples * self.shifts.step + self.fit.delays[name] for name, samples in self.late.items()
        }

    @property
    def is_exact(self) -> bool:
        """Whether noise explains what the laws leave."""
        return not self.fit.chi_square_off and self.fit.model_error == 0.0

    @property
    def is_optimum(self) -> bool:
        """Whether the delays are such that no other shift stands for them; at the end of their range they have no errors."""
        return all(abs(delay) <= _BESIDE * self.shifts.step for delay in self.fit.delays.values())

    @property
    def misfit(self) -> tuple[bool, float]:
        """By which fits at other shifts are ordered; a model error says little, as it depends on the noise beside it."""
        return not self.is_exact, self.fit.chi_square

    def beside(self, name: str, samples: int) -> _ShiftedFit[Fit] | None:
        """The fit with a channel shifted by some samples more; None where there is none, as the motion runs to infinity."""
        try:
            return self.shifts.fitted({**self.late, name: self.late[name] + samples})
        except IdentificationError:
            return None


def _settled(shifts: _Shifts[Fit], late: Mapping[str, int]) -> _ShiftedFit[Fit]:
    """The fit at shifts beside which delays are parts of a sample."""
    moved: dict[str, int] = {}
    for _ in range(_SHIFTS):
        shifted = shifts.fitted(late)
        moved = {
            name: round(delay / shifts.step)
            for name, delay in shifted.fit.delays.items()
            if abs(delay) > _WHOLE * shifts.step
        }
        if not moved or shifted.fit.status is AnnealingStatus.INTERRUPTED:
            return shifted
        if len({record.rate for record in shifts.records}) > 1:
            raise IdentificationError(
                f"{next(iter(moved))} is late by more than a sample, which cannot be found from records of different "
                f"rates together: find it from one of them, and remove it from all (without_delays)"
            )
        late = {**late, **{name: late[name] + samples for name, samples in moved.items()}}
    raise IdentificationError(
        f"the delay of {', '.join(moved)} does not settle: {_SHIFTS} fits, each shifted by the last one's delay, do not "
        "agree. Estimate it from signals that move together (inspect), and take it out (without_delays)"
    )


def _at_best_shift(shifted: _ShiftedFit[Fit], name: str) -> _ShiftedFit[Fit]:
    """The fit at the shift of a channel from which one sample more or less explains the records worse."""
    if shifted.is_exact:
        return shifted
    best = _nearest(shifted, name)
    if best.is_exact or _interrupted(best):
        return best
    neighbours = []
    for samples in _FAR:
        neighbour = shifted.beside(name, samples)
        if neighbour is not None and _interrupted(neighbour):
            return neighbour
        neighbours += [] if neighbour is None else [neighbour]
    nearest = min(neighbours, key=lambda neighbour: neighbour.misfit, default=best)
    if not nearest.misfit < best.misfit:
        return best
    far = _nearest(nearest, name)
    return far if far.is_optimum or _interrupted(far) else best


def _is_small(ratio: float, error: float, record: Record) -> bool:
    """Whether a ratio in ppm, known to an `error`, is hardly different from one, or no sample moves by it."""
    return abs(ratio) < max(_NO_RATIO * error, _NO_SLIP / (PPM * len(record)))


def _interrupted(shifted: _ShiftedFit[Fit]) -> bool:
    return shifted.fit.status is AnnealingStatus.INTERRUPTED


def _nearest(start: _ShiftedFit[Fit], name: str) -> _ShiftedFit[Fit]:
    """The same, sample by sample from a fit."""
    forward = 1 if start.fit.delays[name] >= 0.0 else -1
    for direction in (forward, -forward):
        best = start
        for _ in range(_SHIFTS):
            if best.is_exact or _interrupted(best):
                return best
            neighbour = best.beside(name, direction)
            if neighbour is not None and _interrupted(neighbour):
                return neighbour
            if neighbour is None or not neighbour.misfit < best.misfit:
                break
            best = neighbour
        if best is not start and best.is_optimum:
            return best
    return start


def _shifted(record: Record, late: Mapping[str, int]) -> Record:
    """The record with channels that are `late` by whole samples set beside the others, cut to what all have."""
    if not any(late.values()):
        return record
    first = max(0, *(-samples for samples in late.values()))
    count = len(record) - first - max(0, *late.values())
    rows: dict[str, slice] = {
        name: slice(first + late.get(name, 0), first + late.get(name, 0) + count) for name in record.channels
    }
    columns = [record.values[rows[name], column] for column, name in enumerate(record.channels)]
    return replace(
        record,
        start=record.start + first * record.step,
        values=np.stack(columns, axis=1),
        simulated=None,
        clipped={name: clipped.rows(rows[name]) for name, clipped in record.clipped.items()},
    )


def errors_to_find(
    records: Sequence[Record],
    *,
    offsets: Sequence[str] = (),
    gains: Sequence[str] = (),
    calibration: Mapping[str, float] | None = None,
    delays: Sequence[str] = (),
) -> dict[str, Any]:
    """The fields of `LikelihoodOptions` for the errors of sensors.

    Parameters
    ----------
    records : sequence of Record
        The records, and what they state (`Record.uncertainty`) of their responses and applied forces.
    offsets, gains, delays : sequence of str, optional
        Channels with an unknown error, whatever the records state of it; gains and delays also those of applied forces.
    calibration : mapping of str to float, optional
        Relative standard deviations of gains, as of `MaximumLikelihood`; they go before what the records state.

    Returns
    -------
    dict
        `offsets`, `gains`, `calibration`, `delays` and the standard deviations of offsets and delays.

    Raises
    ------
    IdentificationError
        If records state different things of a channel, a gain, delay or calibration is that of none in them, or a gain or
        delay that of a force that is 0 throughout.
    """
    stated = _stated(records)
    requested = dict(calibration or {})
    inputs, forces = records[0].inputs, records[0].forces
    _require_acting((*gains, *delays), records)
    delays = [
        channel
        for name in delays
        for channel in ((name in inputs and late_channels(records[0], name)) or (name,))
    ]
    named = {
        name: known.gain
        for name, known in stated.items()
        if known.gain and not isinf(known.gain) and name not in (*requested, *gains)
    }
    free = {name: known for name, known in stated.items() if isinf(known.gain) and name not in requested}
    if ALL in requested:
        named = (
            dict.fromkeys((name for name in records[0].responses if name not in free), requested[ALL]) | named
        )
    named |= {name: sigma for name, sigma in requested.items() if name != ALL}
    by_channel(requested, records[0].responses, forces)
    deviations = {
        kind: _deviations(stated, kind, own) for kind, own in (("offset", offsets), ("delay", delays))
    }
    return {
        "offsets": _with(offsets, stated, "offset"),
        "gains": (*gains, *(name for name in free if name not in gains)),
        "calibration": by_channel(named, records[0].responses, forces),
        "delays": _with(delays, stated, "delay"),
        "offset_deviations": deviations["offset"],
        "delay_deviations": deviations["delay"],
    }


def unknown_gains(errors: Mapping[str, Any]) -> tuple[str, ...]:
    """The channels of whose gains nothing is known, among `errors_to_find`."""
    return tuple(name for name in errors["gains"] if name not in errors["calibration"])


def _with(requested: Sequence[str], stated: Mapping[str, SensorUncertainty], kind: str) -> Sequence[str]:
    """The channels that are asked for, and those of which such an error is stated."""
    more = [name for name, known in stated.items() if getattr(known, kind) and name not in requested]
    return (*requested, *more) if more else requested


def _deviations(
    stated: Mapping[str, SensorUncertainty], kind: str, requested: Sequence[str]
) -> dict[str, float]:
    sigmas = {name: float(getattr(known, kind)) for name, known in stated.items() if name not in requested}
    return {name: sigma for name, sigma in sigmas.items() if sigma and not isinf(sigma)}


def _require_acting(named: Sequence[str], records: Sequence[Record]) -> None:
    """Raise IdentificationError for an error of a force that no channel shows, or that its channel shows nowhere."""
    forces = records[0].forces
    for name in (name for name in dict.fromkeys(named) if name.startswith(FORCE)):
        if name not in forces:
            raise IdentificationError(
                f"no gain or delay of {name} can be estimated{near_miss(name, forces)}: the record "
                f"{'has the forces ' + ', '.join(forces) if forces else 'shows no applied force'}"
            )
        if not any(np.any(record.channel(name)) for record in records):
            raise IdentificationError(
                f"no gain or delay of {name} can be estimated: it is 0 throughout the "
                f"{'record' if len(records) == 1 else 'records'}. If no force acts there, leave its gain and delay out; if "
                "one does, its channel is dead, and the motion cannot be explained without it"
            )


def _stated(records: Sequence[Record]) -> dict[str, SensorUncertainty]:
    """What the records state of their responses and forces; IdentificationError where they disagree."""
    stated: dict[str, SensorUncertainty] = {}
    for record in records:
        for name, known in _counted(record).items():
            if stated.setdefault(name, known) != known:
                first, second = (
                    uncertainty.described(name).rstrip(".").partition(": ")[2]
                    for uncertainty in (stated[name], known)
                )
                raise IdentificationError(
                    f"records that are taken together state different errors of {name}: {first}, and {second}; state the same "
                    "of all, for instance in a mapping file"
                )
    return stated


def _counted(record: Record) -> dict[str, SensorUncertainty]:
    """What a record states and the likelihood counts, with the delay of the only input as one of each response.

    Of forces that is the gain and, beside other inputs, the delay.
    """
    stated = {
        name: known for name, known in record.uncertainty.items() if name in (COMMON, *record.responses)
    }
    for name, known in record.uncertainty.items():
        if name not in record.inputs:
            continue
        if name.startswith(FORCE) and known.gain:
            stated[name] = SensorUncertainty(gain=known.gain)
        for channel in late_channels(record, name) if known.delay else ():
            own = stated.get(channel, SensorUncertainty())
            stated[channel] = replace(own, delay=hypot(own.delay, known.delay))
    return stated


def uncounted(records: Sequence[Record], method: str) -> tuple[str, ...]:
    """Sentences on what records state of sensors that `method` does not count."""
    every = method == "ml"
    names = [
        name
        for record in records
        for name in record.uncertainty
        if not every or (name not in (COMMON, *record.responses) and not _is_counted(record, name))
    ]
    if not names:
        return ()
    listed = ", ".join(dict.fromkeys(names))
    of_inputs = "offsets of forces and errors of a base are not estimated"
    why = of_inputs if every else 'method "ml" alone counts errors of sensors'
    return (f"What is stated of the errors of {listed} is not counted: {why}.",)


def _is_counted(record: Record, name: str) -> bool:
    """Whether all that is stated of an input is its gain, if it is a force, and a delay that can be estimated."""
    known, is_force = record.uncertainty[name], name.startswith(FORCE)
    late = not known.delay or bool(late_channels(record, name))
    return (is_force or not known.gain) and not known.offset and late
