"""Pages of the documentation run their code, and the reference has one for every public name."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest
from public import public

pytestmark = pytest.mark.skipif(find_spec("sphinx") is None, reason="needs the extra 'docs': make docs")


EXTENSIONS = Path(__file__).resolve().parents[2] / "docs" / "extensions"


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


FAULTS = (  # what stands in the page, what in its place, and what is told
    ("1 + 2", "1 + None", "expected no error, got TypeError"),
    ("ZeroDivisionError", "KeyError", "expected KeyError, got ZeroDivisionError"),
    ("total / 0", "total / 1", "expected ZeroDivisionError, got None"),
    ("--dof 2", "--dof 3", "exit codes"),
    ("linkwise structure", "other structure", "not all commands of linkwise"),
    ("shown:: chain", "shown:: chains", "no block before has written chains.toml"),
)
BUILD = """
import sys
from contextlib import redirect_stderr
from pathlib import Path
from sphinx.cmd.build import main

for folder in map(Path, sys.argv[1:]):
    with (folder / "stderr").open("w", encoding="utf-8") as file, redirect_stderr(file):
        code = main(["-q", "-W", "-b", "html", str(folder), str(folder / "site")])
    (folder / "code").write_text(str(code))
"""


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Sites of one page each, built with warnings as errors: the good one, then those with a fault; one process builds all."""
    folders = []
    for page in (GOOD, *(GOOD.replace(old, new) for old, new, _ in FAULTS)):
        folders.append(tmp_path_factory.mktemp("site"))
        conf = f"import sys\nsys.path.insert(0, {str(EXTENSIONS)!r})\nextensions = ['executed']\n"
        (folders[-1] / "conf.py").write_text(conf, encoding="utf-8")
        (folders[-1] / "index.rst").write_text(page, encoding="utf-8")
    subprocess.run([sys.executable, "-c", BUILD, *map(str, folders)], check=True)
    return folders


def test_output_stands_below_the_code(sites: list[Path]) -> None:
    assert (sites[0] / "code").read_text() == "0", (sites[0] / "stderr").read_text(encoding="utf-8")
    page = (sites[0] / "site" / "index.html").read_text(encoding="utf-8")
    for shown in (
        "the sum is 3",
        "ZeroDivisionError: division by zero",
        "bistable chain of 2 masses",
        "a figure",
    ):
        assert shown in page


@pytest.mark.parametrize("number", range(len(FAULTS)))
def test_a_block_that_fails_fails_the_build(sites: list[Path], number: int) -> None:
    old, _, message = FAULTS[number]
    assert GOOD.count(old) == 1
    site = sites[1 + number]
    said = (site / "stderr").read_text(encoding="utf-8")
    assert (site / "code").read_text() != "0" and message in said and "index.rst" in said


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The extension that writes the reference."""
    monkeypatch.syspath_prepend(EXTENSIONS)
    module: ModuleType = pytest.importorskip("api_reference")
    return module


def test_every_public_name_has_a_page_of_its_own(reference: ModuleType) -> None:
    pages = reference.pages()
    listed = {name.rpartition("/")[2] for name in pages if name != "index"}
    assert listed >= {name for name, _ in public()}
    assert len({name.lower() for name in pages}) == len(pages)  # also where files do not tell capitals apart


def test_a_public_constant_without_a_docstring_is_refused(reference: ModuleType) -> None:
    with pytest.raises(Exception, match='the public constant "NUMBER" has no docstring'):
        reference.comment("NUMBER", "linkwise.display")
