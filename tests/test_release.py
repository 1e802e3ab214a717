"""What stands beside the package agrees with it: version, citation, changelog, workflows, recipe, notebook, platforms."""

import json
import re
import shutil
import subprocess
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from commands import python
from matplotlib.figure import Figure

import linkwise as lw

TOP = Path(__file__).resolve().parents[1]
CHANGELOG = (TOP / "CHANGELOG.md").read_text(encoding="utf-8")
CITATION = (TOP / "CITATION.cff").read_text(encoding="utf-8")
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RELEASE = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", re.MULTILINE)


def cited(key: str) -> str:
    """The value of a key at the top level of the citation file."""
    match = re.search(rf'^{key}: "?([^"\n]+)"?$', CITATION, re.MULTILINE)
    assert match is not None, key
    return match[1]


def test_the_newest_release_of_the_changelog_is_this_version() -> None:
    assert RELEASE.findall(CHANGELOG)[0] == (lw.__version__, cited("date-released"))
    assert cited("version") == lw.__version__


def test_releases_stand_newest_first_below_what_is_unreleased() -> None:
    versions = [tuple(map(int, version.split("."))) for version, _ in RELEASE.findall(CHANGELOG)]
    assert len(versions) >= 2 and versions == sorted(versions, reverse=True)
    assert CHANGELOG.index("## [Unreleased]") < CHANGELOG.index(f"## [{lw.__version__}]")


def test_the_licence_is_the_same_everywhere() -> None:
    assert PROJECT["license"] == cited("license") == "BSD-3-Clause"
    assert (TOP / "LICENSE").read_text(encoding="utf-8").startswith("BSD 3-Clause License\n")


def test_every_dependency_has_a_lowest_version() -> None:
    """Which `make matrix` installs; the extra that names other extras of this package is none."""
    script = TOP / ".ci" / "constraints.py"
    written = python(str(script)).stdout
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    named = [each for group in groups for each in group if not each.startswith("linkwise")]
    lines = written.splitlines()
    assert len(lines) == len(named) > 20
    assert all(re.fullmatch(r"[\w-]+==[\d.]+", line) for line in lines)


WORKFLOWS = sorted((TOP / ".github" / "workflows").glob("*.yml"))


def normal(requirement: str) -> str:
    """A requirement without spaces and markers, with the name that conda-forge has for it."""
    plain = re.sub(r"\s", "", requirement.partition(";")[0])
    return plain.replace("matplotlib-base", "matplotlib").replace("heyoka.py", "heyoka")


def test_the_recipe_requires_what_the_package_does() -> None:
    recipe = (TOP / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.findall(r"^    - (.*)$", recipe.partition("  run:\n")[2].partition("\ntests:")[0], re.MULTILINE)
    needed = [f"python{PROJECT['requires-python']}", *map(normal, PROJECT["dependencies"])]
    assert sorted(map(normal, run)) == sorted(needed)
    assert f'version: "{lw.__version__}"' in recipe


def test_wheels_are_asked_for_by_the_markers_of_the_platform() -> None:
    spec = spec_from_file_location("wheels", TOP / "packaging" / "wheels.py")
    assert spec is not None and spec.loader is not None
    wheels = module_from_spec(spec)
    spec.loader.exec_module(wheels)
    systems = ("linux", "win32", "darwin")
    named = {system: list(wheels.requirements(system, "3.12", ["files"])) for system in systems}
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
    needs = [job["needs"] for job in release.values() if "needs" in job]
    assert needs == ["build", ["install", "documentation"]]
    steps = [step for job in (*tests.values(), *release.values()) for step in job["steps"]]
    lines = [line.strip() for step in steps for line in step.get("run", "").splitlines()]
    mine = [line for line in lines if line.startswith("linkwise ")]
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


WITHOUT = """
import importlib, json, pkgutil, sys, tempfile
for name in ("heyoka", "fcntl", "resource", "pwd", "termios"):
    sys.modules[name] = None
import linkwise as lw
from linkwise.cli import run

refused = []
for module in pkgutil.walk_packages(lw.__path__, "linkwise."):
    try:
        importlib.import_module(module.name)
    except ImportError:
        refused.append(module.name)
chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 0.3}, duration=0.3, rate=500.0).with_noise(30.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"), method="weak")
with tempfile.TemporaryDirectory() as folder:
    for _ in range(2):  # the second one replaces the first
        answer = lw.report.write_result(fit, f"{folder}/answer")
    files = sorted(path.name for path in answer.iterdir())
    lw.write_record(record, f"{folder}/run.csv")
    code = run(["inspect", f"{folder}/run.csv", "--json"])
print(json.dumps([refused, files, code]))
"""


@pytest.mark.slow
def test_every_module_loads_and_folders_are_written_without_what_other_systems_lack() -> None:
    done = python("-c", WITHOUT, timeout=300.0)
    assert done.returncode == 0, done.stderr
    refused, files, code = json.loads(done.stdout.splitlines()[-1])
    assert set(refused) <= {"linkwise.simulation.integrator.taylor"}
    assert {"report.html", "result.json", "structure.toml", "covariance.csv"} < set(files) and code == 0
