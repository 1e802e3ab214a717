"""Channels: a kind of quantity at a mass or the base, written `KIND:MASS`."""

from __future__ import annotations

from dataclasses import dataclass

from linkwise.errors import RecordError

UNITS = {"x": "m", "v": "m/s", "a": "m/s^2", "force": "N"}
QUANTITIES = {"x": "displacement", "v": "velocity", "a": "acceleration", "force": "applied force"}
BASE = "base"
_RESERVED = frozenset(":[]()\"',;\t\n")


@dataclass(frozen=True)
class Channel:
    """One sensor, or one input.

    Parameters
    ----------
    kind : {"x", "v", "a", "force"}
        Displacement (m), velocity (m/s), acceleration (m/s^2) or applied force (N).
    mass : str
        Name of the mass, or "base" for the moving base.

    Examples
    --------
    >>> import linkwise as lw
    >>> channel = lw.Channel.parse("v:m1")
    >>> channel.kind, channel.mass, channel.unit, channel.is_input
    ('v', 'm1', 'm/s', False)
    """

    kind: str
    mass: str

    @classmethod
    def parse(cls, name: str) -> Channel:
        """Read the name of a channel.

        Parameters
        ----------
        name : str
            KIND:MASS, such as "x:m1".

        Returns
        -------
        Channel
            The channel.

        Raises
        ------
        RecordError
            If it is not the name of a channel.
        """
        kind, colon, mass = name.partition(":")
        if not colon or not mass or not kind:
            raise RecordError(
                f"{name!r} is not a channel: expected KIND:MASS, such as x:m1, with KIND one of {', '.join(UNITS)}"
            )
        if kind not in UNITS:
            known = ", ".join(f"{key} ({QUANTITIES[key]}, {unit})" for key, unit in UNITS.items())
            raise RecordError(f"{name!r} is not a channel: unknown kind {kind!r}; choose from {known}")
        if mass != mass.strip() or _RESERVED & set(mass):
            raise RecordError(f"{name!r} is not a channel: {mass!r} is not a valid name of a mass")
        if kind == "force" and mass == BASE:
            raise RecordError(
                "'force:base' is not a channel: a base is moved by x:base, v:base or a:base, not by a force"
            )
        return cls(kind, mass)

    def __str__(self) -> str:
        return f"{self.kind}:{self.mass}"

    @property
    def unit(self) -> str:
        """The SI unit of the channel."""
        return UNITS[self.kind]

    @property
    def is_input(self) -> bool:
        """True for what drives the structure (applied force, base motion), False for a response."""
        return self.kind == "force" or self.mass == BASE
