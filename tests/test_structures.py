"""Structures that tests work on are built in one place, whose words are those of `tests/structures.py`."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent
PARTS = {"Structure", "Link", "Mass", "Host"}
BUILDING_IS_TESTED = {
    "structures.py",
    "fuzz/worker.py",
}  # and the model


def built(module: ast.AST) -> list[int]:
    """Lines that call the class of a structure or of a part of it."""
    calls = (node for node in ast.walk(module) if isinstance(node, ast.Call))
    return [
        call.lineno
        for call in calls
        if (isinstance(call.func, ast.Name) and call.func.id in PARTS)
        or (
            isinstance(call.func, ast.Attribute)
            and call.func.attr in PARTS
            and ast.unparse(call.func.value) == "lw"
        )
    ]


def test_structures_are_built_in_one_place() -> None:
    """So that a structure that another test works on as well is found, and stands there once."""
    lines = {
        path.relative_to(TESTS).as_posix(): built(ast.parse(path.read_text(encoding="utf-8")))
        for path in sorted(TESTS.rglob("*.py"))
    }
    own = {name for name, found in lines.items() if found and not name.startswith("model/")}
    assert len(lines) > 200 and own == BUILDING_IS_TESTED


def test_the_walk_sees_what_it_must_refuse() -> None:
    module = ast.parse(
        'a = lw.Mass("m1", one)\nb = Link("spring", ends, law)\nc = structure.Mass\nd = link("s")\n'
    )
    assert built(module) == [1, 2]
