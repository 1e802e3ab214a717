"""Errors of a discovery: they allow for terms that were dropped from the links found and could be there unseen."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from judged import masses
from present import present, some
from problems import chain_record
from structures import link, structure

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.evidence import DroppedTerms, dropped_terms_remark
from linkwise.discovery.selection import Penalty, QuadraticModel

NAMES = ("m1-ground.k", "m2-m1.k", "m1-ground.c", "m2-m1.c", "m2-ground.k")  # the first two are kept


@pytest.fixture(scope="module")
def model() -> tuple[QuadraticModel, Penalty]:
    """A parabola over columns with random products; the values of the coefficients are 1 to 5."""
    chain = lw.bnes_chain(2)
    candidates = candidates_for([chain_record(2, duration=0.1)], masses(chain), "d, v")
    columns = np.random.default_rng(0).normal(size=(40, 5))
    columns[:, 2] += 0.8 * columns[:, 0]
    h = columns.T @ columns
    return QuadraticModel(NAMES, h, h @ np.arange(1.0, 6.0)), Penalty.of(candidates, NAMES, 400)


def test_errors_are_those_of_the_terms_on_the_links_found_all_together(
    model: tuple[QuadraticModel, Penalty],
) -> None:
    quadratic, penalty = model
    dropped = DroppedTerms.of(quadratic, penalty, 2)
    assert dropped.names == NAMES[2:4]  # a link that was not found is a decision of its own
    together = np.linalg.inv(quadratic.h[:4, :4])
    alone = quadratic.solve([0, 1])
    moved = alone.values - (together @ quadratic.g[:4])[:2]  # by terms that are not zero
    expected = together[:2, :2] + np.outer(moved, moved)
    np.testing.assert_allclose(np.linalg.inv(quadratic.h[:2, :2]) + dropped.covariance, expected, rtol=1e-9)


def test_scores_that_scatter_as_white_noise_would_give_the_same(
    model: tuple[QuadraticModel, Penalty],
) -> None:
    quadratic, penalty = model
    white = DroppedTerms.of(quadratic, penalty, 2).covariance
    covariance = DroppedTerms.of(replace(quadratic, scatter=quadratic.h), penalty, 2).covariance
    np.testing.assert_allclose(covariance, white, rtol=1e-9)
    more = DroppedTerms.of(replace(quadratic, scatter=4.0 * quadratic.h), penalty, 2).covariance
    alone = DroppedTerms.of(replace(quadratic, scatter=0.0 * quadratic.h), penalty, 2).covariance
    np.testing.assert_allclose(more - alone, 4.0 * (white - alone), rtol=1e-9)


def test_the_term_that_widens_an_error_most_is_told(model: tuple[QuadraticModel, Penalty]) -> None:
    dropped = DroppedTerms.of(*model, 2)
    assert dropped.names[int(np.argmax(dropped.shares[0]))] == "m1-ground.c"


def test_columns_that_repeat_those_kept_are_left_out(model: tuple[QuadraticModel, Penalty]) -> None:
    quadratic, penalty = model
    copy = [0, 1, 0, 3, 4]  # m1-ground.c is m1-ground.k again: the record tells nothing of it
    repeated = QuadraticModel(NAMES, quadratic.h[np.ix_(copy, copy)], quadratic.g[copy])
    dropped = DroppedTerms.of(repeated, penalty, 2)
    independent = [0, 1, 3]
    without = DroppedTerms.of(
        QuadraticModel(
            tuple(NAMES[k] for k in independent),
            quadratic.h[np.ix_(independent, independent)],
            quadratic.g[independent],
        ),
        Penalty(penalty.term, penalty.link, penalty.pair[independent], penalty.stated),
        2,
    )
    np.testing.assert_allclose(dropped.covariance, without.covariance, rtol=1e-6, atol=1e-12)


def test_nothing_dropped_adds_nothing(model: tuple[QuadraticModel, Penalty]) -> None:
    assert not DroppedTerms.of(*model, 5).covariance.any()


def test_errors_that_a_form_beyond_the_offer_widens_are_not_laid_to_dropped_terms() -> None:
    """Of tanh damping with all terms on offer kept: the search for the dropped term to name was an internal error."""
    estimate: Any = SimpleNamespace(
        parameters=(SimpleNamespace(name="m1-ground.c"),),
        covariance=np.array([[1.0]]),
        coefficient=lambda name: SimpleNamespace(standard_error=1.0),
    )
    alone = np.array([0.1])
    nothing = DroppedTerms((), np.zeros((1, 1)), np.zeros((1, 0)))
    assert dropped_terms_remark(nothing, estimate, alone) == ()
    something = DroppedTerms(("m1-ground.c3",), np.array([[0.99]]), np.array([[0.99]]))
    (remark,) = dropped_terms_remark(something, estimate, alone)
    assert "m1-ground.c (10 times as wide, mostly by m1-ground.c3)" in remark


def test_a_damper_that_the_noise_hides_is_in_the_intervals_of_the_others() -> None:
    """Three dampers of two masses in two modes: most often one is dropped, and the others take its part."""
    true = structure(
        {"m1": 1.0, "m2": 0.5},
        link("m1-ground", "m1-ground", "k*d + c*v", k=4e3, c=0.4),
        link("m2-m1", "m2-m1", "k*d + k3*d**3 + c*v", k=4e3, k3=1e6, c=0.3),
        link("m2-ground", "m2-ground", "k*d + c*v", k=2e3, c=0.05),
    )
    far, far_alone = [], []
    for seed in range(100, 106):
        record = lw.simulate(true, release={"v:m1": 0.5}, duration=3.0, rate=400.0).with_noise(
            25.0, seed=seed
        )
        discovery = lw.discover(record, masses(true))
        assert discovery.trusted
        for term in some(discovery.kept):
            error = discovery.estimate.coefficient(term.name).standard_error
            # of one fit in two ways, the model of the selection and the covariance of the optimum
            assert error is not None and error == pytest.approx(term.standard_error, rel=0.01)
            distance = abs(term.value - present(true.coefficient(term.name).value))
            far.append(distance / error)
            far_alone.append(distance * abs(term.z / term.value))
    assert max(far_alone) > 8.0  # ten in five of six other seeds, where the damper was dropped
    assert max(far) < 4.0  # 1e-4 of normal errors are larger; some thirty are looked at
    assert "mostly by" in " ".join(discovery.remarks)
