"""What memory is held to be free: by the system, by a container, and never so little that small work is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from linkwise import runtime as memory

GIGA = 2**30


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with 16 GB available in a container of 8 GB that uses 5, 2 of them for files."""
    (tmp_path / "meminfo").write_text(f"MemTotal: 1 kB\nMemAvailable: {16 * GIGA // 1024} kB\n")
    (tmp_path / "memory.max").write_text(f"{8 * GIGA}\n")
    (tmp_path / "memory.current").write_text(f"{5 * GIGA}\n")
    (tmp_path / "memory.stat").write_text(f"anon {3 * GIGA}\ninactive_file {2 * GIGA}\n")
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "_GROUP", tmp_path)
    return tmp_path


def test_the_container_counts_without_its_cached_files(told: Path) -> None:
    assert memory.available_memory() == 5 * GIGA


def test_without_a_limit_the_system_counts(told: Path) -> None:
    (told / "memory.max").write_text("max\n")
    assert memory.available_memory() == 16 * GIGA


def test_small_work_is_never_refused_for_a_moments_lack(told: Path) -> None:
    (told / "memory.current").write_text(f"{10 * GIGA}\n")
    assert memory.available_memory() == GIGA


def test_a_system_that_tells_nothing_has_half_of_what_is_installed(told: Path) -> None:
    (told / "meminfo").unlink()
    (told / "memory.max").unlink()
    assert 0 < memory.available_memory() < 2**50
