"""Runs of `identify` that share a folder, are killed while they write, or find the disk full; and what they leave."""

import os
import random
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

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


@dataclass
class DamagedRuns:
    """Two records of one structure, in `home`, and the folder and the printed text of an undisturbed run of each."""

    home: Path
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

    def started(self, name: str, folder: Path, code: str = _COMMAND, *before: str) -> subprocess.Popen[bytes]:
        """A run on the record `name` that writes to `folder`."""
        temporary = self.home / "kept"
        temporary.mkdir(exist_ok=True)
        arguments = ["identify", f"{name}.csv", "unknown.toml", "--method", "weak", "-o", str(folder)]
        return subprocess.Popen(
            [sys.executable, "-c", code, *before, *arguments],
            cwd=self.home,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(temporary)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,  # what is left after its first line is for `communicate`
        )

    def answer(self, run: subprocess.Popen[bytes]) -> bytes:
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
