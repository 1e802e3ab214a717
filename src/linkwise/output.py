"""Atomic output: files and folders that appear complete or not at all, and never replace what linkwise did not write."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from secrets import token_hex
from typing import Any

from linkwise.errors import OutputError

fcntl: Any = None
with suppress(ImportError):  # of Windows, which cannot lock folders
    fcntl = import_module("fcntl")

# marks a folder as a result of linkwise; its key "files" lists the files linkwise wrote
RESULT = "result.json"
ABSORPTION = "absorption.json"  # the same of a folder that `absorb` wrote
COMPARISON = "comparison.json"  # the same of a folder that `compare` wrote
DESIGN = "design.json"  # the same of a folder that `design` wrote
BACKBONE = "backbone.json"  # the same of a folder that `backbone` wrote
BASINS = "basins.json"  # the same of a folder that `basins` wrote
RESPONSE = "response.json"  # the same of a folder that `respond` wrote
VALIDATION = "validation.json"  # the same of a folder that `validate` wrote
INSPECTION = "inspection.json"  # the same of a folder that `inspect` wrote

_ROOM = 20_000_000  # bytes that must be free: a page takes five million, its figures one
_TRIAL = 65_536  # bytes written to find out whether the disk accepts any
_ABANDONED = 86_400.0  # s without a change after which a temporary folder belongs to a run that was killed
_NOT_RENAMED = frozenset({errno.EBUSY, errno.EXDEV, errno.EACCES, errno.EPERM, errno.EROFS})
_OCCUPIED = frozenset({errno.EEXIST, errno.ENOTEMPTY})
_DISK_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


def answer_folder(path: Path) -> Path:
    """The path itself; of the folder of a first answer, which holds that in a folder of its own, this one."""
    inside = path / "answer"
    return inside if not (path / RESULT).is_file() and (inside / RESULT).is_file() else path


def is_disk_fault(error: OSError) -> bool:
    """Whether the disk is to blame, full or broken, rather than the place that was given."""
    return error.errno in _DISK_FAULTS


class FullDiskError(OutputError):
    """The disk is full or broken."""

    exit_code = 1


def to_json(data: Any, *, indent: int | None = None) -> str:
    """`data` as strictly valid JSON: numbers that are not finite become null."""
    return json.dumps(_finite(data), indent=indent, allow_nan=False)


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return data


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path in the folder of `path`; renamed to `path` when the block ends without an error.

    Missing parent folders are created. The suffix is kept, since writers choose the format by it. Each of several writers has
    its own temporary path, and the last one to finish wins. Raises OutputError where `path` is a device or a folder or cannot
    be written, FullDiskError where the disk is to blame.
    """
    with _own_file(path) as own:
        yield own
        own.replace(path.resolve())


def check_file(path: Path) -> None:
    """Check, before the work, that a file can be written to `path`; raises OutputError as `atomic_file` would."""
    with _own_file(path) as own:
        own.write_bytes(bytes(_TRIAL))


@contextmanager
def _own_file(path: Path) -> Iterator[Path]:
    """A new temporary path next to the target of `path`."""
    try:
        place = path.resolve()
        if place.exists() and not place.is_file():
            raise OutputError(f"{path}: exists and is not a regular file; choose another name")
        place.parent.mkdir(parents=True, exist_ok=True)
        partial = place.with_name(f".{place.stem}.{token_hex(4)}.partial{place.suffix}")
        try:
            yield partial
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise _refusal(f"{path}: cannot be written", error) from error


def _refusal(message: str, error: OSError) -> OutputError:
    """The error for what an operating system refused to write."""
    kind = FullDiskError if is_disk_fault(error) else OutputError
    # libraries say more than the system does, in several lines
    reason = str(error) if error.errno is None else os.strerror(error.errno)
    return kind(f"{message}: {reason}")


def check_result_folder(path: Path, mark: str = RESULT) -> None:
    """Check, before the work, that a result can be written to `path`: OutputError unless it does not exist, is an empty
    folder, or holds an earlier result marked by `mark`; where no folder can be created there; and where its disk is full.
    """
    with _own_folder(path, mark) as own:
        free = shutil.disk_usage(own).free
        if free < _ROOM:
            raise FullDiskError(
                f"{path}: {free / 1e6:.3g} MB are free on its disk, and a result needs {_ROOM / 1e6:g} MB"
            )
        (own / "trial").write_bytes(bytes(_TRIAL))


@contextmanager
def atomic_folder(path: Path, mark: str = RESULT) -> Iterator[Path]:
    """An empty temporary folder; renamed to `path` when the block ends without an error.

    An earlier result stays untouched until then, and files that its user added are kept. Each of several writers has its
    own temporary folder, and the last one to finish wins. Where `path` cannot be renamed, for example because it is a
    mount point, its files are replaced one by one, `mark` last. OutputError where `path` exists and is not a result marked
    by `mark`, and where it cannot be written.
    """
    with _own_folder(path, mark) as own:
        yield own
        place = path.resolve()
        try:
            _swap(own, place, mark)
        except OSError as error:
            if error.errno not in _NOT_RENAMED or not place.is_dir():
                raise
            _fill(own, place, mark)


