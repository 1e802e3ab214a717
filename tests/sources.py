"""The source files of the package, each parsed once, for the tests that walk them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import linkwise

SOURCE = Path(linkwise.__file__).parent
FILES = tuple(sorted(SOURCE.rglob("*.py")))


@cache
def tree(path: Path) -> ast.Module:
    """The syntax tree of a file; nobody may change it."""
    return ast.parse(path.read_text(encoding="utf-8"))
