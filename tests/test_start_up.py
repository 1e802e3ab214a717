"""What a start costs: names load on first use, and help pays for nothing that it does not show."""

import ast
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from public import PACKAGES, public

import linkwise as lw
from linkwise.registry import listed_names

HEAVY = {"numpy", "scipy", "heyoka", "h5py", "matplotlib", "jinja2", "pint"}
LOADED = "; import sys; print(*{name.partition('.')[0] for name in sys.modules})"


def run(code: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter running `code`, where any warning is an error."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("code", ["import linkwise", "import linkwise.cli"])
def test_start_loads_nothing_heavy(code: str) -> None:
    result = run(code + LOADED)
    assert result.returncode == 0, result.stderr
    assert HEAVY & set(result.stdout.split()) == set()


QUESTIONS = """
import sys
import linkwise as lw
import linkwise.study.workers
from linkwise.report.estimate import estimate_page
from linkwise.report.result_folder import Reported
chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0).with_noise(30.0, seed=1)
estimate_page(Reported(lw.identify(record, chain.unknown("nes"))), {})
lw.discover(record, {"m1": 1.0, "m2": 0.01})
print(*sys.modules)
lw.absorb(chain, release={"v:m1": 1.0}, duration=0.5)
print(*sys.modules)
"""


def test_questions_load_nothing_heavy_that_they_do_not_use() -> None:
    """`scipy.signal` imports `scipy.stats`, and both more than half a second of other packages, `pint` a third of one."""
    result = run(QUESTIONS)
    assert result.returncode == 0, result.stderr
    fits, all_of_them = (set(line.split()) for line in result.stdout.splitlines())
    # `identify` uses scipy.special, which takes 40 ms, for the scatter of blocks
    assert fits & {"pint", "scipy.signal", "scipy.stats", "scipy.optimize", "scipy.interpolate"} == set()
    # crossings of wells are roots of splines
    assert all_of_them & {"pint", "scipy.signal", "scipy.stats"} == set()


def test_public_names_are_few_load_and_are_listed() -> None:
    """A screen of them, packages included, and another of pictures; what else there is lies in a package of its subject."""
    assert len(lw.__all__) <= 60 and len(lw.plot.__all__) <= 35
    assert dir(lw) == lw.__all__ and len(list(public())) > 200
    with pytest.raises(AttributeError, match="module 'linkwise' has no attribute 'identfy'"):
        lw.identfy  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("package", [lw, *(package for package in PACKAGES if package is not lw.files)])
def test_a_package_exports_what_type_checkers_see(package: ModuleType) -> None:
    """The names are read line by line, so each of them must stand on a line of its own."""
    stub = f"{package.__file__}i"
    tree = ast.parse(Path(stub).read_text(encoding="utf-8"))
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    exported = {alias.name: node.module for node in nodes for alias in node.names if alias.asname}
    assert exported and exported == listed_names(stub)
    assert package.__all__ == sorted(exported) == dir(package)


@pytest.mark.parametrize("package", [lw, *PACKAGES])
def test_no_module_bears_the_name_of_a_public_function_of_its_package(package: ModuleType) -> None:
    """Else the import system would bind the module in its place."""
    inside = {path.stem for path in Path(str(package.__file__)).parent.iterdir()}
    packages = {value.__name__.rpartition(".")[2] for value in PACKAGES} if package is lw else set()
    assert inside & set(package.__all__) == packages


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_commands_and_options(shell: str) -> None:
    """As docs/commands.md says; each shell sends what was typed, and gets the words that may follow."""
    page = (Path(__file__).parents[1] / "docs" / "commands.md").read_text(encoding="utf-8")
    assert f"_LINKWISE_COMPLETE={shell}_source linkwise" in page
    command = [sys.executable, "-c", "import sys; from linkwise.__main__ import main; sys.exit(main())"]

    def asked(**variables: str) -> str:
        environment = {**os.environ, **variables}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False).stdout

    assert f"{shell}_complete" in asked(_LINKWISE_COMPLETE=f"{shell}_source")
    last = "1" if shell != "fish" else "resp"
    typed = {"COMP_WORDS": "linkwise resp", "COMP_CWORD": last}
    assert "respond" in asked(_LINKWISE_COMPLETE=f"{shell}_complete", **typed)
