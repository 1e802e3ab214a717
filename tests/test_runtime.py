"""What memory is held to be free: by the system, by a container, and never so little that small work is refused.

And what is freed, which is used again.
"""

import platform
from pathlib import Path

import numpy as np
import pytest

from linkwise.runtime import available_memory, keep_freed_memory

GIGA = 2**30


@pytest.fixture
def reported(tmp_path: Path) -> Path:
    """A machine with 16 GB available in a container of 8 GB that uses 5, 2 of them for files."""
    (tmp_path / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {16 * GIGA // 1024} kB\n")
    (tmp_path / "memory.max").write_text(f"{8 * GIGA}\n")
    (tmp_path / "memory.current").write_text(f"{5 * GIGA}\n")
    (tmp_path / "memory.stat").write_text(f"anon {3 * GIGA}\ninactive_file {2 * GIGA}\n")
    return tmp_path


def test_the_container_counts_without_its_cached_files_and_else_the_system(reported: Path) -> None:
    assert available_memory(reported / "meminfo", reported) == 5 * GIGA
    (reported / "memory.max").write_text("max\n")
    assert available_memory(reported / "meminfo", reported) == 16 * GIGA
    (reported / "meminfo").unlink()
    (reported / "memory.max").unlink()  # half of the installed memory
    assert 0 < available_memory(reported / "meminfo", reported) < 2**50


def test_at_least_one_gibibyte_is_always_available(reported: Path) -> None:
    (reported / "memory.current").write_text(f"{10 * GIGA}\n")
    assert available_memory(reported / "meminfo", reported) == GIGA


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="what is freed is another allocator's")
def test_memory_that_was_freed_is_used_again() -> None:
    """Without the call every one of 40 MB is asked for anew, as this process has freed no such array before it."""
    resource = pytest.importorskip("resource")

    def pages_cleared() -> int:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        parts = [np.ones(2**17) for _ in range(40)]
        assert len(parts) == 40
        return int(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

    keep_freed_memory()
    pages_cleared()
    assert pages_cleared() < 0.1 * 40 * 2**20 / 4096
