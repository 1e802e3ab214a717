"""Channels: a kind of quantity at a mass or the base, `KIND:MASS`, or of a link, `f:LINK` and `state:LINK.NAME`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from linkwise.argument_types import check_type
from linkwise.errors import RecordError

UNITS = {"x": "m", "v": "m/s", "a": "m/s^2", "force": "N", "f": "N", "state": "?"}
ANGULAR_UNITS = {"x": "rad", "v": "rad/s", "a": "rad/s^2", "force": "N m", "f": "N m"}
"""Of places that turn, and of links between them: a force there is a moment."""
QUANTITIES = {
    "x": "displacement", "v": "velocity", "a": "acceleration", "force": "applied force", "f": "force in a link",
    "state": "state of a link",
}  # fmt: skip
OF_MASSES = ("x", "v", "a", "force")
FORCE = "force:"  # with which the names of applied forces begin
BASE = "base"
_RELATIVE = "rel:"
_RESERVED = frozenset(":[]()\"',;\t\n")


@dataclass(frozen=True)
class Channel:
    """One sensor, or one input.

    Parameters
    ----------
    kind : {"x", "v", "a", "force", "f", "state"}
        Displacement (m), velocity (m/s), acceleration (m/s^2), applied force (N), force in a link (N) or state of a link.
    mass : str
        Name of the mass, or "base" for the moving base; of a link its name, of a state "LINK.NAME".
    relative : bool, optional
        Whether a sensor shows the motion of the mass relative to the base, as "rel:x:m1" does.
    angular : bool, optional
        Whether its place turns, so that it is in rad, rad/s, rad/s^2 or N m; its name does not tell.

    Examples
    --------
    >>> import linkwise as lw
    >>> channel = lw.Channel.parse("v:m1")
    >>> channel.kind, channel.mass, channel.unit, channel.is_input
    ('v', 'm1', 'm/s', False)
    """

    kind: str
    mass: str
    relative: bool = False
    angular: bool = False

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
        if type(name) is not str:  # a comparison takes no call, and names are parsed by the thousand
            check_type("Channel.parse(name): name", name, str)
        relative = name.startswith(_RELATIVE)
        kind, colon, mass = name.removeprefix(_RELATIVE).partition(":")
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
        if kind == "state" and not all(mass.rpartition(".")[::2]):
            raise RecordError(f"{name!r} is not a channel: a state is written state:LINK.NAME")
        if relative and (kind not in "xva" or mass == BASE):
            raise RecordError(
                f"{name!r} is not a channel: only the motion of a mass is relative to the base, as in rel:x:m1"
            )
        return cls(kind, mass, relative)

    @property
    def of_link(self) -> bool:
        """Whether it shows the force in a link or its state."""
        return self.kind not in OF_MASSES

    @property
    def link(self) -> str:
        """The name of the link of such a channel."""
        return self.mass.rpartition(".")[0] if self.kind == "state" else self.mass

    def __str__(self) -> str:
        return f"{_RELATIVE if self.relative else ''}{self.kind}:{self.mass}"

    @property
    def unit(self) -> str:
        """The SI unit of the channel; "?" of a state, which is in the unit that its law gives it."""
        return (ANGULAR_UNITS if self.angular else UNITS)[self.kind]

    @property
    def is_input(self) -> bool:
        """True for what drives the structure (applied force, base motion), False for a response."""
        return self.kind == "force" or (self.mass == BASE and not self.of_link)


def of_links(channels: Iterable[str]) -> tuple[str, ...]:
    """Those of these channels that show forces or states of links."""
    return tuple(name for name in channels if Channel.parse(name).of_link)
