"""What a maximum-likelihood fit is asked for: its options, and the errors of sensors that users or records state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf, isinf
from typing import Any, TypedDict

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import Cause
from linkwise.likelihood.random_forces import HarmonicForce, RandomForce
from linkwise.likelihood.shooting.minimise import AnnealingSchedule
from linkwise.likelihood.shooting.residuals import Gaussian, Loss
from linkwise.likelihood.terms import (
    ERRORS,
    Constant,
    Delay,
    Drift,
    Gain,
    HighPass,
    Hum,
    Offset,
    Stated,
    Term,
    accelerating_base,
    beside_clocks,
    frequencies_by_channel,
    late_channels,
    of_kind,
)
from linkwise.progress import Progress, silent
from linkwise.records.channel import COMMON, SensorUncertainty
from linkwise.records.record import Record

CALIBRATION = {"typed": "CHANNEL=PERCENT%", "unit": "%", "example": "x:m1=1%"}
ADMIT = {"typed": "gain,offset,..."}
CLOCKS = {"typed": "CHANNEL[=PPM]", "unit": "ppm", "example": "a:m1=20"}
CORNERS = {"typed": "CHANNEL[=HZ]", "unit": "Hz", "example": "a:m1=0.5Hz"}
HARMONICS = {"typed": "MASS=HZ", "unit": "Hz", "several": True, "example": "m1=4Hz"}
AMBIENT = {"typed": "MASS[=DENSITY]", "unit": "N/sqrt(Hz)", "example": "m1=0.5"}
INPUT_NOISE = {"typed": "CHANNEL[=SIGMA]", "unit": "channel", "example": "force:m1=0.5"}


class AskedKeywords(TypedDict, total=False):
    """The fields of `AskedFor`, as keywords."""

    offsets: str | Sequence[str]
    gains: str | Sequence[str]
    calibration: Mapping[str, float] | None
    delays: str | Sequence[str]
    drifts: Stated
    hums: Mapping[str, float | Sequence[float]]
    corners: Stated
    clocks: Stated
    harmonics: Mapping[str, float | Sequence[float]]
    ambient: Stated
    input_noise: Stated
    admit: str | Sequence[str]
    as_stated: bool


@dataclass(frozen=True, kw_only=True)
class AskedFor:
    """What `identify` and `discover` are asked to find of sensors and inputs; `MaximumLikelihood` says what each is."""

    offsets: str | Sequence[str] = ()
    gains: str | Sequence[str] = ()
    calibration: Mapping[str, float] = field(default_factory=dict, hash=False, metadata=CALIBRATION)
    delays: str | Sequence[str] = ()
    drifts: Stated = field(default=(), hash=False)
    hums: Mapping[str, float | Sequence[float]] = field(default_factory=dict, hash=False)
    corners: Stated = field(default=(), hash=False, metadata=CORNERS)
    clocks: Stated = field(default=(), hash=False, metadata=CLOCKS)
    harmonics: Mapping[str, float | Sequence[float]] = field(
        default_factory=dict, hash=False, metadata=HARMONICS
    )
    ambient: Stated = field(default=(), hash=False, metadata=AMBIENT)
    input_noise: Stated = field(default=(), hash=False, metadata=INPUT_NOISE)
    admit: str | Sequence[str] = field(default=(), metadata=ADMIT)
    as_stated: bool = field(default=False, metadata={"typed": ""})


@dataclass(frozen=True)
class LikelihoodOptions:
    """Options of `likelihood_fit`.

    Parameters
    ----------
    errors : sequence of Term, optional
        What is unknown of sensors and inputs.
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

    errors: Sequence[Term] = ()
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

    @property
    def is_trial(self) -> bool:
        """Whether searches end early, of laws that may be wrong: what counts of them is whether they leave only noise."""
        return self.steps < AnnealingSchedule.max_steps

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled, with the fit that it belongs to: all but the progress, which is for this process only."""
        return {**vars(self), "progress": silent}


ALL = "all"
OF_FORCE = "force "  # before the kind of an error of an applied force
_LARGEST = 0.5  # relative deviation of a calibration: the first order does not hold for a sensor that may show half or twice


def _calibrated(calibration: Mapping[str, float], record: Record) -> dict[str, float]:
    """Relative deviations of gains by channel, and of that common to the responses; `ALL` stands for responses without one.

    Raises IdentificationError for a channel that is neither a response nor an input that has a gain, or a deviation that is
    not small and positive.
    """
    responses, inputs = record.responses, (*record.forces, *accelerating_base(record))
    channels = (*responses, *inputs)
    for name, deviation in calibration.items():
        if name not in (*channels, ALL, COMMON):
            beside = f" and the inputs {', '.join(inputs)}" if inputs else ""
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


def require_known_kinds(admitted: Sequence[str]) -> None:
    """Raise IdentificationError for a kind of error that cannot be admitted."""
    for kind in admitted:
        if kind not in ERRORS:
            raise IdentificationError(
                f'unknown error of a sensor "{kind}"{near_miss(kind, ERRORS)}; choose from {", ".join(ERRORS)}',
                arguments=("admit",),
            )


def is_admissible(cause: Cause) -> bool:
    """Whether a cause is an error of a sensor or of an applied force that can be estimated with the laws."""
    return cause.kind.removeprefix(OF_FORCE) in ERRORS


def with_error(options: LikelihoodOptions, cause: Cause, record: Record) -> LikelihoodOptions | None:
    """The options with the error of a sensor that a cause names as an unknown; None where none can be, or is one already."""
    error = ERRORS[cause.kind.removeprefix(OF_FORCE)].named_by(cause)
    errors = error.beside(options.errors, record)
    return None if errors is None else replace(options, errors=errors)


def errors_to_find(records: Sequence[Record], sought: AskedFor) -> tuple[Term, ...]:
    """The errors of sensors that a user asks for, and those that records state (`Record.uncertainty`) and he does not.

    Raises IdentificationError if records state different things of a channel, one is named twice, a gain, delay, calibration
    or clock is that of none in them, or a gain or delay that of a force that is 0 throughout.
    """
    offsets, gains, delays, clocks = sought.offsets, sought.gains, sought.delays, sought.clocks
    stated, first = _stated(records), records[0]
    sigmas = _known_gains(sought, stated, first)
    _require_acting((*gains, *delays), records)
    late = [
        channel
        for name in delays
        for channel in ((name in first.inputs and late_channels(first, name)) or (name,))
    ]
    for named in (offsets, gains, late):
        repeated = [name for name in dict.fromkeys(named) if list(named).count(name) > 1]
        if repeated:
            raise IdentificationError(f"{repeated[0]} is named twice; an error of a channel is one unknown")
    asked = beside_clocks((*map(Offset, offsets), *map(Delay, late)), clocks, first)
    known: list[Constant] = [Gain(name, sigma) for name, sigma in sigmas.items()]
    for kind in (Offset, Delay):
        there = {one.channel for one in of_kind(asked, kind)}
        sizes = {name: float(getattr(uncertainty, kind.kind)) for name, uncertainty in stated.items()}
        known += [kind(name, sigma) for name, sigma in sizes.items() if sigma and name not in there]
    humming = frequencies_by_channel(sought.hums or {}).items()
    lines = (Hum(name, frequency) for name, several in humming for frequency in several)
    return (*asked, *known, *Drift.stated(sought.drifts), *lines, *HighPass.stated(sought.corners))


def _known_gains(
    sought: AskedFor, stated: Mapping[str, SensorUncertainty], record: Record
) -> dict[str, float]:
    """To within what each gain that is unknown is known, by channel; infinity where nothing is known of it."""
    gains, calibration = sought.gains, sought.calibration or {}
    free = [name for name, known in stated.items() if isinf(known.gain)]
    known = {name: one.gain for name, one in stated.items() if one.gain and name not in (*free, *gains)}
    calibrated = _calibrated({**known, **calibration}, record)
    return dict.fromkeys((*gains, *free), inf) | {
        name: sigma for name, sigma in calibrated.items() if name in calibration or name not in free
    }


def _require_acting(named: Sequence[str], records: Sequence[Record]) -> None:
    """Raise IdentificationError for an error of a force that its channel shows nowhere."""
    for name in dict.fromkeys(named):
        if name in records[0].forces and not any(np.any(record.channel(name)) for record in records):
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

    Of inputs that is the gain and, beside other inputs, the delay.
    """
    stated = {
        name: known for name, known in record.uncertainty.items() if name in (COMMON, *record.responses)
    }
    for name, known in record.uncertainty.items():
        if name not in record.inputs:
            continue
        if name in Gain(name).sensors(record) and known.gain:
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
    of_inputs = "offsets of forces and of a base are not estimated, nor errors of its displacement"
    why = of_inputs if every else 'method "ml" alone counts errors of sensors'
    return (f"What is stated of the errors of {listed} is not counted: {why}.",)


def _is_counted(record: Record, name: str) -> bool:
    """Whether all that is stated of an input is a gain and a delay that can be estimated."""
    known, has_gain = record.uncertainty[name], name in Gain(name).sensors(record)
    late = not known.delay or bool(late_channels(record, name))
    return (has_gain or not known.gain) and not known.offset and late
