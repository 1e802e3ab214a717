"""Maps of absorption are the single answers, point by point, whatever is swept; what cannot be swept is said."""

from typing import Any

import numpy as np
import pytest
from present import some
from structures import equal_sinks, link, structure

import linkwise as lw
from linkwise.absorption import absorption_map, map

CHAIN = lw.bnes_chain(2)
RELEASE = {"v:m1": 1.0}
SHORT: dict[str, Any] = {"duration": 0.5, "rate": 1000.0, "settle": 0.5, "release": RELEASE}


def check(swept: lw.absorption.AbsorptionMap, place: tuple[int, ...], single: lw.Absorption) -> None:
    """One point of a map against `absorb`: same numerics, before chaos multiplies the 80-bit start of the single run."""
    at = {quantity.name: float(swept[quantity.name][place]) for quantity in swept.quantities}
    settled = [np.nan if time is None else time for time in single.settled]
    np.testing.assert_allclose([at["settled"], at["settled_without"]], settled, rtol=1e-7)
    assert at["rms_reduction"] == pytest.approx(single.rms_reduction, abs=1e-7)
    assert at["sinks_share"] == pytest.approx(single.sinks_share, abs=1e-7)
    assert at["crossings"] == sum(len(sink.crossings) for sink in single.sinks)
    assert at["remaining"] == pytest.approx(float(single.with_sinks.remaining[-1]), abs=1e-7)
    shares = {name: value for name, value in at.items() if name.startswith("share:")}
    for name in some(own.name for own in single.with_sinks.structure.links):
        assert shares[f"share:{name}"] == pytest.approx(single.with_sinks.share(name), abs=1e-7)
    assert sum(shares.values()) + at["remaining"] == pytest.approx(1.0, abs=1e-12) and at["closure"] < 1e-12
    powers = {name: value for name, value in at.items() if name.startswith("power:")}
    assert powers == pytest.approx(
        {f"power:{harvest.link}": harvest.average_power for harvest in single.harvests}, rel=1e-6
    )


def test_two_coefficients_of_the_sink() -> None:
    alphas, betas = [-150.0, -60.0], [5e5, 1e6, 1.7e6]
    reports: list[float] = []
    swept = absorption_map(
        CHAIN, {"nes1.alpha": alphas, "nes1.beta": betas}, **SHORT, workers=2,
        progress=lambda report: reports.append(report.fraction),
    )  # fmt: skip
    assert swept.completed.shape == (2, 3) == swept["settled"].shape and swept.trusted
    assert reports == sorted(reports) and reports[-1] == pytest.approx(1.0)
    for i, alpha in enumerate(alphas):
        for j, beta in enumerate(betas):
            single = lw.absorb(lw.bnes_chain(2, alpha=alpha, beta=beta), **SHORT)
            check(swept, (i, j), single)
    shares = swept["sinks_share"]
    best = swept.best("sinks_share")
    row, column = np.unravel_index(np.argmax(shares), shares.shape)
    assert best == {"nes1.alpha": alphas[row], "nes1.beta": betas[column]}


def test_a_harvester_an_unknown_and_a_shared_coefficient() -> None:
    swept = absorption_map(CHAIN, {"nes1-harvester.c": [0.005, 0.03]}, **SHORT, harvesters={"nes1": 0.01})
    check(swept, (1,), lw.absorb(CHAIN, **SHORT, harvesters={"nes1": 0.03}))
    alphas = {"nes1.alpha": [-150.0, -60.0]}
    swept = absorption_map(CHAIN.unknown("nes1.alpha"), alphas, **SHORT)
    check(swept, (1,), lw.absorb(lw.bnes_chain(2, alpha=-60.0), **SHORT))
    both = absorption_map(equal_sinks(), alphas, **SHORT)
    check(both, (0,), lw.absorb(lw.bnes_chain(4, alpha=-150.0), **SHORT))


