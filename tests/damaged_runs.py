"""Runs of `identify` that share a folder, are killed while they write, or find the disk full; and what they leave."""

from __future__ import annotations

import multiprocessing
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Protocol

from problems import chain_record

import linkwise as lw
from linkwise.output import check_result_folder

ABSENT, MIXED = "absent", "mixed"
_COMMAND = "import sys; from linkwise.__main__ import main; main()"
_TIMES = re.compile(rb'"seconds": [^,\n]+|, [0-9.e+-]+ s[,)]')  # that a fit took: no two are equal

# The command on a disk with room for so many bytes more than the answer found there.
_FULL = """
import builtins, errno, io, os, sys
from linkwise.__main__ import main

room, usual = int(sys.argv.pop(1)), io.open

def limited(write):
    def to_disk(data):
        global room
        size = len(data if isinstance(data, str) else memoryview(data).cast("B"))
        if size > room:
            write(data[:room])
            room = 0
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        room -= size
        return write(data)
    return to_disk

class Limited:
    def __init__(self, file):
        self._file = file
        self.write = limited(file.write)
    def __getattr__(self, name):
        return getattr(self._file, name)
    def __iter__(self):
        return iter(self._file)
    def __enter__(self):
        self._file.__enter__()
        return self
    def __exit__(self, *error):
        return self._file.__exit__(*error)

def opened(file, mode="r", *rest, **named):
    found = usual(file, mode, *rest, **named)
    ours = isinstance(file, (str, os.PathLike)) and ".partial" in os.fspath(file) and not os.fspath(file).endswith("trial")
    return Limited(found) if ours and set(mode) & set("wxa+") else found

io.open = builtins.open = opened
main()
"""


class Run(Protocol):
    """A running process, as `subprocess.Popen` describes one."""

    stdout: IO[bytes] | None
    returncode: int | None

    def communicate(self, *, timeout: float | None = None) -> tuple[bytes, bytes]: ...

    def kill(self) -> None: ...


def started_anew(code: str, arguments: list[str], home: Path, environment: dict[str, str]) -> Run:
    """A run of Python, as a user starts one."""
    run: Run = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=home,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,  # what is left after its first line is for `communicate`
    )
    return run


_LOADED = [
    "linkwise.cli.identify",
    "linkwise.report.estimate",
    "linkwise.weak.estimate",
    "linkwise.plot.links",
    "linkwise.plot.records",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
]


def forked(code: str, arguments: list[str], home: Path, environment: dict[str, str]) -> Run:
    """The same in a copy of a process that has loaded already what the command loads."""
    return _Forked(code, arguments, home, environment)


class _Forked:
    """A process of a server that forks; its error stream goes to a file."""

    def __init__(self, code: str, arguments: list[str], home: Path, environment: dict[str, str]) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(_LOADED)
        inlet, outlet = context.Pipe(duplex=False)
        self._errors = home / f"errors-{time.monotonic_ns()}"
        self._process = context.Process(
            target=_execute, args=(code, arguments, home, environment, outlet, self._errors)
        )
        self._process.start()
        outlet.close()
        self.stdout: IO[bytes] | None = os.fdopen(os.dup(inlet.fileno()), "rb", buffering=0)
        inlet.close()
        self.returncode: int | None = None

    def communicate(self, *, timeout: float | None = None) -> tuple[bytes, bytes]:
        assert self.stdout is not None
        with self.stdout:
            rest = self.stdout.read()
        self._process.join(timeout)
        self.returncode = self._process.exitcode
        return rest, self._errors.read_bytes() if self._errors.exists() else b""

    def kill(self) -> None:
        self._process.kill()


def _execute(
    code: str, arguments: list[str], home: Path, environment: dict[str, str], outlet: Connection, errors: Path
) -> None:
    """In the copy: run `code` as Python would after `-c`."""
    with open(errors, "wb") as file:
        os.dup2(file.fileno(), 2)
    os.dup2(outlet.fileno(), 1)
    os.chdir(home)
    os.environ.update(environment)
    sys.argv = ["-c", *arguments]
    with open(1, "w", closefd=False) as sys.stdout, open(2, "w", closefd=False) as sys.stderr:
        exec(code, {"__name__": "__main__"})


