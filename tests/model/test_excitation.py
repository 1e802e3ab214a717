"""Excitations: expressions of t, splines of samples, and what is refused."""

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from linkwise.errors import ArgumentTypeError, LawError, SimulationError
from linkwise.model.excitation import Excitation, Impulse, Sampled, TimeFunction

FREQUENCY = 7.0


def wave(rate: float, *, order: int = 5, band_limited: bool = False, frequency: float = FREQUENCY) -> Sampled:
    time = np.arange(int(2 * rate) + 1) / rate
    return Sampled(0.0, rate, np.sin(2 * np.pi * frequency * time), order, band_limited)


def error(sampled: Sampled, frequency: float = FREQUENCY) -> float:
    """Largest error away from the ends, where a spline has neighbours on both sides."""
    time = np.linspace(0.6, 1.4, 5001)
    return float(np.abs(sampled.value(time) - np.sin(2 * np.pi * frequency * time)).max())


def test_a_time_function_has_values_and_a_derivative_and_knows_only_t() -> None:
    function = TimeFunction("2*sin(3*t) + t**2")
    time = np.linspace(0.0, 2.0, 7)
    assert function.value(time) == pytest.approx(2 * np.sin(3 * time) + time**2, rel=1e-12)
    assert function.derivative(time) == pytest.approx(6 * np.cos(3 * time) + 2 * time, rel=1e-12)
    with pytest.raises(LawError, match=r"Unknown name 'A' in a function of time(.|\n)*the time t, in s"):
        TimeFunction("A*sin(3*t)")


@pytest.mark.parametrize("order", [1, 3, 5, 7])
def test_the_error_of_a_spline_has_the_stated_order(order: int) -> None:
    coarse, fine = error(wave(100.0, order=order)), error(wave(200.0, order=order))
    # the declared order: measured to 0.11, and the next one is 2 away
    assert np.log2(coarse / fine) == pytest.approx(order + 1, abs=0.5)


@pytest.mark.parametrize("order", [0, 1, 3, 5, 7])
def test_an_interpolant_passes_through_its_samples_and_its_pieces_are_it(order: int) -> None:
    """Order 0 holds each sample."""
    sampled, samples = wave(100.0, order=order), np.arange(200) / 100.0
    held = samples + 0.009 if order == 0 else samples
    assert sampled.value(held) == pytest.approx(sampled.values[:-1], abs=1e-12)
    edges, coefficients = sampled.pieces
    time = np.linspace(0.0, 2.0, 777)[1:-1] + 1e-5
    piece = np.searchsorted(edges, time, side="right") - 1
    value = sum(coefficients[piece, k] * (time - edges[piece]) ** k for k in range(order + 1))
    assert value == pytest.approx(sampled.value(time), abs=1e-12)
    assert edges[0] == sampled.start and edges[-1] == sampled.end


def test_band_limited_samples_reach_close_to_half_the_rate() -> None:
    """At 0.3 of the rate the quintic through the samples is off by 1 %, the band-limited signal by 1e-5."""
    plain, limited = (wave(100.0, frequency=30.0, band_limited=b) for b in (False, True))
    assert error(plain, 30.0) > 5e-3
    assert error(limited, 30.0) < 3e-5
    time = np.arange(201) / 100.0
    assert limited.value(time) == pytest.approx(limited.values, abs=1e-12)
    few = Sampled(0.0, 10.0, np.arange(7.0), band_limited=True)
    assert few.value([0.25, 0.31]) == pytest.approx([2.5, 3.1], abs=1e-2)  # a sinc cut off at 6 samples


@pytest.mark.parametrize("share", [0.01, 0.06, 0.2])
def test_acceleration_of_a_band_limited_base_is_that_of_its_motion(share: float) -> None:
    """An image near the rate accelerates 10 000 times as much as motion of its amplitude at a hundredth of the rate."""
    rate, time = 100.0, np.linspace(1.0, 9.0, 4001)
    angular = 2.0 * np.pi * share * rate
    moved = Sampled(0.0, rate, np.sin(angular * np.arange(1001) / rate), band_limited=True)
    assert moved.derivative(time, 2) / angular**2 == pytest.approx(-np.sin(angular * time), abs=2e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: wave(100.0).value(2.5), "an input is sampled from 0 to 2 s, but is needed at 2.5 s"),
        (lambda: Sampled(0.0, 10.0, np.ones(5)),
         "a spline of order 5 needs a one-dimensional array of at least 6 samples, got shape (5,)"),
        (lambda: Sampled(0.0, 10.0, np.ones((9, 2))), "got shape (9, 2); a lower order needs fewer"),
        (lambda: Sampled(0.0, 10.0, np.ones(9), order=4), "unknown spline order 4; choose from 0, 1, 3, 5, 7"),
        (lambda: Sampled(0.0, -1.0, np.ones(9)), "its rate positive, got 0.0 s and -1.0 Hz"),
        (lambda: Sampled(0.0, 10.0, np.array([1, 2, np.nan, 4, 5, 6])), "sample 2 of an input, at 0.2 s, is nan"),
        (lambda: Sampled(0.0, 10.0, np.array(["a", "b"])), "the samples of an input must be numbers, got <U1"),
        (lambda: Impulse("m1", np.inf), "a time that is not negative, got inf N s at 0.0 s"),
        (lambda: Impulse("m1", 1.0, -1.0), "a time that is not negative, got 1.0 N s at -1.0 s"),
        (lambda: Excitation(release={"x:m1": "far"}), "release['x:m1'] must be of type float, got 'far'"),  # type: ignore[dict-item]
        (lambda: Excitation(release={"x:m1": np.nan}), "the release x:m1 must be finite, got nan"),
        (lambda: Excitation(forces={"m1": [1.0]}),  # type: ignore[dict-item]
         "forces['m1'] must be of type"),
        (lambda: Excitation(base=True), "base must be of type TimeFunction, Sampled, str or float, got True"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises((SimulationError, ArgumentTypeError)) as caught:
        make()
    assert message in str(caught.value)


def test_what_a_user_writes_becomes_a_drive_and_survives_a_pickle() -> None:
    sampled = wave(100.0)
    given = Excitation(
        {"v:m1": 1}, [Impulse("m1", 1.0, 2.0), Impulse("m2", 1.0)], {"m1": "sin(t)", "m2": 3}, sampled
    )
    assert [impulse.mass for impulse in given.impulses] == ["m2", "m1"]
    assert given.forces == {"m1": TimeFunction("sin(t)"), "m2": TimeFunction("3")}
    assert list(given.drives) == ["m1", "m2", "base"]
    again = pickle.loads(pickle.dumps(given))
    assert again.forces == given.forces and again.release == given.release
    assert np.array_equal(again.base.values, sampled.values)
