"""The API reference, written from `linkwise.__all__` and that of its packages: a new public name appears by itself.

Names are grouped by their package, those of linkwise itself by the one that they live in, in the order of PACKAGES and under
their titles; others follow. Each gets a page of its own in docs/api, and a bare name in a docstring links to it.
"""

from __future__ import annotations

import ast
import inspect
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType

from docutils import nodes
from docutils.nodes import TextElement
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer

import linkwise as lw
from linkwise.registry import listed_names

PACKAGES = {
    "model": "Structures, laws and excitations",
    "records": "Records",
    "files": "Record files",
    "inspection": "Inspection",
    "modal": "Modal tests and hosts",
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
    "export": "Exports",
    "verdict": "Trust",
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
    tree = ast.walk(ast.parse(Path(str(file)).read_text(encoding="utf-8")))
    imports = [node for node in tree if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def comment(name: str, module: str) -> list[str]:
    """The lines of the docstring below a constant, or of the `#:` comment above it, where it is defined."""
    while name in (names := imported(module)):
        module = names[name]
    comments = ModuleAnalyzer.for_module(module).find_attr_docs()
    if ("", name) not in comments:
        raise ExtensionError(f'the public constant "{name}" has no docstring: write one below it in {module}')
    return comments["", name]


@dataclass(frozen=True)
class PublicName:
    """A public name, `plot.force` for a function of a public module, its value, and the module that it is imported from."""

    name: str
    value: object
    home: str

    @property
    def package(self) -> str:
        """The package that it is listed under."""
        return self.name.split(".")[0] if "." in self.name else self.home.split(".")[1]

    @property
    def kind(self) -> str:
        """The folder of its page: `Limit` and `limit` are one file where capitals do not count."""
        if inspect.isclass(self.value):
            return "classes"
        return "functions" if callable(self.value) else "constants"

    @property
    def page(self) -> str:
        """Its page."""
        head = f"{self.name}\n{'=' * len(self.name)}\n\n.. currentmodule:: linkwise\n\n"
        if inspect.isclass(self.value):
            return f"{head}.. autoclass:: linkwise.{self.name}\n   :members:\n{members(self.value)}"
        if callable(self.value):
            return f"{head}.. autofunction:: linkwise.{self.name}\n"
        text = "\n   ".join(comment(self.name.rpartition(".")[2], self.home))
        return f"{head}.. py:data:: {self.name}\n   :value: {self.value!r}\n\n   {text}\n"


def public_names(module: ModuleType = lw, prefix: str = "") -> list[PublicName]:
    """The names in `__all__` of a module; of a module among them its names."""
    stub = f"{module.__file__}i"
    home, found = listed_names(stub) if Path(stub).exists() else {}, []
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.ismodule(value):
            found += public_names(value, f"{prefix}{name}.")
        else:
            found.append(PublicName(f"{prefix}{name}", value, home.get(name, module.__name__)))
    return found


FULL = {
    each.name.rpartition(".")[2]: each.name for each in public_names() if not each.name.startswith("plot.")
}


def members(value: type) -> str:
    """The members of an enumeration with their values; nothing for other classes."""
    if not issubclass(value, Enum):
        return ""
    return "\n.. rubric:: Members\n\n" + "".join(f"``{each.name}``\n   {each.value}\n\n" for each in value)


def section(title: str, names: list[PublicName]) -> str:
    """A section of the index: a table of what can be called, a line of constants."""
    table = "".join(f"   {each.name}\n" for each in names if callable(each.value))
    constants = ", ".join(f":py:data:`{each.name}`" for each in names if each.kind == "constants")
    tree = "".join(f"   {each.kind}/{each.name}\n" for each in names)
    return (
        f"\n{title}\n{'-' * len(title)}\n\n.. autosummary::\n   :nosignatures:\n\n{table}\n"
        f"{'Constants: ' + constants if constants else ''}\n\n.. toctree::\n   :hidden:\n\n{tree}\n"
    )


def pages() -> dict[str, str]:
    """All pages of the reference by path, the index among them."""
    names = sorted(public_names(), key=lambda each: each.name.lower())
    packages = {each.package for each in names}
    titles = {**PACKAGES, **{package: package.capitalize() for package in sorted(packages - set(PACKAGES))}}
    sections = [
        section(title, [each for each in names if each.package == package])
        for package, title in titles.items()
        if package in packages
    ]
    return {f"{each.kind}/{each.name}": each.page for each in names} | {"index": INDEX + "".join(sections)}


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


def linked(
    app: Sphinx, environment: BuildEnvironment, node: pending_xref, content: TextElement
) -> nodes.Element | None:
    """A link to the page of a public name that a docstring writes without its package, as `Posterior`."""
    name = FULL.get(node.get("reftarget", ""))
    if name is None or node.get("refdomain") != "py":
        return None
    python = environment.get_domain("py")
    return python.resolve_xref(
        environment, node["refdoc"], app.builder, "obj", f"linkwise.{name}", node, content
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the reference before Sphinx looks for pages."""
    app.connect("builder-inited", write, priority=100)
    app.connect("missing-reference", linked)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
