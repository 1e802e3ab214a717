"""Damping between modes from a test: found where it is, with its standard error, and not where it is not."""

import numpy as np
import pytest
from structures import host, structure

import linkwise as lw

FREQUENCIES, DAMPING = (5.0, 5.6, 9.0), 0.02
SHAPES = {"tip": (1.0, 0.7, -0.8), "mid": (0.5, -0.9, 0.4)}
BETWEEN = {(1, 2): 0.9, (2, 3): -0.6}  # of 1.4 N s/m at most, with which no motion gains energy


def taps(between: dict[tuple[int, int], float], seed: int) -> lw.modal.HostEstimate:
    record = lw.simulate(
        structure({}, hosts=[host("wing", FREQUENCIES, DAMPING, SHAPES, between)]),
        forces={"wing.tip": "8*exp(-((t - 0.05)/0.01)**2)", "wing.mid": "6*exp(-((t - 1.5)/0.01)**2)"},
        duration=4.0,
        rate=200.0,
        sensors=["a:wing.tip", "a:wing.mid"],
    )
    return lw.modal.identify_host(record.with_noise(40.0, seed=seed), modes=3)


@pytest.mark.slow
def test_it_is_found_to_within_its_error_and_without_it_ratios_are_enough() -> None:
    found = taps(BETWEEN, 1)
    assert found.trusted
    modes, scores = found.host.modes, []
    for (first, second), entry in found.host.entries.items():
        shapes = [modes[number - 1].shape["tip"] * SHAPES["tip"][number - 1] for number in (first, second)]
        true = BETWEEN.get((first, second), 0.0) * np.prod(np.sign(shapes))  # a mode may have either sign
        scores.append(((entry.value or 0.0) - true) / entry.sigma)
    assert len(scores) == 3
    assert np.abs(scores).max() < 4.0
    assert found.host.entries[1, 2].sigma < 0.1
    for mode, frequency in zip(modes, FREQUENCIES, strict=True):
        assert abs((mode.frequency.value or 0.0) - frequency) < 4.0 * mode.frequency.sigma
        assert abs((mode.damping.value or 0.0) - DAMPING) < 4.0 * mode.damping.sigma
    assert "damping between modes: 3 pairs are free" in str(found)
    assert len(found.to_dict()["damping"]) == 3
    without = taps({}, 3)
    assert without.trusted
    assert not without.host.damping
    assert "damping" not in without.to_dict()
