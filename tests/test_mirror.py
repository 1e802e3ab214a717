"""Tests mirror the tree: what is tested of a package stands in the folder of its name."""

from __future__ import annotations

from pathlib import Path

from sources import FILES, SOURCE

TESTS = Path(__file__).parent
OF_NO_PACKAGE = {"docs", "fuzz", "robustness"}  # of the documentation, and of what everything must stand


def folders(files: list[Path], top: Path) -> set[str]:
    """Folders below `top` that hold one of the files, "sindy/regression" for one."""
    return {path.parent.relative_to(top).as_posix() for path in files} - {"."}


def test_every_package_has_its_folder_of_tests_and_no_other_has() -> None:
    packages = folders(list(FILES), SOURCE)
    tested = folders(list(TESTS.rglob("test_*.py")), TESTS)
    assert "identification/limit" in packages  # inner ones among them
    assert tested - OF_NO_PACKAGE == packages
    assert tested > OF_NO_PACKAGE  # none is named in vain


def test_what_tests_share_stands_at_their_top() -> None:
    """In a package's folder is nothing but its tests, so that a structure is found where all look for it."""
    inside = [path for path in TESTS.rglob("*.py") if path.parent != TESTS and "fuzz" not in path.parts]
    assert len(inside) > 100
    assert [path for path in inside if not path.name.startswith("test_")] == []
