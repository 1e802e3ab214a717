"""What names the version of a release agrees: the package, the citation and the changelog."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import linkwise as lw

TOP = Path(__file__).resolve().parents[1]
CHANGELOG = (TOP / "CHANGELOG.md").read_text(encoding="utf-8")
CITATION = (TOP / "CITATION.cff").read_text(encoding="utf-8")
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
    project = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["license"] == cited("license") == "BSD-3-Clause"
    assert (TOP / "LICENSE").read_text(encoding="utf-8").startswith("BSD 3-Clause License\n")


def test_every_dependency_has_a_lowest_version() -> None:
    """Which `make matrix` installs; the extra that names other extras of this package is none."""
    script = TOP / ".ci" / "constraints.py"
    written = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True).stdout
    project = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    named = [
        requirement for group in groups for requirement in group if not requirement.startswith("linkwise")
    ]
    lines = written.splitlines()
    assert len(lines) == len(named) > 20
    assert all(re.fullmatch(r"[\w-]+==[\d.]+", line) for line in lines)
