"""Prediction of pieces of the records that models were not fitted to."""

import numpy as np
import pytest
from present import some
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.discovery.prediction import BlockParabolas

BLOCKS, ROWS = 10, 40


def regression() -> tuple[np.ndarray, np.ndarray]:
    """Columns (B, R, 3) and samples (B, R), in none of which the third is."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(BLOCKS, ROWS, 3))
    return columns, columns @ [2.0, 0.03, 0.0] + rng.normal(size=(BLOCKS, ROWS))


@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize("chosen", [[0], [1], [0, 1], [0, 1, 2]])
def test_prediction_is_that_of_fits_without_each_block(chosen: list[int], is_known: bool) -> None:
    """What is known beforehand is in every fit and paid once."""
    columns, samples = regression()
    known = np.array([2.01, 0.2, 0.1])
    deviations = np.array([0.01, 0.5, 0.02]) if is_known else np.full(3, np.inf)

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
    slopes = np.einsum("brk,br->bk", columns, samples - columns @ values)
    curvatures = np.einsum("brk,brl->bkl", columns, columns)
    prior = ((known - values) / deviations**2, np.diag(deviations**-2.0)) if is_known else None
    parabolas = BlockParabolas(slopes, curvatures, values, {0: 0, 1: 1, 2: 2}, 2, prior)
    excess = paid(chosen) - paid([0, 1])
    prediction = parabolas.prediction(chosen)
    assert prediction.excess == pytest.approx(excess.sum(), rel=1e-9, abs=1e-8)
    assert prediction.scatter == pytest.approx(np.sqrt(BLOCKS) * excess.std(ddof=1), rel=1e-9, abs=1e-8)


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


def test_short_records_are_not_divided() -> None:
    record = chain_record(2, duration=0.1).with_noise(40.0, seed=1)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    assert all(np.isnan(point.prediction) and np.isnan(point.share) for point in some(discovery.path))
    assert "models of other sizes" not in str(discovery)
