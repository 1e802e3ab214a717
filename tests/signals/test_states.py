"""States from records, and from what moves with a base: what is measured stays, what is not is derived or integrated, and
what cannot be is refused; polynomials that the smoothers give exactly.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present
from structures import link, oscillator, with_links

import linkwise as lw
from linkwise.signals.base_frame import framed
from linkwise.signals.states import (
    DRIFT_FREQUENCY,
    DifferentiationMethod,
    drift_frequency,
    finite_differences,
    integral,
    savitzky_golay,
    smoothing_spline,
)

RATE = 1000.0
TIME = np.arange(3000) / RATE
W = 2 * np.pi * np.array([12.0, 31.0])
X = np.sin(TIME[:, None] * W)
V = W * np.cos(TIME[:, None] * W)
A = -(W**2) * X


def _record(**channels: np.ndarray) -> lw.Record:
    """A record of channels given as x_m1=..., "_" for ":"."""
    names = tuple(name.replace("_", ":") for name in channels)
    return lw.Record(0.5, RATE, names, np.column_stack(list(channels.values())))


def _share(computed: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(computed - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("derivative", [1, 2])
def test_differences_have_their_declared_order_up_to_both_ends(derivative: int) -> None:
    errors = []
    for count in (30, 60):
        time = np.linspace(0.0, 1.0, count + 1)
        values = np.exp(2 * time)[:, None]
        found = finite_differences(values, count, derivative)
        errors.append(np.max(np.abs(found - values * 2**derivative)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)  # measured to 0.12
    with pytest.raises(lw.RecordError, match="5 samples are too few for differences of order 4"):
        finite_differences(X[:5], RATE, 2)


@pytest.mark.parametrize(
    ("method", "v_limit", "a_limit"),
    [
        ("differences", 2e-4, 2e-4),  # (2 pi 31 Hz / kHz)^4 / 30 and / 90
        ("spline", 1e-5, 2e-4),  # (2 pi 31 Hz / kHz)^4 / 720 for a of a quintic spline, with room
        ("savgol", 1e-4, 2e-3),  # the window is cut at 1.4 bandwidths, and a loses first
    ],
)
def test_methods_derive_what_is_missing(
    method: DifferentiationMethod, v_limit: float, a_limit: float
) -> None:
    states = lw.sindy.differentiate(_record(x_m1=X[:, 0], x_m2=X[:, 1]), method)
    inner = np.isin(TIME + 0.5, states.time)
    assert states.masses == ("m1", "m2")
    for mass in range(2):
        assert _share(states.v[:, mass], V[inner, mass]) < v_limit
        assert _share(states.a[:, mass], A[inner, mass]) < a_limit


def test_forces_and_base_motion_come_along() -> None:
    push, base = np.cos(TIME), 1e-3 * np.sin(2 * np.pi * 5 * TIME)
    record = _record(x_m1=X[:, 0], x_m2=X[:, 1], force_m2=push, x_base=base)
    states = lw.sindy.differentiate(record, "differences")
    assert states.driven == ("m2",)
    np.testing.assert_array_equal(states.forces, np.column_stack([np.zeros(3000), push]))
    np.testing.assert_array_equal(states.base, base)
    # fourth order of 2 pi 5 Hz / kHz over 30, 3.2e-8; measured 3.3e-8
    assert _share(present(states.base_velocity), 1e-3 * 2 * np.pi * 5 * np.cos(2 * np.pi * 5 * TIME)) < 1e-6
    assert lw.sindy.differentiate(_record(x_m1=X[:, 0]), "differences").base is None


HOLED = X.copy()
HOLED[[100, 2000], 0] = np.nan
SLOW = np.cos(TIME[:64]) + 0.01 * np.random.default_rng(1).normal(size=64)


@pytest.mark.parametrize(
    ("channels", "method", "message"),
    [
        ({"x_m1": HOLED[:, 0], "x_m2": HOLED[:, 1]}, "spline",
         r"channel x:m1: 2 samples are missing, the first at 0\.6 s.*record\.between\(0\.601, 2\.499\)"),
        ({"x_m1": X[:, 0], "x_m2": np.full(3000, np.nan)}, "spline", "no row is complete"),
        ({"a_m1": A[:, 0]}, "spline", "m1 has a:m1 but no displacement x:m1, and integrating a record causes drift"),
        ({"x_m1": X[:, 0], "a_base": A[:, 1]}, "spline", "base has a:base but no displacement x:base"),
        ({"force_m1": X[:, 0]}, "spline", "no response channel to differentiate, only force:m1"),
        ({"x_m1": X[:, 0]}, "kalman", r"unknown method 'kalman'; choose from \"spline\" .* \"savgol\" .* \"differences\""),
        ({"x_m1": SLOW}, "spline", r"64 samples are too few, since \d+ at each end have one-sided derivatives only"),
    ],
)  # fmt: skip
def test_refused_signals(
    channels: dict[str, np.ndarray], method: DifferentiationMethod, message: str
) -> None:
    with pytest.raises(lw.RecordError, match=message):
        lw.sindy.differentiate(_record(**channels), method)


def test_the_integral_has_its_order() -> None:
    errors = []
    for count in (101, 201):
        time = np.linspace(0.0, 2.0, count)
        errors.append(np.abs(integral(np.cos(3.0 * time), time[1]) - np.sin(3.0 * time) / 3.0).max())
    assert errors[0] / errors[1] == pytest.approx(2.0**4, rel=0.05)  # order four, as of parabolas


@pytest.mark.parametrize(("frequency", "cutoff"), [(0.5, 0.1), (5.0, 1.0), (40.0, DRIFT_FREQUENCY)])
def test_drift_is_below_the_motion(frequency: float, cutoff: float) -> None:
    time = np.arange(20_000) / 1000.0
    sine = np.sin(2.0 * np.pi * frequency * time)
    for drift in (0.0, 0.05 * time, 0.5 * np.sin(0.4 * time)):  # of the sensor, weaker than the motion
        assert drift_frequency(sine + drift, 1000.0) == pytest.approx(cutoff, rel=0.02)
    assert drift_frequency(np.full(100, 9.81), 1000.0) == DRIFT_FREQUENCY  # at rest


@pytest.mark.parametrize("half", [3, 10])
def test_savitzky_golay_reproduces_polynomials_of_its_degree_up_to_both_ends(half: int) -> None:
    polynomial = np.polynomial.Polynomial(np.random.default_rng(0).normal(size=6))
    smoothed = savitzky_golay(polynomial(TIME), RATE, half=half)
    for order, values in enumerate(smoothed):
        exact = polynomial.deriv(order)(TIME) if order else polynomial(TIME)
        # Identity; each derivative multiplies rounding by the rate over the half window.
        np.testing.assert_allclose(values[:, 0], exact, atol=1e-11 * RATE**order)


@pytest.mark.parametrize("half", [2, 1500])
def test_a_window_that_cannot_be_is_refused(half: int) -> None:
    message = rf"window for degree 5 must .* at most 3000 samples .*, got {2 * half + 1}"
    with pytest.raises(lw.RecordError, match=message):
        savitzky_golay(TIME, RATE, half=half)


def test_the_spline_reproduces_cubics_at_any_smoothing() -> None:
    # The penalty is on fourth differences, so cubics cost nothing.
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    time = TIME[:1500]
    for smoothing in (1e-8, 1.0, 1e6, 1e12):
        spline = smoothing_spline(cubic(time), RATE, smoothing=smoothing)
        np.testing.assert_allclose(spline.value()[:, 0], cubic(time), atol=1e-8)
        np.testing.assert_allclose(spline.first()[:, 0], cubic.deriv()(time), atol=1e-8 * RATE)
        # identity, as the two above: the second derivative multiplies rounding by the square of the rate
        np.testing.assert_allclose(spline.second()[:, 0], cubic.deriv(2)(time), atol=1e-8 * RATE**2)


def test_smoothers_refuse_gaps_and_short_records() -> None:
    holed = np.sin(TIME)
    holed[[30, 31]] = np.nan
    message = "2 samples are missing, the first at index 30; smoothers cannot bridge a gap"
    with pytest.raises(lw.RecordError, match=message):
        smoothing_spline(holed, RATE)
    with pytest.raises(lw.RecordError, match="2 samples are missing"):
        savitzky_golay(holed, RATE, half=5)
    with pytest.raises(lw.RecordError, match="10 samples are too few for a smoothing spline, which needs 16"):
        smoothing_spline(np.arange(10.0), RATE)
    with pytest.raises(lw.RecordError, match=r"smoothing must be between 1e-8 and 1e12, got 0\.0"):
        smoothing_spline(TIME, RATE, smoothing=0.0)


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