@dataclass
class DamagedRuns:
    """Two records of one structure, in `home`, and the folder and the printed text of an undisturbed run of each.

    `start` starts a run: `started_anew`, or `forked`, which saves what it takes to load everything.
    """

    home: Path
    start: Callable[[str, list[str], Path, dict[str, str]], Run] = started_anew
    folders: dict[str, Path] = field(default_factory=dict)
    printed: dict[str, bytes] = field(default_factory=dict)
    writing: float = 0.0  # s that it took the last undisturbed run

    def __post_init__(self) -> None:
        chain = lw.bnes_chain(2)
        lw.write_structure(chain.unknown("nes"), self.home / "unknown.toml")
        motion = chain_record(2, duration=1.0, rate=500.0)
        for seed, name in enumerate(("first", "second")):
            lw.write_record(motion.with_noise(30.0, seed=seed), self.home / f"{name}.csv")
            self.folders[name] = self.home / name
            self.printed[name] = self.undisturbed(name, self.folders[name])

    def undisturbed(self, name: str, folder: Path) -> bytes:
        """What a run prints that nothing happens to."""
        run = self.started(name, folder)
        first = self.answer(run)
        began = time.monotonic()
        rest, error = run.communicate(timeout=300)
        self.writing = time.monotonic() - began
        if run.returncode:
            raise RuntimeError(error.decode(errors="replace"))
        return _TIMES.sub(b"", first + rest)

    def started(self, name: str, folder: Path, code: str = _COMMAND, *before: str) -> Run:
        """A run on the record `name` that writes to `folder`."""
        temporary = self.home / "kept"
        temporary.mkdir(exist_ok=True)
        arguments = ["identify", f"{name}.csv", "unknown.toml", "--method", "weak", "-o", str(folder)]
        environment = {"OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(temporary)}
        return self.start(code, [*before, *arguments], self.home, environment)

    def answer(self, run: Run) -> bytes:
        """The first line of the answer, which is printed when the fit is done and nothing is written yet."""
        assert run.stdout is not None
        return run.stdout.readline()

    def state(self, folder: Path) -> str:
        """Whose result `folder` holds: the name of a record, `ABSENT`, or `MIXED` where it is not whole or of two runs."""
        if not folder.exists():
            return ABSENT
        files = _contents(folder)
        return next((name for name, whole in self.folders.items() if _contents(whole) == files), MIXED)

    def pair(self, number: int) -> str:
        """The folder after two runs at once, the second of which begins up to half a second later."""
        folder = self.home / f"pair{number}" / "answer"
        first = self.started("first", folder)
        time.sleep(random.Random(number).uniform(0.0, 0.5))
        two = self.started("second", folder)
        for name, run in (("first", first), ("second", two)):
            out, error = run.communicate(timeout=300)
            assert run.returncode == 0, error
            assert _TIMES.sub(b"", out) == self.printed[name]
        assert os.listdir(folder.parent) == ["answer"]
        return self.state(folder)

    def kill(self, number: int) -> str:
        """The folder after a kill while it was written, over an earlier result where `number` is odd."""
        folder = self.home / f"kill{number}" / "answer"
        if number % 2:
            shutil.copytree(self.folders["second"], folder)
        run = self.started("first", folder)
        first = self.answer(run)
        time.sleep(random.Random(number).uniform(0.0, 1.1 * self.writing))
        run.kill()
        assert _TIMES.sub(b"", first + run.communicate()[0]) == self.printed["first"]
        left = self.state(folder)
        check_result_folder(
            folder
        )  # as the next run does, which finds what a kill between two renames has moved
        after = self.state(folder)
        assert after in ({left, "second"} if number % 2 and left == ABSENT else {left})
        assert not number % 2 or after != ABSENT
        return left

    def full_disk(self, number: int, count: int) -> str:
        """The folder after the disk has become full at the moment `number` of `count`, over an earlier result where odd.

        The moments are spread evenly in the logarithm of the bytes that were written before.
        """
        folder = self.home / f"disk{number}" / "answer"
        if number % 2:
            shutil.copytree(self.folders["second"], folder)
        total = sum(path.stat().st_size for path in self.folders["first"].iterdir())
        room = int(total ** ((number + 0.5) / count))
        run = self.started("first", folder, _FULL, str(room))
        out, error = run.communicate(timeout=300)
        assert run.returncode == 1 and b"No space left on device" in error, error
        assert _TIMES.sub(b"", out) == self.printed["first"]
        assert len(os.listdir(folder.parent)) == number % 2
        return self.state(folder)


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: _TIMES.sub(b"", path.read_bytes()) for path in sorted(folder.iterdir())}
