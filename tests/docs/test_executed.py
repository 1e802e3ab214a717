"""Pages of the documentation run their code, and a block that fails fails the build."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

EXTENSIONS = Path(__file__).resolve().parents[2] / "docs" / "extensions"
pytestmark = pytest.mark.skipif(find_spec("sphinx") is None, reason="needs the extra 'docs': make docs")

GOOD = """
Page
====

.. run::

   total = 1 + 2
   print(f"the sum is {total}")

.. run::
   :raises: ZeroDivisionError

   total / 0

.. command::

   linkwise structure bnes --dof 2 -o chain.toml

.. shown:: chain.toml
   :lines: 1

.. run::

   import matplotlib.pyplot as plt

   fig, ax = plt.subplots()
   ax.set_title("a figure")
"""


def built(folder: Path, page: str) -> subprocess.CompletedProcess[str]:
    """A site of one page, built with warnings as errors."""
    conf = f"import sys\nsys.path.insert(0, {str(EXTENSIONS)!r})\nextensions = ['executed']\n"
    (folder / "conf.py").write_text(conf, encoding="utf-8")
    (folder / "index.rst").write_text(page, encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(folder), str(folder / "site")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_output_stands_below_the_code(tmp_path: Path) -> None:
    done = built(tmp_path, GOOD)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    for shown in (
        "the sum is 3",
        "ZeroDivisionError: division by zero",
        "bistable chain of 2 masses",
        "a figure",
    ):
        assert shown in page


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("1 + 2", "1 + None", "expected no error, got TypeError"),
        ("ZeroDivisionError", "KeyError", "expected KeyError, got ZeroDivisionError"),
        ("total / 0", "total / 1", "expected ZeroDivisionError, got None"),
        ("--dof 2", "--dof 3", "exit codes"),
        ("linkwise structure", "other structure", "not all commands of linkwise"),
        ("shown:: chain", "shown:: chains", "no block before has written chains.toml"),
    ],
)
def test_a_block_that_fails_fails_the_build(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert GOOD.count(old) == 1
    done = built(tmp_path, GOOD.replace(old, new))
    assert done.returncode != 0 and told in done.stderr and "index.rst" in done.stderr
