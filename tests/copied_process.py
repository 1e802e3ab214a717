"""Python processes that begin as copies of this one, and need not import what it has imported: most of a second each."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from subprocess import DEVNULL, PIPE
from types import SimpleNamespace
from typing import IO, Self

import pytest


class CopiedProcess:
    """What `subprocess.Popen` of `[sys.executable, "-c", code, *arguments]` is to its caller, without an interpreter's start.

    Standard output is a pipe, standard input one or nothing, and what is written to standard error is lost. The modules `anew`
    are unknown to the process until it imports them.
    """

    def __init__(
        self,
        command: Sequence[str],
        stdin: int | None = None,
        stdout: int | None = None,
        stderr: int | None = None,
        env: Mapping[str, str] | None = None,
        start_new_session: bool = False,
        anew: Sequence[str] = (),
    ) -> None:
        _, flag, code, *arguments = command
        assert flag == "-c" and stdin in (PIPE, DEVNULL) and (stdout, stderr) == (PIPE, DEVNULL)
        given, into = os.pipe()
        out, answered = os.pipe()
        with warnings.catch_warnings():  # of other threads, which the copy has not
            warnings.simplefilter("ignore")
            self.pid = os.fork()
        if self.pid == 0:
            with suppress(BaseException):
                if start_new_session:
                    os.setsid()
                os.environ.update(env or {})
                nowhere = os.open(os.devnull, os.O_RDWR)
                for target, source in enumerate((given if stdin == PIPE else nowhere, answered, nowhere)):
                    os.dup2(source, target)
                for end in (given, into, out, answered):
                    os.close(end)
                for name in anew:
                    sys.modules.pop(name, None)
                _run(code, arguments)
                os._exit(0)
            os._exit(1)
        os.close(given)
        os.close(answered)
        self.stdin: IO[bytes] | None = os.fdopen(into, "wb")
        self.stdout: IO[bytes] | None = os.fdopen(out, "rb")
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """The code that it ended with, negative for a signal; None while it runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def wait(self) -> int:
        """The same, when it has ended."""
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def kill(self) -> None:
        """End it."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)

    def communicate(self) -> tuple[bytes, bytes]:
        """Close the pipes, and wait."""
        self.__exit__()
        return b"", b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for pipe in (self.stdin, self.stdout):
            if pipe is not None:
                with suppress(OSError):  # of what it did not read
                    pipe.close()
        self.wait()


def _run(code: str, arguments: Sequence[str]) -> None:
    """Run a program as a new interpreter does, whose warnings nobody sees."""
    sys.stdin, sys.stdout, sys.stderr = (
        os.fdopen(number, mode, closefd=False) for number, mode in enumerate(("r", "w", "w"))
    )
    sys.argv = ["-c", *arguments]
    warnings.resetwarnings()
    warnings.simplefilter("ignore")
    exec(code, {"__name__": "__main__"})


@contextmanager
def processes_are_copies(module: str, anew: Sequence[str] = ()) -> Iterator[None]:
    """In its block, the processes that this module of linkwise starts are copies of this one, on systems made for that."""
    with pytest.MonkeyPatch.context() as patch:
        if sys.platform == "linux":
            replacement = SimpleNamespace(Popen=partial(CopiedProcess, anew=anew), PIPE=PIPE, DEVNULL=DEVNULL)
            patch.setattr(f"{module}.subprocess", replacement)
        yield
