"""Excitations: initial conditions, impulses, and forces and base motions as expressions of time or samples under a
spline.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from sys import float_info
from types import MappingProxyType, NoneType
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import LawError, SimulationError, expect
from linkwise.expression import Expression, differentiate, parse_with_positions, symbols
from linkwise.expression.program import cached_program
from linkwise.expression.tree import Symbol
from linkwise.model.coefficient import by_constructor

ORDERS = (0, 1, 3, 5, 7)
_UPSAMPLING = 4  # factor by which band-limited samples are refined before the spline
_HALF_WIDTH = 64  # of the windowed sinc, in samples
_KEPT = 20_000  # samples up to which the last splines are kept: at most 4 MB each
_LONGEST_KEPT = 250_000  # samples up to which the last spline of more is kept: at most 16 MB
_KAISER = 20.0  # shape of its Kaiser window: images so far down that those of second derivatives are, too

if TYPE_CHECKING:  # SciPy loads its packages when they are asked for
    _Spline: TypeAlias = scipy.interpolate.PPoly | scipy.interpolate.BSpline


@dataclass(frozen=True)
class TimeFunction:
    """An input given by an expression of time.

    Parameters
    ----------
    text : str
        An expression of ``t`` in s, such as ``"2*sin(30*t)*exp(-t)"``, in N for a force and in m for the base.

    Attributes
    ----------
    expression : Expression
        The parsed text.

    Raises
    ------
    LawError
        If the expression is invalid or contains a name other than ``t``.

    Examples
    --------
    >>> import linkwise as lw
    >>> float(lw.model.TimeFunction("2*sin(30*t)").value(0.0))
    0.0
    """

    text: str
    expression: Expression = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        expect("TimeFunction: text", self.text, str)
        parsed = parse_with_positions(self.text, ("t",))
        for name in symbols(parsed.expression):
            if name != "t":
                place = parsed.position(Symbol(name))
                reason = f"Unknown name {name!r} in a function of time."
                raise LawError(reason, self.text, place, "The only variable is the time t, in s.")
        object.__setattr__(self, "expression", parsed.expression)

    def value(self, time: ArrayLike) -> Floats:
        """Values of the input.

        Parameters
        ----------
        time : array
            Times in s.

        Returns
        -------
        array
            Values in N or m, in the shape of `time`.
        """
        return cached_program((self.expression,), ("t",))(time)[0]

    def derivative(self, time: ArrayLike, order: int = 1) -> Floats:
        """Time derivative of the input.

        Parameters
        ----------
        time : array
            Times in s.
        order : int, optional
            Order of the derivative.

        Returns
        -------
        array
            Derivative in the unit of the input over s^order, in the shape of `time`.
        """
        expression = self.expression
        for _ in range(order):
            expression = differentiate(expression, "t")
        return cached_program((expression,), ("t",))(time)[0]


class PiecewisePolynomial(NamedTuple):
    """A piecewise polynomial: on [edges[p], edges[p+1]] it is sum_k coefficients[p, k] (t - edges[p])^k.

    Attributes
    ----------
    edges : array of shape (P + 1,)
        Times in s, ascending.
    coefficients : array of shape (P, order + 1)
        Coefficients in the unit of the input per s^k, constant first.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> ramp = lw.model.Sampled(0.0, 10.0, np.arange(5.0), order=1)
    >>> pieces = ramp.pieces
    >>> pieces.edges.tolist(), pieces.coefficients.shape
    ([0.0, 0.1, 0.2, 0.3, 0.4], (4, 2))
    """

    edges: Floats
    coefficients: Floats


@dataclass(frozen=True, eq=False)
class Sampled:
    """An input given by samples, interpolated by a spline.

    Parameters
    ----------
    start : float
        Time of the first sample in s.
    rate : float
        Sampling rate in Hz.
    values : array of shape (N,)
        Samples in N for a force and in m for the base.
    order : {5, 7, 3, 1, 0}, optional
        Order of the spline. 5 has four continuous derivatives and an error of the sixth order in the sampling interval; 0
        holds each sample until the next.
    band_limited : bool, optional
        Whether the signal has no content above half the sampling rate. A windowed sinc then adds three samples to each
        interval before the spline is fitted.

    Raises
    ------
    SimulationError
        If samples are not finite numbers or too few, or the order is another one.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> time = np.arange(200) / 100.0
    >>> force = lw.model.Sampled(0.0, 100.0, np.sin(20.0 * time))
    >>> bool(abs(force.value(0.505) - np.sin(20.0 * 0.505)) < 1e-6)
    True
    """

    start: float
    rate: float
    values: Floats
    order: int = 5
    band_limited: bool = False

    def __post_init__(self) -> None:
        for name in ("start", "rate"):
            expect(f"Sampled: {name}", getattr(self, name), float)
        kind = np.asarray(self.values).dtype
        if kind.kind not in "biuf":
            raise SimulationError(f"the samples of an input must be numbers, got {kind}")
        values = np.array(self.values, dtype=float)
        values.flags.writeable = False
        vars(self).update(values=values, start=float(self.start), rate=float(self.rate))
        if self.order not in ORDERS:
            listed = ", ".join(map(str, ORDERS))
            raise SimulationError(f"unknown spline order {self.order!r}; choose from {listed}")
        if not (np.isfinite(self.start) and np.isfinite(self.rate) and self.rate > 0.0):
            message = f"the start of an input must be finite and its rate positive, got {self.start!r} s and {self.rate!r} Hz"
            raise SimulationError(message)
        if values.ndim != 1 or values.size < max(self.order + 1, 2):
            raise SimulationError(
                f"a spline of order {self.order} needs a one-dimensional array of at least {max(self.order + 1, 2)} samples, "
                f"got shape {values.shape}; a lower order needs fewer"
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise SimulationError(
                f"sample {bad[0]} of an input, at {self.start + bad[0] / self.rate:g} s, is {values[bad[0]]}; "
                "inputs must not have gaps: fill them first"
            )

    @property
    def end(self) -> float:
        """Time of the last sample in s."""
        return self.start + (self.values.size - 1) / self.rate

    @cached_property
    def _spline(self) -> _Spline:
        return self._derived(0)

    def _derived(self, order: int) -> _Spline:
        """The derivative of an order of the interpolant, which simulations and fits of one record ask for again and again.

        That of a long signal stays a B-spline, since its polynomials take more time and memory than they save.
        """
        given = (self.values.tobytes(), self.start, self.rate, (self.order, self.band_limited))
        if self.values.size <= _KEPT:
            return _pieces_through(*given, order)
        if order:
            return self._spline.derivative(order)
        return (_last_long_spline if self.values.size <= _LONGEST_KEPT else _spline_through)(*given)

    @cached_property
    def pieces(self) -> PiecewisePolynomial:
        """The interpolant as polynomials, lowest power first."""
        pieces = _as_pieces(self._spline)
        return PiecewisePolynomial(pieces.x.copy(), np.array(pieces.c[::-1].T, order="C"))

    def value(self, time: ArrayLike) -> Floats:
        """Values of the interpolant.

        Parameters
        ----------
        time : array
            Times in s.

        Returns
        -------
        array
            Values in N or m, in the shape of `time`.

        Raises
        ------
        SimulationError
            If a time is outside the samples.
        """
        return self._evaluated(self._spline, time)

    def derivative(self, time: ArrayLike, order: int = 1) -> Floats:
        """Time derivative of the interpolant.

        Parameters
        ----------
        time : array
            Times in s.
        order : int, optional
            Order of the derivative.

        Returns
        -------
        array
            Derivative in the unit of the input over s^order, in the shape of `time`.

        Raises
        ------
        SimulationError
            If a time is outside the samples.
        """
        return self._evaluated(self._derived(order), time)

    def integral(self, time: ArrayLike) -> Floats:
        """Integral of the interpolant from the first sample.

        Parameters
        ----------
        time : array
            Times in s.

        Returns
        -------
        array
            Integral in N s or m s, in the shape of `time`.

        Raises
        ------
        SimulationError
            If a time is outside the samples.
        """
        return self._evaluated(self._spline.antiderivative(), time)

    def _evaluated(self, spline: _Spline, time: ArrayLike) -> Floats:
        time = np.asarray(time, dtype=float)
        slack = 1e-6 / self.rate  # times are computed as k/rate, with rounding
        outside = (time < self.start - slack) | (time > self.end + slack)
        if np.any(outside):
            raise SimulationError(
                f"an input is sampled from {self.start:g} to {self.end:g} s, but is needed at "
                f"{np.atleast_1d(time)[np.atleast_1d(outside)][0]:g} s; give more samples or simulate a shorter time"
            )
        return np.asarray(spline(np.clip(time, self.start, self.end)), dtype=float)


def _spline_through(samples: bytes, start: float, rate: float, kind: tuple[int, bool]) -> _Spline:
    """The spline through samples; `kind` has its order and whether the signal is band-limited."""
    values, (order, band_limited) = np.frombuffer(samples), kind
    if band_limited:
        values, rate = _upsampled(values), rate * _UPSAMPLING
    time = start + np.arange(values.size) / rate
    if order == 0:
        return scipy.interpolate.PPoly(values[None, :-1], time)
    return scipy.interpolate.make_interp_spline(time, values, k=order)


_last_long_spline = lru_cache(maxsize=1)(_spline_through)


@lru_cache(maxsize=16)
def _pieces_through(
    samples: bytes, start: float, rate: float, kind: tuple[int, bool], derivative: int
) -> scipy.interpolate.PPoly:
    """The polynomials of a derivative of a spline."""
    pieces = _as_pieces(_spline_through(samples, start, rate, kind))
    return pieces.derivative(derivative) if derivative else pieces


def _as_pieces(spline: _Spline) -> scipy.interpolate.PPoly:
    """The polynomials of a spline."""
    if isinstance(spline, scipy.interpolate.PPoly):
        return spline
    pieces = scipy.interpolate.PPoly.from_spline(scipy.interpolate.BSpline(spline.t, spline.c, spline.k))
    nonempty = np.diff(pieces.x) > 0.0  # knots at the ends are repeated
    return scipy.interpolate.PPoly(pieces.c[:, nonempty], np.append(pieces.x[:-1][nonempty], pieces.x[-1]))


def _upsampled(values: Floats) -> Floats:
    """`_UPSAMPLING` (N - 1) + 1 samples of the band-limited signal through `values` (N,).

    A sinc under a Kaiser window; beyond its ends the signal is continued by point reflection, which keeps value and slope.
    """
    reach = min(_HALF_WIDTH, values.size - 1)
    before = 2.0 * values[0] - values[reach:0:-1]
    after = 2.0 * values[-1] - values[-2 : -2 - reach : -1]
    extended = np.concatenate([before, values, after])
    upsampled: Floats = np.empty((values.size, _UPSAMPLING))
    upsampled[:, 0] = values
    for phase in range(1, _UPSAMPLING):
        offset = np.arange(-reach, reach + 1) - phase / _UPSAMPLING  # from the new point to the samples
        window = np.clip(1.0 - (offset / (reach + 1)) ** 2, 0.0, None)
        taps = np.sinc(offset) * np.i0(_KAISER * np.sqrt(window)) / np.i0(_KAISER)
        upsampled[:, phase] = np.convolve(extended, taps[::-1] / taps.sum(), mode="valid")
    return upsampled.ravel()[: _UPSAMPLING * (values.size - 1) + 1]


InputSignal = TimeFunction | Sampled


@dataclass(frozen=True)
class Impulse:
    """An ideal impulse on a mass: its velocity jumps, its position does not.

    Parameters
    ----------
    mass : str
        Name of the mass.
    momentum : float
        Momentum in N s.
    time : float, optional
        Time in s.

    Raises
    ------
    SimulationError
        If a number is not finite or the time is negative.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.model.Impulse("m1", 0.5, time=0.2)
    Impulse(mass='m1', momentum=0.5, time=0.2)
    """

    mass: str
    momentum: float
    time: float = 0.0

    def __post_init__(self) -> None:
        expect("Impulse: mass", self.mass, str)
        for name in ("momentum", "time"):
            expect(f"Impulse: {name}", getattr(self, name), float)
        if not (np.isfinite(self.momentum) and np.isfinite(self.time) and self.time >= 0.0):
            raise SimulationError(
                f"an impulse needs a finite momentum and a time that is not negative, got {self.momentum!r} N s at "
                f"{self.time!r} s",
                mass=self.mass,
            )


@dataclass(frozen=True, eq=False)
class Excitation:
    """Everything that sets a structure in motion; without arguments, nothing.

    Parameters
    ----------
    release : mapping of str to float, optional
        Initial displacements ``"x:MASS"`` in m and velocities ``"v:MASS"`` in m/s; 0 where not given.
    impulses : iterable of Impulse, optional
        Impulses on masses.
    forces : mapping of str to TimeFunction, Sampled, str or float, optional
        Force in N on each mass; a text or a number becomes a `TimeFunction`.
    base : TimeFunction, Sampled, str or float, optional
        Displacement of the base in m.
    signals : mapping of str to TimeFunction, Sampled, str or float, optional
        Each signal that laws name, in its SI unit.

    Raises
    ------
    SimulationError
        If a release is not a finite number.
    TypeError
        If an input has another type.
    LawError
        If a text is not a valid expression of t.

    Examples
    --------
    >>> import linkwise as lw
    >>> excitation = lw.model.Excitation(release={"v:m1": 1.0}, forces={"m1": "2*sin(30*t)"})
    >>> excitation.forces["m1"]
    TimeFunction(text='2*sin(30*t)')
    """

    release: Mapping[str, float]
    impulses: tuple[Impulse, ...]
    forces: Mapping[str, InputSignal]
    base: InputSignal | None
    signals: Mapping[str, InputSignal]
    __reduce__ = by_constructor

    def __init__(
        self,
        release: Mapping[str, float] | None = None,
        impulses: Iterable[Impulse] = (),
        forces: Mapping[str, InputSignal | str | float] | None = None,
        base: InputSignal | str | float | None = None,
        signals: Mapping[str, InputSignal | str | float] | None = None,
    ) -> None:
        for name, given in (("release", release), ("forces", forces), ("signals", signals)):
            expect(name, given, Mapping, NoneType)
        blows = tuple(impulses)
        for number, impulse in enumerate(blows):
            expect(f"Excitation: impulses[{number}]", impulse, Impulse)
        for name, value in (release or {}).items():
            expect(f"release[{name!r}]", value, float)
            if not abs(value) <= float_info.max:
                raise SimulationError(f"the release {name} must be finite, got {value!r}")
        drives = {key: _drive(f"forces[{key!r}]", given) for key, given in (forces or {}).items()}
        inputs = {key: _drive(f"signals[{key!r}]", given) for key, given in (signals or {}).items()}
        vars(self).update(
            release=MappingProxyType({name: float(value) for name, value in (release or {}).items()}),
            impulses=tuple(sorted(blows, key=lambda impulse: impulse.time)),
            forces=MappingProxyType(drives),
            base=None if base is None else _drive("base", base),
            signals=MappingProxyType(inputs),
        )

    def base_at(self, times: ArrayLike) -> Floats | None:
        """Displacement of the base.

        Parameters
        ----------
        times : (N,) array_like
            Times in s.

        Returns
        -------
        (N,) ndarray or None
            Displacement in m; None where the base does not move.
        """
        return None if self.base is None else self.base.value(times)

    @property
    def is_empty(self) -> bool:
        """Whether it sets nothing in motion."""
        return not (any(self.release.values()) or self.impulses or self.drives)

    @property
    def drives(self) -> dict[str, InputSignal]:
        """Force by mass, the motion of the base under the name "base", and signals under those of their channels."""
        base = {} if self.base is None else {"base": self.base}
        return {**self.forces, **base, **{f"signal:{name}": given for name, given in self.signals.items()}}


def _drive(argument: str, given: InputSignal | str | float) -> InputSignal:
    expect(argument, given, TimeFunction, Sampled, str, float)
    if isinstance(given, TimeFunction | Sampled):
        return given
    return TimeFunction(str(given))
