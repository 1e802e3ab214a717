"""Messages: no longer than a screen, in words, with a code that says whose turn it is; also after Ctrl-C."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from commands import python, refusal, said

import linkwise as lw
from linkwise.display import LONGEST, shortened

LONG = "n" * 200_000


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    text = shortened("begin " + LONG + " end")
    assert text.startswith("begin nnn") and text.endswith("nnn end") and "[... 198010 characters ...]" in text
    assert shortened("x" * LONGEST) == "x" * LONGEST


@pytest.mark.parametrize(
    "text",
    [
        f'name = "{LONG}',
        LONG,
        f'{LONG} = 1\n[[mass]]\nname="m"\nmass=1',
        f'[[mass]]\nname = "m1"\nmass = "{LONG}"\n',
        f'[[mass]]\nname = "m1"\nmass = {{ {LONG} = 1 }}\n[[link]]\nname="s"\nbetween=["m1","ground"]\nlaw="k*d"\n',
        f'[[mass]]\nname = "{LONG}"\nmass = 1\n[[mass]]\nname = "{LONG}"\nmass = 1\n[[link]]\nname="s"\n'
        f'between=["m1","ground"]\nlaw="k*d"\n',
        f'[[mass]]\nname="m1"\nmass=1\n[[link]]\nname="s"\nbetween=["m1","ground"]\nlaw="{LONG}*d"\n',
        f'[[mass]]\nname="m1"\nmass=1\n[[link]]\nname="s"\nbetween=["{LONG}","ground"]\nlaw="k*d"\n',
    ],
)
def test_a_long_structure_file_is_refused_on_a_screen(text: str, tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text(text)
    refusal(f"structure show {tmp_path}/long.toml")


def test_long_headers_are_refused_on_a_screen(tmp_path: Path, chain_files: Path) -> None:
    (tmp_path / "long.csv").write_text(f"time,{LONG},{LONG}2,x:{LONG}\n0,1,2,3\n")
    refusal(f"identify {tmp_path}/long.csv {chain_files}/chain.toml")


def test_lack_of_memory_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object, **__: Any) -> None:
        raise MemoryError("Unable to allocate 43.7 TiB")

    monkeypatch.setattr(lw, "bnes_chain", exhausted)
    said = refusal("structure bnes --dof 2", 1)
    assert said == "linkwise: the computer has too little memory for this (Unable to allocate 43.7 TiB)\n"


def command(arguments: list[str], redirections: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """`linkwise` with these arguments in `folder`, its streams redirected by a shell."""
    words = " ".join(f"'{word}'" for word in [sys.executable, "-m", "linkwise", *arguments])
    shell = f"import subprocess, sys; sys.exit(subprocess.run({f'{words} {redirections}'!r}, shell=True).returncode)"
    return python("-c", shell, folder=folder)


@pytest.mark.skipif(os.name != "posix", reason="streams are closed by a shell of Unix")
def test_without_standard_error_answers_and_codes_are_the_same(chain_files: Path) -> None:
    closed = command(["structure", "show", "chain.toml"], "2>&-", chain_files)
    assert (closed.returncode, closed.stdout) == (0, said(f"structure show {chain_files}/chain.toml").out)
    assert command(["identify", "chain.toml", "absent.toml"], "2>&-", chain_files).returncode == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_standard_output_is_told(chain_files: Path) -> None:
    full = command(["structure", "show", "chain.toml"], "> /dev/full", chain_files)
    assert full.returncode == 1
    assert full.stderr == "linkwise: No space left on device\n"


def test_a_name_that_standard_output_cannot_say_is_escaped(tmp_path: Path) -> None:
    """As on a pipe of Windows: an answer is not lost for a letter of it."""
    text = lw.model.format_structure(lw.bnes_chain(2)).replace('"m1"', '"\u8cea\u91cf"')
    (tmp_path / "chain.toml").write_text(text, encoding="utf-8")
    show = ["-m", "linkwise", "structure", "show", "chain.toml"]
    done = python(*show, folder=tmp_path, PYTHONIOENCODING="cp1252", PYTHONUTF8="0")
    assert (done.returncode, done.stderr) == (0, "")
    assert "\\u8cea\\u91cf" in done.stdout or "\u8cea\u91cf" in done.stdout


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
@pytest.mark.parametrize("module", ["linkwise.cli", "numpy", "heyoka"])
def test_ctrl_c_during_an_import_ends_in_one_line(module: str, tmp_path: Path) -> None:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    arguments = ["simulate", "chain.toml", "--duration", "1", "--rate", "100", "-o", "run.csv"]
    done = python("-c", INTERRUPTED, module, *arguments, folder=tmp_path)
    assert done.returncode == 130, done.stderr
    (line,) = done.stderr.strip().splitlines()  # behind the line that a terminal has begun with ^C
    assert line.startswith("linkwise: interrupted")
    assert {path.name for path in tmp_path.iterdir()} == {"chain.toml"}
