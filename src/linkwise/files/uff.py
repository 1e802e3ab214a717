"""Universal files: time responses, or else frequency response functions, of data sets of type 58, ASCII or binary.

Measured frequency response functions as the record of a pulse, whose spectrum is 1 N at every line that was measured.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.files.table import Column, Table
from linkwise.records.record import Record
from linkwise.registry import lazy_module
from linkwise.units import converts

pyuff = lazy_module("pyuff")  # of an extra

_PER_PERIOD = 8  # samples of the highest frequency: splines through them follow the pulse
_BEFORE = 0.1  # of the period, before the pulse
_EVEN = 1e-4  # of the spacing of lines: what single precision leaves of it


def record_of_responses(frequencies: ArrayLike, responses: Mapping[str, ArrayLike], *, force: str) -> Record:
    """The record of one period of the steady motion under pulses, from frequency response functions of one force.

    It is read as any other record: by `modal.identify_host`, and by `identify` and `validate`. What a function says of
    a line, the record says, and nothing of others.

    Parameters
    ----------
    frequencies : array of shape (L,)
        Evenly spaced frequencies in Hz, multiples of their spacing.
    responses : mapping of str to complex array of shape (L,)
        By channel, such as ``"a:beam.tip"``, motion per force in SI units, with motion of exp(i w t).
    force : str
        The channel of the force, such as ``"force:beam.tip"``.

    Returns
    -------
    Record
        The force and the motions, at 8 times the highest frequency.

    Raises
    ------
    RecordError
        If frequencies are not evenly spaced multiples, or a response has not as many lines.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> hz = np.arange(1.0, 21.0, 0.5)
    >>> s = 2j * np.pi * hz
    >>> receptance = 1.0 / (s**2 + 2 * 0.01 * 40.0 * s + 40.0**2)
    >>> record = lw.files.record_of_responses(hz, {"x:arm.tip": receptance}, force="force:arm.tip")
    >>> record.channels, record.duration < 2.0
    (('force:arm.tip', 'x:arm.tip'), True)
    """
    hz = np.asarray(frequencies, dtype=np.float64)
    spacing = (hz[-1] - hz[0]) / (len(hz) - 1) if hz.ndim == 1 and len(hz) > 1 else 0.0
    lines = np.rint(hz / spacing).astype(int) if spacing > 0.0 else np.zeros(0, dtype=int)
    if not len(lines) or np.abs(hz - lines * spacing).max() > _EVEN * spacing * lines.max() or lines[0] < 0:
        raise RecordError(
            "frequencies of response functions must be evenly spaced multiples of their spacing"
        )
    count = _PER_PERIOD * int(lines[-1])
    at = np.exp(-2j * np.pi * lines * _BEFORE)

    def motion(name: str, values: ArrayLike) -> Floats:
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        measured = np.asarray(values)
        if measured.shape != hz.shape:
            raise RecordError(f"has {measured.size} lines, and there are {len(hz)} frequencies", channel=name)
        known = np.isfinite(measured) & (lines > 0)
        spectrum[lines[known]] = (measured * at)[known]
        return np.asarray(np.fft.irfft(spectrum, count) * 0.5 * count)

    columns = [motion(force, np.ones(len(hz))), *(motion(*entry) for entry in responses.items())]
    return Record(0.0, count * spacing, (force, *responses), np.column_stack(columns))


_TIME_RESPONSE, _RESPONSE_FUNCTION = 1, 4
_EVEN_SPACING = 1
_KINDS = {8: "x", 9: "force", 11: "v", 12: "a", 13: "force"}  # ordinate_spec_data_type
_MARK = re.compile(rb"    -1(?=[\r\n]|\Z| {74})")
"""The line before and after each data set, as pyuff finds it."""
_DIRECTIONS = ("", "x", "y", "z", "rx", "ry", "rz")  # by number
_NONE = frozenset({"", "NONE"})


def read_table(path: Path) -> Table:
    """One column per time response, named by its first ID line; see `files.read_record`.

    A response whose ID line does not name a channel stands for KIND:NODE, from the quantity and node of the data set. Raises
    RecordError for a file without time responses and for responses that do not share one time axis.
    """
    content = path.read_bytes()
    marks = [match.start() for match in _MARK.finditer(content)]
    if len(marks) % 2:  # pyuff leaves such a set out
        line = content.count(b"\n", 0, marks[-1]) + 1
        raise RecordError("the data set that begins here has no end; the file was cut off", path, line)
    file = pyuff.UFF(str(path))
    unreadable = [str(k + 1) for k, kind in enumerate(file.get_set_types()) if kind == 0]
    if unreadable:
        damaged = f"data set {', '.join(unreadable)}"
        raise RecordError(f"the type of {damaged} cannot be read; the file is damaged", path)
    read = file.read_sets()
    sets = [data for data in (read if isinstance(read, list) else [read]) if data.get("type") == 58]
    responses = [data for data in sets if data["func_type"] == _TIME_RESPONSE]
    functions = [data for data in sets if data["func_type"] == _RESPONSE_FUNCTION]
    if functions and not responses:
        return _of_response_functions(functions, path)
    if not responses:
        raise RecordError("contains no time response (data set 58, function type 1)", path)
    others = [_column_of_set(data).header for data in sets if data["func_type"] != _TIME_RESPONSE]
    notes = (f"Data sets that are not time responses were ignored: {', '.join(others)}.",) if others else ()
    first, columns = responses[0], tuple(map(_column_of_set, responses))
    for data, column in zip(responses, columns, strict=True):
        if len(data["data"]) != data["num_pts"]:
            message = f"has {len(data['data'])} samples of {data['num_pts']} that the file states; the file is damaged"
            raise RecordError(message, path, channel=column.header)
        if data["abscissa_spacing"] != first["abscissa_spacing"] or not np.array_equal(data["x"], first["x"]):
            other = f"has a different time axis than {columns[0].header}"
            raise RecordError(other, path, channel=column.header)
    if first["abscissa_spacing"] != _EVEN_SPACING:
        return Table((Column("time", np.asarray(first["x"])), *columns), notes=notes)
    rate = _sampling_rate(float(first["abscissa_inc"]))
    return Table(columns, start=float(first["abscissa_min"]), rate=rate, notes=notes)


def _of_response_functions(sets: list[dict[str, Any]], path: Path) -> Table:
    """The record of a pulse that these give, in the units that they state.

    RecordError where they are of several forces or lines, or one is given twice or of a quantity that is not stated.
    """
    references = {_point_name(data, "ref") for data in sets}
    if len(references) > 1:
        raise RecordError(
            f"holds response functions of forces at {', '.join(sorted(references))}; keep those of one in a file, "
            "and give a file for each",
            path,
        )
    if any(len(data["x"]) != len(sets[0]["x"]) or np.any(data["x"] != sets[0]["x"]) for data in sets):
        raise RecordError("holds response functions of different lines", path)
    force, responses, units = f"force:{references.pop()}", {}, {}
    for data in sets:
        place = _point_name(data, "rsp")
        if data["ordinate_spec_data_type"] not in _KINDS:
            raise RecordError(
                f"does not state which motion the response function of {place} is of; write it with the ordinate data type 8 "
                "(displacement), 11 (velocity) or 12 (acceleration)",
                path,
            )
        name = f"{_KINDS[data['ordinate_spec_data_type']]}:{place}"
        if name in responses:
            raise RecordError(f"holds two response functions of {name}; keep one of them", path)
        opposed = data["rsp_dir"] * data["ref_dir"] < 0  # response and force along axes of opposite senses
        responses[name] = -data["data"] if opposed else data["data"]
        units[name], of_force = _unit_of_set(data)
        if units.setdefault(force, of_force) != of_force:
            raise RecordError(f"holds response functions per {units[force]} and per {of_force}", path)
    record = record_of_responses(sets[0]["x"], responses, force=force)
    headers = [f"{name}[{units[name]}]" if units[name] else str(name) for name in record.channels]
    columns = tuple(map(Column, headers, map(record.channel, record.channels)))
    note = f"Response functions stand as the motion under a pulse of 1 {units[force] or 'N'} at every line."
    return Table(columns, start=record.start, rate=record.rate, notes=(note,))


def _unit_of_set(data: dict[str, Any]) -> tuple[str, str]:
    """What a response and its force are in; empty where that is not stated, and SI. The former may state both, as g/N."""
    labels = (str(data.get(f"{axis}_axis_units_lab", "")).strip() for axis in ("ordinate", "orddenom"))
    response, force = ("" if label in _NONE else label for label in labels)
    motion, _, per = response.rpartition("/")
    if not converts(per.strip(" ()"), "N"):
        return response, force
    return motion.strip(" ()"), force or per.strip(" ()")


def _point_name(data: dict[str, Any], end: str) -> str:
    """The entity, or the node and the direction, as in files of modes."""
    entity = str(data[f"{end}_ent_name"]).strip()
    direction = _DIRECTIONS[abs(int(data[f"{end}_dir"]))]
    return entity if entity not in _NONE else f"{data[f'{end}_node']}{direction}"


def _column_of_set(data: dict[str, Any]) -> Column:
    kind = _KINDS.get(data["ordinate_spec_data_type"], "")
    entity = data["rsp_ent_name"].strip()
    place = entity if entity not in _NONE else str(data["rsp_node"])
    label = data["id1"].strip()
    header = label if label not in _NONE else f"node {place}"
    unit = data.get("ordinate_axis_units_lab", "").strip()
    unit = "" if unit in _NONE or header.endswith((")", "]")) else f"[{unit}]"
    return Column.of(f"{header}{unit}", np.asarray(data["data"]), f"{kind}:{place}" if kind else "")


def _sampling_rate(step: float) -> float:
    """The rate with the fewest digits whose interval prints as `step` does: the format keeps six digits of it."""
    printed = f"{step:.5e}"
    for digits in range(1, 16):
        rate = float(f"{1.0 / step:.{digits - 1}e}")
        if f"{1.0 / rate:.5e}" == printed:
            return rate
    return 1.0 / step
