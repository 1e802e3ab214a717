"""The house, walked: one direction, no circles, one door to each guarded library."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import linkwise

SOURCE = Path(linkwise.__file__).parent
ROOMS = """arrays atomic runtime text units errors expression model records files signals analysis simulation estimates
    sindy weak likelihood identification discovery absorption study plot paper report"""
FLOORS = {"rooms": ROOMS, "doors": "cli linkwise"}  # coarse while modules move into their packages
HEIGHT = {room: height for height, rooms in enumerate(FLOORS.values()) for room in rooms.split()}
DOORS = {"heyoka": "simulation/integrator.py", "pint": "units.py"}  # the one file that may import each
FILES = sorted(SOURCE.rglob("*.py"))


def module_name(path: Path) -> str:
    """`linkwise.cli.simulate` for the file of that module; the package's own name for its `__init__.py`."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path) for path in FILES}


def imported(tree: ast.AST) -> Iterator[str]:
    """Full dotted names that the tree imports; of `from a import b` it is `a.b` where that is a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            names = (f"{base}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES else base for name in names)


def imports_of(path: Path) -> set[str]:
    """What a file of the package imports, as `imported` gives it."""
    return set(imported(ast.parse(path.read_text(encoding="utf-8"))))


def without_type_imports(tree: ast.Module) -> ast.Module:
    """The module without its `if TYPE_CHECKING:` blocks."""
    body = [node for node in tree.body if getattr(getattr(node, "test", None), "id", "") != "TYPE_CHECKING"]
    return ast.Module(body, type_ignores=[])


def room(module: str) -> str:
    """The file or folder directly under linkwise that a module belongs to; "linkwise" for the package itself."""
    return module.split(".")[1] if "." in module else module


def imports_inside_functions(tree: ast.AST) -> list[int]:
    """Line numbers of import statements within a function's body."""
    return sorted(
        {
            inner.lineno
            for node in ast.walk(tree)
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            for inner in ast.walk(node)
            if isinstance(inner, (ast.Import, ast.ImportFrom))
        }
    )


def climbs(module: str, target: str) -> bool:
    """Whether an import of `target` in `module` goes up the floors."""
    return HEIGHT.get(room(target), 0) > HEIGHT.get(room(module), 0)


def test_every_module_has_a_floor() -> None:
    assert set(HEIGHT) - {room(name) for name in MODULES} <= set(ROOMS.split())


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_go_down(path: Path) -> None:
    name = module_name(path)
    inside = [target for target in imports_of(path) if target.split(".")[0] == "linkwise"]
    assert [target for target in inside if climbs(name, target)] == []


def test_no_circles() -> None:
    """What only type checkers see does not count, nor does the lazy top package: neither runs."""
    graph: dict[str, set[str]] = {}
    for path in FILES:
        name = module_name(path)
        if name != "linkwise":
            tree = without_type_imports(ast.parse(path.read_text(encoding="utf-8")))
            graph[name] = set(imported(tree)) & MODULES - {"linkwise"}
    assert len(list(TopologicalSorter(graph).static_order())) >= len(graph)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_no_import_inside_a_function(path: Path) -> None:
    assert imports_inside_functions(ast.parse(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(("library", "door"), DOORS.items())
def test_guarded_libraries_have_one_door(library: str, door: str) -> None:
    users = [path for path in FILES if library in {target.split(".")[0] for target in imports_of(path)}]
    assert users == [SOURCE / door]


def test_imports_are_absolute() -> None:
    """So that a line says where a name comes from, and the walk above is complete."""
    assert [path for path in FILES if any(target.startswith(".") for target in imports_of(path))] == []


def test_nobody_imports_pyplot() -> None:
    """Its global state keeps every figure alive and picks a display."""
    assert [path for path in FILES if any("pyplot" in target for target in imports_of(path))] == []


def test_the_walk_sees_what_it_must_refuse() -> None:
    """Beside each check, one that must be refused."""
    tree = ast.parse("def f():\n    from linkwise.cli import main\n")
    assert list(imported(tree)) == ["linkwise.cli"]
    assert list(imported(ast.parse("from . import law"))) == ["."]
    assert imports_inside_functions(tree) == [2]
    assert climbs("linkwise.model.law", "linkwise.cli") and not climbs("linkwise.cli", "linkwise.model.law")
    with pytest.raises(ValueError, match="cycle"):
        list(TopologicalSorter({"a": {"b"}, "b": {"a"}}).static_order())
