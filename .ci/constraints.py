"""Write the lowest version of every dependency that pyproject.toml allows, as constraints for pip.

The lowest versions are a promise as much as the newest: `make matrix` installs them and runs the tests.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
REQUIREMENT = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(?:\[[^]]*\])?\s*>=\s*(?P<version>[0-9.]+)")


def requirements(project: dict[str, object]) -> list[str]:
    """Every requirement of the `[project]` table, its own extras named in other extras left out."""
    required = project["dependencies"]
    extras = project.get("optional-dependencies", {})
    assert isinstance(required, list) and isinstance(extras, dict)
    own = re.compile(rf"{project['name']}\b")
    return [line for group in [required, *extras.values()] for line in group if not own.match(line)]


def lowest(requirement: str) -> str:
    """`name==version` of a requirement's lower bound.

    Raises
    ------
    ValueError
        If the requirement has no lower bound: its lowest version is then one that nobody has tried.
    """
    match = REQUIREMENT.match(requirement)
    if match is None:
        raise ValueError(f"requirement {requirement!r} in pyproject.toml needs a lower bound, such as >=1.2")
    return f"{match['name']}=={match['version']}"


def constraints() -> str:
    """The lines of a constraints file."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    return "".join(f"{lowest(requirement)}\n" for requirement in requirements(project))


if __name__ == "__main__":
    print(constraints(), end="")
