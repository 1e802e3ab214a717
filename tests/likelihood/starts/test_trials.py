"""Random starts stay within the bounds of parameters, and near what units imply."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.starts.trials import trial_values

SIZE = 1e3


def trials(*, first: bool, count: int = 200, **known: Any) -> np.ndarray:
    """(count,) starts of the stiffness of a spring, whose size is SIZE."""
    asked = oscillator("k*d", k=lw.Coefficient.unknown(**known))
    rng = np.random.default_rng(1000)
    return np.array(
        [trial_values(asked.parameters, {}, {"link.k": SIZE}, rng, first=first)[0] for _ in range(count)]
    )


@pytest.mark.parametrize(
    ("lower", "upper", "start"), [(0.0, np.inf, 0.0), (-np.inf, 200.0, 200.0), (100.0, 300.0, 300.0)]
)
@pytest.mark.parametrize("first", [True, False])
def test_a_start_at_a_bound_is_moved_inside(first: bool, lower: float, upper: float, start: float) -> None:
    """From a bound a search goes nowhere."""
    found = trials(first=first, lower=lower, upper=upper, start=start)
    assert np.all((lower < found) & (found < upper))


def test_the_first_trial_takes_what_is_stated_and_later_ones_scatter_about_it() -> None:
    assert np.all(trials(first=True, start=50.0) == 50.0)
    decades = np.log10(trials(first=False, start=50.0) / 50.0)
    # of a fifth of a decade: four deviations of a mean and of a deviation of 200 normal numbers
    assert abs(decades.mean()) < 4.0 * 0.2 / np.sqrt(200.0)
    assert np.std(decades) == pytest.approx(0.2, rel=4.0 / np.sqrt(2.0 * 200.0))


def test_without_a_start_trials_fill_the_bounds_or_three_decades() -> None:
    bounded = trials(first=False, lower=-1.0, upper=3.0)
    # all but a twentieth at each end, of which 200 uniform numbers leave a twentieth free once in 30 000
    assert -0.8 <= bounded.min() < -0.6 and 2.6 < bounded.max() <= 2.8
    free = np.log10(np.abs(trials(first=False)) / SIZE)
    assert -1.5 <= free.min() < -1.35 and 1.35 < free.max() <= 1.5
    negative = np.mean(trials(first=False) < 0.0)
    assert negative == pytest.approx(0.3, abs=4.0 * np.sqrt(0.3 * 0.7 / 200.0))  # deviations of the share
    assert np.all(trials(first=False, lower=0.0) > 0.0) and np.all(trials(first=False, upper=0.0) < 0.0)
