"""Records of structures on a base of which a velocity or an acceleration is all that is known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present
from structures import link, oscillator, with_links

import linkwise as lw
from linkwise.signals.base_frame import framed

BASE = "0.004*sin(31*t) + 0.003*sin(47*t + 1) + 0.01*sin(9*t)"


def storey(below: str = "base", mass: float | lw.Coefficient = 2.0) -> lw.Structure:
    return oscillator("k*d + c*v", mass=mass, to=below, name="frame", k=2000.0, c=1.0)


@cache
def measured(*sensors: str) -> lw.Record:
    return lw.simulate(storey(), duration=2.0, rate=500.0, base=BASE, sensors=sensors)


def test_relative_displacements_need_forces_of_inertia() -> None:
    record = measured("rel:x:m1", "a:m1", "a:base")
    frame = framed(record.select(["rel:x:m1", "a:base"]), storey())
    assert frame.record.channels == ("x:m1", "force:m1", "x:base", "a:base")
    assert (frame.record.channel("force:m1") == -2.0 * record.channel("a:base")).all()
    assert not frame.record.channel("x:base").any()
    assert not frame.shown.any()
    record = record.select(["rel:x:m1", "a:base"])  # clipped samples go with their channel
    x = record.channel("rel:x:m1")
    peak = 0.6 * np.abs(x).max()
    values = np.column_stack([np.clip(x, -peak, peak), record.channel("a:base")])
    marked = lw.inspection.mark_missing(replace(record, values=values, simulated=None))
    assert marked.clipped.keys() == {"rel:x:m1"}
    assert framed(marked, storey()).record.clipped.keys() == {"x:m1"}


def test_an_absolute_accelerometer_carries_the_acceleration_of_the_base_also_from_its_velocity() -> None:
    record = measured("a:m1", "a:base")
    frame = framed(record, storey())
    relative = record.channel("a:m1") - record.channel("a:base")
    assert (frame.record.channel("a:m1") == relative).all()
    assert frame.shown[:, 0] == pytest.approx(record.channel("a:base"), rel=1e-12)
    # to the pass band of the interpolating sinc, 5e-4 at a sixth of the sampling rate
    record = measured("rel:x:m1", "v:base")
    exact = lw.model.TimeFunction(BASE).derivative(record.time, 2)[100:-100]
    acceleration = present(framed(record, storey()).acceleration)[100:-100]
    assert acceleration == pytest.approx(exact, abs=5e-4 * np.abs(exact).max())


REFUSED = {
    "no base": (["rel:x:m1"], storey(), "is relative to the base, whose motion the record lacks"),
    "ground": (["rel:x:m1", "a:base"], storey("ground"), "with links to the ground alone"),
    "absolute": (["x:m1", "a:base"], storey(), r"the displacement of the base only up to drift: .*rel:x:m1"),
    "absolute rate": (["v:m1", "a:base"], storey(), "the velocity of the base only up to drift"),
    "no base for a link": (["x:m1"], storey(), 'the link "frame" ends at the base, and the record has no motion of it'),
    "twice": (["rel:x:m1", "x:m1", "x:base"], storey(), "show the same motion"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_suffice_is_refused(case: str) -> None:
    channels, structure, message = REFUSED[case]
    record = measured("x", "v", "rel:x", "a:base", "x:base").select(channels)
    with pytest.raises(lw.IdentificationError, match=message):
        framed(record, structure)


def test_a_few_samples_are_integrated_and_fewer_refused() -> None:
    record = measured("x", "a:base").select(["x:m1", "a:base"])
    assert np.isfinite(framed(record[:6], storey(), integrated=True).record.values).all()
    for values in (record[:2], replace(record, values=record.values * [[np.nan, 1.0]])):
        with pytest.raises(lw.IdentificationError, match="x:m1 has no more than 2 samples"):
            framed(values, storey(), integrated=True)


@pytest.mark.parametrize(("sensor", "known"), [("x:m1", "a:base"), ("x:m1", "v:base"), ("v:m1", "a:base")])
def test_integrals_of_the_base_leave_an_offset_and_a_drift(sensor: str, known: str) -> None:
    """To a polynomial, the motion relative to the base: to the error of the interpolation."""
    record = measured("x", "v", "rel:x", "rel:v", "v:base", "a:base")
    frame = framed(record.select([sensor, known]), storey(), integrated=True)
    assert frame.drifting == (sensor,)
    error = frame.record.channel(sensor) - record.channel(f"rel:{sensor}")
    # one more than what is open, for an offset of the base
    degree = 2 if (sensor, known) == ("x:m1", "a:base") else 1
    line = np.polynomial.Polynomial.fit(record.time, error, degree)
    assert error == pytest.approx(line(record.time), abs=1e-6 * np.abs(record.channel(sensor)).max())
    shown = frame.record.channel(sensor)  # has no such polynomial left
    assert np.polynomial.Polynomial.fit(record.time, shown, degree).coef == pytest.approx(0.0, abs=1e-12)
    assert shown + frame.shown[:, 0] == pytest.approx(record.channel(sensor), abs=1e-12)


def test_both_supports_need_the_displacement() -> None:
    both = with_links(storey(), link("stop", "m1-ground", "k*d", k=10.0))
    message = 'link "stop" ends at the ground and another at the base'
    with pytest.raises(lw.IdentificationError, match=message):
        framed(measured("rel:x:m1", "a:base"), both)
