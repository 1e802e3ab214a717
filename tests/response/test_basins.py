"""Where free motion ends: symmetry, agreement with simulations, and what is refused."""

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.response import basins

PLANE = {"x:m1": (-0.025, 0.02), "v:m1": (-0.6, 0.5)}
DOUBLE_WELL = oscillator("alpha*d + beta*d**3 + c*v", mass=0.1, alpha=-100.0, beta=1e6, c=0.3)


def test_motions_end_where_simulations_end() -> None:
    found = basins(DOUBLE_WELL, PLANE, points=5)
    for row, x in enumerate(found.values[0].tolist()):
        for column, v in enumerate(found.values[1].tolist()):
            run = lw.simulate(DOUBLE_WELL, release={"x:m1": x, "v:m1": v}, duration=10.0, rate=100.0)
            rest = float(found.rests[found.ends[row, column], 0])
            assert run.values[-1, 0] == pytest.approx(rest, abs=1e-3)
    assert sorted(found.rests[:, 0].tolist()) == pytest.approx([-0.01, 0.01])
    assert found.shares.sum() == 1.0


def test_a_symmetric_well_has_symmetric_basins() -> None:
    found = basins(DOUBLE_WELL, {"x:m1": (-0.02, 0.02), "v:m1": (-0.5, 0.5)}, points=8)
    np.testing.assert_array_equal(found.ends + found.ends[::-1, ::-1], 1)


def test_what_is_no_plane_is_refused() -> None:
    with pytest.raises(
        lw.SimulationError, match="need two states and at least 2 values of each, got 1 and 31"
    ):
        basins(DOUBLE_WELL, {"x:m1": (0.0, 1.0)})
    with pytest.raises(lw.StructureError, match="no stable equilibrium was found"):
        basins(oscillator("k*d", k=-1.0), PLANE)
