"""What the columns of a file may hold, guessed from units and names, and the mapping file that says so.

A guess has doubts where neither the header nor what is known of the masses settles it: a person answers them, or an option.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from linkwise.display import on_one_line
from linkwise.files.mapping import RecordMapping
from linkwise.files.table import ColumnHeader, Table
from linkwise.files.table_to_record import mapped, numbers, recognised
from linkwise.model.toml import toml_text
from linkwise.records.channel import BASE, KINDS, MOTIONS, Channel, is_angular
from linkwise.units import converts, factor_to_si

NO_UNIT, NO_QUANTITY, NO_MASS, TWICE = "in which unit?", "which quantity?", "of which mass?", "twice"
OTHER_TIME = "other times than the first column of them"
"""Doubts of a guess."""


@dataclass(frozen=True)
class ColumnGuess:
    """What a column may hold.

    Attributes
    ----------
    label : str or int
        What a mapping calls the column: its header without the unit, or its number where several have that header.
    name : Channel or str
        A channel, "time", or "" where nothing is guessed.
    unit : str
        The unit that the header states.
    why : {"", "unit", "name"}
        What the quantity was guessed from; empty where the header, or a person, says the channel itself.
    doubts : tuple of str
        What the header does not settle.
    header : str
        The header as it stands in the file.
    """

    label: str | int
    name: Channel | str
    unit: str
    why: str = ""
    doubts: tuple[str, ...] = ()
    header: str = ""


_NAMES = (
    (re.compile(r"acc|beschl|pcb|imu", re.IGNORECASE), "a"),
    (re.compile(r"vel|geschw|ldv|vibrometer|geophone", re.IGNORECASE), "v"),
    (re.compile(r"laser|lvdt|disp|pos|weg|deflection|encoder", re.IGNORECASE), "x"),
    (re.compile(r"force|load|kraft|shaker|hammer", re.IGNORECASE), "force"),
)
_TIMES = re.compile(r"(?:time|zeit|t|elapsed|seconds?)\b|time", re.IGNORECASE)
_WORDS = re.compile(r"[^\W\d_]+|\d+")
_BASES = {BASE, "basis", "floor", "foundation", "fundament", "ground", "boden", "table", "tisch"}
_OTHERS = {
    "rel", "relative", "relativ", "gap", "spalt", "diff", "difference", "differenz", "delta", "error", "setpoint", "soll",
    "sollwert", "target", "command", "demand", "ref", "reference", "peak", "rms", "mean", "spring", "feder", "reaction",
    "rpm", "weight", "gewicht",
}  # fmt: skip
"""Words of what has a unit of motion or force, and may be neither the motion of a mass nor a force that is applied to it."""
_SENSORS = {
    "sensor", "signal", "channel", "ch", "ai", "dev", "mod", "cdaq", "untitled", "of", "at", "x", "y", "z",
}  # fmt: skip
_CAMEL = re.compile(r"(?<=[a-zäöüß])(?=[A-ZÄÖÜ])")
_RATES = (5.0, 1e7)  # Hz: between which vibrations are sampled


def guessed_columns(
    table: Table,
    masses: Sequence[str] = (),
    channels: Mapping[str, str | int] | None = None,
    left_out: Collection[str] = (),
) -> tuple[ColumnGuess, ...]:
    """What each column that holds numbers may be, for the `masses` there are; `channels` are known, as of `read_record`, and
    nothing is guessed of columns `left_out`, by header or label.

    Raises RecordError where no column holds numbers, or a column of `channels` does not exist or holds text.
    """
    numeric = {number: own.header for number, own in enumerate(table.columns) if own.values is not None}
    headers = {number: _parsed_header(header) for number, header in numeric.items()}
    if not headers:
        raise table.error(f"no column holds numbers alone, so there is nothing to map: {not_numbers(table)}")
    given = mapped(table, channels or {})
    guesses = {
        number: ColumnGuess(_mapping_label(table, number), "", ColumnHeader.parse(header).unit, header=header)
        for number, header in numeric.items()
    }
    for choice in (*given, *recognised(table, given, tuple(masses) or None)):
        if choice.column in guesses:
            guesses[choice.column] = replace(guesses[choice.column], name=choice.name, unit=choice.unit)
        elif table.headers[choice.column] not in left_out:
            numbers(table, choice)
    out = {number for number, guess in guesses.items() if {str(guess.label), guess.header} & set(left_out)}
    for number in out:
        guesses[number] = replace(guesses[number], name="")
        del headers[number]
    _guess_time(table, headers, guesses)
    kinds = {number: _guessed_kind(header) for number, header in headers.items() if not guesses[number].name}
    for forces in (False, True):  # which act on masses that move
        for number, (kind, why) in kinds.items():
            if kind and (kind == "force") is forces:
                place, doubts = _guessed_place(kind, number, guesses, kinds, masses)
                others = _OTHERS.intersection(_words(guesses[number].header)).difference(*map(_words, masses))
                by = why if guesses[number].unit else "name"
                doubts = (*_doubts_of_quantity(headers[number], kind, by, others), *doubts)
                name, unit = Channel(kind, place), headers[number].unit
                guesses[number] = replace(guesses[number], name=name, unit=unit, why=why, doubts=doubts)
            elif not kind and converts(headers[number].unit, "s") and _is_apart(table, number, guesses):
                guesses[number] = replace(guesses[number], doubts=(OTHER_TIME,))
            elif not kind and {*_BASES, *masses} & set(_words(guesses[number].header)):
                guesses[number] = replace(guesses[number], doubts=(NO_QUANTITY,))
    times = Counter(_guessed_names(guesses))
    return tuple(
        replace(guess, doubts=(*guess.doubts, TWICE)) if guess.name and times[guess.name] > 1 else guess
        for guess in guesses.values()
    )


def _guess_time(table: Table, headers: Mapping[int, ColumnHeader], guesses: dict[int, ColumnGuess]) -> None:
    """Guess which column is the time, by its name or by its values, and whether its unit is in doubt."""
    for number, header in headers.items():
        named = _TIMES.match(header.name) and converts(header.unit or "s", "s")
        if not guesses[number].name and named and "time" not in _guessed_names(guesses):
            guesses[number] = replace(guesses[number], name="time", why="name")
    unnamed = [number for number in headers if not guesses[number].name]
    even = [number for number in unnamed if _is_clock(table.columns[number].values)]
    if even and "time" not in _guessed_names(guesses) and table.rate is None:
        guesses[even[0]] = replace(guesses[even[0]], name="time", why="values")
    for number, header in headers.items():
        if guesses[number].name == "time" and not guesses[number].unit:
            unsaid = () if _is_plausible(table, number, header.unit) else (NO_UNIT,)
            guesses[number] = replace(guesses[number], unit=header.unit, doubts=unsaid)


def not_numbers(table: Table) -> str:
    """The columns that hold no numbers, each with the first cell that is none."""
    cells = [
        f"{column.header} holds {column.bad.text!r}{f' in line {column.bad.line}' if column.bad.line else ''}"
        for column in table.columns
        if column.bad is not None
    ]
    return ", ".join(cells)


def _guessed_names(guesses: Mapping[int, ColumnGuess]) -> list[Channel | str]:
    return [guess.name for guess in guesses.values()]


def _mapping_label(table: Table, number: int) -> str | int:
    """What a mapping calls a column."""
    names = [ColumnHeader.parse(text).leaf.name for text in table.headers]
    return names[number] if table.named and names[number] and names.count(names[number]) == 1 else number + 1


def _parsed_header(text: str) -> ColumnHeader:
    """The last part of a header, with the unit behind its last underscore where it states none, as frame_mm does."""
    leaf = ColumnHeader.parse(text).leaf
    name, _, unit = leaf.name.rpartition("_")
    stated = leaf.unit or leaf.channel or not name
    return leaf if stated or not (_kind_of_unit(unit) or converts(unit, "s")) else ColumnHeader(name, unit)


def _is_clock(values: object) -> bool:
    """Whether values grow by even steps, and do not count samples."""
    steps = np.diff(np.asarray(values, dtype=float))
    return len(steps) > 0 and 0.0 < steps.max() < _EVEN * steps.min() and not np.all(steps == 1.0)


def _is_apart(table: Table, number: int, guesses: Mapping[int, ColumnGuess]) -> bool:
    """Whether a column of times is of other moments than the column that was chosen as the time, but for their beginning."""
    chosen = next((column for column, guess in guesses.items() if guess.name == "time"), number)
    first, other = (
        np.diff(np.asarray(table.columns[column].values, dtype=float)) for column in (chosen, number)
    )
    return not np.allclose(first, other, rtol=0.1, equal_nan=True)


def _is_plausible(table: Table, number: int, unit: str) -> bool:
    """Whether a column of times would be sampled at a rate of vibrations, were it in this unit, in s without one."""
    times = np.asarray(table.columns[number].values, dtype=float)
    steps = np.diff(times[np.isfinite(times)]) * factor_to_si(unit or "s", "s")
    return bool(steps.size) and _RATES[0] <= 1.0 / max(float(np.median(steps)), 1e-300) <= _RATES[1]


def _guessed_kind(header: ColumnHeader) -> tuple[str, str]:
    """The kind of channel that a header may stand for, and what says so; none where nothing does."""
    by_unit = _kind_of_unit(header.unit)
    if by_unit:
        return by_unit, "unit"
    by_name = _kind_of_name(header.name)
    return by_name, "name" if by_name else ""


def _kind_of_unit(unit: str) -> str:
    kinds = (*MOTIONS, "force")
    return next((k for k in kinds if is_angular(unit, k) or converts(unit, KINDS[k].unit)), "")


def _kind_of_name(name: str) -> str:
    return next((kind for pattern, kind in _NAMES if pattern.search(name)), "")


def _doubts_of_quantity(
    header: ColumnHeader, kind: str, why: str, others: Collection[str]
) -> tuple[str, ...]:
    """What unit and name do not settle: names tell no unit, and may contradict it, or name something else by `others`."""
    if why == "name":
        return (NO_UNIT,)
    named = {kind for pattern, kind in _NAMES if pattern.search(header.name)}
    contradicted = named and kind not in named and "force" in {kind, *named}
    return (NO_QUANTITY,) if contradicted or others else ()


def _guessed_place(
    kind: str,
    number: int,
    guesses: Mapping[int, ColumnGuess],
    kinds: Mapping[int, tuple[str, str]],
    masses: Sequence[str],
) -> tuple[str, tuple[str, ...]]:
    """The mass, or the base, of a column of this kind, and whether that is in doubt."""
    names, header = _guessed_names(guesses), guesses[number].header
    named = _named_in(header, masses)
    if len(named) == 1:
        return named[0], ()
    bases = _BASES & set(_words(header))
    if bases and not named and kind != "force":
        return BASE, () if BASE in bases else (NO_MASS,)
    alike = [n for n, (other, _) in kinds.items() if other == kind and n != number]
    unsaid = [n for n in alike if len(_named_in(guesses[n].header, masses)) != 1]
    taken = {mass for n in alike for mass in _named_in(guesses[n].header, masses)}
    sure = [guess.name for guess in guesses.values() if NO_MASS not in guess.doubts]
    free = [mass for mass in masses if Channel(kind, mass) not in sure and mass not in taken]
    if len(free) == 1 and not named and not unsaid and (kind != "force" or len(masses) == 1):
        return free[0], ()
    if kind == "force":
        return _driven_mass(names, masses), (NO_MASS,)
    return next((mass for mass in free if Channel(kind, mass) not in names), _free_mass(names)), (NO_MASS,)


def _words(header: str) -> list[str]:
    return [word.lower() for word in _WORDS.findall(_CAMEL.sub(" ", header))]


def _named_in(header: str, masses: Sequence[str]) -> list[str]:
    """The masses whose names stand in a header; else those with the only number in it."""
    words = _words(header)
    named = []
    for mass in masses:
        parts = _words(mass)
        if any(words[start : start + len(parts)] == parts for start in range(len(words))):
            named.append(mass)
    digits = [word for word in _words(ColumnHeader.parse(header).leaf.name) if word.isdecimal()]
    if named or len(digits) != 1:
        return named
    return [mass for mass in masses if [word for word in _words(mass) if word.isdecimal()] == digits]


def proposed_masses(guesses: Iterable[ColumnGuess]) -> tuple[str, ...]:
    """Names for the masses whose motion the columns hold: of their channels, or the last word that says no sensor."""
    names: list[str] = []
    for guess in guesses:
        if not isinstance(guess.name, Channel) or not guess.name.is_motion or guess.name.place == BASE:
            continue
        words = _words(_parsed_header(guess.header).name)
        words = [word for word in words if not (word.isdecimal() or word in _SENSORS or _kind_of_name(word))]
        names.append(words[-1] if words and guess.why else guess.name.place)
    return tuple(dict.fromkeys(names))


def _free_mass(named: Iterable[Channel | str]) -> str:
    """The first of m1, m2, ... that none of the channels has."""
    masses = {channel.place for channel in named if isinstance(channel, Channel)}
    return next(f"m{number}" for number in count(1) if f"m{number}" not in masses)


def _driven_mass(named: Iterable[Channel | str], masses: Sequence[str]) -> str:
    """The first mass of a sensor among the channels on which none of them acts; without one the first of m1, m2, ..."""
    channels = [channel for channel in named if isinstance(channel, Channel)]
    driven = [channel.place for channel in channels if channel.is_force]
    moving = [channel.place for channel in channels if channel.is_motion and not channel.is_input]
    ranked = [*(mass for mass in masses if mass in moving), *sorted(moving)]
    return next((mass for mass in ranked if mass not in driven), _free_mass(channels))


_NOTHING = "nothing says what it is"
_EVEN = 1.5  # times the shortest step: times as a logger prints them
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


def first_mapping(table: Table) -> tuple[str, tuple[str, ...]]:
    """The text of a mapping file for the columns of a table, and a sentence on each quantity that was guessed.

    Raises RecordError where no column holds numbers.
    """
    guesses = guessed_columns(table)
    if {guess.name for guess in guesses} <= {"time", ""}:  # a mapping of nothing could not be read
        guesses = _placeholders(table, guesses)
    return mapping_text(table.file, guesses), tuple(_guess_sentence(guess) for guess in guesses if guess.why)


def _placeholders(table: Table, guesses: Sequence[ColumnGuess]) -> tuple[ColumnGuess, ...]:
    """The guesses with displacements for columns that say nothing of themselves; what grows by even steps is the time."""
    placed: list[ColumnGuess] = []
    columns = [column.values for column in table.columns if column.values is not None]
    for guess, values in zip(guesses, columns, strict=True):
        names = [other.name for other in (*placed, *guesses)]
        if guess.name:
            placed.append(guess)
        elif _is_clock(values) and "time" not in names:
            placed.append(replace(guess, name="time", why="values"))
        else:
            placed.append(replace(guess, name=Channel("x", _free_mass(names)), why=_NOTHING))
    return tuple(placed)


def _guess_sentence(guess: ColumnGuess) -> str:
    if not isinstance(guess.name, Channel):
        return f"Column {guess.label} was guessed from its {guess.why} to be the time."
    if guess.why == _NOTHING:
        return f"Column {guess.label} stands as {guess.name}, a displacement: {_NOTHING}."
    quantity = KINDS[guess.name.kind].quantity
    article = "an" if quantity[0] in "aeiou" else "a"
    return f"Column {guess.label} was guessed from its {guess.why} to be {article} {quantity}, {guess.name}."


def mapping_text(file: str, guesses: Sequence[ColumnGuess], stated: RecordMapping | None = None) -> str:
    """The text of a mapping file for the record `file`, with the header, rates and masses that are `stated`."""
    blocks = [_mapping_block(guess) for guess in guesses if guess.name]
    spare = [guess.label for guess in guesses if not guess.name]
    unused = [f"\n# not used: {', '.join(map(toml_text, spare))}\n"] if spare else []
    if {guess.name for guess in guesses} <= {"time", ""} and spare:
        example = _mapping_block(ColumnGuess(spare[0], Channel("x", "m1"), "mm")).strip().split("\n")
        unused += ["\n", *(f"# {line}\n" for line in example)]
    head = _HEAD.format(path=on_one_line(Path(file).name))
    stated = stated or RecordMapping()
    if stated.rate is not None:
        head = head.replace('# rate = "1 kHz"   ', f"rate = {stated.rate!r}", 1)
    if stated.resample is not None:
        head += f"resample = {stated.resample!r}\n"
    if stated.header is not None:
        head += f"header = {toml_text(stated.header)}\n"
    masses = "".join(f"{toml_text(name)} = {toml_text(mass)}\n" for name, mass in stated.masses.items())
    return head + "".join([*blocks, *unused, f"\n[mass]\n{masses}" if masses else _MASSES])


def _mapping_block(guess: ColumnGuess) -> str:
    channel = guess.name if isinstance(guess.name, Channel) else None
    title = f"[channel.{toml_text(channel)}]" if channel else "[time]"
    remark = f"guessed from its {guess.why}" if guess.why else ""
    remark += "; of which mass?" if remark and NO_MASS in guess.doubts else ""
    nothing = guess.why == _NOTHING
    if nothing:
        remark = f"{_NOTHING}{f', in {guess.unit}' if guess.unit else ''}: which quantity, of which mass?"
    lines = ["", f"{title}{f'  # {remark}' if remark else ''}", f"column = {toml_text(guess.label)}"]
    unit = guess.unit or ("s" if guess.why and not channel else "")
    unit = channel.unit if channel and unit and nothing else unit
    if unit:
        lines.append(f"unit = {toml_text(unit)}")
    elif channel:
        lines.append(f'# unit = "{channel.unit}"')
    return "\n".join([*lines, ""])
