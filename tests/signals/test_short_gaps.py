"""Short gaps of channels, bridged for starting values."""

import numpy as np
import pytest

import linkwise as lw
from linkwise.signals.gaps import short_gaps_bridged

RATE = 100.0
TIME = np.arange(200) / RATE
CYCLES = 2.0  # Hz: fifty samples a period


def _record(*missing: slice) -> lw.Record:
    motion = np.sin(2.0 * np.pi * CYCLES * TIME)
    for gap in missing:
        motion[gap] = np.nan
    return lw.Record(0.0, RATE, ("x:m1", "force:m1"), np.column_stack([motion, motion]))


@pytest.mark.parametrize("length", [1, 2, 6])
def test_a_short_gap_is_bridged(length: int) -> None:
    """The error of a cubic across h is at most h**4 / 384 of the fourth derivative; a factor of two for the spline."""
    gap = slice(40, 40 + length)
    bridged = short_gaps_bridged(_record(gap))
    assert bridged is not None
    across = 2.0 * np.pi * CYCLES * (length + 1) / RATE
    motion = np.sin(2.0 * np.pi * CYCLES * TIME)
    assert bridged.channel("x:m1") == pytest.approx(motion, abs=2.0 * across**4 / 384.0)
    assert np.isnan(bridged.channel("force:m1")[gap]).all()  # of an input nothing is guessed


def test_long_gaps_and_ends_are_left() -> None:
    assert short_gaps_bridged(_record(slice(40, 47))) is None
    assert short_gaps_bridged(_record(slice(0, 2), slice(198, 200))) is None
    assert short_gaps_bridged(_record()) is None
    assert short_gaps_bridged(_record(slice(3, 200))) is None
