"""Resources of this process: available memory and what is freed of it, processors, and the threads of BLAS."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path

from threadpoolctl import ThreadpoolController

_MEMINFO = Path("/proc/meminfo")
_CGROUP = Path("/sys/fs/cgroup")  # limits set by a container (version 2)
_ASSUMED = 4 * 2**30  # bytes, where the system reports nothing
# bytes: a momentary shortage is no reason to refuse, since systems swap and other processes finish
_MINIMUM = 2**30
_LARGEST = 32 * 2**20 - 2**16  # bytes of an array from which glibc learns: 32 MiB with what it adds to it


def available_memory(meminfo: Path = _MEMINFO, cgroup: Path = _CGROUP) -> int:
    """Bytes that are free or can be freed, within the limit of a container, if any; never less than 1 GiB.

    Half of the installed memory where the system does not report what is free.
    """
    limits = [size for size in (_system_available(meminfo), _container_available(cgroup)) if size is not None]
    return max(min(limits), _MINIMUM) if limits else _half_of_installed()


def _system_available(meminfo: Path) -> int | None:
    """Bytes that Linux reports as available; None on other systems."""
    try:
        lines = meminfo.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    return int(fields["MemAvailable"].split()[0]) * 1024 if "MemAvailable" in fields else None


def _container_available(cgroup: Path) -> int | None:
    """Bytes below the limit of a container, the file cache not counted as used; None without a limit."""
    try:
        limit = (cgroup / "memory.max").read_text(encoding="ascii").strip()
        used = (cgroup / "memory.current").read_text(encoding="ascii").strip()
        cached = dict(
            line.split() for line in (cgroup / "memory.stat").read_text(encoding="ascii").splitlines()
        )
    except OSError:
        return None
    return max(int(limit) - int(used) + int(cached.get("inactive_file", 0)), 0) if limit != "max" else None


def _half_of_installed() -> int:
    """Half of the physical memory in bytes, for systems that report no more (macOS)."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (AttributeError, ValueError, OSError):
        return _ASSUMED


def processors() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which BLAS uses the calling thread only.

    A product that takes microseconds is finished before a second thread wakes up; on a busy machine, waiting for that thread
    costs milliseconds.
    """
    limited: AbstractContextManager[object] = _blas_libraries().limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _blas_libraries() -> ThreadpoolController:
    """The BLAS libraries that are loaded; cached, since finding them takes milliseconds."""
    return ThreadpoolController()


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let arrays take the memory of those that were freed before, where glibc allocates it.

    It gives freed memory back to the system beyond a limit, and the system clears every page that it is asked for again,
    which takes microseconds each, a tenth of the time of a fit. The limit is twice the size of the largest array that has
    been freed so far, of at most 32 MiB (mallopt(3), M_MMAP_THRESHOLD): one that nothing is written to sets it.
    """
    bytes(_LARGEST)
