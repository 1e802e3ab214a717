"""Ctrl-C at awkward moments: one line and the exit code of an interrupt, never a traceback."""

import subprocess
import sys
from pathlib import Path

import pytest

import linkwise as lw

# The command `linkwise`, and Ctrl-C in the moment when the module that is named first is imported.
INTERRUPTED = """
import os, signal, sys
from linkwise.__main__ import main

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == moment:
            os.kill(os.getpid(), signal.SIGINT)

moment = sys.argv.pop(1)
sys.meta_path.insert(0, Finder())
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a process of Windows cannot send itself Ctrl-C")
@pytest.mark.parametrize(
    "module",
    ["linkwise.cli", "click", "linkwise.model.structure_file", "numpy", "heyoka"],
)
def test_ctrl_c_during_an_import_ends_in_one_line(module: str, tmp_path: Path) -> None:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    arguments = ["simulate", "chain.toml", "--duration", "1", "--rate", "100", "-o", "run.csv"]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, module, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 130, done.stderr
    (line,) = done.stderr.strip().splitlines()  # behind the line that a terminal has begun with ^C
    assert line.startswith("linkwise: interrupted")
    assert {path.name for path in tmp_path.iterdir()} == {"chain.toml"}
