"""The command line, run in this process on a line as it is typed, and Python in processes of their own."""

import io
import json
import os
import shlex
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

from linkwise.cli import run

SCREEN = 4000  # characters that a screen shows


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
    assert len(err) < SCREEN
    return err


def python(
    *arguments: str, folder: Path | None = None, given: str = "", timeout: float = 60.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A process of Python with these arguments and variables, which reads what is `given`."""
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env={**os.environ, **environment}, input=given,
        capture_output=True, text=True, timeout=timeout, check=False,
    )  # fmt: skip
