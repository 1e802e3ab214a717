"""No test passes because what it loops over was empty: attributes of results are looped over as `some(fit.links)`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SAME = {
    "enumerate",
    "sorted",
    "reversed",
    "list",
    "set",
    "zip",
    "items",
    "keys",
    "values",
}  # as long as what they hold
Generators = ast.GeneratorExp | ast.ListComp | ast.SetComp


def asserted(tree: ast.AST) -> Iterator[ast.expr]:
    """What a loop with an assertion goes over, or a generator of which `all` is asserted."""
    for node in ast.walk(tree):
        if isinstance(node, ast.For) and any(isinstance(each, ast.Assert) for each in ast.walk(node)):
            yield node.iter
        elif isinstance(node, ast.Assert):
            for each in ast.walk(node.test):
                if isinstance(each, ast.Call) and ast.unparse(each.func) == "all":
                    yield from (part.generators[0].iter for part in each.args if isinstance(part, Generators))


def may_be_empty(loop: ast.expr) -> bool:
    """Whether it is an attribute of an object, which nobody sees in the test, by itself or in a pair or a list."""
    if isinstance(loop, ast.Attribute):
        return not loop.attr.isupper()
    if isinstance(loop, ast.Call):
        function = loop.func
        if isinstance(function, ast.Name) and function.id in SAME:
            return bool(loop.args) and all(may_be_empty(each) for each in loop.args)
        if isinstance(function, ast.Attribute) and function.attr in SAME:
            return may_be_empty(function.value)
    return False


def empty_loops(text: str) -> list[int]:
    """Lines of loops that may run over nothing."""
    return sorted({loop.lineno for loop in asserted(ast.parse(text)) if may_be_empty(loop)})


def test_no_loop_of_assertions_may_run_over_nothing() -> None:
    texts = {
        str(path.relative_to(TESTS)): path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py")
    }
    assert len(texts) > 100
    assert {name: lines for name, text in texts.items() if (lines := empty_loops(text))} == {}


@pytest.mark.parametrize(
    "test",
    [
        "for term in found.kept:\n    assert term.certain",
        "for name, each in fit.noise.items():\n    assert each.sigma > 0.0",
        "for one, other in zip(fit.links, again.links, strict=True):\n    assert one == other",
        "assert all(term.certain for term in found.terms)",
        "assert found.trusted and all([link.covariance is None for link in enumerate(fit.links)])",
    ],
)
def test_the_walk_sees_what_it_must_refuse(test: str) -> None:
    assert empty_loops(test) == [1]


@pytest.mark.parametrize(
    "test",
    [
        "for term in some(found.kept):\n    assert term.certain",
        "for name in module.NAMES:\n    assert name in found",
        "for name, true in zip(TRUE, fit.values, strict=True):\n    assert name",
        "for link in fit.links:\n    print(link)",
        "assert not any(term.certain for term in some(found.terms))",
    ],
)
def test_the_walk_leaves_what_is_not_empty(test: str) -> None:
    assert empty_loops(test) == []
