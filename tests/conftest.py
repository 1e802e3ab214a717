"""What all tests share: deterministic hypothesis, Ctrl-C, and the data that may lie beside a checkout."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from hypothesis import settings
from judged import masses
from problems import chain_record

import linkwise as lw

settings.register_profile("linkwise", derandomize=True, deadline=None)
settings.load_profile("linkwise")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # so a shell starts what runs in its background, and the processes whose Ctrl-C is tested would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

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


@pytest.fixture(scope="session")
def chain() -> lw.Structure:
    """The paper's two-mass chain."""
    return lw.bnes_chain(2)


@pytest.fixture(scope="session")
def fitted(chain: lw.Structure) -> lw.Estimate:
    """The sink of that chain, identified from three simulated seconds at 30 dB."""
    record = chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    return lw.identify(record, chain.unknown("nes"), method="weak")


@pytest.fixture(scope="session")
def discovered() -> lw.Discovery:
    """The paper's two-mass chain, discovered from three simulated seconds at 30 dB."""
    return lw.discover(chain_record(2, duration=3.0).with_noise(30.0, seed=1001), masses(lw.bnes_chain(2)))
