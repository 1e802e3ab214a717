"""What stands beside the package: workflows of a forge, the recipe for conda, the check of wheels, the notebook."""

import json
import re
import shutil
import subprocess
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import linkwise as lw

TOP = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((TOP / ".github" / "workflows").glob("*.yml"))


def normal(requirement: str) -> str:
    """A requirement without spaces and markers, with the name that conda-forge has for it."""
    plain = re.sub(r"\s", "", requirement.partition(";")[0])
    return plain.replace("matplotlib-base", "matplotlib").replace("heyoka.py", "heyoka")


def test_the_recipe_requires_what_the_package_does() -> None:
    recipe = (TOP / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.findall(r"^    - (.*)$", recipe.partition("  run:\n")[2].partition("\ntests:")[0], re.MULTILINE)
    assert sorted(map(normal, run)) == sorted(
        [f"python{PROJECT['requires-python']}", *map(normal, PROJECT["dependencies"])]
    )
    assert f'version: "{lw.__version__}"' in recipe


def test_wheels_are_asked_for_by_the_markers_of_the_platform() -> None:
    spec = spec_from_file_location("wheels", TOP / "packaging" / "wheels.py")
    assert spec is not None and spec.loader is not None
    wheels = module_from_spec(spec)
    spec.loader.exec_module(wheels)
    named = {
        system: list(wheels.requirements(system, "3.12", ["files"]))
        for system in ("linux", "win32", "darwin")
    }
    assert named["win32"] == named["darwin"] and any(one.startswith("pyarrow") for one in named["win32"])
    assert {re.split("[><=]", one)[0] for one in set(named["linux"]) - set(named["win32"])} == {"heyoka"}


@pytest.mark.skipif(shutil.which("actionlint") is None, reason="no actionlint on this machine")
def test_workflows_are_right() -> None:
    run = subprocess.run(["actionlint", *map(str, WORKFLOWS)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout


def test_workflows_run_on_three_systems_and_every_python() -> None:
    yaml = pytest.importorskip("yaml")
    tests, release = (
        yaml.safe_load((TOP / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8"))["jobs"]
        for name in ("tests", "release")
    )
    matrix = tests["tests"]["strategy"]["matrix"]
    assert [system.partition("-")[0] for system in matrix["os"]] == ["ubuntu", "windows", "macos"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert [job["needs"] for job in release.values() if "needs" in job] == ["build", "install"]
    commands = [
        step["run"] for job in (*tests.values(), *release.values()) for step in job["steps"] if "run" in step
    ]
    mine = [
        line.strip()
        for text in commands
        for line in text.splitlines()
        if line.strip().startswith("linkwise ")
    ]
    assert len(mine) == 5 and "run.csv answer" in mine[-1]


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cell by cell, as a kernel does."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "linkwise.plot.style.encoded", lambda figure, *formats: [b"<svg></svg>" for _ in formats]
    )
    notebook = json.loads((TOP / "notebooks" / "first_hour.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for text in cells:
        *_, last = text.splitlines()
        exec(compile(text, "cell", "exec"), names)
        if last.startswith("lw.plot."):
            assert isinstance(eval(last, names), Figure)
    assert names["linear"].grade is lw.Grade.APPROXIMATE and names["fit"].trusted
    assert all(cell["outputs"] == [] for cell in notebook["cells"] if cell["cell_type"] == "code")
