"""What memory is held to be free: by the system, by a container, and never so little that small work is refused.

And what is freed, which is used again.
"""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from linkwise.runtime import available_memory

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
    """Of 40 MB that a process frees and takes again, without the call every page is cleared anew."""
    pytest.importorskip("resource")
    code = """
import resource, sys
import numpy as np
from linkwise.runtime import keep_freed_memory
if sys.argv[1] == "kept":
    keep_freed_memory()
for _ in range(2):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    parts = [np.ones(2**17) for _ in range(40)]
    del parts
    cleared = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(cleared)
"""
    plain = {key: value for key, value in os.environ.items() if not key.startswith("MALLOC_")}
    kept, given_back = (
        int(subprocess.run([sys.executable, "-c", code, how], env=plain, capture_output=True).stdout)
        for how in ("kept", "given back")
    )
    pages = 40 * 2**20 / 4096
    assert kept < 0.1 * pages and given_back > 0.5 * pages