def test_a_sweep_may_leave_the_bistable_range() -> None:
    """The sink is that of the structure given, also where the grid gives it one well."""
    swept = absorption_map(CHAIN, {"nes1.alpha": [-100.0, 0.0, 50.0]}, **SHORT)
    assert swept["crossings"][0] > 0 and swept["crossings"][1:].tolist() == [0.0, 0.0]
    single = lw.absorb(lw.bnes_chain(2, alpha=50.0), sinks=["nes1"], **SHORT)
    check(swept, (2,), single)


@pytest.mark.slow
def test_laws_with_kinks_are_run_one_by_one() -> None:
    spring = link("a", "m1-ground", "k*d + c*v", k=900.0, c=0.3)
    slider = link("s", "m2-m1", "p*d + q*d**3 + F*tanh(v/s)", p=-100.0, q=1e6, F=0.02, s=0.01)
    rubbing = structure({"m1": 1.0, "m2": 0.01}, spring, slider)
    swept = absorption_map(rubbing, {"s.F": [0.02, 0.05]}, **SHORT | {"release": {"v:m1": 0.3}})
    check(swept, (1,), lw.absorb(rubbing.with_values({"s.F": 0.05}), **SHORT | {"release": {"v:m1": 0.3}}))


def test_where_the_motion_diverges_the_map_has_holes() -> None:
    swept = absorption_map(CHAIN, {"nes1.beta": [-1e6, 5e5, -5e5, 1e6]}, sinks=["nes1"], **SHORT)
    assert swept.completed.tolist() == [False, True, False, True]
    assert swept.to_dict()["diverged"] == 2
    assert np.isnan(swept["sinks_share"]).tolist() == [True, False, True, False]
    check(swept, (3,), lw.absorb(CHAIN, **SHORT))
    assert swept.findings[0].startswith("2 of 4 runs diverge: their cells have no value")
    assert swept.verdicts == (lw.Verdict.ENERGY_BALANCE_CLOSED,)
    assert "4 runs of 0.5 s over nes1.beta" in str(swept) and "2 diverged" in str(swept)
    message = r"none of the 2 runs came to its end: .* check the ranges of nes1\.beta"
    with pytest.raises(lw.LinkwiseError, match=message):
        absorption_map(CHAIN, {"nes1.beta": [-1e6, -5e5]}, sinks=["nes1"], **SHORT)


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({}, r"a sweep takes one or two parameters, got 0"),
        ({"nes1.alpha": [1.0], "nes1.beta": [1.0], "nes1.c": [1.0]}, r"takes one or two parameters, got 3"),
        ({"nes1.gamma": [1.0]}, r'unknown coefficient "nes1.gamma"; did you mean "nes1.alpha"'),
        ({"nes1.alpha": [np.nan]}, r"nes1\.alpha: the values of a swept parameter must be a row of finite"),
        ({"a:m1": [1.0]}, r"a:m1: a sweep takes coefficients, masses and releases; write a release as x:MASS"),
        ({"m2.mass": [-1.0, 0.01]}, r"mass of|positive"),
    ],
)  # fmt: skip
def test_what_cannot_be_swept(over: dict[str, list[float]], message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        absorption_map(CHAIN, over, **SHORT)


def test_a_map_of_chaos_says_so() -> None:
    wild = absorption_map(
        lw.bnes_chain(6), {"nes1.c": [0.02, 0.03]}, duration=2.0, rate=500.0, release={"v:m1": 3.0}
    )
    assert wild.horizon is not None and f"chaotic past {wild.horizon:.3g} s of 2 s" in str(wild).replace(
        "\n  ", " "
    )
    calm = absorption_map(CHAIN, {"nes1.c": [0.02, 0.03]}, **SHORT)
    assert calm.horizon is None and calm.to_dict()["findings"] == []


def test_a_sweep_beyond_memory_is_refused_before_it_takes_any(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map, "available_memory", lambda: 24 * 10**9)
    alphas, betas = np.linspace(-200.0, -20.0, 100_000), np.linspace(1e5, 2e6, 100_000)
    over = {"nes1.alpha": alphas, "nes1.beta": betas}
    message = r"a sweep of 10000000000 runs needs 7.4e\+04 GB, and 24 GB are free; use fewer values of nes1\.alpha and"
    with pytest.raises(lw.SimulationError, match=message):
        absorption_map(CHAIN, over, **SHORT)
