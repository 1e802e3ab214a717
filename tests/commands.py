"""The command line, run in this process on a line as it is typed."""

import io
import json
import shlex
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, NamedTuple

from linkwise.cli import run


class Said(NamedTuple):
    """What a command printed."""

    out: str
    err: str


def said(line: str, code: int = 0) -> Said:
    """What `linkwise` prints of this line, which ends with this exit code."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        ended = run(shlex.split(line))
    assert ended == code, f"linkwise {line}: exit code {ended}\n{out.getvalue()}{err.getvalue()}"
    return Said(out.getvalue(), err.getvalue())


def document(line: str, code: int = 0) -> dict[str, Any]:
    """What --json prints, and beside it nothing but notes."""
    out, err = said(f"{line} --json", code)
    assert err == "" or err.startswith("note: ")
    result: dict[str, Any] = json.loads(out)
    return result


def refusal(line: str, code: int = 2) -> str:
    """What is said where nothing was done: one paragraph after the notes, and no traceback."""
    out, err = said(line, code)
    notes, name, paragraph = err.partition("linkwise: ")
    assert out == "" and name and (notes == "" or notes.startswith("note: "))
    assert "Traceback" not in paragraph and "\n\n" not in paragraph
    return err
