"""Everything that the likelihood must take in its stride: laws, sensors, inputs, several records, bounds, outliers."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present, some
from problems import chain_record
from random_signals import random_force
from structures import asked_oscillator, equal_sinks, link, oscillator, row_of_masses, structure
from within import assert_within, errors

import linkwise as lw

pytestmark = pytest.mark.slow


def two(law: str, *, ground: str = "ground", **values: float) -> lw.Structure:
    """A frame of 1 kg at 10 Hz that carries 0.2 kg through a link under `law`."""
    frame = link("frame", f"m1-{ground}", "k*d + c*v", k=4000.0, c=2.0)
    return structure({"m1": 1.0, "m2": 0.2}, frame, link("link", "m2-m1", law, **values))


@dataclass(frozen=True)
class Case:
    """What is driven, seen with noise in dB for some s at some Hz, and asked; standard errors that must not be larger."""

    true: lw.Structure
    drive: dict[str, Any]
    sensors: tuple[str, ...] = ("x",)
    snr_db: float = 40.0
    span: tuple[float, float] = (2.0, 1000.0)
    unknown: tuple[str, ...] = ("all",)
    starts: dict[str, float] = field(default_factory=dict)
    largest: dict[str, float] = field(default_factory=dict)

    def record(self, seed: int) -> lw.Record:
        duration, rate = self.span
        clean = lw.simulate(self.true, duration=duration, rate=rate, sensors=self.sensors, **self.drive)
        return clean.with_noise(self.snr_db, seed=seed)


FORCE: dict[str, Any] = {"forces": {"m1": "30*sin(50*t) + 20*sin(71*t + 1)"}}
BASE = {"base": "0.002*sin(55*t) + 0.001*sin(83*t)"}
CUBIC = {"k": 500.0, "c": 0.5, "b": 1e6}
DUFFING = oscillator("k*d + c*v + k3*d**3", mass=1.3, name="spring", k=1500.0, c=1.5, k3=2e5)
RANDOM = {
    "forces": {
        "m1": random_force(np.random.default_rng(3), 10.0, 400.0, rms=8.0, highest=20.0, band_limited=True)
    }
}
MIXED = [("x:m1", "v:m2"), ("x:m1", "a:m2"), ("x:m1", "a:m1", "x:m2")]
CASES = {
    "gap": Case(
        two("k*d + c*v + s*max(d - g, 0)", k=500.0, c=0.5, s=8000.0, g=0.004),
        FORCE,
        unknown=("link",),
        starts={"link.k": 600.0, "link.c": 0.3, "link.s": 5000.0, "link.g": 0.005},
        largest={"link.g": 2e-5},  # in 4 mm; 1.3e-5 to 1.6e-5 on seeds 2000 to 2007
    ),
    "friction": Case(
        two("k*d + F*tanh(v/s)", k=500.0, F=3.0, s=0.1),
        FORCE,
        unknown=("link",),
        starts={"link.k": 600.0, "link.F": 2.0, "link.s": 0.2},
        largest={"link.s": 0.006},  # 0.0046 to 0.0048 on seeds 2000 to 2007
    ),
    "masses under a force": Case(
        two("k*d + c*v", k=500.0, c=0.5),
        FORCE,
        unknown=("all", "mass:m1", "mass:m2"),
        largest={"m2.mass": 1.5e-4},  # kg of 0.2; its interval is 3.9e-4 to 4.1e-4 wide on seeds 2000 to 2007
    ),
    "friction under two hits": Case(
        oscillator("k*d + k3*d**3 + F*tanh(v/0.02) + c*v", mass=0.1, k=3000.0, k3=2e9, F=1.5, c=0.1),
        {"forces": {"m1": "80*exp(-((t - 0.02)/0.002)**2) + 60*exp(-((t - 0.17)/0.002)**2)"}},
        ("a",),
        30.0,
        (0.3, 2000.0),
    ),
    "five samples a period": Case(
        row_of_masses(
            [1.0, 0.5],
            first=("k*d + k3*d**3 + c*v", {"k": 2e4, "k3": 1e7, "c": 1.0}),
            second=("k*d + k3*d**3 + c*v", {"k": 3e4, "k3": 2e7, "c": 1.5}),
        ),
        {"release": {"v:m1": 2.0, "v:m2": -2.0}},
        snr_db=30.0,
        span=(5.45, 275.0),
    ),
    "moving base": Case(two("k*d + c*v + b*d**3", ground="base", **CUBIC), BASE),
    "unknown mass by a": Case(DUFFING, RANDOM, ("a",), span=(10.0, 400.0), unknown=("all", "mass:m1")),
    **{
        " ".join(sensors): Case(lw.bnes_chain(2), {"release": {"v:m1": 1.0}}, sensors, 30.0, (3.0, 1000.0))
        for sensors in MIXED
    },
}


@pytest.mark.parametrize(("seed", "name"), list(enumerate(CASES, start=1)))
def test_coefficients_are_found_within_their_errors(seed: int, name: str) -> None:
    case = CASES[name]
    record = case.record(seed)
    fit = lw.identify(record, case.true.unknown(*case.unknown), starts=case.starts or None)
    assert_within(fit, case.true)
    for coefficient, largest in case.largest.items():
        assert present(fit.coefficient(coefficient).standard_error) < largest
    for channel, noise in some(fit.noise.items()):  # of 800 samples and more: 2.5 / sqrt(2 800)
        assert noise.sigma == pytest.approx(present(record.simulated).noise[channel], rel=0.1)
    if name in map(" ".join, MIXED):
        assert sinks(2, fit, record) < LARGEST_NMSE / 10


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    return lw.bnes_chain(2)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return chain_record(2, duration=2.0, sensors=("x", "v", "a"))  # one second of jumps between the wells


def test_a_shared_coefficient_is_one_unknown() -> None:
    true = lw.bnes_chain(4)
    shared = equal_sinks().unknown("nes")
    record = chain_record(4, duration=2.0).with_noise(30.0, seed=3)
    fit, apart = lw.identify(record, shared), lw.identify(record, true.unknown("nes"))
    assert len(fit.parameters) == 5
    assert_within(fit, true)
    assert fit.coefficient("nes1.alpha").value == fit.coefficient("nes2.alpha").value
    # two sinks tell more of it than the better one
    assert present(fit.coefficient("nes1.c").standard_error) < min(
        present(apart.coefficient(f"nes{i}.c").standard_error) for i in (1, 2)
    )


@pytest.mark.parametrize(
    ("name", "bounds", "stopped"),
    [
        ("c", "start = 0.05, lower = 0.03", 0.03),
        ("alpha", "start = -80.0, lower = -90.0, upper = 0.0", -90.0),
        ("alpha", "start = -80.0, lower = -200.0, upper = 0.0", None),
    ],
)
def test_a_coefficient_that_leaves_its_bounds_ends_at_them(
    name: str, bounds: str, stopped: float | None, chain: lw.Structure, clean: lw.Record
) -> None:
    """However far inside it starts: one that stays where it is would be taken for an estimate."""
    text = lw.model.format_structure(chain.unknown("nes"))
    bounded = lw.parse_structure(text.replace(f'{name} = "unknown"', f"{name} = {{ {bounds} }}"))
    starts = {"nes1.alpha": -80.0, "nes1.beta": 9e5, "nes1.c": 0.05}
    noisy = clean.select(["x:m1", "x:m2"]).with_noise(30.0, seed=4)
    fit = lw.identify(noisy, bounded, starts=starts, as_stated=True)
    found = fit.coefficient(f"nes1.{name}")
    if stopped is not None:
        assert found.value == stopped and found.interval is None and found.standard_error is None
    told = [line for line in fit.findings if f"nes1.{name} was stopped by its bound" in line]
    assert bool(told) == (stopped is not None)
    if stopped is None:
        assert_within(fit, chain)


def test_gaps_and_single_losses_carry_no_weight(chain: lw.Structure, clean: lw.Record) -> None:
    record = clean.select(["x:m1", "x:m2"]).with_noise(30.0, seed=7)
    # a level found anew moves every interval
    record = replace(record, noise=dict(present(record.simulated).noise))
    values = record.values.copy()
    values[500:560] = np.nan  # 60 ms of both, five periods of the frame in all
    values[np.random.default_rng(1).random(len(values)) < 0.1, 1] = np.nan
    fit = lw.identify(replace(record, values=values), chain.unknown("all"))
    assert_within(fit, chain)
    assert fit.samples == np.isfinite(values).sum()
    whole = lw.identify(record, chain.unknown("all"))
    # information is lost with samples, at most as many as the poorer channel has lost; 4 to 6 % on seeds 2000 to 2005
    ratio = np.sqrt(np.diag(fit.covariance) / np.diag(whole.covariance))
    share = np.mean(np.isfinite(values), axis=0).min()
    assert (ratio > 1.0).all() and (ratio < 1.0 / np.sqrt(share)).all()


def test_long_gaps_everywhere_are_refused() -> None:
    """Bursts of 15 samples leave no window of the weak form, and are not guessed at."""
    true = two("k*d + c*v + b*d**3", k=500.0, c=0.5, b=1e6)
    record = Case(true, {"release": {"v:m1": 1.0}}, snr_db=30.0).record(12)
    values = np.where(np.arange(len(record))[:, None] % 30 < 15, np.nan, record.values)
    with pytest.raises(lw.IdentificationError, match="too many samples are missing"):
        lw.identify(replace(record, values=values), true.unknown("all"))


def test_two_records_tell_more_than_either(chain: lw.Structure) -> None:
    first = chain_record(2, duration=1.5).with_noise(30.0, seed=8)
    second = chain_record(2, duration=0.8, rate=1500.0, hit="m2", speed=-3.0).with_noise(30.0, seed=9)
    unknown = chain.unknown("all")
    both = lw.identify([first, second], unknown)
    alone = [lw.identify(record, unknown) for record in (first, second)]
    assert_within(both, chain)
    assert both.samples == sum(single.samples for single in alone)
    information = sum(np.linalg.inv(single.covariance) for single in alone)
    joint = np.linalg.inv(both.covariance)
    # Fisher's information adds up. The noise is one figure for both records, which were at different levels
    assert (np.diag(both.covariance) < np.min([np.diag(single.covariance) for single in alone], axis=0)).all()
    # and moves the sum by 0.2 % at most on seeds 2000 to 2007
    assert np.trace(np.linalg.solve(information, joint)) / 5 == pytest.approx(1.0, abs=0.01)


def test_outliers_bend_the_gaussian_and_not_the_robust(chain: lw.Structure, clean: lw.Record) -> None:
    record = clean.select(["x:m1", "x:m2"]).with_noise(40.0, seed=13)
    random = np.random.default_rng(2)
    values = record.values.copy()
    bad = random.random(values.shape) < 0.03
    sigma = np.array([present(record.simulated).noise[name] for name in record.channels])
    values[bad] += (random.uniform(20.0, 60.0, values.shape) * sigma)[bad]  # all to one side
    spoiled = replace(record, values=values, noise=dict(present(record.simulated).noise))
    unknown = chain.unknown("all")
    losses = (lw.likelihood.Gaussian(), lw.likelihood.Huber(), lw.likelihood.Student())
    plain, *robust = (lw.identify(spoiled, unknown, loss=loss, as_stated=True) for loss in losses)
    assert not plain.trusted
    true = np.array([chain.coefficient(p.name).value for p in unknown.parameters])
    deviation = np.sqrt(np.diag(lw.identify(replace(record, noise={}), unknown, as_stated=True).covariance))
    wrong, *right = (np.max(np.abs(fit.values - true) / deviation) for fit in (plain, *robust))
    # on seeds 2000 to 2005 the Gaussian is off by 6.3 to 16.6 deviations of the record without outliers, the others by 0.8
    # to 2.3, which is 6 to 35 % of it
    assert wrong > 4.0 > max(right)
    # of the 6 to 35 % above
    assert max(right) < 0.5 * wrong


def test_two_runs_are_equal(chain: lw.Structure, clean: lw.Record, monkeypatch: pytest.MonkeyPatch) -> None:
    record = clean.select(["x:m1", "x:m2"]).with_noise(20.0, seed=16)
    first, second = (lw.identify(record, chain.unknown("all")) for _ in range(2))
    assert np.array_equal(first.values, second.values)
    assert np.array_equal(first.covariance, second.covariance)
    monkeypatch.setattr("linkwise.likelihood.fit.processors", lambda: 1)
    alone = lw.identify(record, chain.unknown("all"))
    assert np.array_equal(first.values, alone.values)


def test_an_interrupt_returns_the_best_so_far(chain: lw.Structure, clean: lw.Record) -> None:
    record = clean.select(["x:m1", "x:m2"]).with_noise(20.0, seed=17)
    reports: list[lw.likelihood.AnnealingStep] = []

    def stop(report: lw.estimates.ProgressReport) -> None:
        assert isinstance(report.detail, lw.likelihood.AnnealingStep)
        reports.append(report.detail)
        if len(reports) == 2:
            raise KeyboardInterrupt

    fit = lw.identify(record, chain.unknown("all"), progress=stop)
    assert len(reports) == 2 and reports[0].step == 0 and reports[0].q > reports[1].q
    assert fit.status == "not converged" and "nterrupted" in fit.message and "best so far" in fit.message
    assert fit.coefficient("nes1.alpha").interval is None
    # after two steps 1 to 20 % are left on seeds 2000 to 2007; the starting value may be off by any factor
    assert fit.coefficient("nes1.alpha").value == pytest.approx(-100.0, rel=0.4)


def test_without_any_start_it_says_which_are_missing() -> None:
    true = two("k*d + F*tanh(v/s)", k=500.0, F=3.0, s=0.1)
    record = Case(true, FORCE, ("v:m1",)).record(20)
    with pytest.raises(lw.IdentificationError, match=r"no starting value for .*link\.s.*start = "):
        lw.identify(record, true.unknown("link"))
    chain = lw.bnes_chain(4)
    short = chain_record(4, duration=0.02).with_noise(40.0, seed=1)
    with pytest.raises(lw.IdentificationError, match=r"no starting value for (\S+, ){5}\S+ and \d+ more: "):
        lw.identify(short, chain.unknown("all"))


FIRST = 1000  # seed
LARGEST_NMSE = 1e-2  # % at 20 dB, that of the worst seed in bench_likelihood.py; ten decibels less noise are a tenth of it


def off(structure: lw.Structure, seed: int, factor: float) -> dict[str, float]:
    """Starts that are the truth times or over `factor`, by lot."""
    rng = np.random.default_rng(seed)
    names = [parameter.name for parameter in structure.unknown("all").parameters]
    return {
        name: float(structure.coefficient(name).value or 0.0) * factor ** rng.choice([-1.0, 1.0])
        for name in names
    }


def sinks(n: int, fit: lw.Estimate, record: lw.Record) -> float:
    """Mean NMSE of the sinks in %."""
    chain = lw.bnes_chain(n)
    names = [f"nes{i}" for i in range(1, n // 2 + 1)]
    return float(np.mean([lw.nmse(chain.link(name), fit.structure.link(name), record) for name in names]))


def test_starts_off_by_a_factor_of_two_reach_the_same_optimum() -> None:
    chain, clean = lw.bnes_chain(4), chain_record(4, duration=3.0)
    record = clean.with_noise(20.0, seed=FIRST)
    fit = lw.identify(record, chain.unknown("all"), starts=off(chain, FIRST, 2.0))
    assert fit.trusted, fit.message
    assert sinks(4, fit, clean) < LARGEST_NMSE


def test_a_hidden_primary_is_found_through_its_sink() -> None:
    chain, clean = lw.bnes_chain(2), chain_record(2, duration=3.0, sensors=("x:m2",))
    good, seeds = 0, 2
    for seed in range(FIRST, FIRST + seeds):
        record = clean.with_noise(30.0, seed=seed)
        fit = lw.identify(record, chain.unknown("all"), starts=off(chain, seed, 1.2))
        good += fit.trusted and np.abs(errors(fit, chain)).max() < 5.0
    assert good >= seeds - 1  # 18 of 20 are asked for: of two, both fail with a chance of 1 %


def test_the_circuit_runs_free_to_a_third_of_a_millivolt(shared_data: Path) -> None:
    record = lw.read_record(shared_data / "silverbox_multisine.csv")
    circuit = asked_oscillator("k*d + k2*d**2 + k3*d**3 + c*v + f0")
    trained = 4 * len(record) // 5
    # what follows is identified as well from it as from the four fifths
    used = record[: len(record) // 10]
    steps: list[lw.estimates.ProgressReport] = []
    fit = lw.identify(used, circuit, progress=steps.append, as_stated=True)
    assert len(steps) < 60  # 38 of the search
    # 0.306 to 0.310 mV from all of it or its first 30 or 50 %; the record's description gives 0.3 mV for these terms
    assert lw.analysis.free_run(fit.structure, record[trained:], settling=50).rmse["x:m1"] < 3.5e-4
