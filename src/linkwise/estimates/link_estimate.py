"""What was found of one link: its coefficients, and what follows from them for the wells of its law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from linkwise.analysis.law_kind import law_kind
from linkwise.analysis.wells import lowest_escape, wells
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.structure import Link

T = TypeVar("T")

NORMAL_95 = 1.959963984540054  # deviations that hold 95 % of a normal distribution
_STEP = 1e-2  # of a standard error: small against the curvature of what is derived, large against rounding
_BEYOND = 0.25  # of the visited range: wells farther outside are not looked for


@dataclass(frozen=True)
class CoefficientEstimate:
    """A coefficient "nes1.alpha" or a mass "m1.mass" in its SI `unit`; `known` ones were given, the others found.

    `standard_error` and the 95 % `interval` are None for what was given and where none can be trusted.
    """

    name: str
    value: float
    unit: str
    known: bool
    standard_error: float | None = None
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class DerivedQuantity:
    """A quantity that follows from coefficients, with its 95 % interval by the delta method, or None without one."""

    name: str
    value: float
    unit: str
    interval: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class LinkEstimate:
    """One identified link (`link`, all numbers), over the ranges of d in m and v in m/s that the record visited.

    `covariance` (q, q) is that of the coefficients named `free` (q,), or None where no interval can be trusted.
    `moving_mass` in kg is the reduced mass of its ends, with which it swings in a well.
    """

    link: Link
    coefficients: tuple[CoefficientEstimate, ...]
    d_range: tuple[float, float]
    v_range: tuple[float, float]
    free: tuple[str, ...]
    covariance: Floats | None
    moving_mass: float

    def force_band(self, d: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Force at rest (v = 0) in N at elongations `d` in m, and the ends of its 95 % band, each in the shape of `d`.

        Without a covariance both ends are NaN; for a link with nothing to identify they equal the force.
        """
        d = np.asarray(d, dtype=float)
        force = self.link.force(d)
        if not self.free:
            return force, force, force
        if self.covariance is None:
            nothing = np.full(force.shape, np.nan)
            return force, nothing, nothing
        slopes = self.link.law.partials(d, 0.0, self.link.values).by_coefficient
        gradient = np.stack([np.broadcast_to(slopes[name], d.shape) for name in self.free])
        variance = np.einsum("i...,ij,j...->...", gradient, self.covariance, gradient)
        half = NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
        return force, force - half, force + half

    @cached_property
    def kind(self) -> str:
        """What its law does where the record saw it, in a word: "hardening", as `law_kind` says."""
        return law_kind(self.link, self._reach[1])

    @cached_property
    def wells(self) -> tuple[DerivedQuantity, ...]:
        """The stable elongations of a link with two wells or more; empty for others."""
        places = self._found(wells)
        if places is None or len(places) < 2:
            return ()
        return tuple(self._derived("well", "m", value, partial(_well_near, value)) for value in places)

    @cached_property
    def barrier(self) -> DerivedQuantity | None:
        """The energy that carries the link out of its deepest well, or None with fewer than two wells."""
        way = self._found(lowest_escape)
        if way is None:
            return None
        return self._derived("barrier", "J", _climb(way, self.link), partial(_climb, way))

    @cached_property
    def frequencies(self) -> tuple[DerivedQuantity, ...]:
        """In-well frequencies in Hz: small free swings of its two ends against each other in each well."""
        swings = [partial(_swing_near, well.value, self.moving_mass) for well in self.wells]
        return tuple(self._derived("frequency", "Hz", swing(self.link), swing) for swing in swings)

    @property
    def _reach(self) -> tuple[float, float]:
        """Where wells are looked for: what was visited, both sides of rest, and a little more."""
        largest = max(abs(end) for end in self.d_range) * (1.0 + _BEYOND)
        return -largest, largest

    def _found(self, search: Callable[[Link, float, float], T]) -> T | None:
        """What a search finds within reach; None for a law that vanishes everywhere."""
        try:
            return search(self.link, *self._reach)
        except StructureError:
            return None

    def _derived(self, name: str, unit: str, value: float, of: Callable[[Link], float]) -> DerivedQuantity:
        """The delta method: the gradient by central differences of a small part of each standard error."""
        if self.covariance is None or not self.free:
            return DerivedQuantity(name, value, unit, None if self.free else (value, value))
        steps: Floats = _STEP * np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))
        gradient = np.zeros(len(self.free))
        for i, coefficient in enumerate(self.free):
            if steps[i] > 0.0:
                sides = [of(self._moved(coefficient, sign * steps[i])) for sign in (1.0, -1.0)]
                gradient[i] = (sides[0] - sides[1]) / (2.0 * steps[i])
        variance = float(gradient @ self.covariance @ gradient)
        half = NORMAL_95 * float(np.sqrt(max(variance, 0.0)))
        return DerivedQuantity(name, value, unit, (value - half, value + half) if np.isfinite(half) else None)

    def _moved(self, coefficient: str, step: float) -> Link:
        moved = Coefficient.number(self.link.values[coefficient] + step)
        return replace(self.link, coefficients={**self.link.coefficients, coefficient: moved})


def _well_near(place: float, link: Link) -> float:
    """The well of a link whose coefficients are a little aside of those that gave one at `place`: a step of Newton's."""
    stiffness = float(link.stiffness(place))
    return place - float(link.force(place)) / stiffness if stiffness > 0.0 else np.nan


def _swing_near(place: float, mass: float, link: Link) -> float:
    """Frequency in Hz of small swings of a mass in kg in that well."""
    stiffness = float(link.stiffness(_well_near(place, link)))
    return float(np.sqrt(stiffness / mass) / (2.0 * np.pi)) if stiffness > 0.0 else np.nan


def _climb(way: tuple[float, float], link: Link) -> float:
    """Energy in J from a well to a top; where both of them lie does not matter to the first order."""
    low, high = link.potential(np.array(way))
    return float(high - low)
