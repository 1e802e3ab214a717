"""Assignment of table columns to channels: first the mapping of the user, then the headers."""

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
    """Column number `column` (from 0) holds `name`, which is "time" or a channel, in `unit` ("" for SI)."""

    channel: Channel | None
    column: int
    unit: str

    @property
    def name(self) -> str:
        """The name of the channel, or "time"."""
        return self.channel or "time"

    @property
    def kind(self) -> str:
        """The kind of the channel, or "time"."""
        return self.channel.kind if self.channel else "time"


def choose(
    table: Table, file: str, channels: Mapping[str, str | int], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns of the record; see `files.read_record` for `channels` and `known_masses`.

    Raises RecordError for an invalid mapping, a channel that occurs twice, an unknown mass, and a table without channels.
    """
    mapped = _mapped(table, file, channels)
    chosen = (*mapped, *_recognised(table, file, mapped, known_masses))
    if all(choice.name == "time" for choice in chosen):
        raise _nothing_recognised(table, file)
    for choice in chosen:
        _check_mass(table, file, choice, known_masses)
    return chosen


def recognised(table: Table, file: str) -> dict[int, Channel | str]:
    """The channel or "time" by number of the column whose header says it."""
    return {choice.column: choice.name for choice in _recognised(table, file, (), None)}


def ignored(table: Table, chosen: tuple[ColumnChoice, ...]) -> list[str]:
    """A note on the columns that are not used."""
    used = {choice.column for choice in chosen}
    unused = [
        f"{column.header} ({remark})"
        if (remark := column.instead or _other_spelling(column))
        else column.header
        for i, column in enumerate(table.columns)
        if i not in used and column.header
    ]
    if not unused:
        return []
    return [f"Columns that are not channels were ignored: {_list(unused)}."]


def _other_spelling(column: Column) -> str:
    """A question where a header is a channel but for capital letters, as "Force:m1" is; such a force must not go unseen."""
    leaf = ColumnHeader.parse(column.header).leaf
    kind, colon, mass = leaf.name.rpartition(":")
    meant = f"{kind.lower()}{colon}{mass}"
    if leaf.channel is not None or meant == leaf.name or ColumnHeader(meant, "").channel is None:
        return ""
    return f"did you mean {meant}?"


def units_over_headers(table: Table, chosen: tuple[ColumnChoice, ...]) -> list[str]:
    """A note for each column whose mapping states another unit than its header does."""
    notes = []
    for choice in chosen:
        header = ColumnHeader.parse(table.headers[choice.column]).unit
        if choice.unit and header and choice.unit != header:
            notes.append(
                f"{choice.name} is taken to be in {choice.unit}, as its mapping states; the header of its column, "
                f"{table.headers[choice.column]}, states {header}."
            )
    return notes


def listing(table: Table) -> str:
    """The columns of the table as a sentence."""
    if not table.named:
        return f"the file has no header and {len(table.columns)} columns, numbered from 1"
    return f"the columns are {_list([header or '(no name)' for header in table.headers])}"


def _list(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _mapped(table: Table, file: str, channels: Mapping[str, str | int]) -> tuple[ColumnChoice, ...]:
    """The columns that the user mapped."""
    chosen: dict[str, ColumnChoice] = {}
    for key, column in channels.items():
        header = ColumnHeader.parse(key)
        try:
            channel = None if header.is_time else Channel.parse(header.name)
        except RecordError as error:
            raise RecordError(f"in `channels`: {error.message}", file, arguments=("channels",)) from error
        name = channel or "time"
        if name in chosen:
            raise RecordError("is mapped twice in `channels`", file, channel=name, arguments=("channels",))
        index = _find(table, file, key, column)
        unit = header.unit or ColumnHeader.parse(table.headers[index]).unit
        chosen[name] = ColumnChoice(channel, index, unit)
    return tuple(chosen.values())


def _find(table: Table, file: str, key: str, column: str | int) -> int:
    """Index of a column given by its header, its header without unit, the last part of its path, or its number from 1."""
    wanted = str(column).strip()
    headers = [ColumnHeader.parse(header) for header in table.headers]
    for names in (
        list(table.headers),
        [header.name for header in headers],
        [header.leaf.name for header in headers],
    ):
        if names.count(wanted) > 1:
            count = names.count(wanted)
            raise RecordError(
                f"{key} is mapped to {wanted!r}, the name of {count} columns; give the number of the column instead",
                file,
                arguments=("channels",),
            )
        if wanted in names:
            return names.index(wanted)
    if wanted.isdecimal() and 1 <= int(wanted) <= len(table.columns):
        return int(wanted) - 1
    near = get_close_matches(wanted, table.headers, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise RecordError(
        f"{key} is mapped to column {wanted!r}, which does not exist; {hint}{listing(table)}",
        file,
        table.header_line,
        arguments=("channels", "header") if table.lines is not None else ("channels",),
    )


def _recognised(
    table: Table, file: str, mapped: tuple[ColumnChoice, ...], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns whose headers name a channel or the time, except what the user has mapped."""
    mapped_names = {choice.name for choice in mapped}
    used = {choice.column for choice in mapped}
    recognised: dict[str, ColumnChoice] = {}
    for index, column in enumerate(table.columns):
        header = _meaning(column, known_masses)
        if header is None or index in used:
            continue
        channel = None if header.is_time else header.channel
        name = channel or "time"
        if name in mapped_names:
            continue
        if name in recognised:
            first, second = table.columns[recognised[name].column].header, column.header
            paths = f" ({first} and {second})" if first != second else ""
            raise RecordError(
                f"columns {recognised[name].column + 1} and {index + 1} both have this name{paths}; rename one, "
                "or map the channel to one of them (`channels`)",
                file,
                table.header_line,
                name,
                arguments=("channels",),
            )
        recognised[name] = ColumnChoice(channel, index, header.unit)
    return tuple(recognised.values())


def _meaning(column: Column, known_masses: tuple[str, ...] | None) -> ColumnHeader | None:
    """The header that a column stands for; None for a column that names neither a channel nor the time.

    A spelling that only resembles a channel (`a_1` in MATLAB) does not count if it would name an unknown mass.
    """
    leaf = ColumnHeader.parse(column.header).leaf
    if leaf.is_time or leaf.channel is not None:
        return leaf
    meant = ColumnHeader(column.meaning, leaf.unit)
    if meant.channel is None:
        return None
    if known_masses is None:
        return None if column.instead else meant
    return meant if meant.channel.place in (*known_masses, BASE) else None


def _nothing_recognised(table: Table, file: str) -> RecordError:
    """The error for a table without a single channel."""
    if not table.named:
        return RecordError(
            f"there is no header: the file starts with {table.opening!r}. The first line must name the columns, as in "
            "`time,x:m1,x:m2`; or map columns by number, as in channels={'time': 1, 'x:m1': 2}",
            file,
            1,
            arguments=("channels",),
        )
    return RecordError(
        f"no channel is recognised; {listing(table)}. Channels are named KIND:MASS, such as x:m1 or a:m2[g]; "
        "map columns of other names, as in channels={'x:m1': 'laser'}",
        file,
        table.header_line,
        arguments=("channels", "mapping"),
    )


def _check_mass(table: Table, file: str, choice: ColumnChoice, known_masses: tuple[str, ...] | None) -> None:
    """Raise RecordError for a channel of a mass that the structure does not have."""
    channel = choice.channel
    if known_masses is None or channel is None:
        return
    mass = channel.place
    if channel.of_link or mass == BASE or mass in known_masses:
        return
    near = get_close_matches(mass, known_masses, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise RecordError(
        f"the structure has no mass {mass!r}; {hint}it has {_list(list(known_masses)) or 'none'}",
        file,
        table.header_line,
        choice.name,
        arguments=("known_masses",),
    )
