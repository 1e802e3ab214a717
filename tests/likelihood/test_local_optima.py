"""When a search that took many steps is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record, truth
from structures import HARDENING, host, link, structure

import linkwise as lw
from linkwise.likelihood import local_optima
from linkwise.likelihood.fit import CostShape, LikelihoodFit, likelihood_fit
from linkwise.likelihood.local_optima import (
    is_quadratic,
    is_regular,
    lower_of_two,
    profiles_rise,
    rises_by,
    rises_in_weak_directions,
)
from linkwise.likelihood.low_signal import tightest_smooth_fit
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.starts.values import starting_values


@pytest.fixture(scope="module")
def fit() -> LikelihoodFit:
    record, unknown = chain_record(2, duration=1.0).with_noise(40.0, seed=1), lw.bnes_chain(2).unknown("all")
    theta, spread = starting_values([record], unknown)
    return likelihood_fit([record], unknown, theta, spread=spread)


def lengthened(fit: LikelihoodFit, steps: int) -> LikelihoodFit:
    """The same fit after so many steps."""
    return replace(fit, path=fit.path[:1] * steps)


def test_a_search_of_many_steps_is_believed_where_the_cost_is_a_parabola(fit: LikelihoodFit) -> None:
    assert fit.status.name == "CONVERGED"
    assert is_regular(lengthened(fit, 50))
    assert not is_regular(replace(lengthened(fit, 50), covariance=16.0 * fit.covariance))


def test_parameters_whose_intervals_do_not_rest_on_the_covariance_stay(fit: LikelihoodFit) -> None:
    """As frequencies of modes that noise hides: one whose variance is much too large does not matter then."""
    factor = np.ones(len(fit.values))
    factor[0] = 10.0
    wide = replace(lengthened(fit, 50), covariance=fit.covariance * np.outer(factor, factor))
    assert not is_regular(wide)
    assert is_regular(wide, fit.segments.system.parameters.names[:1])


def test_profiles_rise_as_the_covariance_says_or_the_fit_is_not_believed(fit: LikelihoodFit) -> None:
    """Intervals a tenth as wide, or none, are no measure of the cost."""
    assert profiles_rise(fit)
    assert not profiles_rise(replace(fit, covariance=0.01 * fit.covariance))
    for none in (0.0, np.inf):
        covariance = fit.covariance.copy()
        covariance[0, 0] = none
        assert not profiles_rise(replace(fit, covariance=covariance))


def test_a_search_that_had_run_out_of_steps_is_not_believed(fit: LikelihoodFit) -> None:
    assert not is_regular(lengthened(fit, AnnealingSchedule.max_steps + 1))


def test_what_a_search_at_a_low_signal_tested_is_not_tested_again(
    fit: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the signal is low or the search long; the cost rises as the covariance says, which is then known."""
    tried: list[AnnealingSchedule] = []

    def counted(
        segments: Segments, point: Iterate, scales: Scales, schedule: AnnealingSchedule, *, loss: Loss
    ) -> AnnealingFit:
        tried.append(schedule)
        return anneal(segments, point, scales, schedule, loss=loss)

    def refit(values: object, nodes: object, relaxation: object) -> LikelihoodFit:
        raise AssertionError("no other optimum is looked for")

    known = tightest_smooth_fit(lengthened(fit, 50), refit)
    assert known.shape is CostShape.QUADRATIC
    monkeypatch.setattr(local_optima, "anneal", counted)
    assert is_regular(known)
    of_known = len(tried)
    assert is_regular(lengthened(fit, 50))
    assert 0 < of_known < len(tried) - of_known
    tried.clear()
    assert is_regular(replace(known, shape=CostShape.REGULAR))
    assert not tried


def test_the_lower_of_two_optima_is_looked_at_as_the_longer_search_was(fit: LikelihoodFit) -> None:
    lower = replace(lengthened(fit, 3), chi_square=fit.chi_square - 0.01)
    chosen = lower_of_two(lengthened(fit, 40), lambda values: lower)
    assert chosen.chi_square == lower.chi_square
    assert len(chosen.path) == 40


