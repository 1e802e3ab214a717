"""Designs: as good as a sweep in a tenth of its simulations, within limits, over levels and draws; what is refused."""

import importlib
import json
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal, said
from problems import chain_record
from structures import link, structure

import linkwise as lw
from linkwise.absorption import DesignOptions, absorption_map
from linkwise.absorption.resonance import Resonance, curve_pool
from linkwise.progress import silent

design_module = importlib.import_module("linkwise.absorption.design")
CHAIN = lw.bnes_chain(2)
SHORT: dict[str, Any] = {"duration": 0.5, "rate": 1000.0, "release": {"v:m1": 1.0}}
ALPHA, BETA, MASS = {"nes1.alpha": (-300.0, -20.0)}, {"nes1.beta": (1e5, 1e7)}, {"m2.mass": (0.002, 0.05)}


def absorbed(found: lw.absorption.Design, **keywords: Any) -> lw.absorption.AbsorptionMap:
    """The quantities of the best design by a sweep of one value."""
    (name, value), *others = found.best.items()
    subject = CHAIN.with_values(dict(others))
    return absorption_map(subject, {name: [value]}, **keywords)


@pytest.mark.parametrize(("quantity", "maximise"), [("rms", False), ("sinks_share", True)])
def test_the_best_is_what_a_sweep_says_of_it(quantity: str, maximise: bool) -> None:
    reports: list[float] = []
    options = DesignOptions(evaluations=40, maximise=maximise, seed=3)
    found = lw.design(
        CHAIN,
        ALPHA | BETA,
        quantity,
        options,
        progress=lambda report: reports.append(report.fraction),
        **SHORT,
    )
    assert found.evaluations == found.simulations == len(found.points) == 40 and found.trusted
    assert reports == sorted(reports) and reports[-1] <= 1.0
    # the same numerics
    assert found.objective == pytest.approx(float(absorbed(found, **SHORT)[quantity][0]), rel=1e-8)
    extreme = np.nanmax if maximise else np.nanmin
    assert found.objective == extreme(found.objectives) and found.given == found.objectives[0]
    assert (
        dict(zip(found.best, found.points[np.nanargmax(found.objectives == found.objective)], strict=True))
        == found.best
    )
    assert all(low <= found.best[name] <= high for name, (low, high) in (ALPHA | BETA).items())
    assert found.structure.coefficient("nes1.beta").value == found.best["nes1.beta"]
    again = lw.design(CHAIN, ALPHA | BETA, quantity, options, **SHORT)
    np.testing.assert_array_equal(found.points, again.points)
    assert found.trade_off == ((0.01, found.objective),)


def test_limits_hold_and_mass_is_traded_off() -> None:
    options = DesignOptions(evaluations=80, limits={"stroke:nes1": 0.025, "added_mass": 0.03})
    found = lw.design(CHAIN, MASS | BETA, "rms", options, **SHORT)
    best = absorbed(found, **SHORT)
    assert best["stroke:nes1"][0] <= 0.025 and found.best["m2.mass"] <= 0.03
    assert not found.allowed.all() and np.array_equal(found.added_mass, found.points[:, 0])
    mass, value = np.array(found.trade_off).T
    assert len(mass) > 2 and np.all(np.diff(mass) > 0.0) and np.all(np.diff(value) < 0.0)
    assert value[-1] == found.objective and mass[-1] == found.best["m2.mass"]
    free = lw.design(CHAIN, MASS | BETA, "rms", DesignOptions(evaluations=80), **SHORT)
    assert free.objective < found.objective
    message = r"none of 20 designs keeps the limits and has a value of rms: widen"
    with pytest.raises(lw.LinkwiseError, match=message):
        lw.design(CHAIN, ALPHA, "rms", DesignOptions(evaluations=20, limits={"stroke:nes1": 1e-4}), **SHORT)


