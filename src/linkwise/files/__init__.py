"""Reading and writing records. The module of a format is imported when a file with its suffix is used."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name

from linkwise.display import near_miss
from linkwise.errors import OutputError, RecordError, expect
from linkwise.files.column_guesses import first_mapping
from linkwise.files.mapping import RecordMapping, read_mapping
from linkwise.files.table import ColumnHeader, Table
from linkwise.files.table_to_record import find_column, to_record
from linkwise.files.uff import record_of_responses
from linkwise.output import atomic_file, check_file
from linkwise.records.record import Record
from linkwise.units import to_si

__all__ = ["RecordMapping", "read_mapping", "read_record", "record_of_responses", "to_si", "write_record"]

_LONGEST = 300  # characters of what a library says
_OF_PROGRAMS = (DeprecationWarning, PendingDeprecationWarning, FutureWarning, ResourceWarning)


@dataclass(frozen=True)
class Format:
    """A format of record files: how it is read and written, and the library of the extra [files] that it needs.

    `reader` and `writer` are "module:function" of a `read(path) -> Table` and a `write(record, path)`. Where the format has a
    line that is the `header`, the reader takes it as a keyword.
    """

    reader: str
    writer: str | None = None
    library: str | None = None
    header: bool = False


FORMATS = {
    ".csv": Format("linkwise.files.text:read_text", "linkwise.files.text:write_csv", header=True),
    **dict.fromkeys((".txt", ".dat", ".tsv", ".asc"), Format("linkwise.files.text:read_text", header=True)),
    ".mat": Format("linkwise.files.mat:read_table", "linkwise.files.mat:write"),
    **dict.fromkeys((".h5", ".hdf5"), Format("linkwise.files.hdf5:read_table", "linkwise.files.hdf5:write")),
    ".parquet": Format("linkwise.files.parquet:read_table", "linkwise.files.parquet:write", "pyarrow"),
    **dict.fromkeys((".uff", ".unv"), Format("linkwise.files.uff:read_table", library="pyuff")),
    **dict.fromkeys((".npy", ".npz"), Format("linkwise.files.arrays:read_numpy")),
    ".json": Format("linkwise.files.arrays:read_json"),
    ".lvm": Format("linkwise.files.text:read_lvm"),
    ".xlsx": Format("linkwise.files.xlsx:read_table", library="openpyxl", header=True),
    ".tdms": Format("linkwise.files.tdms:read_table", library="nptdms"),
    ".wav": Format("linkwise.files.wav:read_table"),
}
"""The formats by the suffix of their files."""


def read_record(
    path: str | Path,
    *,
    channels: Mapping[str, str | int] | None = None,
    rate: float | None = None,
    resample: float | None = None,
    known_masses: Iterable[str] | None = None,
    informative: bool = True,
    mapping: RecordMapping | str | Path | None = None,
    header: str | int | None = None,
) -> Record:
    """Read a record from a file; its suffix says the format.

    Parameters
    ----------
    path : str or Path
        A file with the suffix ``.csv``, ``.txt``, ``.dat``, ``.tsv``, ``.asc``, ``.mat``, ``.h5``, ``.hdf5``, ``.parquet``,
        ``.uff``, ``.unv``, ``.tdms``, ``.npy``, ``.npz``, ``.json``, ``.lvm``, ``.xlsx`` or ``.wav``.
    channels : mapping of str to str or int, optional
        Column of each channel, or of ``"time"``, for columns whose header does not say it: the header of the column or its
        number from 1. A channel may carry a unit in brackets: ``{"x:m1[mm]": "LVDT 3"}``. Times may be in a file of their
        own, row by row: ``{"time": "clock.csv:Time"}``.
    rate : float, optional
        Sampling rate in Hz of a file without a time column; a time column is then ignored.
    resample : float, optional
        Rate in Hz to which uneven times are interpolated.
    known_masses : iterable of str, optional
        Names of the masses of the structure; a channel of any other mass is then an error.
    informative : bool, default True
        Refuse a response that is constant, missing throughout or a copy of another. Without it such channels are read, for
        `inspect`.
    mapping : RecordMapping, str or Path, optional
        What the columns are and what is known of the sensors, or the file that states it, as of `read_mapping`. The other
        arguments take precedence over it, and it takes precedence over what the file of the record states of its sensors.
    header : str or int, optional
        The header line of a text file where it is not found: its number from 1, or a text that it contains.

    Returns
    -------
    Record
        The record in SI units. Its `notes` say what was assumed while reading.

    Raises
    ------
    RecordError
        If the file cannot be read; the error names file, line and channel where they are known.

    See Also
    --------
    write_record : Write a record to a file.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     rows = (f"{k / 100},{k % 7}" for k in range(100))
    ...     _ = path.write_text("\\n".join(["time,laser", *rows]))
    ...     lw.read_record(path, channels={"x:m1[mm]": "laser"})
    Record of 100 samples at 100 Hz, 0 to 0.99 s: x:m1
    """
    expect("read_record(path): path", path, str, Path)
    given = RecordMapping(dict(channels or {}), rate=rate, resample=resample, header=header)
    stated = read_mapping(mapping) if isinstance(mapping, str | Path) else mapping or RecordMapping()
    chosen = given.over(stated)
    masses = None if known_masses is None else tuple(known_masses)
    table = _with_times(read_table(Path(path), chosen.header), chosen.channels)
    return to_record(table, chosen, masses, informative=informative)


def _with_times(table: Table, channels: Mapping[str, str | int]) -> Table:
    """The table, and beside its columns that of the times where it is one of another file, FILE:COLUMN."""
    for key, place in channels.items():
        file, colon, name = str(place).rpartition(":")
        if not colon or not ColumnHeader.parse(key).is_time or not Path(file).is_file():
            continue
        other = read_table(Path(file), None)
        column = other.columns[find_column(other, key, name)]
        rows = max(len(column.values) for column in table.columns if column.values is not None)
        if column.values is not None and len(column.values) != rows:
            raise RecordError(
                f"{file} has {len(column.values)} times for {rows} rows: times in a file of their own are those of the rows, "
                "one by one",
                table.file,
                channel="time",
            )
        unit = ColumnHeader.parse(column.header).unit
        header = f"{place}[{unit}]" if unit else str(place)
        return replace(table, columns=(*table.columns, replace(column, header=header)))
    return table


def write_first_mapping(record: Path, path: Path, header: str | int | None = None) -> tuple[str, ...]:
    """Write a mapping file for the columns of the file of a record; sentences on what was guessed.

    Raises RecordError where the record cannot be read, or the mapping file is there already or cannot be written.
    """
    text, guesses = first_mapping(read_table(record, header))
    if path.exists():
        message = "is there already, and what was written into it by hand would be lost; give another name"
        raise RecordError(message, path)
    with _refused(path), atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")
    return guesses


def read_table(path: Path, header: str | int | None) -> Table:
    """All columns of a file; RecordError where it cannot be read."""
    _check_exists(path)
    format_ = _format(path)
    if header is not None and not format_.header:
        message = f"a header line is of text files and sheets; a {path.suffix} file states its names itself"
        raise RecordError(message, path, arguments=("header",))
    options = {} if header is None else {"header": header}
    try:
        with warnings.catch_warnings(record=True, action="always") as caught:  # of libraries
            table: Table = resolve_name(format_.reader)(path, **options)
    except RecordError:
        raise
    except Exception as error:  # format libraries raise all kinds of errors on a damaged file
        reason = " ".join(str(error).split())[:_LONGEST] or type(error).__name__
        if isinstance(error, MemoryError):
            reason = "it states more numbers than memory holds"
        raise RecordError(f"cannot be read as a {path.suffix} file: {reason}", path) from error
    warned = dict.fromkeys(
        f"While reading: {' '.join(str(warning.message).split())[:_LONGEST]}"
        for warning in caught
        if not issubclass(warning.category, _OF_PROGRAMS)
    )
    return replace(table, file=str(path), notes=(*table.notes, *warned))


def write_record(record: Record, path: str | Path) -> None:
    """Write a record to a file in the format of its suffix.

    Times, values and missing samples are read back exactly. All formats but CSV also keep noise, source and notes; the truth
    of a simulated record is not written. The file appears complete or not at all; missing folders
    are created.

    Parameters
    ----------
    record : Record
        The record to write.
    path : str or Path
        A path with the suffix ``.csv``, ``.mat`` (v5), ``.h5``, ``.hdf5`` or ``.parquet``.

    Raises
    ------
    RecordError
        If the suffix is another one, or the file cannot be written or is not a regular one.

    See Also
    --------
    read_record : Read a record from a file.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.1, rate=1000.0)
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "run.csv"
    ...     lw.write_record(record, path)
    ...     bool((lw.read_record(path).values == record.values).all())
    True
    """
    expect("write_record(record, path): record", record, Record)
    expect("write_record(record, path): path", path, str, Path)
    path = Path(path)
    write = resolve_name(_writer(path))
    with _refused(path), atomic_file(path) as partial:
        write(record, partial)


def check_record_file(path: str | Path) -> None:
    """Raise RecordError where `write_record` would, before the work that leads to a record."""
    _writer(Path(path))
    with _refused(Path(path)):
        check_file(Path(path))


def _writer(path: Path) -> str:
    """Full name of the function that writes a file of this suffix; RecordError for one that is not written."""
    writers = {suffix: entry.writer for suffix, entry in FORMATS.items() if entry.writer is not None}
    if path.suffix.lower() not in writers:
        message = f"records cannot be written as {path.suffix or 'a file without suffix'}; use one of {', '.join(writers)}"
        raise RecordError(message, path)
    _format(path)
    return writers[path.suffix.lower()]


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Tell of what a file cannot be written for as a RecordError."""
    try:
        yield
    except OutputError as error:
        refusal = RecordError(str(error).removeprefix(f"{path}: "), path)
        refusal.exit_code = error.exit_code
        raise refusal from error


def _format(path: Path) -> Format:
    """The format of a file; RecordError for an unknown suffix and for a library that is not installed."""
    suffix = path.suffix
    if suffix.lower() not in FORMATS:
        problem = f"unknown suffix {suffix!r}" if suffix else "the file name has no suffix"
        raise RecordError(f"{problem}; choose from {', '.join(FORMATS)}", path)
    entry = FORMATS[suffix.lower()]
    if entry.library is not None and find_spec(entry.library) is None:
        raise RecordError(
            f"{suffix} files need the library {entry.library}, which the extra 'files' installs: "
            "pip install 'linkwise[files]'",
            path,
        )
    return entry


def _check_exists(path: Path) -> None:
    """Raise RecordError unless there is a file to read; suggest a similar name."""
    if path.is_dir():
        raise RecordError("is a folder, not a record file", path)
    if path.is_file():
        if path.stat().st_size == 0:
            raise RecordError("the file is empty", path)
        return
    folder = path.parent
    if not folder.is_dir():
        raise RecordError(f"the folder {str(folder)!r} does not exist", path)
    names = [entry.name for entry in folder.iterdir() if entry.is_file()]
    raise RecordError(f"there is no such file{near_miss(path.name, names)}", path)
