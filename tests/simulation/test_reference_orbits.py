"""Simulation against orbits that were computed in 400-bit arithmetic."""

from pathlib import Path

import numpy as np
import pytest
from problems import chain_record, paper_speed

from linkwise.arrays import Floats
from linkwise.model.chains import bnes_chain
from linkwise.simulation.simulate import simulate


def departure(folder: Path, n: int, **changes: float) -> Floats:
    """Largest error of each channel over the whole file, relative to the largest value of the channel."""
    table = np.loadtxt(folder / f"bnes_{n}.csv", delimiter=",", skiprows=1)
    rows = np.rint(1000.0 * table[:, 0]).astype(int)
    chain, release = bnes_chain(n, **changes), {"v:m1": paper_speed(n)}
    record = simulate(chain, release=release, duration=table[-1, 0], rate=1000.0)
    assert record.channels == tuple(f"x:m{i + 1}" for i in range(n))
    worst: Floats = np.abs(record.values[rows] - table[:, 1:]).max(axis=0)
    size: Floats = np.abs(table[:, 1:]).max(axis=0)
    return worst / size


@pytest.mark.parametrize("n", [2, 4, 6, 8, 10])
def test_follows_the_reference_to_the_end_of_the_file(shared_reference: Path, n: int) -> None:
    """The files end where ordinary double precision has departed by 1e-6; see trajectory.EXTENDED_WORK for the margin."""
    assert departure(shared_reference, n).max() < 1e-6


def test_the_reference_would_tell_another_chain(shared_reference: Path) -> None:
    """A mass that differs by 1e-12 of itself is enough to miss the bound above."""
    assert departure(shared_reference, 6, primary_mass=1.0 + 1e-12).max() > 1e-6


def test_the_two_mass_chain_does_what_the_paper_shows() -> None:
    """Fig. 2: the sink crosses between its wells until 2.3 to 2.5 s and rests at +0.0099 m."""
    record = chain_record(2, duration=60.0)
    d = record.channel("x:m2") - record.channel("x:m1")
    crossings = record.time[1:][np.diff(np.sign(d)) != 0]
    assert 2.3 < crossings[-1] < 2.5
    early = record.between(5.0, 6.0).channel("x:m2")
    assert early.mean() == pytest.approx(0.0099, abs=1e-4)
    assert d[-1] == pytest.approx(0.01, rel=1e-8)  # sqrt(-alpha/beta), what moves has died down by exp(-30)