def test_the_best_place_is_that_of_the_best_search(tmp_path: Path) -> None:
    """A sink on the first or the second of two masses: each place has a search of its own."""
    springs = {
        f"s{n}": link(f"s{n}", ends, "k*d + c*v", k=3e3, c=0.5)
        for n, ends in ((1, "m1-ground"), (2, "m2-m1"))
    }
    nes = link("nes", "sink-m1", "alpha*d + beta*d**3 + c*v", alpha=20.0, beta=1e6, c=0.1)
    subject = structure({"m1": 1.0, "m2": 1.0, "sink": 0.05}, *springs.values(), nes)
    over, asked = {"nes.beta": (1e4, 1e7)}, {**SHORT, "sinks": ["nes"]}
    options = DesignOptions(evaluations=10, places={"nes": ("m1", "m2")})
    found = lw.design(subject, over, "rms", options, **asked)
    links = (*springs.values(), replace(nes, between=("sink", "m2")))
    alone = {
        place: lw.design(own, over, "rms", DesignOptions(evaluations=10), **asked).objective
        for place, own in (("m1", subject), ("m2", replace(subject, links=links)))
    }
    assert {where["nes"]: value for where, value in found.places} == alone
    best = min(alone, key=alone.__getitem__)
    assert found.places[0][0] == {"nes": best} and found.objective == alone[best]
    assert found.structure.link("nes").between == ("sink", best) and "at each of 2 places" in str(found)
    lw.write_structure(subject, tmp_path / "row.toml")
    line = f"design {tmp_path}/row.toml --vary nes.beta=1e4:1e7 --sink nes --release v:m1=1 --duration 0.5 --rate 1000"
    told = document(f"{line} --minimise rms --evaluations 10 --place nes=m1,m2 -o {tmp_path}/best")
    assert told["places"] == [{**where, "objective": value} for where, value in found.places]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best", "row.toml"]
    assert 'unknown end "m9"' in refusal(f"{line} --place nes=m9")


def test_the_worst_level_counts_or_their_mean() -> None:
    levels, at = (0.5, 2.0), {"nes1.alpha": (-100.0 - 1e-9, -100.0)}
    every = [
        float(
            absorption_map(CHAIN, {"nes1.alpha": [-100.0]}, **{**SHORT, "release": {"v:m1": level}})["rms"][0]
        )
        for level in levels
    ]
    for way, expected in (("worst", max(every)), ("mean", float(np.mean(every)))):
        options = DesignOptions(evaluations=8, levels=levels, over_levels=way)
        found = lw.design(CHAIN, at, "rms", options, **SHORT)
        assert found.given == pytest.approx(expected, rel=1e-6) and f"{way} of the levels 0.5, 2." in str(
            found
        )


@pytest.mark.slow
def test_draws_of_an_answer_are_judged_by_mean_or_quantile(tmp_path: Path) -> None:
    fit = lw.identify(chain_record(2, duration=1.0).with_noise(30.0, seed=1), CHAIN.unknown("nes"))
    draws = lw.estimates.Posterior.of(fit).draws(5, 0)
    values = [
        float(absorption_map(fit.structure.with_values(dict(zip(("nes1.alpha", "nes1.beta"), row, strict=False))),
                             {"nes1.c": [0.02]}, **SHORT)["rms"][0])
        for row in draws
    ]  # fmt: skip
    at = {"nes1.c": (0.02, 0.02 + 1e-9)}
    of_mean = lw.design(fit, at, "rms", DesignOptions(evaluations=8, draws=5), **SHORT)
    assert of_mean.simulations == 40 and of_mean.objective == pytest.approx(np.mean(values), rel=1e-5)
    of_quantile = lw.design(fit, at, "rms", DesignOptions(evaluations=8, draws=5, quantile=0.9), **SHORT)
    assert of_quantile.objective == pytest.approx(max(values), rel=1e-5)
    answer = lw.report.write_result(fit, tmp_path / "answer")
    line = f"design {answer} --vary nes1.c=0.01:0.05 --minimise rms --evaluations 8 --draws 2 --duration 0.3 --release v:m1=1"
    assert document(line)["simulations"] == 16


ABSORBER = structure(
    {"frame": 1.0, "ball": 0.05},
    link("leaf", "frame-ground", "k*d", k=400.0),
    link("spring", "ball-frame", "k*d + c*v", k=18.0, c=0.2),
)
DRIVEN = lw.response.ResponseOptions(hz=(2.2, 4.2), force={"frame": 1.0}, starts=0)


@pytest.mark.slow
def test_the_least_resonance_is_that_of_fixed_points() -> None:
    """The curves of all dampings meet in two points, at best at F/k*sqrt(1 + 2/mu) (Den Hartog 1956): no peak is below, and
    the optimum is above by less than mu/20 (Asami and Nishihara 2003).
    """
    over = {"spring.k": (15.0, 21.0), "spring.c": (0.05, 0.5)}
    options = DesignOptions(evaluations=40, levels=(2.0,), harmonic=DRIVEN)
    found = lw.design(ABSORBER, over, "resonance", options, sinks=["spring"])
    least = 2.0 / 400.0 * np.sqrt(1.0 + 2.0 / 0.05)
    assert least <= found.objective < 1.02 * least  # 20 designs for each parameter
    assert found.quantity.unit == "m" and found.quantity.title == "largest steady amplitude of x:frame"
    assert found.best["spring.k"] == pytest.approx(20.0 / 1.05**2, rel=0.03)
    assert found.response is not None and found.response.drive.place == "frame"
    [branch] = found.response.levels[0].branches
    assert branch.amplitude.max() == pytest.approx(found.objective / 2.0, rel=1e-6)
    # nothing else moves it: a sweep from the lowest to the highest frequency
    assert found.absorption.time[-1] == pytest.approx(100.0 / 2.2, rel=1e-3)
    limited = DesignOptions(evaluations=20, harmonic=DRIVEN, limits={"resonance": 1.3 * least / 2.0})
    within = lw.design(ABSORBER, over, "stroke:spring", limited, sinks=["spring"])
    assert within.response is not None
    assert within.response.levels[0].branches[0].amplitude.max() <= 1.3 * least / 2.0


