"""The restoring-force surface of a link."""

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from rigs import rig

import linkwise as lw


def test_the_colours_are_the_forces_of_the_law(fitted: lw.Estimate) -> None:
    axes = lw.plot.surface(fitted, "nes1")
    [mesh] = [collection for collection in axes.collections if isinstance(collection, QuadMesh)]
    corners = np.asarray(mesh.get_coordinates())
    shown = np.asarray(mesh.get_array()).ravel()
    link = fitted.link("nes1")
    low, high = link.d_range
    assert corners[..., 0].min() < 1e3 * low and corners[..., 0].max() > 1e3 * high  # in mm
    largest = max(abs(float(link.link.force(d, v))) for d in link.d_range for v in link.v_range)
    assert np.abs(shown).max() >= largest
    motion = axes.lines[0]
    drawn = np.asarray(motion.get_xdata(), dtype=float)
    # what is drawn of the samples may miss an end by the farthest that two of them are apart, each end once
    assert np.ptp(drawn) <= 1e3 * (high - low)
    assert np.ptp(drawn) > 1e3 * (high - low) - 2.0 * np.abs(np.diff(drawn)).max()


def test_a_link_with_memory_has_no_surface() -> None:
    sliding = rig("k*d + F*z", {"k": 400.0, "F": 1.0, "x0": 1e-3}, {"z": "(v - abs(v)*z)/x0"})
    record = lw.simulate(sliding, duration=2.0, rate=100.0, base="0.01*sin(5*t)").with_noise(40.0, seed=1)
    fit = lw.identify(record, sliding.unknown("damper.k"))
    with pytest.raises(
        lw.StructureError, match="has memory or takes a signal, so that its force is not a function"
    ):
        lw.plot.surface(fit, "damper")