@pytest.mark.parametrize("parameter", [0, 3])
def test_a_look_that_ends_early_has_seen_a_lower_bound_of_the_rise(
    fit: LikelihoodFit, parameter: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looks to the end bracket the expected rise within a tenth."""
    is_fixed = np.arange(len(fit.values)) == parameter
    deviation = float(np.sqrt(fit.covariance[parameter, parameter]))
    moved = fit.values + 3.0 * fit.covariance[parameter] / deviation
    statuses: list[AnnealingStatus] = []

    def watched(*args: object, **options: object) -> AnnealingFit:
        annealed = anneal(*args, **options)  # type: ignore[arg-type]
        statuses.append(annealed.status)
        return annealed

    monkeypatch.setattr("linkwise.likelihood.local_optima.anneal", watched)
    assert rises_by(0.1, fit, moved, is_fixed, 3.0)
    assert rises_by(0.9, fit, moved, is_fixed, 3.0)
    assert not rises_by(1.1, fit, moved, is_fixed, 3.0)
    assert statuses[0] is AnnealingStatus.COSTLY
    assert statuses[2] is AnnealingStatus.CONVERGED


@pytest.mark.parametrize("seed", [1, 2, 6])
def test_a_valley_that_bends_is_told(seed: int) -> None:
    """Two masses that move in one mode: two dampers share its decay, and were up to 22 standard errors off, and trusted."""
    pair = structure(
        {"m1": 3.4, "m2": 0.38},
        link("m2-ground", "m2-ground", HARDENING, k=1830.0, k3=-2.4e4, c=0.565),
        link("m1-m2", "m1-m2", HARDENING, k=6900.0, k3=-1.4e6, c=1.47),
    )
    clean = lw.simulate(pair, release={"v:m2": -1.168, "v:m1": -1.2275}, duration=15.64, rate=300.0)
    fit = lw.identify(clean.with_noise(17.0, seed=seed), pair.unknown("all"))
    off = np.abs(fit.values - truth(pair, fit.given_structure)) / np.sqrt(fit.covariance.diagonal())
    assert not fit.trusted or off.max() < 5.0


def test_checks_know_the_inertia_of_an_unknown_mass_in_coordinates_of_the_base() -> None:
    """With all parameters held, forces of inertia were those of the masses that the structure states, here none."""
    storeys = structure(
        {"m1": 1.3, "m2": 1.0},
        link("lower", "m1-base", "k*d + c*v", k=2000.0, c=1.0),
        link("upper", "m2-m1", "k*d + c*v", k=1500.0, c=0.5),
    )
    record = lw.simulate(
        storeys,
        duration=4.0,
        rate=500.0,
        base="0.01*sin(35*t) + 0.004*sin(61*t)",
        sensors=("a:m1", "a:m2", "a:base"),
    ).with_noise(30.0, seed=1)
    unknown = storeys.unknown("all", "mass:m1")
    theta, spread = starting_values([record], unknown)
    fit = likelihood_fit([record], unknown, theta, spread=spread)
    assert fit.status is AnnealingStatus.CONVERGED
    assert is_quadratic(fit) and rises_in_weak_directions(fit)
    assert not is_quadratic(replace(fit, covariance=16.0 * fit.covariance))


def test_dampings_between_modes_of_which_little_is_known_are_fitted_again() -> None:
    """They shift the frequency of a mode by their squares: the cost is no parabola of all, but one of what is unknown.

    The masses of a structure without points have the same unknowns, which are all moved and held.
    """

    def joined(first: object, second: object, between: object, **values: object) -> lw.Structure:
        shapes = {"tip": (0.6, 0.5), "mid": (0.4, -0.5)}
        wing = host("wing", (first, second), 0.01, shapes, {(1, 2): between})  # type: ignore[arg-type, dict-item]
        return structure({}, link("joint", "wing.tip-ground", "k3*d**3 + c*v", **values), hosts=[wing])  # type: ignore[arg-type]

    known_to_within = lw.Coefficient.unknown
    record = lw.simulate(
        joined(5.0, 12.0, 0.0, k3=2e4, c=0.05),
        forces={"wing.mid": "5*sin(2*pi*(2*t + 0.5*t**2))"},
        duration=8.0,
        rate=200.0,
        sensors=["a:wing.tip"],
    ).with_noise(20.0, seed=4)
    unknown = joined(
        known_to_within(5.0, sigma=0.25),
        known_to_within(12.0, sigma=0.6),
        known_to_within(0.0, sigma=3.0),
        k3=lw.Coefficient.unknown(2e4),
        c=lw.Coefficient.unknown(0.05),
    )
    theta = np.array([parameter.start for parameter in unknown.parameters])
    fit = likelihood_fit([record], unknown, theta)
    assert fit.status is AnnealingStatus.CONVERGED
    assert is_regular(lengthened(fit, 50))
    of_cubic = np.where(np.array(fit.segments.system.parameters.names) == "joint.k3", 4.0, 1.0)
    assert not is_quadratic(replace(fit, covariance=fit.covariance * np.outer(of_cubic, of_cubic)))
    system = fit.segments.system
    without_points = replace(fit.segments, system=replace(system, points=system.points[:0]))
    assert not is_quadratic(replace(fit, segments=without_points))