def test_unstable_motion_alone_is_no_resonance() -> None:
    """Its amplitude would be the least of all designs."""
    fed = ABSORBER.with_values({"spring.c": -0.1})
    resonance = Resonance(replace(DRIVEN, harmonics=3, show=["x:frame"]), "m")
    unstable, stable = resonance.values([fed, ABSORBER.with_values({"spring.c": 0.2})], 1.0, silent)
    assert np.isnan(unstable) and stable > 0.01


def test_curves_are_followed_side_by_side() -> None:
    """Processes give what this one does, designs in their order, and are asked for by the number of workers."""
    resonance = Resonance(replace(DRIVEN, show=["x:frame"]), "m")
    designs = [ABSORBER.with_values({"spring.c": damping}) for damping in (0.1, 0.2, 0.4)]
    alone = resonance.values(designs, 1.0, silent)
    with curve_pool(2) as pool:
        assert pool is not None
        np.testing.assert_array_equal(resonance.values(designs, 1.0, silent, pool), alone)
    with curve_pool(None) as none, curve_pool(1) as one:
        assert none is None and one is None
    question: dict[str, Any] = {
        "over": {"spring.c": (0.05, 0.5)},
        "minimise": "resonance",
        "sinks": ["spring"],
    }
    options = DesignOptions(evaluations=8, harmonic=DRIVEN, workers=1)
    with ThreadPoolExecutor(1) as executor:  # of any library
        found = lw.design(ABSORBER, options=options, executor=executor, **question)
        assert executor.submit(lambda: 1).result() == 1
    assert found.best == lw.design(ABSORBER, options=options, **question).best


@pytest.mark.parametrize(
    ("harmonic", "message"),
    [
        (None, "the resonance is that of steady motion: give a harmonic excitation"),
        ({"force": {"ball2": 1.0}}, "unknown mass 'ball2' in a force; did you mean \"ball\""),
        ({"base": {"a": 1.0}}, 'no link has "base" as an end'),
        ({"force": {"frame": 1.0}, "show": ["x:mass"]}, "unknown mass 'mass' in what is shown"),
    ],
)
def test_a_resonance_of_nothing_is_refused(harmonic: dict[str, Any] | None, message: str) -> None:
    driven = None if harmonic is None else lw.response.ResponseOptions(hz=(2.0, 4.0), **harmonic)
    options, varied = DesignOptions(evaluations=8, harmonic=driven), {"spring.c": (0.1, 0.2)}
    with pytest.raises(lw.SimulationError, match=re.escape(message)):
        lw.design(ABSORBER, varied, "resonance", options, sinks=["spring"], release={"v:frame": 1.0})


def test_the_command_writes_a_folder(tmp_path: Path) -> None:
    file, folder = tmp_path / "chain.toml", tmp_path / "best"
    lw.write_structure(CHAIN, file)
    line = (
        f"design {file} --vary nes1.beta=1e5:1e7 --vary m2.mass=0.002:0.05 --release v:m1=1.0 --duration 0.3"
    )
    result = document(
        f"{line} --minimise rms --evaluations 40 --levels 0.5,1 --limit stroke:nes1=0.05 -o {folder}"
    )
    assert set(result["best"]) == {"nes1.beta", "m2.mass"} and result["evaluations"] == 40
    assert result["simulations"] == 80 and result["trade_off"][-1]["objective"] == result["objective"]
    names = {path.name for path in folder.iterdir()}
    figures = {"trade_off.png", "designs.png"}
    assert {"design.json", "designs.csv", "structure.toml", "report.html", *figures} <= names
    assert json.loads((folder / "design.json").read_text())["best"] == result["best"]
    best = lw.read_structure(folder / "structure.toml")
    assert best.mass("m2").mass.value == pytest.approx(result["best"]["m2.mass"], rel=1e-12)
    rows = (folder / "designs.csv").read_text().splitlines()
    assert rows[0] == "nes1.beta,m2.mass,added_mass,within limits,rms" and len(rows) == 41
    page = (folder / "report.html").read_text()
    assert "no lighter one" in page or "Trade-off" in page
    assert "energy left at the end" in said(f"{line} --evaluations 8").out


