"""What this process may use: memory, processors, and the threads of BLAS."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path

from threadpoolctl import ThreadpoolController

_MEMINFO = Path("/proc/meminfo")
_GROUP = Path("/sys/fs/cgroup")  # limits that a container sets (version 2)
_ASSUMED = 4 * 2**30  # where the system does not tell
_ALWAYS = 2**30  # a moment's lack of less is no reason to refuse: systems swap, neighbours finish


def available_memory() -> int:
    """Bytes that are free or can be freed, no more than a container leaves: 1 GB at least, half of all if nothing is told."""
    found = [_free(_MEMINFO), _left(_GROUP)]
    known = [number for number in found if number is not None]
    return max(min(known), _ALWAYS) if known else _installed()


def _free(meminfo: Path) -> int | None:
    """What Linux holds to be available."""
    try:
        lines = meminfo.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    return int(fields["MemAvailable"].split()[0]) * 1024 if "MemAvailable" in fields else None


def _left(group: Path) -> int | None:
    """What the limit of a container leaves, files that are only kept in memory for speed not counted."""
    try:
        limit = (group / "memory.max").read_text(encoding="ascii").strip()
        used = (group / "memory.current").read_text(encoding="ascii").strip()
        cached = dict(
            line.split() for line in (group / "memory.stat").read_text(encoding="ascii").splitlines()
        )
    except OSError:
        return None
    return max(int(limit) - int(used) + int(cached.get("inactive_file", 0)), 0) if limit != "max" else None


def _installed() -> int:
    """Half of what is installed, for systems that tell no more (macOS)."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (AttributeError, ValueError, OSError):
        return _ASSUMED


def processors() -> int:
    """The processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def one_blas_thread() -> AbstractContextManager[object]:
    """A block in which BLAS works on the calling thread alone.

    A product that takes microseconds is done before a second thread is awake, and on a busy machine it would wait for that
    thread's turn: milliseconds.
    """
    limited: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """The BLAS libraries that are loaded; finding them costs milliseconds."""
    return ThreadpoolController()
