"""The house, walked: one direction, no circles, one door to each guarded library."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from sources import FILES, SOURCE, tree

PACKAGES = (  # from the ground up: a package imports only from those before it, the root is everybody's
    "root", "expression", "model", "records", "files", "signals", "modal", "inspection", "analysis", "simulation",
    "estimates", "sindy", "weak", "likelihood", "identification", "discovery", "response", "absorption", "study", "export",
    "plot", "paper", "report", "cli",
)  # fmt: skip
DOORS = {
    "heyoka": "simulation/integrator",
    "pint": "units.py",
}  # the one package or file that may import each


def module_name(path: Path) -> str:
    """`linkwise.cli.simulate` for the file of that module; the package's own name for its `__init__.py`."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULE_FILES = {module_name(path): path for path in FILES}
MODULES = set(MODULE_FILES)


def imported(module: ast.AST) -> Iterator[str]:
    """Full dotted names that a module imports; of `from a import b` it is `a.b` where that is a module."""
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            names = (f"{base}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES or name == "linkwise.__version__" else base for name in names)


@cache
def imports_of(path: Path) -> frozenset[str]:
    """What a file of the package imports, as `imported` gives it."""
    return frozenset(imported(tree(path)))


def package(module: str) -> str:
    """The package of a module, "sindy" for `linkwise.sindy.regression.gram`; "root" directly under linkwise."""
    return next(iter(MODULE_FILES[module].parent.relative_to(SOURCE).parts), "root")


def climbs(module: str, target: str) -> bool:
    """Whether an import of `target` in `module` goes to a package that does not stand before its own."""
    own_package, target_package = package(module), package(target)
    return own_package != target_package and PACKAGES.index(target_package) >= PACKAGES.index(own_package)


def circle(graph: dict[str, set[str]]) -> list[str]:
    """A circle of imports, empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_every_package_has_its_place() -> None:
    assert {package(name) for name in MODULES} == set(PACKAGES)
    rules = (SOURCE.parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    order = rules.partition("    root <")[2].partition("\n\n")[0]
    assert ["root", *order.replace("<", " ").split()] == list(PACKAGES)


@pytest.mark.slow
def test_a_package_imports_only_from_those_before_it() -> None:
    """The package itself and `__main__` are doors: they show everything."""
    doors = {"linkwise", "linkwise.__main__"}
    inside = {name: imports_of(path) & (MODULES - {"linkwise"}) for name, path in MODULE_FILES.items()}
    climbing = {
        name: [target for target in targets if climbs(name, target)] for name, targets in inside.items()
    }
    assert {name: targets for name, targets in climbing.items() if targets and name not in doors} == {}


def test_only_the_command_line_imports_the_whole_package() -> None:
    users = {package(module_name(path)) for path in FILES if "linkwise" in imports_of(path)}
    assert users == {"cli"}


def test_no_circles() -> None:
    """Imports that only type checkers see count too."""
    graph = {
        name: (MODULES - {"linkwise", name}) & imports_of(path)
        for name, path in MODULE_FILES.items()
        if name != "linkwise"
    }
    assert len(graph) > 200 and circle(graph) == []


@pytest.mark.parametrize(("library", "door"), DOORS.items())
def test_guarded_libraries_have_one_door(library: str, door: str) -> None:
    users = [path for path in FILES if library in {target.split(".")[0] for target in imports_of(path)}]
    assert users and all(path.is_relative_to(SOURCE / door) for path in users)


def test_imports_are_absolute() -> None:
    """So that a line says where a name comes from, and the walk above is complete."""
    assert [path for path in FILES if any(target.startswith(".") for target in imports_of(path))] == []


def test_nobody_imports_pyplot() -> None:
    """Its global state keeps every figure alive and picks a display."""
    assert [path for path in FILES if any("pyplot" in target for target in imports_of(path))] == []


def test_the_walk_sees_what_it_must_refuse() -> None:
    """Beside each check, one that must be refused."""
    inside = ast.parse("def f():\n    from linkwise.cli import main\n")
    assert list(imported(inside)) == ["linkwise.cli"]
    assert list(imported(ast.parse("from . import law"))) == ["."]
    assert climbs("linkwise.model.law", "linkwise.cli.console")
    assert climbs("linkwise.errors", "linkwise.model.law")
    assert not climbs("linkwise.cli.console", "linkwise.model.law")
    assert circle({"a": {"b"}, "b": {"a"}}) and not circle({"a": {"b"}, "b": set()})
