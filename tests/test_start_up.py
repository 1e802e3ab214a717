"""What a start costs: names load on first use, and help pays for nothing that it does not show."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import linkwise as lw
from linkwise.public_names import HOMES

HEAVY = {"numpy", "scipy", "heyoka", "h5py", "matplotlib", "plotly", "jinja2", "pint"}
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


def test_result_folders_load_nothing_that_draws() -> None:
    """Figures may be drawn by another process."""
    folders = ("estimate", "discovery", "absorption")
    result = run("; ".join(f"import linkwise.report.{name}_folder" for name in folders) + LOADED)
    assert result.returncode == 0, result.stderr
    assert {"linkwise", "jinja2"} <= set(result.stdout.split()) and "matplotlib" not in result.stdout.split()


@pytest.mark.parametrize("arguments", [["-c", "import linkwise"], ["-m", "linkwise", "--help"]])
def test_start_takes_little_processor_time(arguments: list[str]) -> None:
    """At most 0.3 s above bare Python; processor time, so that a busy machine is no failure."""

    def cost(command: list[str]) -> float:
        before = os.times()
        subprocess.run([sys.executable, *command], check=True, capture_output=True)
        after = os.times()
        return (after.children_user - before.children_user) + (after.children_system - before.children_system)

    bare = min(cost(["-c", "pass"]) for _ in range(3))
    assert min(cost(arguments) for _ in range(3)) - bare < 0.3


def test_every_public_name_loads_and_is_listed() -> None:
    assert set(dir(lw)) == {*lw.__all__, "__version__"}
    for name in lw.__all__:
        assert getattr(lw, name) is not None


def test_table_of_homes_equals_what_type_checkers_see() -> None:
    tree = ast.parse(Path(lw.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {(f"linkwise.{home}", name) for home, names in HOMES.items() for name in names}
    names = [name for names in HOMES.values() for name in names]
    assert sorted(lw.__all__) == sorted([*names, "plot"])  # a package, whose names load on first use too


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'linkwise' has no attribute 'identfy'"):
        lw.identfy  # noqa: B018


def test_no_module_at_the_root_bears_the_name_of_a_public_function() -> None:
    """Else the import system would bind the module in its place."""
    modules = {path.stem for path in Path(lw.__file__).parent.iterdir()}
    assert "errors" in modules and modules & set(lw.__all__) == {"plot"}  # which is that module
