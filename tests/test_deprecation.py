"""Old spellings work, warn with the replacement and the versions, and are gone when their time is up."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from types import SimpleNamespace

import pytest
from problems import chain_record
from sources import FILES, SOURCE, tree

import linkwise as lw
from linkwise.deprecation import Deprecated, DeprecatedAttribute, deprecated_keyword

CHANGELOG = (Path(__file__).resolve().parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")
ATTRIBUTES = [
    (owner, old, alias)
    for name in lw.__all__
    if isinstance(owner := getattr(lw, name), type)
    for old, alias in vars(owner).items()
    if isinstance(alias, DeprecatedAttribute)
]
SAMPLE = Deprecated("Stlsq", since="0.2.0", until="9.0.0")


@deprecated_keyword("fs", Deprecated("rate", since="0.2.0", until="9.0.0"))
def period(*, rate: float) -> float:
    """Duration of a sample in s at a rate in Hz."""
    return 1.0 / rate


def numbers(version: str) -> tuple[int, ...]:
    """The numbers of a version, which compare as versions do."""
    return tuple(int(part) for part in version.split("."))


def entries(module: ast.AST) -> list[Deprecated]:
    """Every `Deprecated(...)` that a module states."""
    calls = [node for node in ast.walk(module) if isinstance(node, ast.Call)]
    stated = [call for call in calls if getattr(call.func, "id", "") == "Deprecated"]
    return [
        Deprecated(
            *(ast.literal_eval(value) for value in call.args),
            **{str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords},
        )
        for call in stated
    ]


def expired(module: ast.AST, version: str) -> list[Deprecated]:
    """The entries of a module's text whose time is up in `version`."""
    return [entry for entry in entries(module) if numbers(entry.until) <= numbers(version)]


def test_an_old_public_name_is_the_new_one_and_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(lw._DEPRECATED, "Ridge", SAMPLE)
    message = (
        r"linkwise\.Ridge is deprecated since linkwise 0\.2\.0 and will be removed in 9\.0\.0; "
        r"use linkwise\.Stlsq"
    )
    for _ in range(2):  # every use warns, not only the first
        with pytest.warns(DeprecationWarning, match=message) as caught:
            assert lw.Ridge is lw.Stlsq  # type: ignore[attr-defined]
        assert caught[0].filename == __file__
    assert "Ridge" not in dir(lw)


def test_an_old_name_may_stand_for_one_that_lies_deeper(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(lw._DEPRECATED, "write_text", SAMPLE._replace(new="Record.select"))
    with pytest.warns(DeprecationWarning, match=r"use linkwise\.Record\.select"):
        assert lw.write_text == lw.Record.select  # type: ignore[attr-defined]


def test_an_old_keyword_is_the_new_one_and_warns() -> None:
    message = r"keyword 'fs' of period is deprecated since linkwise 0\.2\.0 .* removed in 9\.0\.0; use 'rate'"
    with pytest.warns(DeprecationWarning, match=message) as caught:
        assert period(fs=4.0) == period(rate=4.0)  # type: ignore[call-arg]
    assert caught[0].filename == __file__


def test_both_spellings_are_refused() -> None:
    with pytest.raises(TypeError, match="period got 'rate' and also 'fs', its old spelling"):
        period(rate=4.0, fs=4.0)  # type: ignore[call-arg]


@pytest.mark.parametrize("old", sorted(lw._DEPRECATED))
def test_every_old_public_name_leads_to_a_public_one_and_is_in_the_changelog(old: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"use linkwise\.{lw._DEPRECATED[old].new}$"):
        assert getattr(lw, old) is not None
    assert f"| `{old}` | `{lw._DEPRECATED[old].new}` |" in CHANGELOG
    assert old not in lw.__all__ and lw._DEPRECATED[old].new.split(".")[0] in lw.__all__


@pytest.mark.parametrize(("owner", "old", "alias"), ATTRIBUTES)
def test_every_old_attribute_warns_and_is_in_the_changelog(
    owner: type, old: str, alias: DeprecatedAttribute
) -> None:
    new = alias.entry.new
    assert new in owner.__annotations__ or hasattr(owner, new)
    standing = SimpleNamespace(**{new: (lw.Verdict.SEARCH_UNSETTLED,)})
    message = rf"{owner.__name__}\.{old} is deprecated .*; use {owner.__name__}\.{new}$"
    with pytest.warns(DeprecationWarning, match=message) as caught:
        value = alias.__get__(standing, owner)
    assert caught[0].filename == __file__
    assert value is getattr(standing, new) or (owner is lw.Discovery and value is (old != "settled"))
    assert f"| `{owner.__name__}.{old}` | `{owner.__name__}.{new}` |" in CHANGELOG


def test_an_old_attribute_of_an_object_is_the_new_one() -> None:
    subject = lw.read_study("paper").subjects[0]
    with pytest.warns(DeprecationWarning, match=r"use Subject\.judged_links"):
        assert subject.judged == subject.judged_links
    with pytest.warns(DeprecationWarning, match=r"use Subject\.unknown_structure"):
        assert subject.asked is subject.unknown_structure


def old_keywords(module: ast.AST) -> set[tuple[str, str, str]]:
    """Function, old keyword and new keyword of every decorator `deprecated_keyword` of a module."""
    return {
        (node.name, ast.literal_eval(decorator.args[0]), entry.new)
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef)
        for decorator in node.decorator_list
        if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "deprecated_keyword"
        for entry in entries(decorator)
    }


