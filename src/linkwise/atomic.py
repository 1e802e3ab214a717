"""Atomic output: files and folders that appear complete or not at all, and never replace what linkwise did not write."""

from __future__ import annotations

import errno
import json
import math
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from linkwise.errors import LinkwiseError

RESULT = (
    "result.json"  # marks a folder as a result of linkwise; its key "files" lists the files linkwise wrote
)
ABSORPTION = "absorption.json"  # the same for `absorb`


_DISK_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


def is_disk_fault(error: OSError) -> bool:
    """Whether the disk is to blame, full or broken, rather than the place that was given."""
    return error.errno in _DISK_FAULTS


class OutputError(LinkwiseError):
    """An output path that cannot or must not be written."""

    exit_code = 2


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

    Missing parent folders are created. The suffix is kept, since writers choose the format by it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def check_result_folder(path: Path, mark: str = RESULT) -> None:
    """Raise OutputError unless `path` does not exist, is an empty folder, or holds an earlier result marked by `mark`."""
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if _written(path, mark) is None:
        other = next(
            (name for name in (RESULT, ABSORPTION) if name != mark and _written(path, name) is not None), None
        )
        what = (
            f"holds the result of another command ({other})"
            if other
            else f"is not a result of linkwise (no valid {mark})"
        )
        raise OutputError(
            f"{path}: already exists and {what}; it was not changed. Choose another folder, or remove this one"
        )


@contextmanager
def atomic_folder(path: Path, mark: str = RESULT) -> Iterator[Path]:
    """An empty temporary folder next to `path`; renamed to `path` when the block ends without an error.

    An earlier result stays untouched until then, and files that its user added are kept. Raises OutputError where `path`
    exists and is not a result marked by `mark`.
    """
    partial, old = path.with_name(f".{path.name}.partial"), path.with_name(f".{path.name}.old")
    if old.exists() and not path.exists():  # a run was killed between the two renames below
        old.rename(path)
    check_result_folder(path, mark)
    for leftover in (partial, old):
        shutil.rmtree(leftover, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        if path.exists():
            _carry_over(path, partial, mark)
            path.rename(old)
        partial.rename(path)
    finally:
        if old.exists() and not path.exists():
            old.rename(path)
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _carry_over(old: Path, new: Path, mark: str) -> None:
    """Copy the entries of `old` that linkwise did not write."""
    written = _written(old, mark) or set()
    for entry in old.iterdir():
        if entry.name in written or (new / entry.name).exists():
            continue
        if entry.is_dir():
            shutil.copytree(entry, new / entry.name, symlinks=True)
        else:
            shutil.copy2(entry, new / entry.name, follow_symlinks=False)


def _written(folder: Path, mark: str) -> set[str] | None:
    """Names of the files that linkwise wrote into an earlier result; None where `folder` is not a result."""
    try:
        result = json.loads((folder / mark).read_text(encoding="utf-8"))
        return {mark, *map(str, result["files"])} if "method" in result else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
