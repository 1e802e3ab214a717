"""Every error that linkwise raises for a reason its user can act on.

The message is one paragraph: what was given, why it cannot be, what was expected and the next step. What the error talks
about (file, line, link, time) stays on the exception as an attribute, so a caller need not read the text. `exit_code` is the
code with which the command line ends: 1 failed with a reason, 2 wrong usage or unreadable input.
"""

from __future__ import annotations

from pathlib import Path

from linkwise.text import shortened

_SHOWN = 72  # characters of a law that are quoted around the place of an error


class LinkwiseError(Exception):
    """The base of all errors of this package; `str(error)` is the whole message."""

    exit_code: int = 1

    def __str__(self) -> str:
        return shortened(super().__str__())


class LawError(LinkwiseError):
    """A law's text that cannot be a law, with a caret under the place.

    `text` is what the user typed, `position` the zero-based character at fault (None where no single place is), `reason` why
    it cannot be and `advice` the next step.
    """

    exit_code = 2

    def __init__(self, reason: str, text: str, position: int | None = None, advice: str = "") -> None:
        self.reason, self.text, self.position, self.advice = reason, text, position, advice
        super().__init__("\n".join([reason, *_quoted(text, position), *([advice] if advice else [])]))

    def __reduce__(self) -> tuple[type[LawError], tuple[str, str, int | None, str]]:
        return type(self), (self.reason, self.text, self.position, self.advice)


class StructureError(LinkwiseError):
    """A structure that cannot be built; `where` is the file, key or link that says so."""

    exit_code = 2

    def __init__(self, message: str, where: str = "") -> None:
        self.message, self.where = message, where
        super().__init__(f"{where}: {message}" if where else message)

    def __reduce__(self) -> tuple[type[StructureError], tuple[str, str]]:
        return type(self), (self.message, self.where)


class RecordError(LinkwiseError):
    """A record or its file that cannot be used; names the file, the line (1-based) and the channel where they are known."""

    exit_code = 2

    def __init__(
        self,
        message: str,
        file: str | Path | None = None,
        line: int | None = None,
        channel: str | None = None,
    ) -> None:
        self.message, self.file, self.line, self.channel = message, file, line, channel
        places = [
            str(file) if file is not None else "",
            f"line {line}" if line is not None else "",
            f"channel {channel}" if channel is not None else "",
        ]
        where = ", ".join(place for place in places if place)
        super().__init__(f"{where}: {message}" if where else message)

    def __reduce__(self) -> tuple[type[RecordError], tuple[str, str | Path | None, int | None, str | None]]:
        return type(self), (self.message, self.file, self.line, self.channel)


class SimulationError(LinkwiseError):
    """A simulation that could not go on; `time` in s and `mass` say where it stopped.

    The message is complete in itself: it names time and mass in words.
    """

    def __init__(self, message: str, time: float | None = None, mass: str | None = None) -> None:
        self.message, self.time, self.mass = message, time, mass
        super().__init__(message)

    def __reduce__(self) -> tuple[type[SimulationError], tuple[str, float | None, str | None]]:
        return type(self), (self.message, self.time, self.mass)


class IdentificationError(LinkwiseError):
    """A record and a structure from which no estimate can be made."""


class StudyError(LinkwiseError):
    """A study that cannot be run or gone on with; `where` is the file and key, or the folder, that says so."""

    exit_code = 2

    def __init__(self, message: str, where: str = "") -> None:
        self.message, self.where = message, where
        super().__init__(f"{where}: {message}" if where else message)

    def __reduce__(self) -> tuple[type[StudyError], tuple[str, str]]:
        return type(self), (self.message, self.where)


def _quoted(text: str, position: int | None) -> list[str]:
    """The line of `text` at `position`, cut to a readable length, and the caret under it."""
    if position is None:
        return [f"  {text}" if len(text) <= _SHOWN else f"  {text[: _SHOWN - 3]}..."]
    position = min(max(position, 0), len(text))
    start = text.rfind("\n", 0, position) + 1
    end = text.find("\n", position)
    end = len(text) if end < 0 else end
    line, column = text[start:end].expandtabs(1), position - start
    before, after = "", ""
    if column > _SHOWN // 2:
        cut = min(column - _SHOWN // 2, max(len(line) - _SHOWN, 0))
        before = "..." if cut else ""
        line, column = line[cut:], column - cut
    if len(line) > _SHOWN:
        line, after = line[:_SHOWN], "..."
    return [f"  {before}{line}{after}", " " * (2 + len(before) + column) + "^"]
