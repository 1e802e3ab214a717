"""Mapping files: what the columns of the records of a test are, and what is known of its sensors, stated once.

```toml
rate = "1 kHz"                  # of files without a time column
decimate = 4                    # resample = "1 kHz"; header = "Time" or the number of the line
calibration = "1 %"             # of all sensors; common_calibration = "1 %" for a factor that they share

[time]
column = "Time"
unit = "ms"

[channel."x:m1"]
column = "Laser 1"              # a header, or a number from 1
unit = "mm"
calibration = "0.5 %"           # gain = 1.02, "unknown" or "1.02 +- 1 %"
offset = "+- 0.1 mm"            # "0.3 mm" where it is known, "unknown"
delay = "2 ms"                  # "2 ms +- 0.1 ms", "unknown"
noise = "5 um"
interpolation = "held"          # of inputs

[mass]
m1 = "1.2 kg"
```

What record files state of their sensors: attributes of columns, or a text of JSON by channel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.errors import LinkwiseError, RecordError
from linkwise.files.table import Column, ColumnHeader
from linkwise.model.link import ANGLE, LENGTH, MASS_UNITS, is_inertia
from linkwise.model.toml import decode, parse_toml, read_toml_text
from linkwise.records.channel import COMMON, Channel
from linkwise.records.record import Record
from linkwise.records.sensor_statement import SensorStatement, attributes_of
from linkwise.units import to_si

_COLUMN = ("column", "unit")


class _ColumnTable(msgspec.Struct, forbid_unknown_fields=True):
    column: str | int = "time"
    unit: str = ""


class _ChannelTable(msgspec.Struct, forbid_unknown_fields=True):
    column: str | int | None = None
    unit: str = ""
    calibration: float | str | None = None
    gain: float | str | dict[str, float | str] | None = None
    offset: float | str | dict[str, float | str] | None = None
    delay: float | str | dict[str, float | str] | None = None
    noise: float | str | None = None
    interpolation: str | None = None


class _MappingTable(msgspec.Struct, forbid_unknown_fields=True):
    channel: dict[str, Any] = {}
    time: _ColumnTable | None = None
    mass: dict[str, float | str] = {}
    rate: float | str | None = None
    resample: float | str | None = None
    decimate: int | None = None
    header: str | int | None = None
    calibration: float | str | None = None
    common_calibration: float | str | None = None


@dataclass(frozen=True)
class RecordMapping:
    """What the columns of a record are, and what is known of its sensors.

    Parameters
    ----------
    channels : mapping of str to str or int, optional
        Column of each channel, or of ``"time"``, as of `read_record`.
    sensors : mapping of str to SensorStatement, optional
        What is stated of sensors, by channel; ``"common"`` is a gain that all share.
    calibration : float, optional
        Relative standard deviation of the gain of every response of which nothing else is stated.
    masses : mapping of str to float or str, optional
        Masses by name: in kg, "unknown", or a text with the moment of inertia of what turns, as ``"20 g m^2"``.
    rate, resample : float, optional
        As of `read_record`.
    decimate : int, optional
        The factor by which the sampling rate is reduced, behind an anti-alias filter.
    header : str or int, optional
        The header line of a text file: its number from 1, or a text that it contains.
    source : str, optional
        Where the mapping comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "sensors.toml"
    ...     _ = path.write_text('[channel."x:m1"]\\ncolumn = "laser"\\nunit = "mm"\\ncalibration = "1 %"')
    ...     mapping = lw.files.read_mapping(path)
    ...     run = Path(folder) / "run.csv"
    ...     rows = (f"{k / 100},{k % 7}" for k in range(100))
    ...     _ = run.write_text("\\n".join(["time,laser", *rows]))
    ...     record = lw.read_record(run, mapping=mapping)
    >>> record.uncertainty["x:m1"].gain, float(record.channel("x:m1").max())
    (0.01, 0.006)
    """

    channels: Mapping[str, str | int] = field(default_factory=dict)
    sensors: Mapping[str, SensorStatement] = field(default_factory=dict)
    calibration: float | None = None
    masses: Mapping[str, float | str] = field(default_factory=dict)
    rate: float | None = None
    resample: float | None = None
    decimate: int | None = None
    header: str | int | None = None
    source: str = ""

    def over(self, other: RecordMapping) -> RecordMapping:
        """Return this mapping, and of another one what it does not state.

        Parameters
        ----------
        other : RecordMapping
            The other one.

        Returns
        -------
        RecordMapping
            Both.
        """
        own = {channel_of(key) for key in self.channels}
        added_channels = {key: column for key, column in other.channels.items() if channel_of(key) not in own}
        sensors = dict(other.sensors)
        for name, stated in self.sensors.items():
            sensors[name] = stated.over(sensors.get(name, SensorStatement()))
        settings = {name: value for name, value in vars(self).items() if value not in (None, {}, "")}
        together = {"channels": {**added_channels, **self.channels}, "sensors": sensors}
        return replace(other, **{**settings, **together})


def channel_of(key: str) -> str:
    """The name of the channel that a key of `channels` maps, without its unit, or "time"."""
    header = ColumnHeader.parse(key)
    return "time" if header.is_time else header.name


def read_mapping(path: str | Path) -> RecordMapping:
    """Read a mapping file: columns, units, masses and sensors, stated once for all records of a test.

    Parameters
    ----------
    path : str or Path
        A TOML file. At its top `rate`, `resample`, `decimate`, `header`, `calibration` of all sensors and
        `common_calibration`; the tables ``[time]`` and ``[channel."x:m1"]`` with `column` and `unit`, a channel also with
        `calibration`, `gain`, `offset`, `delay`, `noise` and `interpolation`; and ``[mass]`` with masses by name.

    Returns
    -------
    RecordMapping
        The mapping.

    Raises
    ------
    RecordError
        If the file cannot be read; the error names file, key and what was expected.

    See Also
    --------
    read_record : Read a record from a file.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "sensors.toml"
    ...     _ = path.write_text('rate = "1 kHz"\\n[channel."x:m1"]\\ncolumn = 2\\noffset = "+- 0.1 mm"')
    ...     mapping = lw.files.read_mapping(path)
    >>> mapping.rate, dict(mapping.channels), mapping.sensors["x:m1"].offset.sigma
    (1000.0, {'x:m1': 2}, 0.0001)
    """
    source = str(path)
    data = parse_toml(read_toml_text(path, RecordError), source, RecordError)
    table = decode(data, _MappingTable, source, "", RecordError)
    if table.decimate is not None and table.decimate < 1:
        raise RecordError(f"decimate: must be a positive integer, got {table.decimate}", source)
    channels: dict[str, str | int] = {}
    sensors: dict[str, SensorStatement] = {}
    if table.time is not None:
        channels[f"time[{table.time.unit}]" if table.time.unit else "time"] = table.time.column
    for name, content in table.channel.items():
        known = _checked_name(name, source)
        entry = decode(content, _ChannelTable, source, f'channel."{name}"', RecordError)
        if entry.column is not None or entry.unit:
            key = f"{known}[{entry.unit}]" if entry.unit else known
            channels[key] = known if entry.column is None else entry.column
        stated = {key: value for key, value in content.items() if key not in _COLUMN}
        if stated:
            sensors[known] = SensorStatement.of(stated, known, source)
    if table.common_calibration is not None:
        sensors[COMMON] = SensorStatement.of({"calibration": table.common_calibration}, COMMON, source)
    of_all = {} if table.calibration is None else {"calibration": table.calibration}
    gain = SensorStatement.of(of_all, COMMON, source).gain
    return RecordMapping(
        channels,
        sensors,
        None if gain is None else gain.sigma,
        {name: _stated_mass(mass, source, f"mass.{name}") for name, mass in table.mass.items()},
        _rate(table.rate, source, "rate"),
        _rate(table.resample, source, "resample"),
        table.decimate,
        table.header,
        source,
    )


def _checked_name(name: str, source: str) -> Channel:
    """The name of a channel; RecordError names the key."""
    header = ColumnHeader.parse(name)
    if header.unit:
        raise RecordError(f'channel."{name}": write the unit as a key of its own, as in unit = "mm"', source)
    try:
        return header.stated_channel()
    except RecordError as error:
        raise RecordError(f'channel."{name}": {error.message}', source) from error


def _rate(given: object, source: str, key: str) -> float | None:
    return None if given is None else _positive_si(given, "Hz", source, key)


def _stated_mass(given: object, source: str, key: str) -> float | str:
    """A mass in kg, "unknown", or a text with a moment of inertia; RecordError names the key."""
    if isinstance(given, str) and is_inertia(given):
        _positive_si(given, MASS_UNITS[ANGLE], source, key)
        return given
    return "unknown" if given == "unknown" else _positive_si(given, MASS_UNITS[LENGTH], source, key)


def _positive_si(given: object, dimension: str, source: str, key: str) -> float:
    """A positive number in SI units; RecordError names the key."""
    try:
        value = to_si(given, dimension)
    except LinkwiseError as error:
        raise RecordError(f"{key}: {error}", source) from error
    if not value > 0.0:
        raise RecordError(f"{key}: must be positive, got {given!r}", source)
    return value


_KEYS = ("calibration", "gain", "offset", "delay")  # "noise" of a column is read with the noise of others
_EXAMPLES = {"calibration": "1 %", "gain": "1.02 +- 1 %", "offset": "+- 0.1 mm", "delay": "+- 1 ms"}
_SHOWN = 40  # characters of an attribute that a note quotes


def stated_in(attributes: Mapping[str, Any]) -> dict[str, object]:
    """The attributes that state an error of a sensor, as numbers and texts."""
    return {name: _plain(attributes[name]) for name in _KEYS if name in attributes}


def _plain(value: Any) -> object:
    """A number or a text; what is neither as the text of it, which a message quotes."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    array = np.asarray(value)
    if array.size == 1 and array.dtype.kind in "iuf":
        return float(array.flat[0])
    if array.size == 1 and array.dtype.kind in "SUO":
        scalar = array.flat[0]
        return scalar.decode("utf-8", "replace") if isinstance(scalar, bytes) else str(scalar)
    return str(value)


