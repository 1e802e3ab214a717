"""What drives a structure: a release, impulses, forces on masses, the motion of the base.

A force or a base motion is a `TimeFunction` (an expression of t) or `Sampled` (a record of it, interpolated by a spline).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import LawError, SimulationError
from linkwise.expression import Expression, Program, differentiate, parse_with_places, symbols
from linkwise.expression.tree import Symbol

ORDERS = (0, 1, 3, 5, 7)
_UPSAMPLING = 4  # samples put into one interval before the spline where the signal is taken as band-limited
_HALF_WIDTH = 32  # of the windowed sinc, in samples to each side
_KAISER = 10.0  # shape of its window: 100 dB of stop band


@dataclass(frozen=True)
class TimeFunction:
    """A function of time as text in `t` (s), such as "2*sin(30*t)*exp(-t)"; in N for a force, in m for the base.

    Raises LawError, with a caret under the place, for text that cannot be read and for any name but t.
    """

    text: str
    expression: Expression = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parsed = parse_with_places(self.text, ("t",))
        others = [name for name in symbols(parsed.expression) if name != "t"]
        if others:
            raise LawError(
                f"{others[0]!r} is not known to a function of time.",
                self.text,
                parsed.place(Symbol(others[0])),
                "Write numbers for everything but the time t, in s.",
            )
        object.__setattr__(self, "expression", parsed.expression)

    def value(self, time: ArrayLike) -> Floats:
        """The function at `time` in s, in the shape of `time`."""
        return _program(self.expression)(time)[0]

    def derivative(self, time: ArrayLike) -> Floats:
        """Its derivative by time."""
        return _program(differentiate(self.expression, "t"))(time)[0]


@lru_cache(maxsize=256)
def _program(expression: Expression) -> Program:
    return Program([expression], ("t",))


class PiecewisePolynomial(NamedTuple):
    """A piecewise polynomial: on [edges[p], edges[p+1]] it is sum_k coefficients[p, k] (t - edges[p])^k."""

    edges: Floats
    coefficients: Floats


@dataclass(frozen=True, eq=False)
class Sampled:
    """Samples `values` (N,) at `start` + k/`rate`, interpolated by a spline of the stated `order`.

    `order` 5 (default) has four continuous derivatives and an error of the sixth order in the sampling interval; 7, 3, 1 are
    splines too, 0 holds each sample until the next. With `band_limited` the samples are taken as those of a signal without
    content above half the rate: a windowed sinc first puts three samples into every interval, then the spline goes through
    all of them. Raises SimulationError for samples that are no finite numbers, too few of them, or another order.
    """

    start: float
    rate: float
    values: Floats
    order: int = 5
    band_limited: bool = False

    def __post_init__(self) -> None:
        try:
            values = np.array(self.values, dtype=float)
        except (TypeError, ValueError):
            raise SimulationError("the samples of an input must be numbers") from None
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "start", float(self.start))
        object.__setattr__(self, "rate", float(self.rate))
        if self.order not in ORDERS:
            raise SimulationError(
                f"a spline of order {self.order!r} cannot be had; the orders are {', '.join(map(str, ORDERS))}"
            )
        if not (np.isfinite(self.start) and np.isfinite(self.rate) and self.rate > 0.0):
            raise SimulationError(
                f"an input cannot start at {self.start!r} s and be sampled at {self.rate!r} Hz; the start is a "
                "number and the rate a number above 0"
            )
        if values.ndim != 1 or values.size < max(self.order + 1, 2):
            raise SimulationError(
                f"an input of shape {values.shape} cannot be interpolated by a spline of order {self.order}: it needs "
                f"one row of at least {max(self.order + 1, 2)} samples; a lower order needs fewer"
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise SimulationError(
                f"sample {bad[0]} of an input, at {self.start + bad[0] / self.rate:g} s, is {values[bad[0]]}; "
                "inputs drive the motion and may not have gaps: fill them first"
            )

    @property
    def end(self) -> float:
        """The time of the last sample in s."""
        return self.start + (self.values.size - 1) / self.rate

    @cached_property
    def _spline(self) -> scipy.interpolate.PPoly:
        values, rate = self.values, self.rate
        if self.band_limited:
            values, rate = _upsampled(values), rate * _UPSAMPLING
        time = self.start + np.arange(values.size) / rate
        if self.order == 0:
            return scipy.interpolate.PPoly(values[None, :-1], time)
        spline = scipy.interpolate.make_interp_spline(time, values, k=self.order)
        pieces = scipy.interpolate.PPoly.from_spline(scipy.interpolate.BSpline(spline.t, spline.c, spline.k))
        real = np.diff(pieces.x) > 0.0  # knots at the ends stand many times
        return scipy.interpolate.PPoly(pieces.c[:, real], np.append(pieces.x[:-1][real], pieces.x[-1]))

    @cached_property
    def pieces(self) -> PiecewisePolynomial:
        """The interpolant as polynomials, lowest power first."""
        return PiecewisePolynomial(self._spline.x, np.ascontiguousarray(self._spline.c[::-1].T))

    def value(self, time: ArrayLike) -> Floats:
        """The interpolant at `time` in s; SimulationError outside of the samples."""
        return self._evaluated(self._spline, time)

    def derivative(self, time: ArrayLike) -> Floats:
        """Its derivative by time; SimulationError outside of the samples."""
        return self._evaluated(self._spline.derivative(), time)

    def integral(self, time: ArrayLike) -> Floats:
        """Its integral from the first sample to `time`; SimulationError outside of the samples."""
        return self._evaluated(self._spline.antiderivative(), time)

    def _evaluated(self, spline: scipy.interpolate.PPoly, time: ArrayLike) -> Floats:
        time = np.asarray(time, dtype=float)
        slack = 1e-6 / self.rate  # times are computed as k/rate, with rounding
        outside = (time < self.start - slack) | (time > self.end + slack)
        if np.any(outside):
            raise SimulationError(
                f"an input is sampled from {self.start:g} to {self.end:g} s and is asked for at "
                f"{np.atleast_1d(time)[np.atleast_1d(outside)][0]:g} s; give more samples or simulate less"
            )
        return np.asarray(spline(np.clip(time, self.start, self.end)), dtype=float)


def _upsampled(values: Floats) -> Floats:
    """`_UPSAMPLING` (N - 1) + 1 samples of the band-limited signal through `values` (N,).

    A sinc under a Kaiser window; beyond its ends the signal is continued by point reflection, which keeps value and slope.
    """
    reach = min(_HALF_WIDTH, values.size - 1)
    before = 2.0 * values[0] - values[reach:0:-1]
    after = 2.0 * values[-1] - values[-2 : -2 - reach : -1]
    long = np.concatenate([before, values, after])
    finer: Floats = np.empty((values.size, _UPSAMPLING))
    finer[:, 0] = values
    for phase in range(1, _UPSAMPLING):
        offset = np.arange(-reach, reach + 1) - phase / _UPSAMPLING  # of the samples from the new point
        inside = np.clip(1.0 - (offset / (reach + 1)) ** 2, 0.0, None)
        taps = np.sinc(offset) * np.i0(_KAISER * np.sqrt(inside)) / np.i0(_KAISER)
        finer[:, phase] = np.convolve(long, taps[::-1] / taps.sum(), mode="valid")
    return finer.ravel()[: _UPSAMPLING * (values.size - 1) + 1]


@dataclass(frozen=True)
class Impulse:
    """A blow: `momentum` in N s that `mass` takes up at `time` in s, too fast for anything to move meanwhile."""

    mass: str
    momentum: float
    time: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.momentum) and np.isfinite(self.time) and self.time >= 0.0):
            raise SimulationError(
                f"an impulse of {self.momentum!r} N s at {self.time!r} s cannot be; both are finite numbers and the time "
                "is not before the start, 0",
                mass=self.mass,
            )


InputSignal = TimeFunction | Sampled


@dataclass(frozen=True, eq=False)
class Excitation:
    """All that sets a structure in motion; without anything it rests.

    `release` holds initial displacements "x:MASS" in m and velocities "v:MASS" in m/s (0 where not named), `impulses` the
    blows, `forces` what acts on each mass in N, `base` the displacement of the base in m.
    """

    release: Mapping[str, float] = field(default_factory=dict)
    impulses: tuple[Impulse, ...] = ()
    forces: Mapping[str, InputSignal] = field(default_factory=dict)
    base: InputSignal | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "release", MappingProxyType(dict(self.release)))
        object.__setattr__(self, "impulses", tuple(sorted(self.impulses, key=lambda impulse: impulse.time)))
        object.__setattr__(self, "forces", MappingProxyType(dict(self.forces)))

    @classmethod
    def of(
        cls,
        release: Mapping[str, float] | None = None,
        impulses: Iterable[Impulse] = (),
        forces: Mapping[str, InputSignal | str | float] | None = None,
        base: InputSignal | str | float | None = None,
    ) -> Excitation:
        """An excitation from what a user writes: a text or a number for a force or the base is a `TimeFunction`.

        Raises SimulationError for what is neither that nor `Sampled`, and for a release that is no finite number.
        """
        return cls(
            {name: _number(name, value) for name, value in (release or {}).items()},
            tuple(impulses),
            {mass: _drive(f"the force on {mass}", given) for mass, given in (forces or {}).items()},
            None if base is None else _drive("the motion of the base", base),
        )

    def __reduce__(self) -> tuple[type[Excitation], tuple[object, ...]]:
        return Excitation, (dict(self.release), self.impulses, dict(self.forces), self.base)

    @property
    def drives(self) -> dict[str, InputSignal]:
        """Force by mass and, under the name "base", the motion of the base."""
        return dict(self.forces) if self.base is None else {**self.forces, "base": self.base}


def _number(name: str, value: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]  # what is no number is refused below
    except (TypeError, ValueError):
        raise SimulationError(f"the release {name} is {value!r}, which is no number") from None
    if not np.isfinite(number):
        raise SimulationError(f"the release {name} is {value!r}; a structure starts from finite numbers")
    return number


def _drive(what: str, given: object) -> InputSignal:
    if isinstance(given, TimeFunction | Sampled):
        return given
    if isinstance(given, str):
        return TimeFunction(given)
    if isinstance(given, int | float) and not isinstance(given, bool):
        return TimeFunction(repr(given))
    raise SimulationError(
        f'{what} is given as {type(given).__name__}; give an expression of t, such as "sin(30*t)", or its samples, '
        "Sampled(start, rate, values)"
    )
