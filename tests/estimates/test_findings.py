"""What an answer finds on a link: energy, wells, bounds, and coefficients that feed the motion."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import chain_record
from structures import link, structure

import linkwise as lw
from linkwise.estimates.findings import bound_findings, energy_findings, link_findings, supplied_power
from linkwise.estimates.link_estimate import CoefficientEstimate, LinkEstimate
from linkwise.model.coefficient import Name

TIME = np.arange(400) / 1000.0


def link_estimate(
    law: str,
    values: dict[str, float],
    errors: list[float],
    reach: tuple[float, float],
    correlation: float = 0,
) -> LinkEstimate:
    """A link identified with these standard errors, the first two coefficients correlated."""
    covariance = np.diag(np.square(errors))
    if len(errors) > 1:
        covariance[0, 1] = covariance[1, 0] = correlation * errors[0] * errors[1]
    coefficients = tuple(
        CoefficientEstimate(
            Name("sink", name), value, "?", False, error, (value - 2 * error, value + 2 * error)
        )
        for (name, value), error in zip(values.items(), errors, strict=True)
    )
    subject = link("sink", "m2-m1", law, **values)
    return LinkEstimate(subject, coefficients, reach, (-1.0, 1.0), tuple(values), covariance, 0.01)


def sentences(estimate: LinkEstimate) -> list[str]:
    low, high = estimate.d_range
    d = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(40 * TIME)
    v = 20 * (high - low) * np.cos(40 * TIME)
    covariance = estimate.covariance
    supply = None if covariance is None else supplied_power(estimate.link, estimate.free, covariance, d, v)
    return list(link_findings(estimate, supply))


SINK = {"alpha": -100.0, "beta": 1e6, "c": 0.02}
LAW = "alpha*d + beta*d**3 + c*v"
SMALL = [0.1, 1e3, 1e-4]


def test_nothing_is_said_where_all_is_well_or_the_answer_has_no_intervals() -> None:
    assert sentences(link_estimate(LAW, SINK, SMALL, (-0.02, 0.02))) == []
    assert sentences(link_estimate(LAW, SINK, SMALL, (-0.02, 0.02), correlation=-0.99)) == []
    correlated = link_estimate(LAW, SINK, SMALL, (-0.02, 0.02), correlation=-0.999)
    assert sentences(replace(correlated, covariance=None, coefficients=())) == []


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((LAW, SINK, SMALL, (0.004, 0.015)),
         "sink never left the well at +0.01 m (d from 0.004 to 0.015 m): its barrier and its other wells"),
        ((LAW, SINK, SMALL, (0.011, 0.012)), "sink reached none of its wells (d from 0.011 to 0.012 m)"),
        # d (d^2 - 1) (d^2 - 4) has wells at -2, 0 and 2
        (("k*d - 5*d**3 + d**5", {"k": 4.0}, [0.01], (-2.2, 1.9)), "sink never reached the well at +2 m"),
        ((LAW, SINK, SMALL, (-0.02, 0.02), -0.998), "sink: alpha and beta are strongly correlated (-0.9980)"),
        ((LAW, SINK, [0.1, 1e3, 0.015], (-0.02, 0.02)), "sink.c cannot be distinguished from zero: 0.02 within ±0.015 ?."),
    ],
)  # fmt: skip
def test_what_a_record_cannot_tell_of_a_sink_is_one_sentence(given: tuple[Any, ...], said: str) -> None:
    [sentence] = sentences(link_estimate(*given))
    assert sentence.startswith(said)
    assert "never left" not in said or sentence.endswith("Use a stronger excitation.")


@pytest.mark.parametrize(
    ("c", "error", "said"),
    [(-0.02, 1e-4, True), (-0.02, 0.0066, True), (-0.02, 0.0067, False), (0.02, 1e-4, False)],
)
def test_a_link_that_gives_energy(c: float, error: float, said: bool) -> None:
    """Only where its sign is beyond doubt; c v (d^2 - e^2), negative about the middle, is positive over a swing."""
    findings = sentences(link_estimate(LAW, {**SINK, "c": c}, [0.1, 1e3, error], (-0.02, 0.02)))
    assert any("sink feeds energy into the motion" in sentence for sentence in findings) == said
    assert sentences(link_estimate("c*v*(d**2 - 0.001**2)", {"c": 5.0}, [0.1], (-0.02, 0.02))) == []


def test_a_bound_names_the_law_that_has_none() -> None:
    joint = lw.model.named_law("bouc-wen").link("joint", ("m2", "ground"))
    two = structure({"m1": 1.0, "m2": 1.0}, link("spring", "m1-ground", "k*d"), joint)
    names = [parameter.name for parameter in two.parameters]
    stopped = {"joint.s", "spring.k"}
    free = np.array([name not in stopped for name in names])
    plain, named = sorted(bound_findings(two.parameters, free, two), key=len)
    assert plain.startswith("spring.k was stopped by its bound") and "widen the bound" in plain
    assert named.startswith("joint.s was stopped")
    assert 'the law "bouc-wen-classical" has no such bound' in named
    assert not list(bound_findings(two.parameters, np.ones(len(names), dtype=bool), two))


def test_a_record_says_what_its_sink_did() -> None:
    """From the record on: after the second in which it crosses, the sink of the paper's chain stays in one well."""
    chain = lw.bnes_chain(2)
    record = chain_record(2).with_noise(30.0, seed=1)
    early = lw.identify(record.between(0.0, 3.0), chain.unknown("nes"), method="weak")
    late = lw.identify(record.between(3.0, 6.0), chain.unknown("nes"), method="weak")
    assert early.findings == ()
    assert any(finding.startswith("nes1 never left the well at +0.01") for finding in late.findings)
    assert late.findings[0].startswith("The records do not rule out a force like ")


def findings_of(law: str, amplitude: float, /, **values: float) -> list[str]:
    """What is said of a link that swings so far at 1 rad/s, its coefficients known to 1 %."""
    errors = [0.01 * abs(value) for value in values.values()]
    estimate = link_estimate(law, values, errors, (-amplitude, amplitude))
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
    assert [line.partition(" is negative")[0] for line in findings] == [f"sink.{name}" for name in named]


def test_a_law_that_feeds_energy_without_a_negative_coefficient_is_named() -> None:
    """c v (d^2 - e^2) gives about the middle: within arcsin(1/2) of it, a third of the time."""
    [finding] = findings_of("c*v*(d**2 - 0.5**2)", 1.0, c=2.0)
    assert finding.startswith("sink feeds energy for 33 % of the time into the motion")
    # friction that is smaller at larger rates is not named: -v |v| beside it is less than that everywhere
    assert findings_of("fc*sign(v) + c2*v*abs(v)", 1.0, fc=1.0, c2=-0.5) == []
    assert findings_of("fc*sign(v) + c2*v*abs(v)", 1.5, fc=1.0, c2=-0.5) != []
