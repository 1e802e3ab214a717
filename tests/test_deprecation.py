"""Old spellings work, warn with the replacement and the versions, and are gone when their time is up."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import linkwise as lw
from linkwise.deprecation import Deprecated, deprecated_keyword

SOURCE = Path(lw.__file__).parent
CHANGELOG = (Path(__file__).resolve().parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")
SAMPLE = Deprecated("Stlsq", since="0.2.0", until="9.0.0")


@deprecated_keyword("fs", Deprecated("rate", since="0.2.0", until="9.0.0"))
def period(*, rate: float) -> float:
    """Duration of a sample in s at a rate in Hz."""
    return 1.0 / rate


def numbers(version: str) -> tuple[int, ...]:
    """The numbers of a version, which compare as versions do."""
    return tuple(int(part) for part in version.split("."))


def entries(text: str) -> list[Deprecated]:
    """Every `Deprecated(...)` that a module's text states."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    stated = [call for call in calls if getattr(call.func, "id", "") == "Deprecated"]
    return [
        Deprecated(
            *(ast.literal_eval(value) for value in call.args),
            **{str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords},
        )
        for call in stated
    ]


def expired(text: str, version: str) -> list[Deprecated]:
    """The entries of a module's text whose time is up in `version`."""
    return [entry for entry in entries(text) if numbers(entry.until) <= numbers(version)]


def test_an_old_public_name_is_the_new_one_and_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(lw._DEPRECATED, "Ridge", SAMPLE)
    told = (
        r"linkwise\.Ridge is deprecated since linkwise 0\.2\.0 and will be removed in 9\.0\.0; "
        r"use linkwise\.Stlsq"
    )
    for _ in range(2):  # every use warns, not only the first
        with pytest.warns(DeprecationWarning, match=told) as caught:
            assert lw.Ridge is lw.Stlsq
        assert caught[0].filename == __file__
    assert "Ridge" not in dir(lw)


def test_an_old_name_may_stand_for_one_that_lies_deeper(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(lw._DEPRECATED, "write_text", SAMPLE._replace(new="Record.select"))
    with pytest.warns(DeprecationWarning, match=r"use linkwise\.Record\.select"):
        assert lw.write_text == lw.Record.select


def test_an_old_keyword_is_the_new_one_and_warns() -> None:
    told = r"keyword 'fs' of period is deprecated since linkwise 0\.2\.0 .* removed in 9\.0\.0; use 'rate'"
    with pytest.warns(DeprecationWarning, match=told) as caught:
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


def test_no_old_spelling_outlives_its_version() -> None:
    modules = sorted(SOURCE.rglob("*.py"))
    assert SOURCE / "__init__.py" in modules
    late = {path: expired(path.read_text(encoding="utf-8"), lw.__version__) for path in modules}
    assert {path: found for path, found in late.items() if found} == {}


def test_the_search_sees_what_it_must_refuse() -> None:
    text = 'TABLE = {"Ridge": Deprecated("Stlsq", "0.2.0", until="0.10.0")}'
    assert expired(text, "0.9.3") == []
    assert expired(text, "0.10.0") == expired(text, "1.0.0") == [Deprecated("Stlsq", "0.2.0", "0.10.0")]
