"""Profile-likelihood intervals: Hessian's where the likelihood is a parabola, honest where it is not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.likelihood import profile
from linkwise.likelihood.fit import likelihood_fit


def number(value: float) -> lw.Coefficient:
    return lw.Coefficient.number(value)


@pytest.fixture(scope="module")
def linear() -> lw.Structure:
    return oscillator("k*d + c*v", k=400.0, c=0.4)


@pytest.fixture(scope="module")
def record(linear: lw.Structure) -> lw.Record:
    return lw.simulate(linear, release={"v:m1": 1.0}, duration=3.0, rate=200.0).with_noise(20.0, seed=3)


@pytest.fixture(scope="module")
def fit(linear: lw.Structure, record: lw.Record) -> lw.Estimate:
    return lw.identify(record, linear.unknown("all"))


@pytest.fixture(scope="module")
def softening() -> lw.Estimate:
    """A softening spring driven so little that only F*g is seen well: a large F with a small g is nearly as likely."""
    law = "F*tanh(g*d) + c*v"
    true = oscillator(law, c=0.4, F=40.0, g=10.0)
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=1.5, rate=200.0).with_noise(30.0, seed=2)
    return lw.identify(record, true.unknown("link.F", "link.g"), starts={"link.F": 40.0, "link.g": 10.0})


@pytest.mark.parametrize("name", ["link.k", "link.c"])
def test_agrees_with_the_hessian_where_the_problem_is_nearly_linear(fit: lw.Estimate, name: str) -> None:
    estimate = fit.coefficient(name)
    assert estimate.interval is not None and estimate.standard_error is not None
    # ends are sought to 1 % of a standard error; the rest is the curvature of a cosine of 1 % noise
    np.testing.assert_allclose(
        lw.likelihood.profile_interval(fit, name), estimate.interval, atol=0.04 * estimate.standard_error
    )


def test_the_cost_at_the_ends_has_risen_by_384(
    fit: lw.Estimate, linear: lw.Structure, record: lw.Record
) -> None:
    """Both ends, fitted by a whole run with the coefficient known, from elsewhere."""
    low, high = lw.likelihood.profile_interval(fit, "link.c")
    assert isinstance(fit.profile, partial)
    optimum = fit.profile.args[0]
    known = replace(record, noise={"x:m1": float(optimum.scales.sigma[0])})
    best = likelihood_fit([known], linear.unknown("all"), np.array([390.0, 0.5]))
    for end in (low, high):
        constrained = linear.unknown("link.k").with_values({"link.c": end})
        at_end = likelihood_fit([known], constrained, np.array([390.0]))
        rise = at_end.misfit.cost(optimum.q) - best.misfit.cost(optimum.q)
        assert rise / optimum.noise**2 == pytest.approx(
            3.84, abs=0.1
        )  # 1 % of a deviation at each end, twice


def test_differs_where_the_likelihood_is_no_parabola(
    softening: lw.Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimate = softening.coefficient("link.F")
    assert estimate.standard_error is not None and estimate.interval is not None
    reports: list[lw.estimates.ProgressReport] = []
    low, high = lw.likelihood.profile_interval(softening, "link.F", progress=reports.append)
    values = [report.detail for report in reports if isinstance(report.detail, float)]
    assert len(values) == len(reports)
    assert [report.fraction for report in reports] == sorted(report.fraction for report in reports)
    assert reports[-1].activity == f"link.F = {values[-1]:.6g}"
    assert low < 40.0 < high  # the true F
    assert estimate.value - low < 0.9 * 1.96 * estimate.standard_error  # a small F bends the motion visibly
    assert high - estimate.value > 1.1 * 1.96 * estimate.standard_error  # a large one does not
    assert min(values) <= low and max(values) >= high
    monkeypatch.setattr(profile, "_FARTHEST", 2.1)
    assert lw.likelihood.profile_interval(softening, "link.F")[1] == np.inf


def test_ends_at_a_bound(fit: lw.Estimate, record: lw.Record) -> None:
    estimate = fit.coefficient("link.c")
    assert estimate.standard_error is not None
    edge = estimate.value - estimate.standard_error
    bounded = oscillator(
        "k*d + c*v", k=lw.Coefficient.unknown(), c=lw.Coefficient.unknown(lower=edge, upper=10.0)
    )
    again = lw.identify(record, bounded)
    assert lw.likelihood.profile_interval(again, "link.c")[0] == edge


@pytest.mark.parametrize(
    ("change", "name", "message"),
    [
        ({}, "link.m", r'"link\.m" was not identified; the unknowns were link\.k, link\.c'),
        ({"profile": None, "method": "weak"}, "link.k", 'method "weak" has none: use "ml"'),
        ({"profile": None}, "link.k", "terms that are missing or that a discovery dropped"),
        (
            {"fit_verdicts": (lw.Verdict.NOT_CONVERGED,), "message": "Why."},
            "link.k",
            r"cannot be trusted \(not converged\): Why\.",
        ),
        ({"free": np.array([False, True])}, "link.k", "was stopped by its bound"),
    ],
)
def test_no_interval_where_none_can_be(
    fit: lw.Estimate, change: dict[str, Any], name: str, message: str
) -> None:
    with pytest.raises(lw.IdentificationError, match=message):
        lw.likelihood.profile_interval(replace(fit, **change), name)
