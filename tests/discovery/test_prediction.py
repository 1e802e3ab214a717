"""Prediction of pieces of the records that models were not fitted to."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from present import some
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.discovery.prediction import BlockParabolas, terms_without_gain
from linkwise.discovery.result import path_rows
from linkwise.discovery.selection import Selection

BLOCKS, ROWS = 10, 40


def regression() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (B, R, 3), samples (B, R), and the least squares of the first two columns; the third is in no sample."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(BLOCKS, ROWS, 3))
    samples = columns @ [2.0, 0.03, 0.0] + rng.normal(size=(BLOCKS, ROWS))
    fitted = np.linalg.lstsq(columns.reshape(-1, 3)[:, :2], samples.ravel(), rcond=None)[0]
    return columns, samples, np.append(fitted, 0.0)


def parabolas(shares: dict[int, float] | None = None) -> BlockParabolas:
    columns, samples, values = regression()
    left = samples - columns @ values
    slopes = np.einsum("brk,br->bk", columns, left)
    curvatures = np.einsum("brk,brl->bkl", columns, columns)
    return BlockParabolas(slopes, curvatures, values, {0: 0, 1: 1, 2: 2}, 2, shares or {})


def left_out(chosen: list[int]) -> np.ndarray:
    """(B,) squares left in each block by a fit to the others."""
    columns, samples, _ = regression()
    squares = []
    for block in range(BLOCKS):
        others = np.arange(BLOCKS) != block
        beside = columns[others][:, :, chosen].reshape(-1, len(chosen))
        fitted = np.linalg.lstsq(beside, samples[others].ravel(), rcond=None)[0]
        squares.append(np.sum((samples[block] - columns[block][:, chosen] @ fitted) ** 2))
    return np.array(squares)


@pytest.mark.parametrize("chosen", [[0], [1], [0, 1], [0, 1, 2]])
def test_prediction_is_that_of_fits_without_each_block(chosen: list[int]) -> None:
    excess = left_out(chosen) - left_out([0, 1])
    prediction = parabolas().prediction(chosen)
    assert prediction.excess == pytest.approx(excess.sum(), rel=1e-9, abs=1e-9)
    assert prediction.scatter == pytest.approx(np.sqrt(BLOCKS) * excess.std(ddof=1), rel=1e-9, abs=1e-9)


def test_other_values_are_compared_with_fits_without_each_block() -> None:
    columns, samples, _ = regression()
    other = np.array([2.1, -0.2])
    paid = np.sum((samples - columns[:, :, :2] @ other) ** 2, axis=1)
    excess = paid - left_out([0, 1])
    prediction = parabolas().prediction_of(other)
    assert prediction.excess == pytest.approx(excess.sum(), rel=1e-9)
    assert prediction.scatter == pytest.approx(np.sqrt(BLOCKS) * excess.std(ddof=1), rel=1e-9)


@pytest.mark.parametrize("chosen", [[0], [1], [0, 2], [0, 1, 2]])
def test_what_is_known_beforehand_is_in_every_fit_and_paid_once(chosen: list[int]) -> None:
    columns, samples, _ = regression()
    known, deviations = np.array([2.01, 0.2, 0.1]), np.array([0.01, 0.5, 0.02])

    def fitted(blocks: np.ndarray, beside: list[int]) -> np.ndarray:
        rows = np.concatenate([columns[blocks].reshape(-1, 3), np.diag(1.0 / deviations)])[:, beside]
        values = np.zeros(3)
        values[beside] = np.linalg.lstsq(rows, np.append(samples[blocks], known / deviations), rcond=None)[0]
        return values

    def paid(beside: list[int]) -> np.ndarray:
        folds = np.arange(BLOCKS)
        values = [fitted(folds != block, beside) for block in folds]
        own = [np.sum((samples[block] - columns[block] @ values[block]) ** 2) for block in folds]
        of_known = [np.sum(((known - some) / deviations) ** 2) for some in values]
        return np.add(own, np.array(of_known) / BLOCKS)

    values = fitted(np.arange(BLOCKS), [0, 1])
    beside_prior = replace(
        parabolas(),
        slopes=np.einsum("brk,br->bk", columns, samples - columns @ values),
        values=values,
        prior=((known - values) / deviations**2, np.diag(deviations**-2.0)),
    )
    excess = paid(chosen) - paid([0, 1])
    prediction = beside_prior.prediction(chosen)
    assert prediction.excess == pytest.approx(excess.sum(), rel=1e-9, abs=1e-8)
    assert prediction.scatter == pytest.approx(np.sqrt(BLOCKS) * excess.std(ddof=1), rel=1e-9, abs=1e-8)


@pytest.mark.parametrize("channel", ["all", "common"])
def test_calibrations_of_sensors_leave_predictions_as_they_are(channel: str) -> None:
    """They were in the first block: a needed term predicted 4900 +- 4900 better, a superfluous one 12 000 worse."""
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=5)
    alone, calibrated = (
        lw.discover(record, {"m1": 1.0, "m2": 0.01}, calibration=calibration)
        for calibration in ({}, {channel: 0.01})
    )
    assert {term.name for term in calibrated.kept} == {term.name for term in alone.kept}
    [selected] = [point for point in calibrated.path if point.chosen]
    larger = [point for point in calibrated.path if point.terms > selected.terms]
    smaller = [point for point in calibrated.path if point.terms < selected.terms]
    assert len(larger) > 3 and len(smaller) > 3
    for point in smaller:
        assert point.prediction > 3.0 * point.scatter
        assert point.prediction > 0.9 * point.criterion
    beside = {point.terms: point for point in alone.path}
    for point in larger:
        assert abs(point.prediction) < 30.0
        assert point.scatter < 3.0 * beside[point.terms].scatter


def test_the_path_tells_prediction_and_share_of_force() -> None:
    values = {"k": 800.0, "c": 4.0, "k3": 3e5}
    force = "3*sin(13*t) + 2*sin(24*t + 1) + 2*sin(37*t + 2) + sin(48*t + 3)"
    truth = oscillator("k*d + k3*d**3 + c*v", k=values["k"], c=values["c"], k3=values["k3"])
    clean = lw.simulate(truth, forces={"m1": force}, duration=8.0, rate=200.0)
    discovery = lw.discover(clean.with_noise(35.0, seed=4), {"m1": 1.0})
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}
    [selected] = [point for point in discovery.path if point.chosen]
    assert selected.prediction == selected.scatter == 0.0
    d = clean.channel("x:m1")
    v = np.gradient(d, clean.time)
    whole = values["k"] * d + values["k3"] * d**3 + values["c"] * v
    true = {"d": values["k"] * d, "d**3": values["k3"] * d**3, "v": values["c"] * v}
    of_name = {term.name: term.term for term in discovery.terms}
    smaller = [point for point in discovery.path if point.terms < selected.terms]
    larger = [point for point in discovery.path if point.terms > selected.terms]
    assert len(smaller) == 2 and larger
    for point in smaller:
        assert point.prediction > 2.0 * point.scatter
        share = np.sqrt(np.mean(true[of_name[point.step.removeprefix("- ")]] ** 2) / np.mean(whole**2))
        assert point.share == pytest.approx(share, rel=0.02)
    assert all(point.prediction > -3.0 * point.scatter for point in larger)
    assert all(point.share < 0.02 for point in larger)
    lines = str(discovery).splitlines()
    [start] = [number for number, line in enumerate(lines) if line.startswith("models of other sizes")]
    table = [line.split() for line in lines[start + 1 :]]
    assert ["3", "selected"] in table
    told = discovery.to_dict()["path"]
    assert [point["prediction"] for point in told] == [point.prediction for point in discovery.path]


@pytest.mark.parametrize(
    ("share", "told"), [(1.0, "100 %"), (1.236, "124 %"), (0.514, "51 %"), (0.02249, "2.2 %"), (np.nan, "")]
)
def test_shares_of_force_are_told_in_plain_numbers(share: float, told: str) -> None:
    """A term that makes all of the force of its link was told as 1e+02 %."""
    point = lw.discovery.PathPoint(
        4, 0.0, 9.0, "- a.k", chosen=False, prediction=8.0, scatter=1.0, share=share
    )
    _, row = path_rows(cast("lw.Discovery", SimpleNamespace(path=(point,), terms=())))
    assert row[-1] == told


def test_short_records_are_not_divided() -> None:
    record = chain_record(2, duration=0.1).with_noise(40.0, seed=1)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    assert all(np.isnan(point.prediction) and np.isnan(point.share) for point in some(discovery.path))
    assert "models of other sizes" not in str(discovery)


@pytest.mark.parametrize(
    ("model_error", "shares", "named"),
    [
        (0.05, {0: 0.9, 1: 0.01}, [1]),
        (0.05, {0: 0.01, 1: 0.9}, []),
        (0.005, {0: 0.9, 1: 0.01}, []),
        (0.0, {0: 0.9, 1: 0.01}, []),
    ],
)
def test_a_small_term_beside_a_larger_model_error_that_predicts_nothing_is_named(
    model_error: float, shares: dict[int, float], named: list[int]
) -> None:
    """The first makes most of the samples, the second hardly any of them."""
    relaxation = 3.0 if model_error else 0.0  # of the flow, which is no part of a force
    fit = SimpleNamespace(model_error=relaxation)
    selection = SimpleNamespace(fit=fit, structure=SimpleNamespace(parameters=("k", "k2")))
    terms = terms_without_gain(cast("Selection", selection), parabolas(shares), model_error)
    assert [term.terms[0] for term in terms] == named
    for term in terms:
        assert term.remark(("l.k", "l.k2")) == (
            "l.k2 makes 1 % of the force of its link, less than the model error of 5 %, and pieces of the record that were "
            "left out are predicted as well without it."
        )
