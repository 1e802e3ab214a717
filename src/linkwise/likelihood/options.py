"""Options of a maximum-likelihood fit, and how users type those that `identify` and `discover` share.

Errors of sensors that are estimated with the laws: calibrations by channel, and errors that the diagnosis names and the user
admits.

What is known beforehand of the errors of sensors: what the records state, and what the user asks for.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf, isinf
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import CLOCK, HIGH_PASS, Cause
from linkwise.likelihood.random_forces import HarmonicForce, RandomForce
from linkwise.likelihood.rigs.motion import PrescribedMotion
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.likelihood.shooting.minimise import AnnealingSchedule
from linkwise.progress import Progress, silent
from linkwise.records.channel import BAND_LIMITED, COMMON, FORCE, SensorUncertainty
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
    motions : sequence of PrescribedMotion, optional
        On a rig the motions that the records prescribe, whose noise is allowed for.
    deviations : array of shape (C, K), optional
        Standard deviations by which residuals are weighed, over segments; by default those of the noise of the channels.
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
    motions: Sequence[PrescribedMotion] = ()
    deviations: Floats | None = None
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
    of_input = channel in record.inputs
    return tuple(name for name in record.responses if name.is_motion and (of_input or name == channel))


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
    return {
        "offsets": _with(offsets, stated, "offset"),
        "gains": (*gains, *(name for name in free if name not in gains)),
        "calibration": by_channel(named, records[0].responses, forces),
        "delays": _with(delays, stated, "delay"),
        "offset_deviations": _deviations(stated, "offset", offsets),
        "delay_deviations": _deviations(stated, "delay", delays),
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
