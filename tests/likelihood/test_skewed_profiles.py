"""Intervals of coefficients whose likelihood is a wall on one side and falls slowly on the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from present import present
from problems import truth

import linkwise as lw
from linkwise.arrays import Bools, Floats
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood import local_optima, skewed_profiles
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.judgement import Judgement
from linkwise.likelihood.local_optima import rise_of_profile
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.skewed_profiles import (
    _accelerations,
    _added,
    _Profiles,
    _reach,
    with_skewed_profiles,
)
from linkwise.likelihood.starts.values import starting_values
from linkwise.verdict import Verdict

CHAIN = lw.bnes_chain(2)
UNKNOWN = CHAIN.unknown("all")
ALPHA = [parameter.name for parameter in UNKNOWN.parameters].index("nes1.alpha")
TRUSTED = Judgement(Verdict.CONVERGED, "The laws explain the record to within its noise.")

Rise = Callable[..., tuple[float, bool]]


def released(speed: float, duration: float, decibel: float, seed: int) -> lw.Record:
    clean = lw.simulate(CHAIN, release={"v:m1": speed}, duration=duration, rate=1000.0)
    return clean.with_noise(decibel, seed=seed)


def fitted(record: lw.Record) -> LikelihoodFit:
    theta, spread = starting_values([record], UNKNOWN)
    return likelihood_fit([record], UNKNOWN, theta, spread=spread)


@pytest.fixture(scope="module")
def skewed() -> LikelihoodFit:
    """A motion that nearly rests between the wells, after a search of few steps."""
    return fitted(released(0.7, 2.0, 20.0, 5730328))


@pytest.fixture(scope="module")
def even() -> LikelihoodFit:
    return fitted(released(1.0, 1.0, 40.0, 5730001))


@pytest.mark.parametrize(
    ("release", "forces", "decibel", "seed"),
    [
        ({"v:m1": -0.4220103447085346, "v:m2": 0.8092605186998718}, {}, 20.0, 5720330),
        ({}, {"m1": "32.596*sin(145.127*t) + 32.475*sin(205.849*t)"}, 16.0, 5730064),
    ],
)
def test_intervals_reach_the_truth_on_the_slow_side(
    release: dict[str, float], forces: dict[str, str], decibel: float, seed: int
) -> None:
    """These were more than 7 standard errors off in alpha, and trusted."""
    clean = lw.simulate(CHAIN, release=release, forces=forces, duration=3.0, rate=1000.0)
    estimate = lw.identify(clean.with_noise(decibel, seed=seed), UNKNOWN)
    off = np.abs(estimate.values - truth(CHAIN, UNKNOWN)) / np.sqrt(estimate.covariance.diagonal())
    assert estimate.trusted
    assert off.max() < 3.5
    assert "The likelihood falls slowly on one side of nes1.alpha (" in estimate.message


def test_another_optimum_behind_the_wall_takes_trust_away() -> None:
    """At a low signal, the laws held loosely: alpha was 7 standard errors off, and 5 with the slow side alone."""
    estimate = lw.identify(released(2.0, 2.0, 10.0, 5750348), UNKNOWN)
    off = np.abs(estimate.values - truth(CHAIN, UNKNOWN)) / np.sqrt(estimate.covariance.diagonal())
    assert off.max() > 5.0
    assert estimate.status == "several optima" and not estimate.trusted
    assert "or rises again beyond" in estimate.message


def test_the_acceleration_is_the_third_difference_of_the_profile(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To within the fifth derivative over a fifth of a standard error."""
    monkeypatch.setattr(local_optima, "_PRECISION", 1e-5)
    error, distance = float(np.sqrt(skewed.covariance[ALPHA, ALPHA])), 0.2
    rises = []
    for side in (1.0, -1.0):
        step = np.array([side * distance * error])
        rise, converged = rise_of_profile(skewed, np.array([ALPHA]), step, distance)
        assert converged
        rises.append(rise)
    acceleration = _accelerations(skewed, None)[ALPHA]
    assert acceleration < -1.0
    assert acceleration == pytest.approx((rises[1] - rises[0]) / (2.0 * distance), rel=0.1)


def test_coefficients_at_a_bound_stay_there_along_profiles(skewed: LikelihoodFit) -> None:
    alone = replace(skewed, free=np.arange(len(skewed.values)) == ALPHA)
    held, free = (present(_Profiles.of(fit, None)) for fit in (alone, skewed))
    deviation = np.linalg.inv(free.covariance)[ALPHA, ALPHA] ** -0.5
    assert held.tangents[ALPHA] == pytest.approx(np.where(alone.free, deviation, 0.0), rel=1e-8)
    assert _accelerations(alone, None).keys() == {ALPHA}


