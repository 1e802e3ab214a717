"""Registries: lazy entries, and what a wrong name is told."""

import fractions

import pytest

from linkwise.errors import IdentificationError
from linkwise.registry import Registry, lazy_module


def test_entries_load_on_first_use_and_keep_their_order() -> None:
    registry: Registry[object] = Registry(
        "thing", {"b": "fractions:Fraction", "a": "no.such.module:Thing", "m": "fractions"}
    )
    assert list(registry) == ["b", "a", "m"] and len(registry) == 3 and "a" in registry
    assert registry["b"] is fractions.Fraction and registry.lookup("m") is fractions
    with pytest.raises(ModuleNotFoundError):
        registry["a"]


def test_an_unknown_name_lists_those_there_are() -> None:
    registry: Registry[int] = Registry("window", {"hann": 1, "hamming": 2}, IdentificationError)
    with pytest.raises(IdentificationError) as error:
        registry.lookup("haming")
    assert (
        str(error.value)
        == "unknown window 'haming'; did you mean \"hamming\"?; choose from 'hann', 'hamming'"
    )
    with pytest.raises(KeyError):
        registry["haming"]


def test_a_lazy_module_shows_what_its_module_holds_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """It kept what was first asked of it, so that figures that a test left undrawn were drawn, or none were afterwards."""
    style = lazy_module("linkwise.plot.style")
    first = style.encoded
    monkeypatch.setattr("linkwise.plot.style.encoded", None)
    assert style.encoded is None and first is not None
