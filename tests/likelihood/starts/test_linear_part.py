"""The linear part of a structure with hosts in samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts.linear_part import LinearPart
from linkwise.likelihood.starts.mode_tuning import with_starts

WING = host("wing", (5.0, 9.0), 0.01, {"tip": (0.1, 0.2), "mid": (0.15, -0.1)})
JOINED = structure({}, link("joint", "wing.mid-ground", "k*d + c*v"), hosts=(WING,))


@pytest.mark.parametrize("damper", [0.0, 1e3, 1e6])
def test_process_noise_is_a_covariance_however_overdamped_the_system(damper: float) -> None:
    """A method that runs a motion back in time loses all digits with a mode that decays within a sample."""
    record, half = (
        lw.Record(0.0, rate, ("x:wing.tip",), np.sin(np.arange(3.0 * rate) * 100.0 / rate)[:, None])
        for rate in (100.0, 200.0)
    )
    part = LinearPart.of(JOINED, np.array([[0.0, damper]]))
    model = part.model(record, {"x:wing.tip": 1e-3}, 0.1)
    finer = part.model(half, {"x:wing.tip": 1e-3}, 0.1)
    twice = finer.process + finer.transition @ finer.process @ finer.transition.T
    twice *= model.process[-1, -1] / twice[-1, -1]  # the random forces of both
    size = np.sqrt(model.process.diagonal())
    assert np.linalg.eigvalsh(model.process / np.outer(size, size)).min() > -1e-12
    assert np.abs((twice - model.process) / np.outer(size, size)).max() < 1e-8


def test_other_values_of_modes_give_the_system_of_a_structure_with_these_values() -> None:
    """What a search for frequencies, damping and springs needs hundreds of times, without a structure for each."""
    values, equivalent = {"wing.mode1.frequency": 5.5, "wing.mode2.damping": 0.03}, np.array([[70.0, 0.4]])
    asked = replace(JOINED, hosts=(WING.known_to_within(frequency=0.1, damping=0.5),))
    moved = LinearPart.of(asked, np.array([[10.0, 0.1]])).with_values(values, equivalent)
    expected = LinearPart.of(with_starts(asked, values), equivalent)
    np.testing.assert_allclose(moved.stiffness, expected.stiffness, rtol=1e-12)
    np.testing.assert_allclose(moved.damping, expected.damping, rtol=1e-12)
    np.testing.assert_array_equal(moved.equivalent, equivalent)
