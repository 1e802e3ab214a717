"""The misfit of a record does not depend on units, but on whether the laws explain what was recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import row_of_masses

import linkwise as lw
from linkwise.weak.estimate import record_misfit

LAW = "k*d + c*v"
ROW = row_of_masses([1.0, 0.5], low=(LAW, {"k": 2000.0, "c": 0.5}), high=(LAW, {"k": 900.0, "c": 0.3}))


def noisy() -> lw.Record:
    clean = lw.simulate(ROW, release={"v:m1": 1.0}, duration=10.0, rate=500.0)
    return replace(clean.with_noise(30.0, seed=3), simulated=None)


def test_a_unit_that_all_channels_share_changes_nothing() -> None:
    """Linear laws explain motions in mm as they explain them in m: an identity but for rounding."""
    record = noisy()
    scaled = replace(record, values=1e3 * record.values)
    assert record_misfit(scaled, ROW.unknown("all")) == pytest.approx(
        record_misfit(record, ROW.unknown("all")), rel=1e-8
    )


@pytest.mark.parametrize("factors", [(1.0, -1.0), (1.0, 1e3), (1.0, 1e-3), (1e3, 1.0)])
def test_a_factor_of_one_channel_is_told(factors: tuple[float, float]) -> None:
    record, asked = noisy(), ROW.unknown("all")
    wrong = replace(record, values=record.values * np.array(factors))
    assert record_misfit(wrong, asked) > record_misfit(record, asked) + 1000.0
