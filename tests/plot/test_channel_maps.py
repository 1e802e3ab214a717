"""Maps of time and frequency, and coherence, show what is in the channels and what is not."""

import numpy as np
import pytest

import linkwise as lw

RATE, COUNT = 1000.0, 8192
TIME = np.arange(COUNT) / RATE


def record(**channels: np.ndarray) -> lw.Record:
    return lw.Record.from_arrays(TIME, {f"x:{name}": values for name, values in channels.items()})


def test_a_line_that_starts_late_is_dark_from_there_on() -> None:
    noise = 0.01 * np.random.default_rng(61).normal(size=COUNT)
    late = noise + np.sin(2.0 * np.pi * 125.0 * TIME) * (TIME > 4.0)
    axes = lw.plot.spectrogram(record(m1=late), "x:m1")
    power = np.asarray(axes.collections[0].get_array())  # frequencies by blocks
    line = power[np.argmax(power.sum(axis=1))]
    assert np.argmax(power.sum(axis=1)) / (len(power) - 1) == pytest.approx(0.25, abs=0.01)
    assert line[-3:].min() > 1e3 * line[:3].max()


def test_independent_noise_exceeds_the_level_of_chance_in_one_of_twenty() -> None:
    """Of 512 frequencies in two pairs 26, within four standard deviations of a count."""
    rng = np.random.default_rng(62)
    noises = record(**{f"m{number}": rng.normal(size=COUNT) for number in range(4)})
    exceeded = 0
    for first, second in (("x:m0", "x:m1"), ("x:m2", "x:m3")):
        values, level = lw.plot.coherence(noises, first, second).get_lines()
        exceeded += int(np.sum(np.asarray(values.get_ydata()) > np.asarray(level.get_ydata())[0]))
    assert 6 < exceeded < 46


def test_what_follows_linearly_is_coherent() -> None:
    rng = np.random.default_rng(63)
    first = rng.normal(size=COUNT)
    second = 3.0 * first + rng.normal(size=COUNT)
    values, _ = lw.plot.coherence(record(m1=first, m2=second), "x:m1", "x:m2").get_lines()
    assert np.mean(np.asarray(values.get_ydata())) == pytest.approx(0.9, abs=0.03)
