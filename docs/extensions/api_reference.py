"""The API reference, written from `linkwise.__all__`: a new public name appears by itself or fails the build.

Names are grouped by the package that they live in, in the order of PACKAGES and under their titles;
others follow. Each gets a page of its own in docs/api.
"""

from __future__ import annotations

import ast
import inspect
from enum import Enum
from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer

import linkwise as lw

PACKAGES = {
    "model": "Structures, laws and excitations",
    "records": "Records",
    "files": "Record files",
    "signals": "Signals",
    "simulation": "Simulation",
    "analysis": "Analysis of structures",
    "identification": "Identification",
    "estimates": "Estimates",
    "likelihood": "Maximum likelihood",
    "weak": "Weak form",
    "sindy": "SINDy",
    "discovery": "Discovery",
    "absorption": "Vibration absorption",
    "study": "Studies",
    "plot": "Figures",
    "report": "Result folders",
    "paper": "The paper",
    "verdict": "Trust",
    "progress": "Progress",
    "units": "Units",
    "errors": "Errors",
}
INDEX = """\
API reference
=============

Everything that ``linkwise`` makes public, by subject. Arrays are given with their shapes, as in (N,), and units; names
load on first use, so ``import linkwise as lw`` costs next to nothing.

.. currentmodule:: linkwise
"""


def imported(module: str) -> dict[str, str]:
    """The names that a module imports from others, those for type checkers included, and from which."""
    file = import_module(module).__file__
    nodes = ast.walk(ast.parse(Path(str(file)).read_text(encoding="utf-8")))
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def comment(name: str, module: str) -> list[str]:
    """The lines of the docstring below a constant, or of the `#:` comment above it, where it is defined."""
    while name in (names := imported(module)):
        module = names[name]
    comments = ModuleAnalyzer.for_module(module).find_attr_docs()
    if ("", name) not in comments:
        raise ExtensionError(f'the public constant "{name}" has no docstring: write one below it in {module}')
    return comments["", name]


def folder_of(value: object) -> str:
    """The folder of a page: `Limit` and `limit` are one file where capitals do not count."""
    if inspect.ismodule(value):
        return "modules"
    return "classes" if inspect.isclass(value) else "functions" if callable(value) else "constants"


def page(name: str, home: str) -> str:
    """The page of one public name."""
    value = getattr(lw, name)
    head = f"{name}\n{'=' * len(name)}\n\n.. currentmodule:: linkwise\n\n"
    if inspect.isclass(value):
        return f"{head}.. autoclass:: {name}\n   :members:\n{members(value)}"
    if inspect.ismodule(value):
        return f"{head}.. automodule:: linkwise.{name}\n   :members:\n"
    if callable(value):
        return f"{head}.. autofunction:: {name}\n"
    text = "\n   ".join(comment(name, home))
    return f"{head}.. py:data:: {name}\n   :value: {value!r}\n\n   {text}\n"


def members(value: type) -> str:
    """The members of an enumeration with their values; nothing for other classes."""
    if not issubclass(value, Enum):
        return ""
    return "\n.. rubric:: Members\n\n" + "".join(f"``{each.name}``\n   {each.value}\n\n" for each in value)


def section(title: str, names: list[str]) -> str:
    """A section of the index: a table of what can be called, a line of constants."""
    values = {name: getattr(lw, name) for name in names}
    table = "".join(
        f"   {name}\n" for name, value in values.items() if callable(value) or inspect.ismodule(value)
    )
    constants = ", ".join(f":py:data:`{name}`" for name in names if folder_of(values[name]) == "constants")
    tree = "".join(f"   {folder_of(value)}/{name}\n" for name, value in values.items())
    return (
        f"{title}\n{'-' * len(title)}\n\n.. autosummary::\n   :nosignatures:\n\n{table}\n"
        f"{'Constants: ' + constants if constants else ''}\n\n.. toctree::\n   :hidden:\n\n{tree}\n"
    )


def pages() -> dict[str, str]:
    """All pages of the reference by path, the index among them."""
    home = imported("linkwise")
    if missing := sorted(set(lw.__all__) - set(home)):
        raise ExtensionError(f"public names that are not imported for type checkers: {', '.join(missing)}")
    package = {name: f"{home[name]}.{name}".split(".")[1] for name in lw.__all__}
    written = {f"{folder_of(getattr(lw, name))}/{name}": page(name, home[name]) for name in lw.__all__}
    index = INDEX
    others = {folder: folder.capitalize() for folder in sorted(set(package.values()) - set(PACKAGES))}
    for folder, title in {**PACKAGES, **others}.items():
        if names := sorted((name for name in lw.__all__ if package[name] == folder), key=str.lower):
            index += "\n" + section(title, names)
    return {**written, "index": index}


def write(app: Sphinx) -> None:
    """Write the pages into docs/api; those that have not changed keep their time, so that they are not built again."""
    folder = Path(app.srcdir) / "api"
    wanted = {folder / f"{name}.rst": text for name, text in pages().items()}
    for old in set(folder.rglob("*.rst")) - set(wanted):
        old.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the reference before Sphinx looks for pages."""
    app.connect("builder-inited", write, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