@pytest.mark.usefixtures("unrendered")
def test_every_old_keyword_works_and_is_in_the_changelog() -> None:
    stated = {
        keyword for path in FILES if path.name != "deprecation.py" for keyword in old_keywords(tree(path))
    }
    assert {("nmse", "found", "estimated"), ("write_absorption", "answer", "result")} < stated
    for function, old, new in sorted(stated):
        assert new in inspect.signature(getattr(lw, function)).parameters
        assert f"| `{function}({old}=...)` | `{function}({new}=...)` |" in CHANGELOG
        message = f"keyword '{old}' of {function} .* use '{new}'"
        with (
            pytest.warns(DeprecationWarning, match=message),
            pytest.raises((TypeError, AttributeError, lw.StudyError)),
        ):
            getattr(lw, function)(**{old: None})  # too few arguments, or none that it can use
    text = '@deprecated_keyword("a", Deprecated("b", since="1", until="2"))\ndef f(): pass'
    assert old_keywords(ast.parse(text)) == {("f", "a", "b")}


def test_the_force_error_may_be_asked_for_by_its_old_keyword() -> None:
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=0.1)
    true, identified = chain.link("nes1"), lw.bnes_chain(2, alpha=-90.0).link("nes1")
    with pytest.warns(DeprecationWarning, match="use 'estimated'"):
        assert lw.nmse(true, found=identified, record=record) == lw.nmse(true, identified, record) > 0.0  # type: ignore[call-arg]


def test_a_study_may_be_given_by_its_old_keyword() -> None:
    with pytest.warns(DeprecationWarning, match="keyword 'which' of read_study .* use 'study'"):
        assert lw.read_study(which="paper").text() == lw.read_study("paper").text()  # type: ignore[call-arg]
    with (
        pytest.warns(DeprecationWarning, match="keyword 'which' of run_study .* use 'study'"),
        pytest.raises(lw.StudyError),
    ):
        lw.run_study(which="none", folder="none")  # type: ignore[call-arg]
    for function in ("read_study", "run_study"):
        assert f"| `{function}(which=...)` | `{function}(study=...)` |" in CHANGELOG


def test_no_old_spelling_outlives_its_version() -> None:
    assert SOURCE / "__init__.py" in FILES
    late = {path: expired(tree(path), lw.__version__) for path in FILES}
    assert {path: names for path, names in late.items() if names} == {}


def test_the_search_sees_what_it_must_refuse() -> None:
    module = ast.parse('TABLE = {"Ridge": Deprecated("Stlsq", "0.2.0", until="0.10.0")}')
    assert expired(module, "0.9.3") == []
    assert expired(module, "0.10.0") == expired(module, "1.0.0") == [Deprecated("Stlsq", "0.2.0", "0.10.0")]
