"""Whether a structure file says that its numbers are not to be trusted: a comment, which goes where the file goes."""

from __future__ import annotations

from pathlib import Path

_MARK = "# NOT to be trusted"


def untrusted_comment(status: str) -> str:
    """The first line of the structure file of an answer with this status, which is not trusted."""
    return f"{_MARK} ({status}): numbers of an answer that does not explain its record.\n"


def untrusted_remark(path: Path) -> str:
    """What the comment in a structure file says, as a sentence; empty where there is none or the file cannot be read."""
    try:
        with path.open(encoding="utf-8") as file:
            line = file.readline()
    except (OSError, UnicodeDecodeError):
        return ""
    if not line.startswith(_MARK):
        return ""
    status = line.removeprefix(_MARK).partition(":")[0].strip()
    return not_trusted(status.strip("()"))


def not_trusted(status: str) -> str:
    """The sentence on an answer with this status, for whatever is computed from its numbers."""
    reason = f" ({status})" if status else ""
    return f"The answer is NOT to be trusted{reason}, and neither is what follows from its numbers."
