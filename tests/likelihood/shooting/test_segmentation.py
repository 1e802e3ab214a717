"""Inputs of long records are interpolated block by block, which changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

import linkwise as lw
from linkwise.likelihood.shooting import segmentation as module
from linkwise.likelihood.shooting.segmentation import signal_at_points, value_at_points
from linkwise.records.channel import INTERPOLATIONS

IDENTICAL = 1e-11  # of the signal, whose times have rounding errors of 1e-13


@pytest.mark.parametrize("kind", INTERPOLATIONS)
@pytest.mark.parametrize(
    "samples", [1000, 1501, 1999]
)  # blocks that end with the record, and little before it
def test_blocks_give_the_signal_in_one(kind: str, samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(5441150)
    values = np.convolve(random.normal(size=samples + 20), np.ones(8) / 8.0, "same")[:samples]
    record = lw.Record(3.0, 500.0, ("force:m1",), values[:, None])
    count, grid = -(-samples // 5), (5, 2)
    whole = signal_at_points(record, values, count, grid, kind)
    monkeypatch.setattr(module, "_BLOCK", 250)
    in_blocks = signal_at_points(record, values, count, grid, kind)
    for one, other in zip(whole, in_blocks, strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=IDENTICAL * max(np.abs(one).max(), 1.0))
    assert np.array_equal(value_at_points(record, values, count, grid, kind), in_blocks[0])
