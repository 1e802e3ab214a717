"""A first mapping file for a record: its columns, with quantities guessed from their units and names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path

import msgspec

from linkwise.display import on_one_line
from linkwise.errors import LinkwiseError, RecordError
from linkwise.files.columns import recognised
from linkwise.files.header import ColumnHeader
from linkwise.files.table import Table
from linkwise.records.channel import KINDS, MOTIONS, Channel, is_angular
from linkwise.units import factor_to_si

_NAMES = (
    (re.compile(r"acc|beschl|pcb|imu", re.IGNORECASE), "a"),
    (re.compile(r"vel|geschw|ldv|vibrometer|geophone", re.IGNORECASE), "v"),
    (re.compile(r"laser|lvdt|disp|pos|weg|deflection|encoder", re.IGNORECASE), "x"),
    (re.compile(r"force|load|kraft|shaker|hammer", re.IGNORECASE), "force"),
)
_TIMES = re.compile(r"(?:time|zeit|t)\b|time", re.IGNORECASE)
_HEAD = """# A mapping file of linkwise: what the columns are and what is known of the sensors, for all records of a test.
# Written from {path}. Check the names of the masses, the quantities and the units.

# rate = "1 kHz"                 # sampling rate of files without a time column
# decimate = 4                   # keep every 4th sample, behind an anti-alias filter
# calibration = "1 %"            # to which the gains of all sensors are known
# Of one channel: calibration = "1 %", offset = "+- 0.1 mm" (or "0.3 mm", "unknown"), delay = "2 ms" (or "2 ms +- 0.1 ms",
# "unknown"), gain = 1.02, noise = "5 um"; interpolation = "held" of an input.
"""
_MASSES = """
# [mass]                         # for a discovery
# m1 = "1.0 kg"
"""


def first_mapping(table: Table, path: Path) -> tuple[str, tuple[str, ...]]:
    """The text of a mapping file for the columns of a table, and a sentence on each quantity that was guessed.

    Raises RecordError where no column holds numbers.
    """
    known, blocks, guesses = recognised(table, str(path)), [], []
    spare: list[str | int] = []
    names = [ColumnHeader.parse(text).leaf.name for text in table.headers]
    headers = {
        number: ColumnHeader.parse(column.header).leaf
        for number, column in enumerate(table.columns)
        if column.values is not None
    }
    guessed = _guessed_names(headers, known)
    for number, header in headers.items():
        label = header.name if table.named and header.name and names.count(header.name) == 1 else number + 1
        name, unit, remark = known.get(number, ""), header.unit, ""
        if not name and number not in guessed:
            spare.append(label)
            continue
        if not name:
            name, why = guessed[number]
            if not isinstance(name, Channel):
                unit, remark = unit or "s", f"guessed from its {why}"
                guesses.append(f"Column {label} was guessed to be the time.")
            else:
                remark = f"guessed from its {why}; of which mass?"
                quantity = _article(KINDS[name.kind].quantity)
                guesses.append(f"Column {label} was guessed from its {why} to be {quantity}, {name}.")
        known[number] = name
        blocks.append(_block(name, label, unit, remark))
    if not blocks and not spare:
        raise RecordError("no column holds numbers, so there is nothing to map", path)
    unused = [f"\n# not used: {', '.join(map(_quoted, spare))}\n"] if spare else []
    if set(known.values()) <= {"time"} and spare:
        example = _block(Channel("x", "m1"), spare[0], "mm", "").strip().split("\n")
        unused += ["\n", *(f"# {line}\n" for line in example)]
    return _HEAD.format(path=on_one_line(path.name)) + "".join([*blocks, *unused, _MASSES]), tuple(guesses)


def _guessed_names(
    headers: Mapping[int, ColumnHeader], known: Mapping[int, Channel | str]
) -> dict[int, tuple[Channel | str, str]]:
    """The channel or "time" that each column not `known` may be, and what says so; forces act on masses that move."""
    guessed: dict[int, tuple[Channel | str, str]] = {}
    of_forces = []
    for number, header in headers.items():
        if number in known:
            continue
        named = [*known.values(), *(name for name, _ in guessed.values())]
        kind, why = _guessed(header)
        if "time" not in named and _TIMES.match(header.name):
            guessed[number] = "time", "name"
        elif kind == "force":
            of_forces.append((number, why))
        elif kind:
            guessed[number] = Channel(kind, _free_mass(named)), why
    for number, why in of_forces:
        named = [*known.values(), *(name for name, _ in guessed.values())]
        guessed[number] = Channel("force", _driven_mass(named)), why
    return guessed


def _free_mass(named: Iterable[Channel | str]) -> str:
    """The first of m1, m2, ... that none of the channels has."""
    masses = {channel.place for channel in named if isinstance(channel, Channel)}
    return next(f"m{number}" for number in count(1) if f"m{number}" not in masses)


def _driven_mass(named: Iterable[Channel | str]) -> str:
    """The first mass of a sensor among the channels on which none of them acts; without one the first of m1, m2, ..."""
    channels = [channel for channel in named if isinstance(channel, Channel)]
    driven = [channel.place for channel in channels if channel.is_force]
    moving = [channel.place for channel in channels if channel.is_motion and not channel.is_input]
    return next((mass for mass in sorted(moving) if mass not in driven), _free_mass(named))


def _guessed(header: ColumnHeader) -> tuple[str, str]:
    """The kind of channel that a header may stand for, and what says so; none where nothing does."""
    for kind in (*MOTIONS, "force"):
        if is_angular(header.unit, kind):
            return kind, "unit"
        try:
            factor_to_si(header.unit, KINDS[kind].unit)
        except LinkwiseError:
            continue
        return kind, "unit"
    return next(((kind, "name") for pattern, kind in _NAMES if pattern.search(header.name)), ("", ""))


def _block(name: Channel | str, column: str | int, unit: str, remark: str) -> str:
    title = "[time]" if name == "time" else f"[channel.{_quoted(name)}]"
    lines = ["", f"{title}{f'  # {remark}' if remark else ''}", f"column = {_quoted(column)}"]
    if unit:
        lines.append(f"unit = {_quoted(unit)}")
    elif isinstance(name, Channel):
        lines.append(f'# unit = "{name.unit}"')
    return "\n".join([*lines, ""])


def _quoted(text: str | int) -> str:
    """A number, or a text as TOML writes it, which for all but DEL is as JSON does."""
    return msgspec.json.encode(text, enc_hook=str).decode().replace("\x7f", "\\u007f")


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
