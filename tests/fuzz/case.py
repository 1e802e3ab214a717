"""One input: files, what is done with them, and what must never come of it."""

import json
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


CODES = frozenset({0, 1, 2, 3})
SCREEN = 4000  # characters of a message
_FORBIDDEN = ("Traceback", "internal error", "Warning:", "too little memory")


def complaints(case: Case, outcome: Outcome) -> list[str]:
    """What is wrong with the outcome; nothing, if nothing is."""
    if outcome.died:
        return [outcome.died]
    if outcome.error:
        return [f"raised {outcome.error.strip().splitlines()[-1][:200]}"]
    faults = [f"says {word!r}" for word in _FORBIDDEN if word in outcome.message]
    if outcome.code not in CODES:
        faults.append(f"ends with code {outcome.code}")
    if outcome.code in (1, 2) and not outcome.message.strip():
        faults.append("fails without a word")
    longest = max((len(line) for line in outcome.message.split("\nlinkwise: ")), default=0)
    if longest > SCREEN:
        faults.append(f"has a message of {longest} characters")
    if outcome.written:
        faults.append(f"writes {outcome.written[:200]!r} to standard output past the command")
    if outcome.lost:
        faults.append(f"loses {', '.join(outcome.lost)} in silence")
    if (
        "--json" in case.arguments
        and "--help" not in case.arguments
        and outcome.out
        and not _is_json(outcome.out)
    ):
        faults.append("prints something that is not JSON")
    return faults


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True
