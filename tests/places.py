"""Places to touch: what a test adds to linkwise from outside, counted."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import linkwise as lw
from linkwise.cli import linkwise
from linkwise.registry import Registry


class Places:
    """What a test adds: `files` are new modules, `lines` are entries in registries."""

    def __init__(self, folder: Path, undo: ExitStack) -> None:
        self.files, self.lines = 0, 0
        self._folder, self._undo = folder, undo

    def file(self, name: str, text: str) -> None:
        """Write a module that can be imported as `name`."""
        (self._folder / f"{name}.py").write_text(text, encoding="utf-8")
        self._undo.callback(sys.modules.pop, name, None)
        self.files += 1

    def copy(self) -> Path:
        """A copy of the package, which `script` will import; returns its folder."""
        folder = self._folder / "linkwise"
        shutil.copytree(Path(lw.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
        return folder

    def insert(self, path: Path, after: str, line: str) -> None:
        """Add a line to a copied file, behind another that is there once."""
        text = path.read_text(encoding="utf-8")
        assert text.count(after) == 1 and line.count("\n") == 1
        path.write_text(text.replace(after, after + line), encoding="utf-8")
        self.lines += 1

    def script(self, text: str, where: Path) -> str:
        """What a program prints that can import the modules written so far; a study's workers import the program itself."""
        path = where / "program.py"
        path.write_text(text, encoding="utf-8")
        paths = filter(None, [str(self._folder), os.environ.get("PYTHONPATH")])
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        ran = subprocess.run(
            [sys.executable, path.name],
            cwd=where,
            env=environment,
            check=True,
            text=True,
            stdout=subprocess.PIPE,
        )
        return ran.stdout

    def line(self, registry: Registry[Any], name: str, entry: object) -> None:
        """Register something for the time of the test."""
        self._undo.enter_context(registry.temporarily(name, entry))
        self.lines += 1


@contextmanager
def adding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Places]:
    """Places to add to for the time of a test; nothing has been added yet."""
    folder = tmp_path / "added"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    with ExitStack() as undo:
        yield Places(folder, undo)


def command(*arguments: str) -> Result:
    return CliRunner().invoke(linkwise, arguments)
