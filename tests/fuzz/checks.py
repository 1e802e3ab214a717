"""What must never come of an input, whatever it is."""

from __future__ import annotations

import json

from fuzz.case import Case, Outcome

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
