"""What a laboratory states of a sensor: gain, offset, delay and noise; known errors are taken out of its samples."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from math import inf, isfinite
from typing import Any, NamedTuple

from linkwise.display import near_miss
from linkwise.errors import LinkwiseError, RecordError
from linkwise.records.channel import COMMON, KINDS, Channel, SensorUncertainty, si_unit, size_in_unit
from linkwise.records.joining import without_delays
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_channel
from linkwise.units import to_si

_NO_CALIBRATION = 0.2  # relative: a number from here on was meant as a percentage
_IN_UNIT = ("offset", "noise")  # which are in the unit of the channel
KEYS = ("calibration", "gain", "offset", "delay", "noise", "interpolation")
_NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*")
_WITHIN = re.compile(r"\s*(?:\+-|\+/-|±)\s*")
_EXAMPLES = {"gain": "1.02", "offset": "0.3 {unit}", "delay": "2 ms"}
_IF_IT_TURNS = {kind.unit: kind.angular_unit for kind in KINDS.values()}
_PLAIN = {"gain": 1.0, "offset": 0.0, "delay": 0.0}


class StatedError(NamedTuple):
    """The size of an error of a sensor, and the standard deviation to which it is known.

    Attributes
    ----------
    value : float
        The size: a factor for a gain, the SI unit of the channel for an offset, s for a delay.
    sigma : float
        Its standard deviation; 0 where it is known, infinity where nothing is.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.records.SensorStatement.of({"delay": "2 ms +- 0.5 ms"}, "x:m1").delay
    StatedError(value=0.002, sigma=0.0005)
    """

    value: float
    sigma: float = 0.0


@dataclass(frozen=True)
class SensorStatement:
    """What is stated of one sensor; None where nothing is.

    A sensor shows `gain` times the motion of `delay` s before, and `offset`.

    Parameters
    ----------
    gain, offset, delay : StatedError, optional
        Errors of the sensor. What is known is taken out of its samples, and the rest is found with the laws.
    noise : float, optional
        Standard deviation of its noise, in the SI unit of the channel.
    interpolation : str, optional
        How an input runs between its samples.
    unit : str, optional
        The SI unit of offset and noise, where a text stated one: ``"m"``, or ``"rad"`` of what turns.

    Examples
    --------
    >>> import linkwise as lw
    >>> stated = lw.records.SensorStatement.of({"calibration": "1 %", "offset": "0.3 mm"}, "x:m1")
    >>> stated.gain.sigma, stated.offset.value
    (0.01, 0.0003)
    """

    gain: StatedError | None = None
    offset: StatedError | None = None
    delay: StatedError | None = None
    noise: float | None = None
    interpolation: str | None = None
    unit: str | None = None

    @classmethod
    def of(cls, stated: Mapping[str, object], channel: str, file: str | None = None) -> SensorStatement:
        """Read what a mapping file or the attributes of a record file state.

        Parameters
        ----------
        stated : mapping of str to object
            The keys calibration, gain, offset, delay, noise and interpolation: numbers in SI units, or texts such as
            ``"0.3 mm"``, ``"0.3 mm +- 0.1 mm"``, ``"+- 0.1 mm"`` and ``"unknown"``; a gain of ``"1 %"`` is known
            to within that.
        channel : str
            The channel, or ``"common"``.
        file : str, optional
            The file, for errors.

        Returns
        -------
        SensorStatement
            The statement.

        Raises
        ------
        RecordError
            If a key is unknown or a value cannot be read; the error names file, channel and key.
        """
        sensor = None if channel == COMMON else Channel.parse(channel)
        units = [unit for key in _IN_UNIT for unit in _units(stated.get(key), sensor)]
        unit = units[0] if units else sensor.unit if sensor else ""
        for key in stated:
            if key not in KEYS:
                message = f"unknown key {key!r}{near_miss(key, KEYS)}; the keys are {', '.join(KEYS)}"
                raise RecordError(message, file, channel=channel)
        values: dict[str, Any] = {"unit": unit} if units else {}
        for key, given in stated.items():
            try:
                values[key] = _value(key, given, unit)
            except LinkwiseError as error:
                raise RecordError(f"{key}: {error}", file, channel=channel) from error
        calibration = values.pop("calibration", None)
        if calibration is not None:
            gain = values.get("gain", StatedError(1.0))
            if gain.sigma:
                message = "calibration and gain both say how well the gain is known; leave one of them out"
                raise RecordError(message, file, channel=channel)
            values["gain"] = StatedError(gain.value, abs(gain.value) * calibration)
        return cls(**values)

    def over(self, other: SensorStatement) -> SensorStatement:
        """Return this statement, and of another one what it does not say.

        Parameters
        ----------
        other : SensorStatement
            The other one.

        Returns
        -------
        SensorStatement
            Both.

        Raises
        ------
        RecordError
            If one is stated in m and the other in rad.
        """
        if None not in (self.unit, other.unit) and self.unit != other.unit:
            message = f"what is stated of a sensor is in {other.unit} and in {self.unit}: correct one of them"
            raise RecordError(message)
        given = {member.name: getattr(self, member.name) for member in fields(self)}
        return replace(other, **{name: value for name, value in given.items() if value is not None})

    @property
    def uncertainty(self) -> SensorUncertainty:
        """What remains to be found when the known errors are taken out."""
        gain, offset, delay = (getattr(self, name) or StatedError(_PLAIN[name]) for name in _PLAIN)
        return SensorUncertainty(gain.sigma / abs(gain.value), offset.sigma / abs(gain.value), delay.sigma)


def _units(given: object, sensor: Channel | None) -> list[str]:
    """The SI units of the texts of a quantity in the unit of a sensor, which may turn or not."""
    if sensor is None or not sensor.angular_unit:
        return []
    texts = given.values() if isinstance(given, Mapping) else (given,)
    parts = (part for text in texts if isinstance(text, str) for part in _WITHIN.split(text))
    units = [_NUMBER.sub("", part, count=1).strip() for part in parts if part.strip() != "unknown"]
    return [si_unit(unit, sensor.kind) for unit in units if unit]


def _known_within(text: str, dimension: str, kind: str) -> StatedError:
    """Read "0.3 mm", "0.3 mm +- 0.1 mm", "+- 0.1 mm" or "unknown" as an error of this kind; "1 %" of a gain is "+- 1 %".

    Raises LinkwiseError for anything else.
    """
    if text.strip() == "unknown":
        return StatedError(_PLAIN[kind], inf)
    parts = _WITHIN.split(text.strip())
    is_tolerance = len(parts) == 1 and not dimension and text.strip().endswith("%")
    parts = [""] * is_tolerance + parts
    try:
        if len(parts) > 2 or not parts[-1] or (is_tolerance and not _si(text, "") < _NO_CALIBRATION):
            raise LinkwiseError(f"{text!r} cannot be read")
        value = _PLAIN[kind] if len(parts) == 2 and not parts[0] else _si(parts[0], dimension)
        return StatedError(value, _deviation(parts[1], dimension, value) if len(parts) == 2 else 0.0)
    except LinkwiseError as error:
        example = _EXAMPLES[kind].format(unit=dimension)
        within = f"{example} +- {'1 %' if kind == 'gain' else example}"
        angular = _IF_IT_TURNS.get(dimension, "")
        raise LinkwiseError(
            f"{str(error).rstrip('.')}; write '{example}' for a known {kind}, '{within}' for one that is known to within a "
            f"standard deviation, or 'unknown'{angular and f'; of what turns, in {angular}'}"
        ) from error


def _si(given: object, dimension: str) -> float:
    """A number, plain or as a text, in SI units; a percentage where a number without unit is expected."""
    if isinstance(given, str):
        text = given.strip()
        if not dimension and text.endswith("%"):
            return 0.01 * _si(text[:-1], "")
        with suppress(ValueError):  # of a text with a unit
            given = float(text)
    return to_si(given, dimension)


def _deviation(given: object, dimension: str, value: float) -> float:
    """A standard deviation in SI units; a percentage is of the value that it belongs to."""
    deviation = _si(given, dimension)
    return deviation * abs(value) if not dimension and str(given).strip().endswith("%") else deviation


def _value(key: str, given: object, unit: str) -> Any:
    """The value of one key of a sensor."""
    if key == "interpolation":
        return str(given)
    if key in ("calibration", "noise"):
        sigma = _si(given, "" if key == "calibration" else unit)
        if sigma < 0.0:
            raise LinkwiseError(f"a standard deviation must not be negative, got {given!r}")
        if key == "noise" and sigma == 0.0:
            raise LinkwiseError("a noise of 0 takes every sample as exact; leave it out, and it is estimated")
        if key == "calibration" and sigma >= _NO_CALIBRATION and not str(given).strip().endswith("%"):
            raise LinkwiseError(
                f"{given} is {100.0 * sigma:g} % of what the sensor shows; write '{given} %' for a percentage"
            )
        return sigma
    stated = _stated(key, given, {"gain": "", "offset": unit, "delay": "s"}[key])
    if not isfinite(stated.value) or stated.sigma < 0.0:
        raise LinkwiseError(f"a standard deviation must not be negative, got {given!r}")
    if key == "gain" and stated.value == 0.0:
        raise LinkwiseError("a gain of 0 shows no motion; leave the channel out")
    return stated


def _stated(key: str, given: object, dimension: str) -> StatedError:
    if isinstance(given, Mapping):
        wrong = [name for name in given if name not in ("start", "sigma")]
        if wrong or "sigma" not in given:
            raise LinkwiseError(f"a table has the keys start and sigma, got {', '.join(map(str, given))}")
        start = _si(given["start"], dimension) if "start" in given else _PLAIN[key]
        return StatedError(start, _deviation(given["sigma"], dimension, start))
    if isinstance(given, str):
        return _known_within(given, dimension, key)
    return StatedError(_si(given, dimension))


def with_statements(record: Record, stated: Mapping[str, SensorStatement], file: str | None = None) -> Record:
    """The record without the known errors of its sensors, with what is known of the others and of their noise.

    Raises RecordError for a channel that is not in the record, and for a known error that all sensors share.
    """
    if not stated:
        return record
    values, notes = record.values.copy(), []
    noise, runs, uncertainty = dict(record.noise), dict(record.interpolation), dict(record.uncertainty)
    units = {**record.units, **_units_stated(record, stated, file)}
    late: dict[str, float] = {}
    channels: dict[str, Channel] = {channel: channel for channel in record.channels}
    for given, statement in stated.items():
        name = channels.get(given, given)
        if name == COMMON:
            _require_gain_around_one(statement, file)
        known = statement.uncertainty
        uncertainty.pop(name, None)
        if known:
            uncertainty[name] = known
        if any(0.0 < sigma < inf for sigma in (known.gain, known.offset, known.delay)):
            # what is unknown is found, and told then
            notes.append(known.described(name, units.get(name, "")))
        if name == COMMON:
            continue
        require_channel(name, record.channels, "errors of its sensor", file)
        gain, offset = statement.gain or StatedError(1.0), statement.offset or StatedError(0.0)
        if statement.noise is not None:
            noise[name] = statement.noise
        if offset.value or gain.value != 1.0:
            column = record.channels.index(name)
            values[:, column] = (values[:, column] - offset.value) / gain.value
            if name in noise:
                noise[name] /= abs(gain.value)
            size = size_in_unit(offset.value, record.channels[column], units.get(name, ""))
            errors = [f"an offset of {size}"] * bool(offset.value)
            errors += [f"a gain of {gain.value:g}"] * (gain.value != 1.0)
            were = "were" if len(errors) == 2 else "was"
            notes.append(f"{name}: {' and '.join(errors)} {were} removed, as known.")
        if statement.delay is not None and statement.delay.value:
            late[name] = statement.delay.value
        corrected = {"gain": gain.value != 1.0, "offset": offset.value, "delay": late.get(name)}
        doubtful = [kind for kind, given in corrected.items() if given and getattr(known, kind)]
        if doubtful:
            errors_left = " and ".join(doubtful)
            notes.append(f"{name}: what is found of its {errors_left} comes on top of the value stated.")
        if statement.interpolation is not None:
            runs[name] = statement.interpolation
    changed = replace(
        record,
        values=values,
        noise=noise,
        interpolation=runs,
        uncertainty=uncertainty,
        units=units,
        notes=(*record.notes, *notes),
    )
    return without_delays(changed, late)


def _units_stated(record: Record, stated: Mapping[str, SensorStatement], file: str | None) -> dict[str, str]:
    """The SI units of channels that statements on their sensors tell; RecordError where the record has another."""
    own = {name: statement.unit for name, statement in stated.items() if name in record.channels}
    units = {name: unit for name, unit in own.items() if unit is not None}
    for name, unit in units.items():
        if record.units.get(name, unit) != unit:
            message = f"is in {record.units[name]}, and what is stated of its sensor is in {unit}: correct one of them"
            raise RecordError(message, file, channel=name)
    return units


def _require_gain_around_one(common: SensorStatement, file: str | None) -> None:
    """Raise RecordError where anything else is stated of all sensors together."""
    gain = common.gain or StatedError(1.0)
    if common != SensorStatement(gain=common.gain) or gain.value != 1.0:
        raise RecordError(
            "of a gain that all sensors share only its standard deviation can be stated, as in '+- 1 %'; state known "
            "errors and noise by channel",
            file,
            channel=COMMON,
        )


def attributes_of(known: SensorUncertainty, unit: str) -> dict[str, str]:
    """The keys, as texts, from which `SensorStatement.of` reads what is known of a sensor that shows its SI `unit`."""
    suffix = f" {unit}".replace(" ?", "")
    stated = (("gain", known.gain, ""), ("offset", known.offset, suffix), ("delay", known.delay, " s"))
    given = (entry for entry in stated if entry[1])
    return {key: "unknown" if sigma == inf else f"+- {sigma!r}{unit}" for key, sigma, unit in given}
