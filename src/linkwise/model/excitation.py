"""Excitations: initial conditions, impulses, forces on masses, and the motion of the base."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from sys import float_info
from types import MappingProxyType

import numpy as np

from linkwise.argument_types import checked_class
from linkwise.errors import SimulationError
from linkwise.model.input_signal import InputSignal, Sampled, TimeFunction


@checked_class
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
    >>> lw.Impulse("m1", 0.5, time=0.2)
    Impulse(mass='m1', momentum=0.5, time=0.2)
    """

    mass: str
    momentum: float
    time: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.momentum) and np.isfinite(self.time) and self.time >= 0.0):
            raise SimulationError(
                f"an impulse needs a finite momentum and a time that is not negative, got {self.momentum!r} N s at "
                f"{self.time!r} s",
                mass=self.mass,
            )


@checked_class
@dataclass(frozen=True, eq=False)
class Excitation:
    """Everything that sets a structure in motion; without arguments, nothing.

    Parameters
    ----------
    release : mapping of str to float, optional
        Initial displacements ``"x:MASS"`` in m and velocities ``"v:MASS"`` in m/s; 0 where not given.
    impulses : tuple of Impulse, optional
        Impulses on masses.
    forces : mapping of str to TimeFunction or Sampled, optional
        Force in N on each mass.
    base : TimeFunction or Sampled, optional
        Displacement of the base in m.

    Examples
    --------
    >>> import linkwise as lw
    >>> excitation = lw.Excitation.of(release={"v:m1": 1.0}, forces={"m1": "2*sin(30*t)"})
    >>> excitation.forces["m1"]
    TimeFunction(text='2*sin(30*t)')
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
        """Build an excitation in which inputs may be texts or numbers, which become `TimeFunction`.

        Parameters
        ----------
        release : mapping of str to float, optional
            Initial values, as of `Excitation`.
        impulses : iterable of Impulse
            Blows, as of `Excitation`.
        forces : mapping of str to TimeFunction, Sampled, str or float, optional
            Force in N on each mass.
        base : TimeFunction, Sampled, str or float, optional
            Displacement of the base in m.

        Returns
        -------
        Excitation
            The excitation.

        Raises
        ------
        SimulationError
            If an input has another type, or a release is not a finite number.
        LawError
            If a text is not a valid expression of t.
        """
        return cls(
            {name: _number(name, value) for name, value in (release or {}).items()},
            tuple(impulses),
            {mass: _drive(given) for mass, given in (forces or {}).items()},
            None if base is None else _drive(base),
        )

    def __reduce__(self) -> tuple[type[Excitation], tuple[object, ...]]:
        return Excitation, (dict(self.release), self.impulses, dict(self.forces), self.base)

    @property
    def drives(self) -> dict[str, InputSignal]:
        """Force by mass and, under the name "base", the motion of the base."""
        return dict(self.forces) if self.base is None else {**self.forces, "base": self.base}


def _number(name: str, value: float) -> float:
    if not abs(value) <= float_info.max:
        raise SimulationError(f"the release {name} must be finite, got {value!r}")
    return float(value)


def _drive(given: InputSignal | str | float) -> InputSignal:
    if isinstance(given, TimeFunction | Sampled):
        return given
    return TimeFunction(str(given))
