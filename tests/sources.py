"""The source files of the package, each parsed once, for the tests that walk them."""

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import linkwise

SOURCE = Path(linkwise.__file__).parent
FILES = tuple(sorted(SOURCE.rglob("*.py")))


@cache
def tree(path: Path) -> ast.Module:
    """The syntax tree of a file; nobody may change it."""
    return ast.parse(path.read_text(encoding="utf-8"))


def lines_of_code(text: str) -> int:
    """Lines of a module with a token that is no comment, docstring or import."""
    lines = {
        number for number, line in enumerate(text.split("\n"), 1) if line.strip() and line.strip()[0] != "#"
    }
    left_out: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            left_out.update(range(node.lineno, (node.end_lineno or 0) + 1))
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if ast.get_docstring(node, clean=False) is not None else None
            left_out.update(range(first.lineno, (first.end_lineno or 0) + 1) if first is not None else ())
        elif isinstance(node, ast.Constant | ast.JoinedStr):  # of several lines, blank ones among them
            lines.update(range(node.lineno, (node.end_lineno or 0) + 1))
    return len(lines - left_out)


def sizes(folder: Path) -> Counter[tuple[str, str]]:
    """Files and lines of code below a folder, by package: the first folder below it, or the root."""
    counted: Counter[tuple[str, str]] = Counter()
    for path in sorted(folder.rglob("*.py")):
        first, *rest = path.relative_to(folder).parts
        counted["files", first if rest else "root"] += 1
        counted["lines", first if rest else "root"] += lines_of_code(path.read_text(encoding="utf-8"))
    return counted
