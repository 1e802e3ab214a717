"""Files and folders that appear whole or not at all, and never take the place of what linkwise did not write."""

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

RESULT = "result.json"  # marks a folder as a result of linkwise; its "files" lists what linkwise put there
ABSORPTION = "absorption.json"  # the same of `absorb`


_DISK_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


def is_disk_fault(error: OSError) -> bool:
    """Whether the disk is to blame, full or broken, rather than the place that was given."""
    return error.errno in _DISK_FAULTS


class OutputError(LinkwiseError):
    """A place where nothing can or may be written."""

    exit_code = 2


def to_json(data: Any, *, indent: int | None = None) -> str:
    """Plain data as JSON that every reader accepts: what is not finite becomes null."""
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
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` when the block ends without an error.

    Missing folders above are made. The suffix is kept, since it says which format is meant.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def check_result_folder(path: Path, mark: str = RESULT) -> None:
    """Raises OutputError unless `path` is free, an empty folder, or an earlier result of the kind that `mark` marks."""
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if _written(path, mark) is None:
        other = next(
            (each for each in (RESULT, ABSORPTION) if each != mark and _written(path, each) is not None), None
        )
        what = (
            f"is the result of another command ({other})"
            if other
            else f"is no result of linkwise (it has no {mark} of one)"
        )
        raise OutputError(
            f"{path}: it is there and {what}, so it is left as it is; give another folder, or remove this one yourself"
        )


@contextmanager
def whole_folder(path: Path, mark: str = RESULT) -> Iterator[Path]:
    """An empty folder beside `path` to write a result into; it takes the place of `path` when the block ends well.

    An earlier result stays untouched until then, and what its user put beside it is carried over. Raises
    OutputError where `path` is something else than a result of the kind that `mark` marks.
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
    """Copy what is in `old` and was not written by linkwise."""
    written = _written(old, mark) or set()
    for entry in old.iterdir():
        if entry.name in written or (new / entry.name).exists():
            continue
        if entry.is_dir():
            shutil.copytree(entry, new / entry.name, symlinks=True)
        else:
            shutil.copy2(entry, new / entry.name, follow_symlinks=False)


def _written(folder: Path, mark: str) -> set[str] | None:
    """The names that linkwise wrote into an earlier result; None where `folder` is not one."""
    try:
        result = json.loads((folder / mark).read_text(encoding="utf-8"))
        return {mark, *map(str, result["files"])} if "method" in result else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
