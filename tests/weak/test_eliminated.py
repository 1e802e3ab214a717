"""The weak form of links with a state that is not measured: D - a, applied to the equations, eliminates it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2
from structures import harvester, host, hysteretic_oscillator, link, named, structure

import linkwise as lw

pytestmark = pytest.mark.slow


START = lw.Coefficient.unknown
SPRING = {"k": 400.0, "k3": 4e4, "c": 0.5}
BRANCH = {"k": 300.0, "c": 20.0}
PIEZO = {"alpha": -40.0, "beta": 9e4, "c": 0.1, "theta": 8e-3, "C": 5e-6, "R": 1e4}
FORCE = "6*sin(14*t) + 6*sin(23*t + 1) + 5*sin(31*t + 2) + 4*sin(47*t)"
BASE = "0.004*sin(40*t) + 0.003*sin(57*t + 1) + 0.002*sin(33*t + 2)"
SEEDS = range(4800, 4812)


def mount(
    spring: Mapping[str, float], branch: Mapping[str, lw.Coefficient | float], extra: str = ""
) -> lw.Structure:
    """A mass of 1 kg on a cubic spring beside a spring in series with a damper."""
    law = "k*d + k3*d**3 + c*v" + extra
    return structure(
        {"m1": 1.0},
        link("spring", "m1-ground", law, **spring),
        named("branch", "m1-ground", "maxwell", **branch),
    )


def asked_mount(extra: str = "") -> lw.Structure:
    """The mount with all unknown, and starts that are 20 % off."""
    return mount({}, {"k": START(1.2 * BRANCH["k"]), "c": START(BRANCH["c"] / 1.2)}, extra)


@lru_cache(maxsize=8)
def shaken(extra: str = "", size: float = 0.0) -> lw.Record:
    """The motion of the mount, perhaps with a further term in its spring."""
    spring = SPRING | ({"e": size} if extra else {})
    return lw.simulate(
        mount(spring, BRANCH, extra), forces={"m1": FORCE}, duration=10.0, rate=500.0, sensors=["x:m1"]
    )


@lru_cache(maxsize=1)
def harvesting() -> lw.Record:
    return lw.simulate(
        harvester(0.02, **PIEZO), duration=8.0, rate=500.0, base=BASE, sensors=["x:m1", "x:base"]
    )


def asked_harvester(**resistance: lw.Coefficient | float) -> lw.Structure:
    """The harvester, with starts that are 20 % off."""
    started = {"theta": START(1.2 * PIEZO["theta"]), "C": START(0.8 * PIEZO["C"])}
    return harvester(0.02, **started, **resistance)


def noisy(clean: lw.Record, snr_db: float, seed: int) -> lw.Record:
    """The record with noise on x:m1 alone."""
    noise = clean.with_noise(snr_db, seed=seed)
    own = np.array(clean.channels) == "x:m1"
    return replace(clean, values=np.where(own, noise.values, clean.values), simulated=None)


def scores(fit: lw.Estimate, true: Mapping[str, float]) -> np.ndarray:
    expected = [true[parameter.name] for parameter in fit.parameters]
    return np.asarray((fit.values - expected) / np.sqrt(fit.covariance.diagonal()))


MOUNT = {f"spring.{name}": value for name, value in SPRING.items()} | {
    f"branch.{name}": value for name, value in BRANCH.items()
}


def test_an_exact_motion_gives_the_laws() -> None:
    """To the alias of the test functions."""
    fit = lw.identify(shaken(), asked_mount(), method="weak")
    assert fit.values == pytest.approx([MOUNT[parameter.name] for parameter in fit.parameters], rel=1e-3)


@pytest.mark.parametrize(
    ("clean", "asked", "true", "count", "snr_db"),
    [
        (shaken, asked_mount(), MOUNT, 12, 30.0),
        (harvesting, asked_harvester(R=PIEZO["R"]), {f"piezo.{name}": PIEZO[name] for name in PIEZO}, 8, 40.0),
    ],
    ids=["mount", "harvester whose resistance is known"],
)  # fmt: skip
def test_intervals(
    clean: Callable[[], lw.Record], asked: lw.Structure, true: dict[str, float], count: int, snr_db: float
) -> None:
    """The mean square of each of five scores is within the central 99.8 % of chi-square.

    Those of the harvester follow the wells together, so their squares are of one number at least.
    """
    fits = [lw.identify(noisy(clean(), snr_db, seed), asked, method="weak") for seed in SEEDS[:count]]
    assert sum(fit.trusted for fit in fits) >= len(fits) - 1
    squares = np.sum([scores(fit, true) ** 2 for fit in fits], axis=0)
    low, high = chi2.ppf([0.001, 0.999], len(fits))
    assert squares.min() > low and squares.max() < high


def test_a_branch_between_two_masses() -> None:
    """The force of the branch is in both equations, and drawn once its state has forgotten where it began."""

    def chain(branch: Mapping[str, lw.Coefficient | float], **values: float) -> lw.Structure:
        return structure(
            {"m1": 1.0, "m2": 0.5},
            link("spring", "m1-ground", "k*d + c*v", **values),
            link("upper", "m2-m1", "k*d", **({"k": 250.0} if values else {})),
            named("branch", "m2-m1", "maxwell", **branch),
        )

    true = chain(BRANCH, k=400.0, c=0.5)
    clean = lw.simulate(true, forces={"m1": FORCE}, duration=10.0, rate=500.0, sensors=["x", "state"])
    record = clean.select(["x:m1", "x:m2", "force:m1"]).with_noise(50.0, seed=4850)
    fit = lw.identify(record, chain({"k": START(350.0), "c": START(17.0)}), method="weak")
    assert fit.trusted
    expected = {"spring.k": 400.0, "spring.c": 0.5, "upper.k": 250.0, "branch.k": 300.0, "branch.c": 20.0}
    assert np.abs(scores(fit, expected)).max() < 4.0
    force = fit.motion.identified_force
    assert force is not None
    known = np.isfinite(force[:, 2])
    state = np.interp(fit.motion.time, clean.time, clean.channel("state:branch.q"))
    assert known.mean() > 0.9
    assert np.std((force[:, 2] - state)[known]) < 0.02 * np.std(state)


def test_a_branch_on_a_host() -> None:
    """Its force is in the equations of both modes, and on the mass that it carries."""
    wing = host("wing", (5.2, 9.0), (0.01, 0.012), {"tip": (1.0, -0.9), "joint": (0.62, 0.5)})

    def carrying(**values: lw.Coefficient | float) -> lw.Structure:
        return structure({"store": 0.5}, named("branch", "store-wing.tip", "zener", **values), hosts=[wing])

    solid = {"k": 500.0, "k1": 300.0, "c1": 12.0}
    taps = {"wing.joint": "6*sin(14*t) + 6*sin(33*t + 1) + 5*sin(45*t + 2) + 4*sin(57*t)"}
    clean = lw.simulate(carrying(**solid), forces=taps, duration=20.0, rate=400.0, sensors=["x"])
    fit = lw.identify(
        clean.with_noise(40.0, seed=4860), carrying(k1=START(360.0), c1=START(10.0)), method="weak"
    )
    assert fit.trusted
    assert np.abs(scores(fit, {f"branch.{name}": value for name, value in solid.items()})).max() < 4.0


@pytest.mark.parametrize(("extra", "size"), [(" + e*d**5", 1e7), (" + e*sign(v)", 0.1)])
def test_a_law_that_lacks_a_term_is_not_trusted(extra: str, size: float) -> None:
    record = noisy(shaken(extra, size), 40.0, SEEDS[0])
    assert not lw.identify(record, asked_mount(), method="weak").trusted
    assert lw.identify(record, asked_mount(extra), method="weak").trusted


def two_branches() -> lw.Structure:
    branches = (named(name, "m1-ground", "maxwell", **BRANCH) for name in ("one", "other"))
    return structure({"m1": 1.0}, *branches).unknown("one")


def with_an_end_unseen() -> lw.Structure:
    spring, branch = asked_mount().links
    elsewhere = replace(branch, between=("m2", "ground"))
    return structure({"m1": 1.0, "m2": 1.0}, spring, elsewhere, link("upper", "m2-m1", "k*d"))


@pytest.mark.parametrize(
    ("clean", "asked", "message"),
    [
        (
            harvesting,  # which are in the equations as theta**2/C and 1/(R C)
            asked_harvester(R=START(PIEZO["R"])),
            r"cannot distinguish piezo.theta, piezo.R, piezo.C",
        ),
        (
            shaken,
            hysteretic_oscillator(k=400.0, c=1.5, F=12.0, x0=0.02, s=0.7).unknown("joint"),
            r"memory \(state z\).*does not enter its law and the rates linearly",
        ),
        (shaken, two_branches(), r"eliminates the single state .* this one has 2"),
        (shaken, mount({}, {}), r"k enters the rate of q, which is not measured, and needs a start"),
        (shaken, with_an_end_unseen(), r"no information on spring.k.*missing x:m2\."),
    ],
    ids=["collinear", "not linear", "two states", "no start", "an end that is not recorded"],
)
def test_unidentifiable_is_refused(clean: Callable[[], lw.Record], asked: lw.Structure, message: str) -> None:
    with pytest.raises(lw.LinkwiseError, match=message):
        lw.identify(noisy(clean(), 40.0, SEEDS[0]), asked, method="weak")
