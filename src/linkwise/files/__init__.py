"""Records in and out of files. Each format is one module, loaded when its suffix is met."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import ModuleType

from linkwise.errors import RecordError
from linkwise.files.assemble import ReadOptions, to_record
from linkwise.files.table import Table
from linkwise.records.record import Record

__all__ = ["read_record", "write_record"]

_MODULES = {
    ".csv": "csv",
    ".txt": "csv",
    ".dat": "csv",
    ".tsv": "csv",
    ".mat": "mat",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".parquet": "parquet",
    ".uff": "uff",
    ".unv": "uff",
    ".tdms": "tdms",
}
_WRITABLE = (".csv", ".mat", ".h5", ".hdf5", ".parquet")
_EXTRAS = frozenset({"pyarrow", "pyuff", "nptdms"})  # top-level packages of the extra [files]


def read_record(
    path: str | Path,
    *,
    channels: Mapping[str, str | int] | None = None,
    rate: float | None = None,
    resample: float | None = None,
    known_masses: Iterable[str] | None = None,
) -> Record:
    """The record in a file of any known format, told by its suffix.

    `channels` maps a channel, with a unit in brackets if need be, or "time", to a column by header or number from 1, where the
    headers do not say it: {"x:m1[mm]": "LVDT 3"}. `rate` in Hz stands in for a time column (which is then ignored); `resample`
    in Hz interpolates an uneven time to an even one; with `known_masses` a channel of any other mass is an error. What
    was assumed on the way stands in `notes`. Raises RecordError for whatever cannot be read.
    """
    path = Path(path)
    _refuse_absent(path)
    module = _module(path.suffix, path)
    try:
        table: Table = module.read_table(path)
    except (RecordError, MemoryError):
        raise
    except Exception as error:  # the format libraries raise all kinds of errors on a file that is damaged
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordError(f"cannot be read as a {path.suffix} file: {reason}", path) from error
    masses = None if known_masses is None else tuple(known_masses)
    return to_record(table, str(path), ReadOptions(channels or {}, rate, resample, masses))


def write_record(record: Record, path: str | Path) -> None:
    """Write a record in the format of the suffix: .csv, .mat (v5), .h5, .hdf5 or .parquet.

    What was seen comes back exactly: times, values and missing samples; all but CSV keep noise, source and notes too. The
    truth of a simulated record is not written. The file appears whole or not at all. Raises RecordError where that fails.
    """
    path = Path(path)
    if path.suffix.lower() not in _WRITABLE:
        raise RecordError(
            f"a record is not written as {path.suffix or 'a file without a suffix'}; use one of {', '.join(_WRITABLE)}",
            path,
        )
    module = _module(path.suffix, path)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        module.write(record, part)
        part.replace(path)
    except OSError as error:
        raise RecordError(f"cannot be written: {error.strerror or error}", path) from error
    finally:
        part.unlink(missing_ok=True)


def _module(suffix: str, path: Path) -> ModuleType:
    """The module of a format; RecordError for an unknown suffix and for a library that is not installed."""
    name = _MODULES.get(suffix.lower())
    if name is None:
        what = f"the suffix {suffix!r} is unknown" if suffix else "the file has no suffix"
        raise RecordError(f"{what}, so its format is too; known are {', '.join(_MODULES)}", path)
    try:
        return import_module(f"{__name__}.{name}")
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in _EXTRAS:
            raise
        raise RecordError(
            f"{suffix} files need the library {library}, which comes with the extra 'files': pip install 'linkwise[files]'",
            path,
        ) from error


def _refuse_absent(path: Path) -> None:
    """RecordError unless there is a file to read, with the name that may have been meant."""
    if path.is_dir():
        raise RecordError("is a folder, not a record file", path)
    if path.is_file():
        if path.stat().st_size == 0:
            raise RecordError("the file is empty", path)
        return
    folder = path.parent
    if not folder.is_dir():
        raise RecordError(f"there is no folder {str(folder)!r}", path)
    near = get_close_matches(path.name, [entry.name for entry in folder.iterdir() if entry.is_file()], n=1)
    raise RecordError(f"there is no such file{f'; did you mean {near[0]}?' if near else ''}", path)
