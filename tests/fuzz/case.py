"""One input: files, and what is done with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class Kind(Enum):
    """What is done with a case."""

    COMMAND = "run the command line on its arguments"
    READ = "read the record in its first file"
    LAW = "parse a law, and simulate a mass that is held by it"


@dataclass(frozen=True)
class Case:
    """The input that `seed` makes: `files` by name, `arguments` of the command or the text of a law.

    `channels` are those that the first file holds as far as whoever damaged it can tell.
    """

    seed: int
    family: str
    kind: Kind
    arguments: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of a case: the exit code (None where Python raised `error`), what was printed, and channels lost unsaid."""

    code: int | None
    out: str = ""
    message: str = ""
    error: str = ""
    lost: tuple[str, ...] = ()
    died: str = ""
    written: bytes = b""  # to standard output, past Python
