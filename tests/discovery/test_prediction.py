"""Prediction of pieces of the records that models were not fitted to."""

import numpy as np
import pytest
from present import some
from problems import chain_record
from structures import oscillator

import linkwise as lw

BLOCKS, ROWS = 10, 40


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
