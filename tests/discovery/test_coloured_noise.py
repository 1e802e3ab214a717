"""Discovery from sensors whose noise is correlated from sample to sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from judged import masses
from present import present, some
from problems import chain_record
from scipy.signal import lfilter

import linkwise as lw
from linkwise.discovery.inexact import select_coloured


def remembering(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """AR(1) of 0.7 in the first sensor, white in the second, of unit power."""
    noise = rng.normal(size=shape)
    noise[:, 0] = lfilter([np.sqrt(1.0 - 0.7**2)], [1.0, -0.7], noise[:, 0])
    return noise


def differenced(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(np.diff(rng.normal(size=(shape[0] + 1, shape[1])), axis=0) / np.sqrt(2.0))


def noisy(record: lw.Record, draw: Callable[..., np.ndarray], seed: int) -> lw.Record:
    """`record` with noise 30 dB below the power of each channel, which it does not state."""
    size = np.sqrt(np.mean(record.values**2, axis=0)) * 10.0**-1.5
    return replace(
        record, values=record.values + size * draw(np.random.default_rng(seed), record.values.shape)
    )


@pytest.mark.parametrize("draw", [remembering, differenced])
def test_coloured_noise_is_told_from_missing_terms(draw: Callable[..., np.ndarray]) -> None:
    chain, clean = lw.bnes_chain(2), chain_record(2, duration=3.0)
    discovery = lw.discover(noisy(clean, draw, 7), masses(chain))
    assert discovery.trusted and discovery.estimate.model_error == 0.0
    assert lw.discovery.term_score(discovery.structure, chain).exact
    assert all(term.certain for term in some(discovery.kept))
    truth = lw.discovery.align_truth(discovery.structure, chain)
    for term in some(discovery.kept):
        true = present(truth.coefficient(term.name).value)
        assert abs(term.value - true) < 4.0 * term.standard_error  # one in 16 000 normal errors is larger


def test_the_evidence_counts_how_well_gains_are_known() -> None:
    """A gain that both sensors share scales the cubic term alone, by the square of it."""
    chain, clean = lw.bnes_chain(2), chain_record(2, duration=3.0)
    discovery = lw.discover(noisy(clean, remembering, 7), masses(chain), calibration={"common": 0.005})
    assert discovery.trusted
    cubic = next(term for term in discovery.kept if term.name == "m2-m1.k3")
    assert abs(cubic.value / cubic.z) == pytest.approx(
        2.0 * 0.005 * cubic.value, rel=0.03
    )  # beside noise of 0.1 %
    for term in some(discovery.kept):  # of one fit in two ways
        assert term.standard_error == pytest.approx(
            present(discovery.estimate.coefficient(term.name).standard_error), rel=0.01
        )


@pytest.mark.usefixtures("memory_not_sought")
def test_where_laws_run_away_the_selection_of_white_noise_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*given: object, **keywords: object) -> object:
        raise lw.IdentificationError("the motion runs to infinity")

    monkeypatch.setattr("linkwise.discovery.inexact.likelihood_fit", refused)
    chain = lw.bnes_chain(2)
    discovery = lw.discover(noisy(chain_record(2, duration=3.0), remembering, 7), masses(chain))
    assert not discovery.trusted and discovery.structure.links


@pytest.mark.usefixtures("memory_not_sought")
def test_a_term_that_was_not_offered_is_no_coloured_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cubic spring of a bistable link, and only springs and dampers to choose from."""
    tried = []

    def watched(*given: object) -> object:
        tried.append(select_coloured(*given))  # type: ignore[arg-type]
        return tried[-1]

    monkeypatch.setattr("linkwise.discovery.discover.select_coloured", watched)
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=7)
    discovery = lw.discover(record, masses(lw.bnes_chain(2)), terms="d, v")
    assert tried == [None] and not discovery.trusted
