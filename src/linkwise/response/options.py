"""The options of a response: what drives the structure, over which frequencies, and what is shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict, Unpack, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import SimulationError, expect
from linkwise.expression import Expression
from linkwise.expression.parser import parse
from linkwise.model.link import BASE, refuse_signals
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.simulation.run import check_base, check_place

FORCE = "force"
# unit, which derivative is harmonic, and the force or the displacement where what is harmonic is size*cos(omega*t)
_KINDS = {
    FORCE: ("N", 0, "size*cos(omega*t)"),
    "x": ("m", 0, "size*cos(omega*t)"),
    "v": ("m/s", 1, "size/omega*sin(omega*t)"),
    "a": ("m/s2", 2, "-size/omega**2*cos(omega*t)"),
}


@dataclass(frozen=True)
class Drive:
    """A harmonic force on a place, or the harmonic displacement, velocity or acceleration of the base.

    Parameters
    ----------
    kind : {"force", "x", "v", "a"}
        What is harmonic: a force in N (N m on what turns), or the motion of the base, in m, m/s or m/s2.
    place : str
        A mass, a point of a host, or "base".

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.response.Drive("force", "m1").unit
    'N'
    """

    kind: str
    place: str

    @property
    def unit(self) -> str:
        """The unit of its size."""
        return _KINDS[self.kind][0]

    @property
    def order(self) -> int:
        """Which derivative of the displacement of the base is harmonic; 0 for a force."""
        return _KINDS[self.kind][1]

    @property
    def expression(self) -> Expression:
        """The force, or the displacement of the base, over t, with symbols size and omega."""
        return parse(_KINDS[self.kind][2], ("t",))

    def base(self, size: float, omega: float, phases: Floats) -> tuple[Floats, Floats]:
        """Give the motion of the base.

        Parameters
        ----------
        size : float
            Amplitude of what is harmonic, in its unit.
        omega : float
            Angular frequency in rad/s.
        phases : array of shape (M,)
            Phases of the excitation in rad.

        Returns
        -------
        tuple of two arrays of shape (M,)
            Displacement in m and velocity in m/s; zero under a force.
        """
        if self.kind == FORCE:
            return np.zeros(len(phases)), np.zeros(len(phases))
        size = size / omega**self.order
        turned = phases - 0.5 * np.pi * self.order
        return size * np.cos(turned), -size * omega * np.sin(turned)

    def sweep(self, size: float, hz: tuple[float, float], duration: float) -> str:
        """Write what is harmonic as a sweep of its frequency at a constant rate.

        Parameters
        ----------
        size : float
            Amplitude of what is harmonic, in its unit.
        hz : tuple of two floats
            First and last frequency in Hz.
        duration : float
            Time from the first to the last in s.

        Returns
        -------
        str
            The force in N, or the displacement of the base in m, as an expression of t.
        """
        first, rate = 2.0 * np.pi * hz[0], 2.0 * np.pi * (hz[1] - hz[0]) / duration
        text = _KINDS[self.kind][2].replace("omega*t", f"{first!r}*t + {0.5 * rate!r}*t**2")
        return text.replace("omega", f"({first!r} + {rate!r}*t)").replace("size", repr(float(size)))

    def check(self, structure: Structure) -> None:
        """Check that a structure can be driven so.

        Parameters
        ----------
        structure : Structure
            The structure.

        Raises
        ------
        SimulationError
            If it has no such place.
        StructureError
            If a law names a signal.
        """
        refuse_signals(structure.links, "responses", "put its mean into the law as a coefficient")
        if self.kind == FORCE:
            check_place(Channel(FORCE, self.place), structure, "a force")
        else:
            check_base(structure, moves=self.place == BASE)


class ResponseKeywords(TypedDict, total=False):
    """The keywords of `ResponseOptions`."""

    hz: tuple[float, float]
    force: Mapping[str, float] | None
    base: Mapping[str, float] | None
    levels: Sequence[float]
    show: Sequence[str]
    starts: int
    seed: int
    draws: int
    harmonics: int


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseOptions:
    """The options of `respond`.

    Parameters
    ----------
    hz : tuple of two floats
        Lowest and highest frequency of the excitation in Hz.
    force : mapping of str to float, optional
        A harmonic force: its amplitude in N by mass or point, such as ``{"m1": 0.5}``.
    base : mapping of str to float, optional
        A harmonic motion of the base: its amplitude by kind, in m, m/s or m/s2, such as ``{"a": 9.81}``.
    levels : sequence of float
        Amplitudes in place of the one that `force` or `base` gives.
    show : sequence of str
        Displacements and velocities whose amplitude is shown (default: the displacements of all masses and points).
    starts : int
        Simulations from states at random, at each of several frequencies, in search of further motions (default 3).
    seed : int
        Seed of these states, and of draws (default 0).
    draws : int
        Draws from the posterior of an answer, from which bands are made (default 100).
    harmonics : int
        Use harmonic balance with so many harmonics (default: 25 where a law has kinks or flat parts, as friction has, else
        shooting).

    Raises
    ------
    SimulationError
        If frequencies, amplitudes or counts are not what they must be.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.response.ResponseOptions(hz=(20.0, 35.0), force={"m1": 2.0}).sizes
    (2.0,)
    """

    hz: tuple[float, float]
    force: Mapping[str, float] | None = None
    base: Mapping[str, float] | None = None
    levels: Sequence[float] = ()
    show: Sequence[str] = field(default=(), metadata={"typed": "CHANNEL"})
    starts: int = field(default=3, metadata={"typed": "N"})
    seed: int = field(default=0, metadata={"typed": "N"})
    draws: int = field(default=100, metadata={"typed": "N"})
    harmonics: int = field(default=0, metadata={"typed": "N"})

    def __post_init__(self) -> None:
        for name in (FORCE, "base"):
            expect(f"ResponseOptions: {name}", getattr(self, name), Mapping, type(None))
        given = [*(self.force or ()), *(self.base or ())]
        _require(
            len(given) == 1,
            'steady motion needs one excitation: force={"m1": 0.5}, or base={"a": 9.81}',
            "excitation",
        )
        known = not self.base or given[0] in ("x", "v", "a")
        _require(known, f"the motion of the base is x, v or a, got {given[0]!r}", "excitation")
        expect("ResponseOptions: hz", self.hz, tuple, list)
        rising = len(self.hz) == 2 and 0.0 < self.hz[0] < self.hz[1] < np.inf
        _require(rising, f"frequencies must go from a positive one to a higher one, got {self.hz!r} Hz", "hz")
        for size in self.sizes:
            expect("ResponseOptions: levels", size, float)
            positive = 0.0 < size < np.inf
            _require(positive, f"the amplitude of the excitation must be positive, got {size!r}", "levels")
        for name, least in (("starts", 0), ("seed", 0), ("draws", 2), ("harmonics", 0)):
            value = getattr(self, name)
            expect(f"ResponseOptions: {name}", value, int)
            _require(value >= least, f"{name} must be at least {least}, got {value}", name)

    @classmethod
    def of(cls, **keywords: Unpack[ResponseKeywords]) -> ResponseOptions:
        """Make options from keywords, which are the fields.

        Parameters
        ----------
        **keywords
            The fields.

        Returns
        -------
        ResponseOptions
            The options.

        Raises
        ------
        SimulationError
            If an option is invalid, or frequencies are missing.
        """
        _require("hz" in keywords, "frequencies are needed: hz=(lowest, highest)", "hz")
        return cls(**keywords)

    @property
    def sizes(self) -> tuple[float, ...]:
        """The amplitudes of the excitation, in ascending order."""
        single = [*(self.force or {}).values(), *(self.base or {}).values()]
        return tuple(sorted(self.levels or single))

    @property
    def drive(self) -> Drive:
        """What is harmonic, and where."""
        if self.force:
            return Drive(FORCE, next(iter(self.force)))
        return Drive(next(iter(self.base or {})), "base")


def _require(holds: bool, message: str, argument: str) -> None:
    """SimulationError, which names the argument of `respond`, for options that cannot be."""
    if not holds:
        raise SimulationError(message, arguments=(argument,))


def shown_channels(
    structure: Structure,
    show: Sequence[str],
    what: str = "what is shown",
    arguments: tuple[str, ...] = ("show",),
) -> tuple[Channel, ...]:
    """The channels that are shown of a structure, by default all displacements; SimulationError for what is none, of the
    `arguments` in which `what` was given.
    """
    channels = tuple(map(Channel.parse, show or [f"x:{place}" for place in structure.places]))
    for channel in channels:
        if channel.kind not in ("x", "v") or channel.relative:
            raise SimulationError(
                f"{channel} cannot be {what}, which is displacements and velocities, such as x:{structure.places[0]}",
                arguments=arguments,
            )
        check_place(channel, structure, what)
    return channels
