"""The size limits of CONTRIBUTING.md hold: what grows past one wants splitting, or a name for its middle."""

import ast
from collections.abc import Iterator
from pathlib import Path

from sources import FILES, SOURCE, sizes, tree

LINES = {str(path.relative_to(SOURCE)): path.read_text(encoding="utf-8").count("\n") for path in FILES}
FILE, FUNCTION, PARAMETERS = 800, 60, 8
TESTS = 35086  # lines of all files of tests


BUDGET = {  # files and lines of code of each package: falls with any commit, rises only in one that argues why
    "absorption": (11, 2016),
    "analysis": (4, 482),
    "cli": (20, 1850),
    "discovery": (19, 3277),
    "estimates": (8, 1530),
    "export": (8, 702),
    "expression": (6, 1045),
    "files": (14, 1933),
    "identification": (12, 2292),
    "inspection": (9, 1840),
    "likelihood": (66, 13443),
    "modal": (5, 840),
    "model": (16, 2952),
    "paper": (3, 358),
    "plot": (12, 1744),
    "records": (9, 1445),
    "report": (12, 1029),
    "response": (13, 1768),  # continuation, shooting, search of branches, harmonic balance, backbones, basins
    "root": (12, 984),
    "signals": (6, 830),
    "simulation": (9, 1587),
    "sindy": (8, 1006),
    "study": (8, 1395),
    "weak": (8, 1576),
}


def functions(module: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Every function of a module, methods and inner functions among them."""
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines from `def` to the end, those of the docstring left out."""
    lines = (function.end_lineno or 0) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        lines -= (first.end_lineno or 0) - first.lineno + 1
    return lines


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many arguments a caller may name; `self` and `cls` are none."""
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return len([parameter for parameter in named if parameter.arg not in {"self", "cls"}])


def too_large(module: ast.AST) -> list[str]:
    """The functions of a module that are too long or take too much."""
    return [
        function.name
        for function in functions(module)
        if length(function) > FUNCTION or parameters(function) > PARAMETERS
    ]


def test_packages_keep_to_their_budgets() -> None:
    counted = sizes(SOURCE)
    assert {package for _, package in counted} == set(BUDGET)
    assert {
        package: (files, lines)
        for package, (files, lines) in BUDGET.items()
        if counted["files", package] > files or counted["lines", package] > lines
    } == {}


def test_tests_keep_to_their_budget() -> None:
    files = Path(__file__).parent.rglob("*.py")
    assert sum(path.read_text(encoding="utf-8").count("\n") for path in files) <= TESTS


def test_no_file_is_too_long() -> None:
    assert {name: lines for name, lines in LINES.items() if lines > FILE} == {}


def test_no_function_is_too_long_or_takes_too_much() -> None:
    assert {path: names for path in FILES if (names := too_large(tree(path)))} == {}


def test_the_count_sees_what_it_must_refuse() -> None:
    body = "    x = 1\n"
    assert too_large(ast.parse("def f():\n" + body * 59)) == []
    assert too_large(ast.parse("def f():\n" + body * 60)) == ["f"]
    assert too_large(ast.parse('def f():\n    """Of\n\n    lines.\n    """\n' + body * 59)) == []
    assert too_large(ast.parse("class C:\n    def f(self, a, b, c, d, e, f, g, *, h): ...\n")) == []
    assert too_large(ast.parse("async def f(a, b, c, d, e, f, g, h, i): ...\n")) == ["f"]