def statement_of(attributes: Mapping[str, object], channel: str) -> tuple[SensorStatement, tuple[str, ...]]:
    """What the attributes of a column state of its sensor, and a sentence on each that does not say it.

    Programs write attributes of these names for other ends, such as the date of a calibration or the gain of an amplifier:
    texts that can be read are taken, and numbers without a unit are not.
    """
    statement, remarks = SensorStatement(), []
    for key, value in attributes.items():
        try:
            if not isinstance(value, str):
                raise RecordError("a number without a unit")
            statement = SensorStatement.of({key: value}, channel).over(statement)
        except RecordError:
            remarks.append(
                f"The attribute {key} of {channel}, {str(value)[:_SHOWN]!r}, was not used: write what is known of the "
                f"sensor as a text, such as {_EXAMPLES[key]!r}."
            )
    return statement, tuple(remarks)


def with_attributes(
    columns: tuple[Column, ...], attributes: Mapping[str, Mapping[str, object]]
) -> tuple[Column, ...]:
    """The columns with the `attributes` of the arrays that they are from, by the name of the array without its unit."""
    names = [ColumnHeader.parse(column.header.partition("(:,")[0]).name for column in columns]
    named = zip(columns, names, strict=True)
    return tuple(replace(column, attributes=attributes.get(name, {})) for column, name in named)


def as_statements(stated: object, file: Path) -> dict[str, dict[str, object]]:
    """What a JSON text, or the objects in it, states by channel; none where it is no such text.

    Raises RecordError for an object that does not hold objects.
    """
    text = msgspec.json.encode(stated).decode() if isinstance(stated, dict) else str(_plain(stated)).strip()
    if not text.startswith("{"):
        return {}  # an array or a setting of that name
    try:
        return msgspec.json.decode(text, type=dict[str, dict[str, object]])
    except msgspec.MsgspecError as error:
        message = f'`sensors` is not what is known of sensors by channel, as in {{"x:m1": {{"calibration": "1 %"}}}}: {error}'
        raise RecordError(message, file) from error


def sensors_of(record: Record) -> dict[str, dict[str, str]]:
    """What `as_statements` reads back as the uncertainty of the sensors of a record."""
    return {
        name: attributes_of(known, "" if name == COMMON else record.unit(name))
        for name, known in record.uncertainty.items()
    }
