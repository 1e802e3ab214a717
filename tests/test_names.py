"""Names say what they are: no class name is used twice, no variable is called `each`, only the command line names flags."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Collection, Iterator

import pytest
from sources import FILES, SOURCE, tree

from linkwise.lazy import listed_names

FLAG = re.compile(r"(?<![\w-])--[a-z]")
VAGUE = {
    *("asked", "each", "found", "held", "here", "kept", "made", "now", "one"),
    *("other", "same", "seen", "taken", "there", "things", "told", "what"),
}


def classes(module: ast.AST) -> Iterator[str]:
    """Names of the classes in a module."""
    return (node.name for node in ast.walk(module) if isinstance(node, ast.ClassDef))


def flags(module: ast.AST) -> list[str]:
    """Texts in a module that name a flag of a command."""
    texts = (node.value for node in ast.walk(module) if isinstance(node, ast.Constant))
    return [text for text in texts if isinstance(text, str) and FLAG.search(text)]


def bound(node: ast.AST) -> str:
    """The name that a node binds, empty where it binds none."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name) | ast.FunctionDef(name=name):
            return name
        case (
            ast.ExceptHandler(name=str() as name)
            | ast.MatchAs(name=str() as name)
            | ast.alias(asname=str() as name)
        ):
            return name
    return ""


def promised(definition: ast.AST) -> set[ast.AST]:
    """The nodes of a public class or function whose names users write: its parameters, attributes and public methods."""
    if isinstance(definition, ast.FunctionDef):
        parameters = {bound(node) for node in ast.walk(definition.args)}
        return {node for node in ast.walk(definition) if bound(node) in parameters}
    nodes: set[ast.AST] = set()
    for statement in definition.body if isinstance(definition, ast.ClassDef) else ():
        if isinstance(statement, ast.FunctionDef):
            nodes |= set() if statement.name.startswith("_") else {statement, *promised(statement)}
        elif isinstance(statement, ast.Assign | ast.AnnAssign):
            nodes |= set(ast.walk(statement))
    return nodes


def vague(module: ast.Module, public: Collection[str] = ()) -> list[str]:
    """Names that do not say what they are, but for those that users of `public` names write and `other` of an operator."""
    nodes = [node for node in ast.walk(module) if bound(node).lstrip("_") in VAGUE]
    exempt: set[ast.AST] = set()
    for node in ast.walk(module) if nodes else ():
        if isinstance(node, ast.FunctionDef) and re.fullmatch("__.*__", node.name):
            exempt |= {operand for operand in promised(node) if bound(operand) == "other"}
        elif isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name in public and node in module.body:
            exempt |= promised(node)
    return [bound(node) for node in nodes if node not in exempt]


def test_no_class_name_is_used_twice() -> None:
    names = Counter(name for path in FILES for name in classes(tree(path)))
    assert len(names) > 200 and [name for name, count in names.items() if count > 1] == []


def test_only_the_command_line_names_flags() -> None:
    library = {path for path in FILES if "cli" not in path.relative_to(SOURCE).parts}
    named = {path: texts for path in FILES if (texts := flags(tree(path)))}
    assert named and not library & named.keys(), named


def test_names_say_what_they_are() -> None:
    public: dict[str, list[str]] = {}
    for name, module in listed_names(str(SOURCE / "__init__.pyi")).items():
        public.setdefault(module, []).append(name)
    names_by_path = {}
    for path in FILES:
        home = path.relative_to(SOURCE).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
        names_by_path[home] = vague(tree(path), public.get(f"linkwise.{home}", ()))
    assert {f"linkwise.{home}" for home in names_by_path} >= public.keys() - {"linkwise"}
    assert {home: names for home, names in names_by_path.items() if names} == {}


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("found, (kept, *rest) = f()", ["found", "kept"]),
        ("for each in x: pass", ["each"]),
        ("y = [each for other, each in x]", ["other", "each"]),
        ("if (told := f(what=1)): pass", ["told"]),
        ("try: pass\nexcept E as seen: pass", ["seen"]),
        ("match x:\n    case [1, *_] as taken: pass", ["taken"]),
        ("def f(now, *, here=1): return lambda there: there", ["now", "here", "there"]),
        ("class A:\n    made: int\n    def held(self): pass", ["made", "held"]),
        ("class A:\n    def __add__(self, other): same = other", ["same"]),
        ("class A:\n    def __init__(self, kept): ...", ["kept"]),
        ("def _told(): ...", ["_told"]),
        ("def _g(asked):\n    x.one = asked.things", ["asked"]),
    ],
)  # fmt: skip
def test_names_that_do_not_say_what_they_are_are_seen(code: str, names: list[str]) -> None:
    assert sorted(vague(ast.parse(code))) == sorted(names)


def test_what_users_write_may_keep_its_name() -> None:
    code = "class A:\n    found: int\n    def f(self, other): kept = other\n    def _g(self, told): ...\ndef h(one): ...\n"
    assert sorted(vague(ast.parse(code), ["A", "h"])) == ["kept", "told"]
    assert sorted(vague(ast.parse(code))) == ["found", "kept", "one", "other", "told"]


def test_the_walk_sees_what_it_must_refuse() -> None:
    assert list(classes(ast.parse("class A: ...\nclass B:\n    class A: ..."))) == ["A", "B", "A"]
    assert flags(ast.parse("x = f'give {y} (--rate HZ)'")) == [" (--rate HZ)"]
    assert flags(ast.parse("x = 'a--b' + '---' + 'well--known'")) == []
