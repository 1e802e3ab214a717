"""Channels of links, forces and states, in all that reads records: used, refused, or told not to be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from structures import harvester, oscillator

import linkwise as lw

OSCILLATOR = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """A load cell in the spring shows three times its force, and 5 N more."""
    clean = lw.simulate(
        OSCILLATOR, release={"v:m1": 1.0}, duration=3.0, rate=200.0, sensors=("x:m1", "f:spring")
    )
    return replace(clean, values=clean.values * [1.0, 3.0] + [0.0, 5.0], simulated=None).with_noise(
        40.0, seed=1
    )


@pytest.mark.parametrize("method", ["weak", "sindy"])
def test_methods_that_do_not_use_a_load_cell_say_so(method: str, record: lw.Record) -> None:
    fit = lw.identify(record, OSCILLATOR.unknown("all"), method=method)  # type: ignore[arg-type]
    takes = "forces" if method == "weak" else "forces and states"
    assert f'f:spring were not used: method "ml" alone takes {takes} of links.' in fit.findings
    assert not lw.identify(record, OSCILLATOR.unknown("all")).trusted


def test_the_weak_form_does_not_disown_the_state_that_it_uses() -> None:
    """Without the voltage it would refuse the law; only the load cell is left out."""
    values = {"k": 400.0, "c": 1.0, "theta": 0.02, "R": 1e5, "C": 1e-6}
    structure = harvester(1.0, "ground", "piezo", **values)
    clean = lw.simulate(
        structure,
        duration=4.0,
        rate=250.0,
        forces={"m1": "2*sin(20*t) + sin(33*t)"},
        sensors=("x:m1", "state:piezo.V", "f:piezo"),
    )
    fit = lw.identify(clean.with_noise(50.0, seed=3), structure.unknown("piezo.c"), method="weak")
    remarks = [line for line in fit.findings if "not used" in line]
    assert remarks == ['f:piezo were not used: method "ml" alone takes forces of links.']


def test_discovery_says_so(record: lw.Record) -> None:
    assert any("f:spring were not used" in line for line in lw.check_discovery(record, {"m1": 1.0}))


def test_validation_scores_a_load_cell(record: lw.Record) -> None:
    """Its force is not that of the spring; without it the record agrees."""
    validation = lw.validate(record, OSCILLATOR)
    assert not validation.channels["f:spring"].agrees
    assert not validation.trusted
    assert lw.validate(record.select(["x:m1"]), OSCILLATOR).trusted


def test_a_unit_of_a_state_must_be_of_its_kind(tmp_path: Path) -> None:
    structure = harvester(1.0, "ground", "piezo")
    time = np.arange(200) / 200.0
    for unit, factor in (("mV", 1e-3), ("mm", 1e-3)):
        path = tmp_path / f"{unit}.csv"
        rows = (f"{t},{np.sin(20.0 * t)},{np.cos(9.0 * t)}" for t in time)
        path.write_text("\n".join([f"time,x:m1,state:piezo.V[{unit}]", *rows]) + "\n")
        record = lw.read_record(path)
        assert record.channel("state:piezo.V")[0] == pytest.approx(factor, rel=1e-12)
        assert dict(record.units) == {"state:piezo.V": unit}
    with pytest.raises(
        lw.IdentificationError, match=r"state:piezo\.V is stated in mm, and the state V of piezo is in V"
    ):
        lw.identify(record, structure)
