"""Maps of absorption are the single answers, point by point, whatever is swept; what cannot be swept is said."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from present import some
from structures import equal_sinks, link, structure

import linkwise as lw
from linkwise.absorption import map
from linkwise.absorption.wells import barriers
from linkwise.plot.absorptions import map_figure

SHORT: dict[str, Any] = {"duration": 0.5, "rate": 1000.0, "settle": 0.5}
RELEASE = {"v:m1": 1.0}


def check(absorption_map: lw.absorption.AbsorptionMap, place: tuple[int, ...], single: lw.Absorption) -> None:
    """One point of a map against `absorb`: same numerics, before chaos multiplies the 80-bit start of the single run."""
    at = {
        quantity.name: float(absorption_map[quantity.name][place]) for quantity in absorption_map.quantities
    }
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
        {f"power:{harvest.link}": harvest.power for harvest in single.harvests}, rel=1e-6
    )


def test_two_coefficients_of_the_sink() -> None:
    alphas, betas = [-150.0, -60.0], [5e5, 1e6, 1.7e6]
    reports: list[float] = []
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1.alpha": alphas, "nes1.beta": betas}, **SHORT, release=RELEASE, workers=2,
        progress=lambda report: reports.append(report.fraction),
    )  # fmt: skip
    assert (
        absorption_map.completed.shape == (2, 3) == absorption_map["settled"].shape and absorption_map.trusted
    )
    assert reports == sorted(reports) and reports[-1] == pytest.approx(1.0)
    for i, alpha in enumerate(alphas):
        for j, beta in enumerate(betas):
            single = lw.absorb(lw.bnes_chain(2, alpha=alpha, beta=beta), **SHORT, release=RELEASE)
            check(absorption_map, (i, j), single)
    shares = absorption_map["sinks_share"]
    best = absorption_map.best("sinks_share")
    row, column = np.unravel_index(np.argmax(shares), shares.shape)
    assert best == {"nes1.alpha": alphas[row], "nes1.beta": betas[column]}


@pytest.mark.parametrize("without", ["removed", "locked"])
def test_what_the_structure_without_sinks_feels_too(without: str) -> None:
    """Masses and springs of the primary part, and what it is released with, change the comparison as well."""
    chain = lw.bnes_chain(4)
    over = {"spring1.k": [2e4, 4e4], "m3.mass": [0.8, 1.3]}
    absorption_map = lw.absorption.absorption_map(chain, over, **SHORT, release=RELEASE, without=without)
    assert {"settled:m1", "rms_reduction:m3", "crossings:nes2"} <= {
        quantity.name for quantity in absorption_map.quantities
    }
    single = lw.absorb(
        chain.with_values({"spring1.k": 4e4, "m3.mass": 0.8}), **SHORT, release=RELEASE, without=without
    )
    check(absorption_map, (1, 0), single)
    assert absorption_map["rms_reduction:m3"][1, 0] == pytest.approx(single.masses[1].rms_reduction, abs=1e-7)
    mass = lw.absorption.absorption_map(
        chain, {"m2.mass": [0.01, 0.02]}, **SHORT, release=RELEASE, without=without
    )
    check(
        mass, (1,), lw.absorb(chain.with_values({"m2.mass": 0.02}), **SHORT, release=RELEASE, without=without)
    )
    speed = lw.absorption.absorption_map(chain, {"v:m1": [0.3, 1.2]}, **SHORT, without=without)
    check(speed, (0,), lw.absorb(chain, **SHORT, release={"v:m1": 0.3}, without=without))
    assert speed.axes[0].unit == "m/s"


def test_a_harvester_an_unknown_and_a_shared_coefficient() -> None:
    harvesters = {"nes1": 0.01}
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1-harvester.c": [0.005, 0.03]}, **SHORT, release=RELEASE, harvesters=harvesters
    )
    check(
        absorption_map, (1,), lw.absorb(lw.bnes_chain(2), **SHORT, release=RELEASE, harvesters={"nes1": 0.03})
    )
    unknown = lw.bnes_chain(2).unknown("nes1.alpha")
    swept = lw.absorption.absorption_map(unknown, {"nes1.alpha": [-150.0, -60.0]}, **SHORT, release=RELEASE)
    check(swept, (1,), lw.absorb(lw.bnes_chain(2, alpha=-60.0), **SHORT, release=RELEASE))
    both = lw.absorption.absorption_map(
        equal_sinks(), {"nes1.alpha": [-150.0, -60.0]}, **SHORT, release=RELEASE
    )
    check(both, (0,), lw.absorb(lw.bnes_chain(4, alpha=-150.0), **SHORT, release=RELEASE))


def test_a_sweep_may_leave_the_bistable_range() -> None:
    """The sink is that of the structure given, also where the grid gives it one well."""
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1.alpha": [-100.0, 0.0, 50.0]}, **SHORT, release=RELEASE
    )
    assert absorption_map["crossings"][0] > 0 and absorption_map["crossings"][1:].tolist() == [0.0, 0.0]
    single = lw.absorb(lw.bnes_chain(2, alpha=50.0), sinks=["nes1"], **SHORT, release=RELEASE)
    check(absorption_map, (2,), single)


def test_laws_with_kinks_are_run_one_by_one() -> None:
    spring = link("a", "m1-ground", "k*d + c*v", k=900.0, c=0.3)
    slider = link("s", "m2-m1", "p*d + q*d**3 + F*tanh(v/s)", p=-100.0, q=1e6, F=0.02, s=0.01)
    rubbing = structure({"m1": 1.0, "m2": 0.01}, spring, slider)
    absorption_map = lw.absorption.absorption_map(
        rubbing, {"s.F": [0.02, 0.05]}, **SHORT, release={"v:m1": 0.3}
    )
    check(absorption_map, (1,), lw.absorb(rubbing.with_values({"s.F": 0.05}), **SHORT, release={"v:m1": 0.3}))


def test_where_the_motion_diverges_the_map_has_holes() -> None:
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1.beta": [-1e6, 5e5, -5e5, 1e6]}, sinks=["nes1"], **SHORT, release=RELEASE
    )
    assert (
        absorption_map.completed.tolist() == [False, True, False, True]
        and absorption_map.to_dict()["diverged"] == 2
    )
    assert np.isnan(absorption_map["sinks_share"]).tolist() == [True, False, True, False]
    check(absorption_map, (3,), lw.absorb(lw.bnes_chain(2), **SHORT, release=RELEASE))
    assert absorption_map.findings[0].startswith("2 of 4 runs diverge: their cells have no value")
    assert absorption_map.verdicts == (lw.Verdict.ENERGY_BALANCE_CLOSED,)
    assert "4 runs of 0.5 s over nes1.beta" in str(absorption_map) and "2 diverged" in str(absorption_map)
    with pytest.raises(
        lw.LinkwiseError, match=r"none of the 2 runs came to its end: .* check the ranges of nes1\.beta"
    ):
        lw.absorption.absorption_map(
            lw.bnes_chain(2), {"nes1.beta": [-1e6, -5e5]}, sinks=["nes1"], **SHORT, release=RELEASE
        )


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({}, r"a sweep takes one or two parameters, got 0"),
        (
            {"nes1.alpha": [1.0], "nes1.beta": [1.0], "nes1.c": [1.0]},
            r"a sweep takes one or two parameters, got 3",
        ),
        ({"nes1.gamma": [1.0]}, r'unknown coefficient "nes1.gamma"; did you mean "nes1.alpha"'),
        (
            {"nes1.alpha": [np.nan]},
            r"nes1\.alpha: the values of a swept parameter must be a row of finite numbers",
        ),
        (
            {"a:m1": [1.0]},
            r"a:m1: a sweep takes coefficients, masses and releases; write a release as x:MASS",
        ),
        ({"m2.mass": [-1.0, 0.01]}, r"mass of|positive"),
    ],
)
def test_what_cannot_be_swept(over: dict[str, list[float]], message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        lw.absorption.absorption_map(lw.bnes_chain(2), over, **SHORT, release=RELEASE)


def test_tops_and_floors_of_many_laws() -> None:
    """Polynomials by companion matrices against wells(), which brackets the zeros of any law."""
    law = lw.Law.parse("a*d + b*d**2 + e*d**3 + g*d**5")
    rng = np.random.default_rng(1001)
    values = {
        "a": rng.normal(0, 100, 60),
        "b": rng.normal(0, 2e3, 60),
        "e": rng.normal(0, 1e6, 60),
        "g": np.full(60, 1e9),
    }
    tops_and_floors = barriers(law, values, 60)
    for run in range(60):
        numbers = {name: float(value[run]) for name, value in values.items()}
        spring = link("link", "m-ground", law, **numbers)
        wells = lw.analysis.wells(spring)
        tops = tops_and_floors.tops[run][np.isfinite(tops_and_floors.tops[run])]
        assert len(tops) == len(wells) - 1
        assert tops_and_floors.floor[run] == pytest.approx(
            min(float(spring.potential(d)) for d in wells), rel=1e-9, abs=1e-15
        )
        for top, below, above in zip(tops, wells[:-1], wells[1:], strict=True):
            assert (
                below < top < above
                and abs(float(spring.force(top))) < 1e-9 * float(abs(spring.stiffness(top))) * 0.1
            )


def test_a_map_of_chaos_says_so() -> None:
    wild = lw.absorption.absorption_map(
        lw.bnes_chain(6), {"nes1.c": [0.02, 0.03]}, duration=2.0, rate=500.0, release={"v:m1": 3.0}
    )
    assert wild.horizon is not None and f"chaotic past {wild.horizon:.3g} s of 2 s" in str(wild).replace(
        "\n  ", " "
    )
    calm = lw.absorption.absorption_map(lw.bnes_chain(2), {"nes1.c": [0.02, 0.03]}, **SHORT, release=RELEASE)
    assert calm.horizon is None and calm.to_dict()["findings"] == []


def test_axes_know_their_scale() -> None:
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1.alpha": [-150.0, -100.0, -50.0], "nes1.beta": [1e5, 4e5, 1.6e6]}, **SHORT, release=RELEASE
    )  # fmt: skip
    assert [axis.logarithmic for axis in absorption_map.axes] == [False, True]
    figure = map_figure(absorption_map)
    panel = figure.axes[0]
    assert (panel.get_xscale(), panel.get_yscale()) == ("linear", "log")
    assert panel.get_xlabel() == "nes1.alpha, N/m" and panel.get_title("left") == "settling time (below 50 %)"


def test_what_no_run_reached_has_no_bar_of_numbers() -> None:
    over = {"nes1.alpha": [-150.0, -50.0], "nes1.beta": [2e5, 2e6]}
    absorption_map = lw.absorption.absorption_map(
        lw.bnes_chain(2), over, duration=0.5, rate=1000.0, settle=0.05, release=RELEASE
    )
    assert np.isnan(absorption_map["settled"]).all() and np.isfinite(absorption_map["sinks_share"]).all()
    bars = [axes.get_ylabel() for axes in map_figure(absorption_map).axes if axes.get_label() == "<colorbar>"]
    assert bars == ["%", "%", ""]  # of settling none


def test_a_sweep_beyond_memory_is_refused_before_it_takes_any(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map, "available_memory", lambda: 24 * 10**9)
    alphas, betas = np.linspace(-200.0, -20.0, 100_000), np.linspace(1e5, 2e6, 100_000)
    over = {"nes1.alpha": alphas, "nes1.beta": betas}
    with pytest.raises(
        lw.SimulationError,
        match=r"a sweep of 10000000000 runs needs 6.7e\+04 GB, and 24 GB are free; use fewer values of nes1\.alpha and",
    ):
        lw.absorption.absorption_map(lw.bnes_chain(2), over, **SHORT, release=RELEASE)


@pytest.mark.parametrize("masses", [2, 8])
def test_the_memory_of_a_sweep_is_what_it_takes(masses: int) -> None:
    """Per run: some hundred kilobytes that every sweep takes, more or less by versions of NumPy, are in both peaks."""
    trial: dict[str, Any] = {"duration": 0.1, "rate": 500.0, "release": RELEASE, "workers": 1}
    chain, alphas = lw.bnes_chain(masses), np.linspace(-200.0, -20.0, 200)
    lw.absorption.absorption_map(chain, {"nes1.alpha": alphas[:2]}, **trial)  # loads what a first one does
    peaks = []
    for values in (alphas[:40], alphas):
        tracemalloc.start()
        lw.absorption.absorption_map(chain, {"nes1.alpha": values}, **trial)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    predicted = map.map_bytes(160, masses)
    assert predicted / 2 < peaks[1] - peaks[0] < predicted
