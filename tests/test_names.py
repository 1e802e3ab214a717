"""Names say one thing: no class name is used twice, and only the command line names its flags."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import linkwise

SOURCE = Path(linkwise.__file__).parent
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(SOURCE.rglob("*.py"))}
FLAG = re.compile(r"(?<![\w-])--[a-z]")


def classes(tree: ast.AST) -> Iterator[str]:
    """Names of the classes in a module."""
    return (node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))


def flags(tree: ast.AST) -> list[str]:
    """Texts in a module that name a flag of a command."""
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return [text for text in texts if isinstance(text, str) and FLAG.search(text)]


def test_no_class_name_is_used_twice() -> None:
    names = Counter(name for tree in TREES.values() for name in classes(tree))
    assert len(names) > 200 and [name for name, count in names.items() if count > 1] == []


def test_only_the_command_line_names_flags() -> None:
    library = {path: tree for path, tree in TREES.items() if "cli" not in path.relative_to(SOURCE).parts}
    assert {path.name: flags(tree) for path, tree in library.items() if flags(tree)} == {}
    assert any(flags(tree) for path, tree in TREES.items() if path not in library)


def test_the_walk_sees_what_it_must_refuse() -> None:
    assert list(classes(ast.parse("class A: ...\nclass B:\n    class A: ..."))) == ["A", "B", "A"]
    assert flags(ast.parse("x = f'give {y} (--rate HZ)'")) == [" (--rate HZ)"]
    assert flags(ast.parse("x = 'a--b' + '---' + 'well--known'")) == []
