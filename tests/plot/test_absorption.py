"""Figures of absorption: what is drawn is what was found, and nothing is promised that is not there."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from present import some

import linkwise as lw
from linkwise.plot.absorptions import crossings_figure, decay_figure


@pytest.fixture(scope="module")
def eight() -> lw.Absorption:
    """The paper's Fig. 5, its first second and a half."""
    return lw.absorb(
        lw.bnes_chain(8), duration=1.5, rate=500.0, release={"v:m1": 3.0}, harvesters={"nes1": 0.01}
    )


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.slow
def test_decay_shows_every_primary_mass_with_and_without(eight: lw.Absorption) -> None:
    figure = decay_figure(eight)
    assert [axes.get_ylabel() for axes in figure.axes] == ["m1\nmm", "m3\nmm", "m5\nmm", "m7\nmm"]
    without, with_sinks, *_ = (np.asarray(line.get_ydata()) for line in figure.axes[1].get_lines())
    np.testing.assert_allclose(with_sinks, 1000.0 * eight.with_sinks.x[:, 2], rtol=1e-12)
    np.testing.assert_allclose(without, 1000.0 * eight.without.x[:, 1], rtol=1e-12)
    assert "chaos: one motion of many" in labels(figure) and "settled with sinks" not in labels(figure)
    assert "envelope, 95 % of draws" not in labels(figure)
    lower, upper = 0.9 * eight.with_sinks.envelope, 1.1 * eight.with_sinks.envelope
    drawn = lw.absorption.AbsorptionIntervals(eight, 2, 0, (), lower, upper, diverged=0, closure=0.0)
    assert "envelope, 95 % of draws" in labels(decay_figure(drawn))


def test_crossings_are_marked_above_each_sink(eight: lw.Absorption) -> None:
    for axes, work in zip(some(crossings_figure(eight).axes), eight.sinks, strict=True):
        marks = next(line for line in axes.get_lines() if line.get_label() == "crossing")
        np.testing.assert_array_equal(marks.get_xdata(), work.crossings)
        assert axes.get_title("left") == f"{work.sink.link}: {len(work.crossings)} crossings"
    one_well, trial = lw.bnes_chain(2, alpha=100.0), {"v:m1": 1.0}
    figure = crossings_figure(lw.absorb(one_well, sinks=["nes1"], duration=0.2, rate=500.0, release=trial))
    assert labels(figure) == ["elongation"] and figure.axes[0].get_title("left") == "nes1: one well"