@contextmanager
def _own_folder(path: Path, mark: str) -> Iterator[Path]:
    """A new temporary folder next to the target of `path`, or inside it where its parent is read-only."""
    place = path.resolve()
    try:
        _tidy(place)
        _refuse_others(path, mark)
        name = f".{place.name}.{token_hex(4)}.partial"
        own = place.parent / name
        try:
            own.mkdir(parents=True)
        except OSError:
            if not place.is_dir():
                raise
            own = place / name
            own.mkdir()
        try:
            yield own
        finally:
            shutil.rmtree(own, ignore_errors=True)
    except OSError as error:
        raise _refusal(f"{path}: the result could not be written", error) from error


def _refuse_others(path: Path, mark: str) -> None:
    """Raise OutputError for a file, and for a folder that holds anything but a result marked by `mark`."""
    while True:
        before = _state(path)
        with suppress(FileNotFoundError):  # another process replaces it
            problem = _problem(path, mark)
            if problem is None:
                return
            if _state(path) == before:
                raise OutputError(problem)


def _state(path: Path) -> tuple[int, int] | None:
    """What changes if another folder takes the place of `path`, or its entries change; None where there is nothing."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns


def _problem(path: Path, mark: str) -> str | None:
    """Why no result marked by `mark` may take the place of `path`; None if one may."""
    hidden = set(_hidden(path.resolve(), path, "partial"))
    if not path.exists() or (path.is_dir() and set(path.iterdir()) <= hidden):
        return None
    if _written(path, mark) is None:
        marks = sorted(entry.name for entry in path.glob("*.json") if entry.name != mark)
        other_mark = next((name for name in marks if _written(path, name) is not None), None)
        problem = f"is not a result of linkwise (no valid {mark})"
        if other_mark:
            problem = f"holds the result of another command ({other_mark})"
        return f"{path}: already exists and {problem}; it was not changed. Choose another folder, or remove this one"
    return None


def _hidden(place: Path, folder: Path, kind: str) -> list[Path]:
    """The temporary folders for `place` that are in `folder`, of one `kind`: "partial" or "old"."""
    name = re.compile(rf"\.{re.escape(place.name)}\.[0-9a-f]{{8}}\.{kind}")
    return [entry for entry in folder.iterdir() if name.fullmatch(entry.name)] if folder.is_dir() else []


def _tidy(place: Path) -> None:
    """Restore the result of a run that was killed between its two renames; remove what killed runs left behind."""
    for old in _hidden(place, place.parent, "old"):
        if place.exists():
            shutil.rmtree(old, ignore_errors=True)
            continue
        with suppress(OSError):  # another process did it first, or has written a new one
            old.rename(place)
    for folder in (place.parent, place):
        for partial in _hidden(place, folder, "partial"):
            with suppress(OSError):
                if time.time() - partial.stat().st_mtime > _ABANDONED:
                    shutil.rmtree(partial, ignore_errors=True)


def _swap(own: Path, place: Path, mark: str) -> None:
    """Replace `place` by `own` with two renames. Raises OSError where a folder cannot be renamed."""
    if Path.cwd().is_relative_to(place):
        raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    while True:
        old = place.with_name(f".{place.name}.{token_hex(4)}.old")
        try:
            _carry_over(place, own, mark)
            place.rename(old)
        except FileNotFoundError:
            pass  # no earlier result, or another process has just moved it
        try:
            own.rename(place)
            break
        except OSError as error:
            if error.errno not in _OCCUPIED:
                with suppress(OSError):
                    old.rename(place)
                raise
        # another process has written a result meanwhile: replace it, as in two runs one after the other
    shutil.rmtree(old, ignore_errors=True)


def _fill(own: Path, place: Path, mark: str) -> None:
    """Replace the files in `place` by those in `own`, one by one."""
    inside = own
    if own.parent != place:
        inside = place / own.name
        shutil.copytree(own, inside)
    with _exclusive(place):
        for name in [mark, *sorted((_written(place, mark) or set()) - {mark})]:
            (place / name).unlink(missing_ok=True)
        for entry in sorted(inside.iterdir(), key=lambda entry: entry.name == mark):
            entry.replace(place / entry.name)
        inside.rmdir()


@contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    """Hold the lock of `folder`, on systems that can lock one."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _carry_over(old: Path, new: Path, mark: str) -> None:
    """Copy the entries of `old` that linkwise did not write."""
    written = _written(old, mark) or set()
    for entry in old.iterdir():
        if entry.name in written or (new / entry.name).exists() or entry in _hidden(old, old, "partial"):
            continue
        if entry.is_dir():
            shutil.copytree(entry, new / entry.name, symlinks=True)
        else:
            shutil.copy2(entry, new / entry.name, follow_symlinks=False)


def _written(folder: Path, mark: str) -> set[str] | None:
    """Names of the files that linkwise wrote into an earlier result; None where `folder` is not a result."""
    names: set[str] | None = None
    # a result that was left while files were replaced
    for where in (folder, *_hidden(folder.resolve(), folder, "partial")):
        try:
            result = json.loads((where / mark).read_text(encoding="utf-8"))
            if "method" in result:
                names = {mark, *map(str, result["files"]), *(names or ())}
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return names
