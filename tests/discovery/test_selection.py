"""Rounds of selection that end without a fit."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from itertools import count
from typing import Any

import pytest
from judged import masses
from problems import chain_record

import linkwise as lw

RUNS_AWAY = "the motion that starts from the states in the record runs to infinity"


def failing(fit: Callable[..., Any], first: int) -> Callable[..., Any]:
    """`fit`, which refuses its laws from call number `first` on."""
    numbers = count(1)

    def refused(*given: object, **keywords: object) -> object:
        if next(numbers) >= first:
            raise lw.IdentificationError(RUNS_AWAY)
        return fit(*given, **keywords)

    return refused


@pytest.mark.parametrize(("place", "first"), [("selection", 2), ("inexact_laws", 1), ("inexact_laws", 2)])
def test_laws_that_run_away_in_a_later_round_leave_the_best_of_those_before(
    place: str, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cubic spring of a bistable link, and only springs and dampers to choose from: a search of several rounds."""
    where = import_module(f"linkwise.discovery.{place}")
    monkeypatch.setattr(where, "likelihood_fit", failing(where.likelihood_fit, first))
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=7)
    found = lw.discover(record, masses(lw.bnes_chain(2)), terms="d, v")
    assert not found.trusted
    assert {link.name for link in found.structure.links} >= {"m1-ground", "m2-m1"}


def test_laws_that_run_away_in_the_first_round_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    where = import_module("linkwise.discovery.selection")
    monkeypatch.setattr(where, "likelihood_fit", failing(where.likelihood_fit, 1))
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=7)
    with pytest.raises(lw.IdentificationError, match=RUNS_AWAY):
        lw.discover(record, masses(lw.bnes_chain(2)))
