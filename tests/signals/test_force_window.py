"""Forces of a hammer are zero between its hits, where their channel shows noise; no other force is taken for that."""

import numpy as np
import pytest

import linkwise as lw
from linkwise.errors import RecordError
from linkwise.signals.force_window import COARSE, coarse_hits, coarseness, with_force_windows

RATE, NOISE = 1000.0, 0.3
TIME = np.arange(2000) / RATE


def struck(*starts: float, width: float = 0.006, peak: float = 300.0) -> np.ndarray:
    """Hits of the shape of a squared sine."""
    phases = [(TIME - start) / width for start in starts]
    hits = [
        np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(np.pi * phase) ** 2, 0.0) for phase in phases
    ]
    return np.asarray(np.sum(hits, axis=0))


def record(force: np.ndarray) -> lw.Record:
    motion = np.random.default_rng(9).standard_normal(len(force))
    return lw.Record.from_arrays(TIME, {"x:m1": motion, "force:m1": force})


def noise(seed: int = 1) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal(len(TIME))


def test_between_hits_a_force_is_zero() -> None:
    clean = struck(0.1, 1.2)
    windowed = with_force_windows(record(clean + noise()))
    force = windowed.channel("force:m1")
    assert np.all(force[clean == 0.0][:50] == 0.0) and np.count_nonzero(force) < 40
    loud, mean = clean > 5 * NOISE, NOISE / np.sqrt(len(TIME))
    # less the mean of the noise
    np.testing.assert_allclose(force[loud], (clean + noise())[loud], atol=4 * mean)
    assert windowed.noise["force:m1"] == pytest.approx(NOISE, rel=4 / np.sqrt(2 * len(TIME)))
    assert "0 outside of 2 hits, where it shows noise of 0." in windowed.notes[-1]


@pytest.mark.parametrize(
    "force",
    [
        struck(0.1),  # without noise
        5.0 * np.sin(40.0 * TIME) + noise(),  # no pulse
        struck(0.1) + 2.0 * np.sin(40.0 * TIME) + noise(),  # a force between the hits
        struck(0.1) + np.convolve(noise(), np.ones(8) / 8, "same"),  # coloured
        struck(0.1) + 2.0 + noise(),  # a constant force
        struck(*np.arange(0.01, 1.9, 0.012)) + noise(),  # seldom quiet
        struck(0.1, peak=4.0) + noise(),  # as low as outliers
    ],
)
def test_other_forces_stay_as_they_are(force: np.ndarray) -> None:
    given = record(force)
    assert with_force_windows(given) is given


def test_a_window_can_be_asked_for() -> None:
    shifted = with_force_windows(record(struck(0.1) + 2.0 + noise()), 0.01, required=True)
    assert abs(shifted.channel("force:m1").max() - 300.0) < 5 * NOISE
    with pytest.raises(RecordError, match=r"force:m1.*not quiet but for pulses"):
        with_force_windows(record(5.0 * np.sin(40.0 * TIME)), required=True)
    motion = record(struck(0.1)).select(["x:m1"])
    with pytest.raises(RecordError, match="no applied force was recorded"):
        with_force_windows(motion, required=True)


def test_hits_of_few_samples_are_coarse() -> None:
    """Of half a sine the sum over n samples is off by 1/(4 n**2 - 1) of the impulse, over all positions."""
    rng = np.random.default_rng(3)
    off: dict[int, list[float]] = {}
    for width in rng.uniform(2.0, 10.0, 4000):
        phase = (np.arange(100.0) - 20.0 - rng.uniform()) / width
        pulse = np.where((phase > 0.0) & (phase < 1.0), np.sin(np.pi * phase), 0.0)
        samples = coarse_hits(lw.Record(0.0, 1.0, ("force:m1",), pulse[:, None]), COARSE)["force:m1"]
        off.setdefault(samples, []).append(pulse.sum() * np.pi / 2.0 / width - 1.0)
    for samples in (3, 5, 8):
        assert np.std(off[samples]) == pytest.approx(coarseness(samples), rel=0.15)
    long = np.sin(np.pi * np.clip(np.arange(100.0) / 20.0, 0.0, 1.0))
    assert not coarse_hits(lw.Record(0.0, 1.0, ("force:m1",), long[:, None]), COARSE)
