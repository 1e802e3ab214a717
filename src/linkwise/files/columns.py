"""Which column of a table is which channel: what the user mapped, then what the headers say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from linkwise.errors import RecordError
from linkwise.files.header import ColumnHeader
from linkwise.files.table import Column, Table
from linkwise.records.channel import BASE, Channel

_SHOWN = 12  # columns listed in an error or a note


@dataclass(frozen=True)
class ColumnChoice:
    """Column number `column` (from 0) holds `name`, "time" or a channel, in `unit` ("" for SI)."""

    name: str
    column: int
    unit: str

    @property
    def kind(self) -> str:
        """The kind of the channel, or "time"."""
        return self.name if self.name == "time" else Channel.parse(self.name).kind


def choose(
    table: Table, file: str, channels: Mapping[str, str | int], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns of the record; see `files.read_record` for `channels` and `known_masses`.

    Raises RecordError for a mapping that does not fit, a channel that stands twice, a mass that the structure does not
    have, and a table without any channel.
    """
    mapped = _mapped(table, file, channels)
    chosen = (*mapped, *_recognised(table, file, mapped, known_masses))
    if all(choice.name == "time" for choice in chosen):
        raise _nothing_recognised(table, file)
    for choice in chosen:
        _refuse_unknown_mass(table, file, choice, known_masses)
    return chosen


def ignored(table: Table, chosen: tuple[ColumnChoice, ...]) -> list[str]:
    """A note on the columns that nothing uses."""
    used = {choice.column for choice in chosen}
    left = [column.header for i, column in enumerate(table.columns) if i not in used and column.header]
    if not left:
        return []
    return [f"Columns that are no channels were ignored: {_list(left)}."]


def listing(table: Table) -> str:
    """The columns there are, in words."""
    if not table.named:
        return f"the file has no header and {len(table.columns)} columns, numbered from 1"
    return f"the columns are {_list([header or '(no name)' for header in table.headers])}"


def _list(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _mapped(table: Table, file: str, channels: Mapping[str, str | int]) -> tuple[ColumnChoice, ...]:
    """The columns that the user named."""
    chosen: dict[str, ColumnChoice] = {}
    for key, column in channels.items():
        heading = ColumnHeader.parse(key)
        if heading.is_time:
            name = "time"
        else:
            try:
                name = str(Channel.parse(heading.name))
            except RecordError as error:
                raise RecordError(f"--channel {key}={column}: {error.message}", file) from error
        if name in chosen:
            raise RecordError("--channel names it twice", file, channel=name)
        index = _find(table, file, key, column)
        chosen[name] = ColumnChoice(
            name, index, heading.unit or ColumnHeader.parse(table.headers[index]).unit
        )
    return tuple(chosen.values())


def _find(table: Table, file: str, key: str, column: str | int) -> int:
    """The index of a column by its header, its header without unit, the last part of its path, or its number from 1."""
    wanted = str(column).strip()
    headings = [ColumnHeader.parse(header) for header in table.headers]
    for names in (
        list(table.headers),
        [heading.name for heading in headings],
        [heading.leaf.name for heading in headings],
    ):
        if names.count(wanted) > 1:
            count = names.count(wanted)
            raise RecordError(
                f"--channel {key}={column}: {count} columns are called that; use a number", file
            )
        if wanted in names:
            return names.index(wanted)
    if wanted.isdecimal() and 1 <= int(wanted) <= len(table.columns):
        return int(wanted) - 1
    near = get_close_matches(wanted, table.headers, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise RecordError(
        f"--channel {key}={column}: there is no such column; {hint}{listing(table)}", file, table.header_line
    )


def _recognised(
    table: Table, file: str, mapped: tuple[ColumnChoice, ...], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns whose headers say what they are, less what the user has mapped."""
    taken = {choice.name for choice in mapped}
    used = {choice.column for choice in mapped}
    found: dict[str, ColumnChoice] = {}
    for index, column in enumerate(table.columns):
        heading = _meaning(column, known_masses)
        if heading is None or index in used:
            continue
        name = "time" if heading.is_time else str(heading.channel)
        if name in taken:
            continue
        if name in found:
            raise RecordError(
                f"columns {found[name].column + 1} and {index + 1} both hold it; rename one, "
                f"or choose with --channel {name}=COLUMN",
                file,
                table.header_line,
                name,
            )
        found[name] = ColumnChoice(name, index, heading.unit)
    return tuple(found.values())


def _meaning(column: Column, known_masses: tuple[str, ...] | None) -> ColumnHeader | None:
    """What a column says it is; None for a column that says nothing known.

    A spelling that merely stands for a channel (`a_1` in MATLAB) does not count where it would name an unknown mass.
    """
    leaf = ColumnHeader.parse(column.header).leaf
    if leaf.is_time or leaf.channel is not None:
        return leaf
    meant = ColumnHeader(column.meaning, leaf.unit)
    if meant.channel is None:
        return None
    known = known_masses is None or meant.channel.mass in (*known_masses, BASE)
    return meant if known else None


def _nothing_recognised(table: Table, file: str) -> RecordError:
    """The error for a table without a single channel."""
    if not table.named:
        return RecordError(
            f"there is no header: the file starts with {table.opening!r}. A first line must name the columns, as in "
            "`time,x:m1,x:m2`; or --channel time=1 --channel x:m1=2 maps them by number",
            file,
            1,
        )
    return RecordError(
        f"no channel is recognised; {listing(table)}. A channel is called KIND:MASS, such as x:m1 or a:m2[g]; "
        "a column of another name is mapped with --channel x:m1=COLUMN",
        file,
        table.header_line,
    )


def _refuse_unknown_mass(
    table: Table, file: str, choice: ColumnChoice, known_masses: tuple[str, ...] | None
) -> None:
    """RecordError for a channel of a mass that the structure does not have."""
    if known_masses is None or choice.name == "time":
        return
    mass = Channel.parse(choice.name).mass
    if mass == BASE or mass in known_masses:
        return
    near = get_close_matches(mass, known_masses, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise RecordError(
        f"the structure has no mass {mass!r}; {hint}it has {_list(list(known_masses))}",
        file,
        table.header_line,
        choice.name,
    )
