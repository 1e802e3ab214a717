"""Show that every requirement resolves to wheels, without a compiler, on each platform and Python that the package promises.

    python packaging/wheels.py [EXTRA...]

pip resolves for another platform, but reads markers of the one that it runs on, so those of this package are read here.
Nothing is installed, and metadata alone is fetched where the index has it apart. Ends with 1 where something has no wheel.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
MANYLINUX = (
    "manylinux2014",
    "manylinux_2_17",
    "manylinux_2_24",
    "manylinux_2_26",
    "manylinux_2_27",
    "manylinux_2_28",
)
PLATFORMS = {
    "win_amd64": ("win32", ["win_amd64"]),
    "macosx arm64": ("darwin", ["macosx_14_0_arm64"]),
    "macosx x86_64": ("darwin", ["macosx_14_0_x86_64"]),
    "linux x86_64": ("linux", [f"{tag}_x86_64" for tag in MANYLINUX]),
    "linux aarch64": ("linux", [f"{tag}_aarch64" for tag in MANYLINUX]),
}
"""The `sys_platform` of each, and the tags of wheels that it takes."""


def requirements(system: str, python: str, extras: Sequence[str] = ()) -> Iterator[str]:
    """What the package requires there, without markers; `extras` of it, too."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    stated = [
        *project["dependencies"],
        *(one for extra in extras for one in project["optional-dependencies"][extra]),
    ]
    for requirement in map(Requirement, stated):
        marker, requirement.marker = requirement.marker, None
        here = {"sys_platform": system, "python_version": python, "extra": ""}
        if marker is None or marker.evaluate(here):
            yield str(requirement)


def missing(platform: str, python: str, extras: Sequence[str]) -> str:
    """What pip says where something has no wheel, empty where everything has."""
    system, tags = PLATFORMS[platform]
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(
                sys.executable,
                "-m",
                "pip",
                "install",
                "--dry-run",
                "--quiet",
                "--ignore-installed",
                "--target",
                folder,
            ),
            *("--only-binary=:all:", "--implementation", "cp", "--python-version", python),
            *(f"--platform={tag}" for tag in tags),
            *requirements(system, python, extras),
        ]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
    return run.stderr.strip() or "pip failed" if run.returncode else ""


def main(extras: Sequence[str]) -> int:
    """Print a line for each platform and Python; 1 where something has no wheel, else 0."""
    failed = 0
    for platform in PLATFORMS:
        for python in PYTHONS:
            told = missing(platform, python, extras)
            print(f"{platform:14} {python:5} {told or 'wheels for everything'}", flush=True)
            failed |= bool(told)
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
