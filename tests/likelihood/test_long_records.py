"""Long records are searched from loose links to tight ones and tested in pieces: the answer is that of others."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from problems import truth

import linkwise as lw
from linkwise.likelihood import marginal, search
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.optima.other_optima import refitted
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting import linear_model, residuals
from linkwise.likelihood.shooting.minimise import AnnealingSchedule, AnnealingStatus

CHAIN = lw.bnes_chain(2)
ASKED = CHAIN.unknown("all")
WHOLE = 10**9  # segments that no record has


def fitted(
    record: lw.Record, start: np.ndarray | None = None, options: LikelihoodOptions | None = None
) -> LikelihoodFit:
    start = truth(CHAIN, ASKED) if start is None else start
    return likelihood_fit([record], ASKED, start, spread=1e-3 * np.abs(start), options=options)


@pytest.fixture(scope="module", autouse=True)
def short_ones_as_long() -> Iterator[None]:
    """Records a tenth as long as others are taken for long ones, in shorter pieces."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(marginal, "_LONG", 1_600)
        patched.setattr(linear_model, "_PIECE", 400)
        yield


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """The chain of two masses, driven chaotically over its sink's barrier."""
    forces = {"m1": "60*sin(150*t) + 40*sin(190*t)"}
    return lw.simulate(CHAIN, duration=10.0, rate=1000.0, forces=forces).with_noise(20.0, seed=5441140)


@pytest.fixture(scope="module")
def held(record: lw.Record) -> LikelihoodFit:
    return fitted(record)


@pytest.mark.slow
def test_answer_of_the_whole(record: lw.Record, held: LikelihoodFit, monkeypatch: pytest.MonkeyPatch) -> None:
    assert marginal.is_long(held.segments) and held.status is AnnealingStatus.CONVERGED
    off = held.values - truth(CHAIN, ASKED)
    square = off @ np.linalg.solve(held.covariance, off)
    assert 0.2 < square < 20.5  # chi-square with five degrees of freedom, one in a thousand on either side
    monkeypatch.setattr(search, "is_long", lambda segments: False)
    q = held.optimum.q
    options = LikelihoodOptions(nodes=held.optimum.point.nodes, relaxation=q, tightest=q, model_error=False)
    whole = fitted(record, held.values, options)
    deviations = np.sqrt(whole.covariance.diagonal())
    assert whole.status is AnnealingStatus.CONVERGED and whole.optimum.q == q
    assert np.max(np.abs(held.values - whole.values) / deviations) < 0.05
    np.testing.assert_allclose(np.sqrt(held.covariance.diagonal()), deviations, rtol=0.01)
    cost = held.chi_square * held.segments.observed.sum()
    # of 8000 states; less than one standard error of one unknown costs
    assert cost == pytest.approx(whole.chi_square * whole.segments.observed.sum(), abs=1.0)


@pytest.mark.slow
def test_causes_are_those_of_the_whole(record: lw.Record, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches end within 0.05 standard errors of one optimum."""
    shown = record[:5000]
    faulty = replace(shown, values=np.add(shown.values, [0.0, 2e-4, 0.0]), simulated=None)
    monkeypatch.setattr(marginal, "_LONG", 800)
    parts = lw.identify(faulty, ASKED, as_stated=True).diagnosis
    monkeypatch.setattr(marginal, "_LONG", WHOLE)
    whole = lw.identify(faulty, ASKED, as_stated=True).diagnosis
    assert parts and [(cause.kind, cause.where) for cause in parts] == [
        (cause.kind, cause.where) for cause in whole
    ]
    for mine, theirs in zip(parts, whole, strict=True):
        assert mine.gain == pytest.approx(theirs.gain, rel=0.01)
        assert mine.size == pytest.approx(theirs.size, abs=0.05 * theirs.standard_error)


def test_states_beside_held_values_stay_in_their_optimum(
    record: lw.Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From looser links than those of the fit, the states of a record of 1e6 samples came back to another optimum, 17 of
    -2 log likelihood higher, which looked like a likelihood that is not quadratic.
    """
    monkeypatch.setattr(marginal, "_LONG", 400)
    fit = fitted(record[:2000], options=LikelihoodOptions(tightest=1e-4, model_error=False))
    optimum = fit.optimum
    again = refitted(optimum, optimum.point, np.ones(len(fit.values), dtype=bool))
    assert optimum.q == 1e-4 and {step.q for step in again.path} == {optimum.q}
    left = 2.0 * AnnealingSchedule.tolerance  # what either search may leave
    assert again.misfit.cost(optimum.q) == pytest.approx(fit.misfit.cost(optimum.q), abs=left)


def test_released_orbit_is_found_again(record: lw.Record, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that lets all orbits go ends where one that keeps them does."""
    kept = fitted(record[:1000])
    monkeypatch.setattr(residuals, "_SMALL", 0)
    found = fitted(record[:1000])
    np.testing.assert_array_equal(found.values, kept.values)
    np.testing.assert_array_equal(found.misfit.trajectories.states, kept.misfit.trajectories.states)