def test_the_acceleration_is_a_second_derivative(skewed: LikelihoodFit) -> None:
    profiles = present(_Profiles.of(skewed, None))
    tangent = profiles.tangents[ALPHA]
    whole, half = profiles.acceleration(tangent, 1.0), profiles.acceleration(2.0 * tangent, 0.5)
    assert np.allclose(half, 4.0 * whole, rtol=1e-8, atol=1e-8)


def test_a_search_that_ended_early_does_not_seem_skewed(even: LikelihoodFit) -> None:
    """What is left of the gradient is no part of the acceleration."""
    optimum = even.optimum
    theta = even.values + 0.5 * even.covariance[:, ALPHA] / np.sqrt(even.covariance[ALPHA, ALPHA])
    point = replace(optimum.point, theta=theta)
    misfit = evaluate(optimum.segments, point, optimum.scales, optimum.loss)
    early = replace(even, optimum=replace(optimum, point=point), misfit=misfit)
    before, after = (present(_Profiles.of(fit, None)) for fit in (even, early))
    for number in range(len(theta)):
        own, moved = (
            profiles.acceleration(profiles.tangents[number], 1.0)[number] for profiles in (before, after)
        )
        assert moved == pytest.approx(own, abs=0.05)


def test_an_even_likelihood_is_left_as_it_is(even: LikelihoodFit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without one profile that is followed."""

    def unexpected(*arguments: object) -> tuple[float, bool]:
        raise AssertionError("a profile is followed")

    monkeypatch.setattr(skewed_profiles, "rise_of_profile", unexpected)
    assert with_skewed_profiles(TRUSTED, even) is TRUSTED


def test_only_exact_laws_and_white_noise_are_looked_at(skewed: LikelihoodFit) -> None:
    assert with_skewed_profiles(TRUSTED, skewed).for_skewed_profiles is not None
    inexact = replace(TRUSTED, verdict=Verdict.MODEL_ERROR_NEEDED)
    assert with_skewed_profiles(inexact, skewed) is inexact
    coloured: Any = replace(skewed, optimum=replace(skewed.optimum, coloured=cast(Any, object())))
    random: Any = replace(skewed, random_forces=cast(Any, (object(),)))
    known = replace(skewed, free=np.zeros(len(skewed.values), dtype=bool))
    for fit in (coloured, random, known):
        assert with_skewed_profiles(TRUSTED, fit) is TRUSTED


@pytest.mark.parametrize(("times", "is_said"), [(1.04, False), (1.06, True), (4.0, True)])
def test_the_interval_reaches_as_far_as_the_profile(
    skewed: LikelihoodFit, times: float, is_said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rising(lambda d: (d / times) ** 2))
    judgement = with_skewed_profiles(TRUSTED, skewed)
    if not is_said:
        assert judgement is TRUSTED
        return
    variance = (skewed.covariance + present(judgement.for_skewed_profiles))[ALPHA, ALPHA]
    assert variance == pytest.approx(times**2 * skewed.covariance[ALPHA, ALPHA], rel=1e-12)
    assert f"slowly on one side of nes1.alpha ({times:.2g} times)" in judgement.message


def test_where_laws_hold_loosely_the_steep_side_is_looked_over(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Along the profile, beyond where noise alone leads."""
    moved = []

    def rises(least: float, fit: LikelihoodFit, theta: Floats, is_fixed: Bools, distance: float) -> bool:
        assert np.flatnonzero(is_fixed).tolist() == [ALPHA]
        moved.append((theta - fit.values)[ALPHA] / np.sqrt(fit.covariance[ALPHA, ALPHA]))
        return distance < 7.0

    monkeypatch.setattr(skewed_profiles, "is_loosened", lambda fit: True)
    monkeypatch.setattr(skewed_profiles, "rises_by", rises)
    assert with_skewed_profiles(TRUSTED, skewed).verdict is Verdict.SEVERAL_OPTIMA
    assert moved == pytest.approx([6.0, 9.0])  # it falls slowly to negative ones


@pytest.mark.parametrize("slow", [1.0, -1.0])
def test_both_sides_are_followed_where_a_motion_that_runs_away_hides_the_slow_one(
    skewed: LikelihoodFit, slow: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rise(fit: object, moved: object, step: Floats, distance: float) -> tuple[float, bool]:
        return (0.25 if slow * step[0] > 0.0 else 1.0), True

    monkeypatch.setattr(skewed_profiles, "_accelerations", lambda *arguments: {ALPHA: float("nan")})
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rise)
    assert "nes1.alpha (2 times)" in with_skewed_profiles(TRUSTED, skewed).message


def test_faint_parameters_and_records_in_pieces_are_left_out(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert with_skewed_profiles(TRUSTED, skewed, ["nes1.alpha"]) is TRUSTED
    monkeypatch.setattr(skewed_profiles, "is_long", lambda segments: True)
    assert with_skewed_profiles(TRUSTED, skewed) is TRUSTED


def test_a_profile_whose_end_is_not_found_forbids_trust(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", lambda *arguments: (0.0, True))
    judgement = with_skewed_profiles(TRUSTED, skewed)
    assert judgement.verdict is Verdict.SEVERAL_OPTIMA
    assert "the likelihood of nes1.alpha falls steeply on one side" in judgement.message
    assert "no interval is given" in judgement.message


def rising(cost: Callable[[float], float], *, lost: Callable[[float], bool] = lambda distance: False) -> Rise:
    """`rise_of_profile` with a cost by the distance, where the others are not found at `lost` distances."""

    def rise(fit: object, moved: object, step: object, distance: float) -> tuple[float, bool]:
        return cost(distance) / distance**2, not lost(distance)

    return rise


@pytest.mark.parametrize(
    ("rise", "low", "high"),
    [
        (rising(lambda d: d**2), NORMAL_95, NORMAL_95),
        (rising(lambda d: 0.05 * d**2), NORMAL_95 / 0.05**0.5, NORMAL_95 / 0.05**0.5),
        (rising(lambda d: 0.6 * d), 0.9 * NORMAL_95**2 / 0.6, 1.1 * NORMAL_95**2 / 0.6),
        (rising(lambda d: 0.1 * d + 5.0 * (d > 7.0)), 7.0, 8.4),  # by a step: behind it
        (rising(lambda d: d**2, lost=lambda d: d > 3.0), 0.9 * NORMAL_95, 1.1 * NORMAL_95),
        # an upper bound of the rise is no end
        (
            rising(lambda d: 0.05 * d**2 + 99.0 * (3.5 < d < 5.0), lost=lambda d: 3.5 < d < 5.0),
            0.9 * NORMAL_95 / 0.05**0.5,
            1.1 * NORMAL_95 / 0.05**0.5,
        ),
        (rising(lambda d: (NORMAL_95 * d / 38.0) ** 2), 38.0, 38.0),
    ],
)
def test_the_end_of_a_profile_is_found(
    skewed: LikelihoodFit, rise: Rise, low: float, high: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rise)
    reach = _reach(skewed, ALPHA, side=-1.0)
    assert reach is not None
    assert low * (1.0 - 1e-12) <= reach <= high * (1.0 + 1e-12)


@pytest.mark.parametrize(
    "rise",
    [
        rising(lambda d: (NORMAL_95 * d / 43.0) ** 2),  # too far
        rising(lambda d: -1.0 + 9.0 * (d > 5.0)),  # another optimum is higher
        rising(lambda d: 1.1 * NORMAL_95**2, lost=lambda d: True),  # an upper bound alone
    ],
)
def test_an_end_that_is_not_there_is_not_made_up(
    skewed: LikelihoodFit, rise: Rise, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rise)
    assert _reach(skewed, ALPHA, side=-1.0) is None


def test_a_profile_ends_at_the_bound_of_its_parameter(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters = skewed.segments.system.parameters
    error = float(np.sqrt(skewed.covariance[ALPHA, ALPHA]))
    lower = parameters.lower.copy()
    lower[ALPHA] = skewed.values[ALPHA] - 6.0 * error
    system = replace(skewed.segments.system, parameters=replace(parameters, lower=lower))
    bounded = replace(skewed, segments=replace(skewed.segments, system=system))
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rising(lambda d: 0.01 * d))
    assert _reach(bounded, ALPHA, side=-1.0) == pytest.approx(6.0, rel=1e-12)


def test_no_trial_is_beyond_the_bound_of_a_parameter(
    skewed: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def rise(fit: object, moved: object, step: object, distance: float) -> tuple[float, bool]:
        tried.append(distance)
        return 99.0 / distance**2, False

    parameters = skewed.segments.system.parameters
    lower = parameters.lower.copy()
    lower[ALPHA] = skewed.values[ALPHA] - 0.5 * np.sqrt(skewed.covariance[ALPHA, ALPHA])
    system = replace(skewed.segments.system, parameters=replace(parameters, lower=lower))
    bounded = replace(skewed, segments=replace(skewed.segments, system=system))
    monkeypatch.setattr(skewed_profiles, "rise_of_profile", rise)
    assert _reach(bounded, ALPHA, side=-1.0) is None
    assert max(tried) == pytest.approx(0.5, rel=1e-12)


def test_what_two_coefficients_share_is_added_once() -> None:
    covariance = np.array([[4.0, 1.8, 0.3], [1.8, 1.0, 0.1], [0.3, 0.1, 2.0]])
    added = _added(covariance, {0: 3.0, 1: 2.0})
    widened = np.sqrt((covariance + added).diagonal() / covariance.diagonal())
    assert widened[0] == pytest.approx(3.0, rel=1e-12)
    assert 2.0 < widened[1] < 3.0  # follows the first along its profile, so that nothing is lacking
    assert np.allclose(added, _added(covariance, {0: 3.0}), rtol=1e-12)
    assert widened[2] < 1.1
    assert np.linalg.eigvalsh(covariance + added).min() > 0.0