@pytest.mark.slow
def test_the_command_writes_the_response_of_the_best(tmp_path: Path) -> None:
    lw.write_structure(ABSORBER, tmp_path / "absorber.toml")
    line = f"design {tmp_path}/absorber.toml --vary spring.c=0.05:0.5 --minimise resonance --force frame=1 --sink spring"
    result = document(f"{line} --from 2.2 --to 4.2 --evaluations 8 -o {tmp_path}/best")
    assert (result["quantity"], result["unit"]) == ("resonance", "m") and result["objective"] < result[
        "as_given"
    ]
    assert "Steady motion of the best" in (tmp_path / "best" / "report.html").read_text()


def test_an_interrupted_search_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of designs that were judged none is simulated again, and the answer is that of a search without a break."""
    lw.write_structure(CHAIN, tmp_path / "chain.toml")
    line = f"design {tmp_path}/chain.toml --vary nes1.alpha=-300:-20 --release v:m1=1 --duration 0.2 --evaluations 24"
    whole = document(f"{line} -o {tmp_path}/whole")
    judged: list[int] = []
    judge = design_module._Problem.judge

    def counted(problem: Any, points: np.ndarray, progress: Any) -> Any:
        if judged and sum(judged) < 24 and not judged[-1]:
            raise KeyboardInterrupt
        judged.append(len(points) if len(judged) != 2 else 0)
        return judge(problem, points, progress)

    monkeypatch.setattr(design_module._Problem, "judge", counted)
    with suppress(KeyboardInterrupt):
        said(f"{line} -o {tmp_path}/best", 130)
    journal = tmp_path / ".best.designs"
    kept = len(journal.read_text().splitlines()) - 1
    assert kept == 3 and not (tmp_path / "best").exists()
    with journal.open("a") as file:
        file.write("\n[[0.1, 0.2")  # as a killed run leaves it
    counts: list[int] = []

    def counting(problem: Any, points: np.ndarray, progress: Any) -> Any:
        counts.append(len(points))
        return judge(problem, points, progress)

    monkeypatch.setattr(design_module._Problem, "judge", counting)
    again = document(f"{line} -o {tmp_path}/best")
    assert again["best"] == whole["best"] and again["evaluations"] == 24 and 0 < sum(counts) < 24
    assert not journal.exists()


REFUSED = {
    "": "Missing option '--vary'",
    "--vary nes1.alpha=3": "'3' is not LOW:HIGH, as in --vary nes1.alpha=-300:-20",
    "--vary nes1.alpha=-20:-300": "the bounds must be two finite numbers, the lower one first, got -20 and -300",
    "--vary nes1.alph=-300:-20": 'unknown coefficient "nes1.alph"',
    "--vary v:m1=0:1": "a release belongs to the excitation",
    "--vary m2.mass=-1:0.1": "mass must be positive",
    "--vary nes1.c=0.01:0.1 --minimise foo": 'unknown quantity "foo"; choose from settled',
    "--vary nes1.c=0.01:0.1 --minimise rms --maximise peak": "exclude each other",
    "--vary nes1.c=0.01:0.1 --limit foo=1": 'unknown quantity "foo"; choose from added_mass',
    "--vary nes1.c=0.01:0.1 --limit peak=a": "the limit of peak must be a positive number, got 'a'",
    "--vary nes1.c=0.01:0.1 --evaluations 3": "evaluations must be a whole number from 8, got 3",
    "--vary nes1.c=0.01:0.1 --quantile 2": "quantile must be between 0 and 1, got 2.0",
    "--vary nes1.c=0.01:0.1 --minimise resonance": "On the command line: --from HZ --to HZ",
    "--vary nes1.c=0.01:0.1 --minimise resonance --from 20": "--from and --to belong together",
    "--vary nes1.c=0.01:0.1 --minimise resonance --from 20 --to 30": "needs one excitation",
    "--vary nes1.c=0.01:0.1 --levels 0,1": "levels must be positive factors of the excitation, got (0.0, 1.0)",
}


@pytest.mark.parametrize("options", REFUSED)
def test_what_cannot_be_searched_is_refused_before_the_work(options: str, tmp_path: Path) -> None:
    file = tmp_path / "chain.toml"
    lw.write_structure(CHAIN, file)
    assert REFUSED[options] in refusal(f"design {file} {options} --release v:m1=1.0 --duration 0.3")
