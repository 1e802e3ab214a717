"""Names say one thing: no class name is used twice, and only the command line names its flags."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator

from sources import FILES, SOURCE, tree

FLAG = re.compile(r"(?<![\w-])--[a-z]")


def classes(module: ast.AST) -> Iterator[str]:
    """Names of the classes in a module."""
    return (node.name for node in ast.walk(module) if isinstance(node, ast.ClassDef))


def flags(module: ast.AST) -> list[str]:
    """Texts in a module that name a flag of a command."""
    texts = (node.value for node in ast.walk(module) if isinstance(node, ast.Constant))
    return [text for text in texts if isinstance(text, str) and FLAG.search(text)]


def test_no_class_name_is_used_twice() -> None:
    names = Counter(name for path in FILES for name in classes(tree(path)))
    assert len(names) > 200 and [name for name, count in names.items() if count > 1] == []


def test_only_the_command_line_names_flags() -> None:
    library = {path for path in FILES if "cli" not in path.relative_to(SOURCE).parts}
    named = {path: found for path in FILES if (found := flags(tree(path)))}
    assert named and not library & named.keys(), named


def test_the_walk_sees_what_it_must_refuse() -> None:
    assert list(classes(ast.parse("class A: ...\nclass B:\n    class A: ..."))) == ["A", "B", "A"]
    assert flags(ast.parse("x = f'give {y} (--rate HZ)'")) == [" (--rate HZ)"]
    assert flags(ast.parse("x = 'a--b' + '---' + 'well--known'")) == []
