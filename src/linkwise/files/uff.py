"""Universal files: time responses, or else frequency response functions, of data sets of type 58, ASCII or binary."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from linkwise.errors import LinkwiseError, RecordError
from linkwise.files.response_functions import record_of_responses
from linkwise.files.table import Column, Table
from linkwise.units import factor_to_si

_TIME_RESPONSE, _RESPONSE_FUNCTION = 1, 4
_EVEN = 1
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
    sets = file.read_sets()
    sets = [data for data in (sets if isinstance(sets, list) else [sets]) if data.get("type") == 58]
    if not any(data["func_type"] == _TIME_RESPONSE for data in sets):
        functions = [data for data in sets if data["func_type"] == _RESPONSE_FUNCTION]
        if functions:
            return _of_response_functions(functions, path)
    others = [_column(data).header for data in sets if data["func_type"] != _TIME_RESPONSE]
    notes = (f"Data sets that are not time responses were ignored: {', '.join(others)}.",) if others else ()
    sets = [data for data in sets if data["func_type"] == _TIME_RESPONSE]
    if not sets:
        raise RecordError("contains no time response (data set 58, function type 1)", path)
    columns = tuple(_column(data) for data in sets)
    first = sets[0]
    for data, column in zip(sets, columns, strict=True):
        if len(data["data"]) != data["num_pts"]:
            message = f"has {len(data['data'])} samples of {data['num_pts']} that the file states; the file is damaged"
            raise RecordError(message, path, channel=column.header)
        if data["abscissa_spacing"] != first["abscissa_spacing"] or not np.array_equal(data["x"], first["x"]):
            other = f"has a different time axis than {columns[0].header}"
            raise RecordError(other, path, channel=column.header)
    if first["abscissa_spacing"] != _EVEN:
        return Table((Column("time", np.asarray(first["x"])), *columns), notes=notes)
    rate = _rate(float(first["abscissa_inc"]))
    return Table(columns, start=float(first["abscissa_min"]), rate=rate, notes=notes)


def _of_response_functions(sets: list[dict[str, Any]], path: Path) -> Table:
    """The record of a pulse that these give, in the units that they state.

    RecordError where they are of several forces or lines, or one is given twice or of a quantity that is not stated.
    """
    references = {_point(data, "ref") for data in sets}
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
        place = _point(data, "rsp")
        if data["ordinate_spec_data_type"] not in _KINDS:
            raise RecordError(
                f"does not state which motion the response function of {place} is of; write it with the ordinate data type 8 "
                "(displacement), 11 (velocity) or 12 (acceleration)",
                path,
            )
        name = f"{_KINDS[data['ordinate_spec_data_type']]}:{place}"
        if name in responses:
            raise RecordError(f"holds two response functions of {name}; keep one of them", path)
        responses[name] = _sign(data) * data["data"]
        units[name], of_force = _units(data)
        if units.setdefault(force, of_force) != of_force:
            raise RecordError(f"holds response functions per {units[force]} and per {of_force}", path)
    record = record_of_responses(sets[0]["x"], responses, force=force)
    headers = [f"{name}[{units[name]}]" if units[name] else str(name) for name in record.channels]
    columns = tuple(map(Column, headers, map(record.channel, record.channels)))
    note = f"Response functions stand as the motion under a pulse of 1 {units[force] or 'N'} at every line."
    return Table(columns, start=record.start, rate=record.rate, notes=(note,))


def _units(data: dict[str, Any]) -> tuple[str, str]:
    """What a response and its force are in; empty where that is not stated, and SI. The former may state both, as g/N."""
    labels = (str(data.get(f"{axis}_axis_units_lab", "")).strip() for axis in ("ordinate", "orddenom"))
    response, force = ("" if label in _NONE else label for label in labels)
    motion, _, per = response.rpartition("/")
    try:
        factor_to_si(per.strip(" ()"), "N")
    except LinkwiseError:
        return response, force
    return motion.strip(" ()"), force or per.strip(" ()")


def _point(data: dict[str, Any], end: str) -> str:
    """The entity, or the node and the direction, as in files of modes."""
    entity = str(data[f"{end}_ent_name"]).strip()
    direction = _DIRECTIONS[abs(int(data[f"{end}_dir"]))]
    return entity if entity not in _NONE else f"{data[f'{end}_node']}{direction}"


def _sign(data: dict[str, Any]) -> float:
    """-1 where response and force point in opposite senses of their axes."""
    return -1.0 if data["rsp_dir"] * data["ref_dir"] < 0 else 1.0


def _column(data: dict[str, Any]) -> Column:
    kind = _KINDS.get(data["ordinate_spec_data_type"], "")
    entity = data["rsp_ent_name"].strip()
    place = entity if entity not in _NONE else str(data["rsp_node"])
    label = data["id1"].strip()
    header = label if label not in _NONE else f"node {place}"
    unit = data.get("ordinate_axis_units_lab", "").strip()
    unit = "" if unit in _NONE or header.endswith((")", "]")) else f"[{unit}]"
    return Column.of(f"{header}{unit}", np.asarray(data["data"]), f"{kind}:{place}" if kind else "")


def _rate(step: float) -> float:
    """The rate with the fewest digits whose interval prints as `step` does: the format keeps six digits of it."""
    printed = f"{step:.5e}"
    for digits in range(1, 16):
        rate = float(f"{1.0 / step:.{digits - 1}e}")
        if f"{1.0 / rate:.5e}" == printed:
            return rate
    return 1.0 / step
