"""Links that feed energy into a part of their motion are named, with the coefficients that are negative for it."""

import numpy as np
import pytest
from problems import chain_record
from structures import link, oscillator

import linkwise as lw
from linkwise.estimates.findings import energy_findings
from linkwise.estimates.link_estimate import CoefficientEstimate, LinkEstimate
from linkwise.model.names import Name

RIG = oscillator("k*d + c*v + fc*tanh(v/0.01)", name="spring", k=1000.0, c=2.0, fc=-0.5)


def test_negative_friction_is_named_where_the_link_as_a_whole_dissipates() -> None:
    clean = lw.simulate(RIG, release={"x:m1": 0.1}, duration=4.0, rate=500.0)
    fit = lw.identify(clean.with_noise(40.0, seed=3), RIG.unknown("all"))
    high = (fit.coefficient("spring.fc").interval or (np.nan, np.nan))[1]
    assert fit.trusted and high < 0.0
    assert [line for line in fit.findings if line.startswith("spring.fc is negative")]
    assert not [line for line in fit.findings if line.startswith(("spring.c is", "spring.k is"))]


def test_negative_stiffness_of_a_bistable_link_is_not_named(chain: lw.Structure) -> None:
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=3)
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.coefficient("nes1.alpha").value < 0.0
    assert not [line for line in fit.findings if "is negative" in line]


def findings_of(law: str, amplitude: float, /, **values: float) -> list[str]:
    """What is said of a link that swings so far at 1 rad/s, its coefficients known to 1 %."""
    errors = {name: 0.01 * abs(value) for name, value in values.items()}
    estimates = tuple(
        CoefficientEstimate(
            Name("link", name), value, "?", False, error, (value - 2 * error, value + 2 * error)
        )
        for (name, value), error in zip(values.items(), errors.values(), strict=True)
    )
    subject = link("link", "m1-ground", law, **values)
    covariance = np.diag(np.square(list(errors.values())))
    reach = (-amplitude, amplitude)
    estimate = LinkEstimate(subject, estimates, reach, reach, tuple(values), covariance, 1.0)
    phase = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    return list(energy_findings(estimate, amplitude * np.sin(phase), amplitude * np.cos(phase)))


FALLING = "c*v + c2*v*d**2"


@pytest.mark.parametrize(
    ("amplitude", "c", "c2", "named"),
    [
        (0.9, 2.0, -2.0, []),  # damping falls with the elongation, to a fifth: it takes energy everywhere
        (1.2, 2.0, -2.0, ["c2"]),  # and gives it beyond 1 m
        (0.9, -2.0, 1.0, ["c"]),
        (2.0, -2.0, 1.0, ["c"]),  # about the middle, where the swing as a whole loses energy
        (2.0, 2.0, 1.0, []),
    ],
)
def test_a_coefficient_that_feeds_energy_is_named(
    amplitude: float, c: float, c2: float, named: list[str]
) -> None:
    findings = findings_of(FALLING, amplitude, c=c, c2=c2)
    assert [line.partition(" is negative")[0] for line in findings] == [f"link.{name}" for name in named]


def test_a_law_that_feeds_energy_without_a_negative_coefficient_is_named() -> None:
    """c v (d^2 - e^2) gives about the middle: within arcsin(1/2) of it, a third of the time."""
    [finding] = findings_of("c*v*(d**2 - 0.5**2)", 1.0, c=2.0)
    assert finding.startswith("link feeds energy for 33 % of the time into the motion")
    # friction that is smaller at larger rates is not named: -v |v| beside it is less than that everywhere
    assert findings_of("fc*sign(v) + c2*v*abs(v)", 1.0, fc=1.0, c2=-0.5) == []
    assert findings_of("fc*sign(v) + c2*v*abs(v)", 1.5, fc=1.0, c2=-0.5) != []


def test_a_coefficient_whose_interval_holds_zero_is_not_named() -> None:
    subject = link("link", "m1-ground", "c*v", c=-1.0)
    estimates = (CoefficientEstimate(Name("link", "c"), -1.0, "?", False, 0.6, (-2.2, 0.2)),)
    estimate = LinkEstimate(subject, estimates, (-1.0, 1.0), (-1.0, 1.0), ("c",), np.array([[0.36]]), 1.0)
    d = np.sin(np.linspace(0.0, 6.0, 500))
    assert not list(energy_findings(estimate, d, np.gradient(d, 6.0 / 499)))
