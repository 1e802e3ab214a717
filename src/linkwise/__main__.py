"""The command `linkwise`, also `python -m linkwise`: what must be so before anything slow is imported."""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
from contextlib import suppress
from importlib import import_module
from types import FrameType
from typing import NoReturn

_SELDOM = 20_000  # objects between collections of garbage: imports leave none, and with 700 looking takes a tenth of a command
_INTERRUPTED = 130  # exit code: ended by Ctrl-C, as shells count it


def main() -> NoReturn:
    """Run the command line on the arguments of this process and end it with the exit code."""
    _open_standard_streams()
    gc.set_threshold(_SELDOM)
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:  # an exception in the middle of an import would not get out of it whole
        signal.signal(signal.SIGINT, _leave)
    run = import_module("linkwise.cli").run
    if interruptible:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code = run(sys.argv[1:])
    if interruptible:  # what is left is the end of the process
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    _end(code)


def _open_standard_streams() -> None:
    """Let a closed standard stream lead nowhere, so that no file gets its number, and let all take any text."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free, which is this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    # escape what its encoding cannot say: an answer is not lost for a name
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _end(code: int) -> NoReturn:
    """End the process without freeing all it holds object by object, which takes a tenth of a command; the system frees it.

    What asked to be called at the end is called, as by the interpreter.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # of which the command has told
            stream.flush()
    os._exit(code)


def _leave(number: int, frame: FrameType | None) -> None:
    """End the process on Ctrl-C before there is anything to undo."""
    os.write(2, b"linkwise: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
