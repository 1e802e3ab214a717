"""What all tests share: deterministic hypothesis, and the data that may lie beside a checkout."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("linkwise", derandomize=True, deadline=None)
settings.load_profile("linkwise")

_SHARED = Path(__file__).resolve().parents[2] / "shared"


def _folder(name: str) -> Path:
    folder = _SHARED / name
    if not folder.is_dir():
        pytest.skip(f"no folder ../shared/{name} beside the checkout")
    return folder


@pytest.fixture(scope="session")
def shared_reference() -> Path:
    """Folder of the 400-bit reference orbits; the test is skipped where it is absent."""
    return _folder("reference")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the measured records; the test is skipped where it is absent."""
    return _folder("data")
