"""The options of a response: what drives the structure, over which frequencies, and what is shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack, final

import numpy as np

from linkwise.errors import SimulationError, expect
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.response.drive import FORCE, Drive
from linkwise.simulation.run import check_place


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
        Displacements and velocities whose amplitude is shown, such as ``"x:m2"``. By default the displacements of all masses
        and points.
    starts : int
        Simulations from states at random, at each of several frequencies, in search of further motions.
    seed : int
        Seed of these states, and of draws.
    draws : int
        Draws from the posterior of an answer, from which bands are made.
    harmonics : int
        Use harmonic balance with so many harmonics. By default, 0, it is used with 25 where a law has kinks or flat parts, as
        friction has, and shooting everywhere else.

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
    show: Sequence[str] = ()
    starts: int = 3
    seed: int = 0
    draws: int = 100
    harmonics: int = 0

    def __post_init__(self) -> None:
        given = [(FORCE, self.force), ("base", self.base)]
        for name, value in given:
            expect(f"ResponseOptions: {name}", value, Mapping, type(None))
        if [len(value or {}) for _, value in given] not in ([1, 0], [0, 1]):
            raise SimulationError(
                'steady motion needs one excitation: force={"m1": 0.5}, or base={"a": 9.81}',
                arguments=("excitation",),
            )
        if self.base and next(iter(self.base)) not in ("x", "v", "a"):
            raise SimulationError(
                f"the motion of the base is x, v or a, got {next(iter(self.base))!r}",
                arguments=("excitation",),
            )
        expect("ResponseOptions: hz", self.hz, tuple, list)
        if len(self.hz) != 2 or not 0.0 < self.hz[0] < self.hz[1] < np.inf:
            raise SimulationError(
                f"frequencies must go from a positive one to a higher one, got {self.hz!r} Hz",
                arguments=("hz",),
            )
        for size in self.sizes:
            expect("ResponseOptions: levels", size, float)
            if not 0.0 < size < np.inf:
                raise SimulationError(
                    f"the amplitude of the excitation must be positive, got {size!r}", arguments=("levels",)
                )
        for name, least in (("starts", 0), ("seed", 0), ("draws", 2), ("harmonics", 0)):
            expect(f"ResponseOptions: {name}", getattr(self, name), int)
            if getattr(self, name) < least:
                raise SimulationError(
                    f"{name} must be at least {least}, got {getattr(self, name)}", arguments=(name,)
                )

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
        if "hz" not in keywords:
            raise SimulationError("frequencies are needed: hz=(lowest, highest)", arguments=("hz",))
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
