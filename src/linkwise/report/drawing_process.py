"""A second process that draws figures of a result: it loads what draws while the first one still computes the result.

Few figures are all left to it; of many both draw, each figure once: the second process from the first figure on, this one
from the last, after it has loaded matplotlib too. Whatever the second does not deliver, because it could not start, was
killed or knows the figure under another name, is drawn here.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from threading import Lock, Thread
from typing import IO, TYPE_CHECKING, Any

from linkwise.registry import lazy_module
from linkwise.runtime import processors

if TYPE_CHECKING:
    from linkwise.model.structure import Structure
    from linkwise.plot import style
else:
    style = lazy_module("linkwise.plot.style")  # the first process may never draw

_LAST_FIGURE = 60.0  # s that the last figure of the second process may take before it is drawn here
_START = "import sys; sys.path[:] = {path!r}; from linkwise.report.drawing_process import main; main()"
_YES, _NO = b"y", b"n"


@dataclass(frozen=True)
class Picture:
    """A figure as files and as the part of a page."""

    png: bytes
    svg: bytes
    html: str


Drawings = Callable[[Any, "Structure | None"], Mapping[str, Callable[[], Picture]]]
"""Gives what draws the figures of a result, by name, beside the true structure where it is known."""


class DrawingProcess:
    """A running process that draws what `folder`, the full name "module:name" of a `ResultFolder`, shows of a result.

    `draw` gives it the result; `claim` and `pictures` are for `write_figures`, which draws beside it.
    """

    def __init__(self, folder: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", _START.format(path=sys.path), folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for this process, which then ends the other
        )
        self._lock = Lock()
        self._claimed: set[str] = set()
        self._pictures: dict[str, Picture] = {}
        self._thread: Thread | None = None

    def draw(self, result: object, truth: Structure | None = None) -> None:
        """Have the figures of a result drawn; returns when the result is copied, so that it may cache what it is asked for."""
        with suppress(Exception):  # of a result that cannot be copied the figures are drawn here
            message = pickle.dumps((result, truth), protocol=pickle.HIGHEST_PROTOCOL)
            self._thread = Thread(target=self._attend, args=(message,), daemon=True)
            self._thread.start()

    def claim(self, name: str) -> bool:
        """Whether nobody draws the figure of this name yet; from now on the caller does."""
        with self._lock:
            free = name not in self._claimed
            self._claimed.add(name)
        return free

    def pictures(self) -> dict[str, Picture]:
        """The figures drawn by the other process, by name, when the last one is done."""
        if self._thread is not None:
            self._thread.join(_LAST_FIGURE)
        with self._lock:
            return dict(self._pictures)

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        if self._thread is not None:
            self._thread.join()
        with suppress(OSError):  # of what it did not read
            self._process.communicate()

    def _attend(self, message: bytes) -> None:
        """Hand the pickled result over, grant what is not drawn yet, and collect the figures."""
        into, out = self._process.stdin, self._process.stdout
        assert into is not None and out is not None
        with suppress(Exception):  # what is wrong with a figure shows where it is drawn here
            into.write(message)
            into.flush()
            for name in iter(partial(pickle.load, out), None):
                granted = self.claim(name)
                into.write(_YES if granted else _NO)
                into.flush()
                picture = pickle.load(out) if granted else None
                if isinstance(picture, Picture):
                    with self._lock:
                        self._pictures[name] = picture


@contextmanager
def drawing_process(folder: str) -> Iterator[DrawingProcess | None]:
    """A process for the figures of `folder`, ended with the block; None where it would save no time or cannot be started."""
    process = None
    if _saves_time():
        with suppress(OSError):  # of a system that has no room for another process
            process = DrawingProcess(folder)
    try:
        yield process
    finally:
        if process is not None:
            process.close()


def _saves_time() -> bool:
    """Whether there is a processor for it, and something to load that this process has not loaded."""
    embedded = not sys.executable or getattr(sys, "frozen", False)  # Python is part of another program
    return processors() > 1 and "matplotlib.figure" not in sys.modules and not embedded


def main() -> None:
    """In the second process: load, wait for a result, draw; standard output is the pipe, which nothing else reaches."""
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)
        module, _, attribute = sys.argv[1].partition(":")
        folder = getattr(import_module(module), attribute)
        style.warm_up()
        with suppress(EOFError, OSError):  # the first process ended
            _draw(folder.drawings, sys.stdin.buffer, out)


def _draw(drawings: Drawings, into: IO[bytes], out: IO[bytes]) -> None:
    """Draw the figures of the result that comes `into` this process, those that the first process grants."""

    def send(message: object) -> None:
        pickle.dump(message, out, protocol=pickle.HIGHEST_PROTOCOL)
        out.flush()

    result, truth = pickle.load(into)
    for name, draw in drawings(result, truth).items():
        send(name)
        answer = into.read(1)
        if not answer:
            return
        if answer == _YES:
            send(draw())
    send(None)
