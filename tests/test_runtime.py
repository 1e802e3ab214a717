"""What memory is held to be free: by the system, by a container, and never so little that small work is refused.

And what is freed, which is used again.
"""

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
