"""Standard errors and intervals: against slow implementations, many records, profiles of the likelihood and blocks."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import paper_fits
import pytest
from paper_fits import LARGEST_NMSE, identified
from present import present
from problems import chain_record, truth
from scipy.integrate import solve_ivp
from scipy.optimize import OptimizeResult, least_squares
from structures import oscillator
from within import assert_within

import linkwise as lw
from linkwise.likelihood.checks import horizons
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.optima import profiles
from linkwise.likelihood.search import BlockScores

CHAIN = lw.bnes_chain(2)
UNKNOWN = CHAIN.unknown("all")
NAMES = ("spring1.k", "spring1.c", "nes1.alpha", "nes1.beta", "nes1.c")
TRUE = np.array([3e4, 1.0, -100.0, 1e6, 0.02])
START = TRUE * np.array([1.02, 0.7, 1.1, 0.9, 1.3])


@pytest.fixture(scope="module")
def short_record() -> lw.Record:
    """0.2 s, over which the chain is not chaotic; its noise is known."""
    clean = chain_record(2, duration=0.2)
    noisy = clean.with_noise(40.0, seed=7)
    return replace(noisy, noise=dict(present(noisy.simulated).noise))


@pytest.fixture(scope="module")
def slow(short_record: lw.Record) -> OptimizeResult:
    """Unknowns: the first state (4,) and theta (5,); written out by hand, nothing of linkwise in it."""
    x = np.stack([short_record.channel("x:m1"), short_record.channel("x:m2")])
    sigma = np.array([[short_record.noise["x:m1"]], [short_record.noise["x:m2"]]])
    scale = np.concatenate([[0.01, 0.01, 1.0, 1.0], np.abs(TRUE)])

    def motions(unknown: np.ndarray) -> np.ndarray:
        """(2, R, N) of R sets of unknowns (9, R), which are integrated as one system."""
        k, c, a, b, s = unknown[4:]

        def rates(_: float, states: np.ndarray) -> np.ndarray:
            x1, x2, v1, v2 = states.reshape(4, -1)
            d, v = x2 - x1, v2 - v1
            link = a * d + b * d**3 + s * v
            return np.concatenate([v1, v2, -k * x1 - c * v1 + link, -link / 0.01])

        run = solve_ivp(
            rates, (0.0, short_record.time[-1]), unknown[:4].ravel(), t_eval=short_record.time, method="DOP853", rtol=1e-9,
            atol=1e-12,
        )  # fmt: skip
        moved: np.ndarray = run.y.reshape(4, unknown.shape[1], -1)[:2]
        return moved

    def residuals(unknown: np.ndarray) -> np.ndarray:
        scaled: np.ndarray = (x - motions((unknown * scale)[:, None])[:, 0]) / sigma
        return scaled.ravel()

    def jacobian(unknown: np.ndarray) -> np.ndarray:
        """Central differences, in steps of the cube root of the precision of a number."""
        step = 6e-6 * np.maximum(np.abs(unknown), 1.0)
        both = motions(scale[:, None] * (unknown[:, None] + np.hstack([np.diag(step), -np.diag(step)])))
        ahead, behind = np.split(both, 2, axis=1)
        slopes: np.ndarray = (behind - ahead) / (2.0 * step[:, None] * sigma[:, None])
        return slopes.transpose(0, 2, 1).reshape(-1, len(unknown))

    start = np.concatenate([[0.0, 0.0, 1.0, 0.0], START]) / scale
    optimum = least_squares(residuals, start, jac=jacobian, xtol=1e-10, ftol=1e-12)
    assert optimum.success
    covariance = np.linalg.inv(optimum.jac.T @ optimum.jac) * np.outer(scale, scale)
    return OptimizeResult(
        theta=optimum.x[4:] * scale[4:], covariance=covariance[4:, 4:], cost=2.0 * optimum.cost
    )


@pytest.fixture(scope="module")
def ours(short_record: lw.Record) -> LikelihoodFit:
    return likelihood_fit([short_record], UNKNOWN, START)


@pytest.mark.slow
def test_optimum_and_covariance_are_the_same(ours: LikelihoodFit, slow: OptimizeResult) -> None:
    assert ours.status.value == "converged"
    error = np.sqrt(np.diag(slow.covariance))
    # the search ends with less than 0.02 of the cost to gain, sqrt(0.02) standard errors along the worst direction
    assert np.abs((ours.values - slow.theta) / error).max() < 0.14
    assert ours.misfit.data == pytest.approx(slow.cost, abs=0.02)  # that end itself
    scaled = (ours.covariance - slow.covariance) / np.outer(error, error)
    assert np.abs(scaled).max() < 0.02  # tangents of order 4 in steps of a sample


@pytest.mark.parametrize("name", ["nes1.alpha", "spring1.k"])
def test_the_curvature_is_the_profiles(short_record: lw.Record, ours: LikelihoodFit, name: str) -> None:
    """Held one standard error away on either side, the cost of the best others rises by one."""
    number = NAMES.index(name)
    error = np.sqrt(ours.covariance[number, number])
    rises = []
    for sign in (-1.0, 1.0):
        constrained = lw.bnes_chain(2).unknown("all").with_values({name: ours.values[number] + sign * error})
        others = likelihood_fit([short_record], constrained, np.delete(ours.values, number))
        assert others.status.value == "converged"
        q = ours.path[-1].q
        rises.append(others.misfit.cost(q) - ours.misfit.cost(q))
    # the mean of both sides leaves out the cubic term; 0.02 of either search's end and the quartic term remain
    assert np.mean(rises) == pytest.approx(1.0, abs=0.1)


MANY = 80  # records of the statistics below: that all 95 % intervals of a coefficient cover has a chance of 1.7 %
CHANCE = 0.02  # of a share being too small, and of its being too large
SHORT = 1.0  # s, a sixth of the paper's record: intervals cover and errors reach the bound at any duration


@pytest.mark.slow
@pytest.mark.parametrize(("n", "seeds"), [(2, 4), (6, 2)])
def test_at_20_db_every_sink_is_found_to_a_few_millionths(n: int, seeds: int) -> None:
    paper_fits.check_sinks_at_20_db(identified(n, 20.0, seeds))


@pytest.mark.slow
def test_at_40_db_a_hundred_times_better() -> None:
    assert np.median(identified(2, 40.0, 3).nmse) <= LARGEST_NMSE[40.0]


@pytest.mark.slow
def test_velocities_alone_are_enough() -> None:
    paper_fits.check_velocities(identified(2, 30.0, 6, "v", duration=SHORT))


@pytest.mark.slow
def test_standard_errors_intervals_and_bands_are_what_the_errors_are_and_these_as_small_as_may_be() -> None:
    many = identified(2, 20.0, MANY, duration=SHORT)
    paper_fits.check_standard_errors(many)
    paper_fits.check_intervals(many, CHANCE)
    paper_fits.check_force_band(many, CHANCE)
    paper_fits.check_bound(many, SHORT)


@pytest.fixture(scope="module")
def linear() -> lw.Structure:
    return oscillator("k*d + c*v", k=400.0, c=0.4)


@pytest.fixture(scope="module")
def decay(linear: lw.Structure) -> lw.Record:
    return lw.simulate(linear, release={"v:m1": 1.0}, duration=3.0, rate=200.0).with_noise(20.0, seed=3)


@pytest.fixture(scope="module")
def nearly_linear(linear: lw.Structure, decay: lw.Record) -> lw.Estimate:
    return lw.identify(decay, linear.unknown("all"))


@pytest.fixture(scope="module")
def softening() -> lw.Estimate:
    """A softening spring driven so little that only F*g is seen well: a large F with a small g is nearly as likely."""
    law = "F*tanh(g*d) + c*v"
    true = oscillator(law, c=0.4, F=40.0, g=10.0)
    decay = lw.simulate(true, release={"v:m1": 1.0}, duration=1.5, rate=200.0).with_noise(30.0, seed=2)
    return lw.identify(decay, true.unknown("link.F", "link.g"), starts={"link.F": 40.0, "link.g": 10.0})


@pytest.mark.parametrize("name", ["link.k", "link.c"])
def test_agrees_with_the_hessian_where_nearly_linear(nearly_linear: lw.Estimate, name: str) -> None:
    estimate = nearly_linear.coefficient(name)
    assert estimate.interval is not None and estimate.standard_error is not None
    # ends are sought to 1 % of a standard error; the rest is the curvature of a cosine of 1 % noise
    np.testing.assert_allclose(
        lw.likelihood.profile_interval(nearly_linear, name),
        estimate.interval,
        atol=0.04 * estimate.standard_error,
    )


def test_at_the_ends_cost_is_384(nearly_linear: lw.Estimate, linear: lw.Structure, decay: lw.Record) -> None:
    """Both ends, fitted by a whole run with the coefficient known, from elsewhere."""
    low, high = lw.likelihood.profile_interval(nearly_linear, "link.c")
    assert isinstance(nearly_linear.profile, partial)
    optimum = nearly_linear.profile.args[0]
    known = replace(decay, noise={"x:m1": float(optimum.scales.sigma[0])})
    best = likelihood_fit([known], linear.unknown("all"), np.array([390.0, 0.5]))
    for end in (low, high):
        constrained = linear.unknown("link.k").with_values({"link.c": end})
        at_end = likelihood_fit([known], constrained, np.array([390.0]))
        rise = at_end.misfit.cost(optimum.q) - best.misfit.cost(optimum.q)
        # 1 % of a deviation at each end, twice
        assert rise / optimum.noise**2 == pytest.approx(3.84, abs=0.1)


def test_differs_where_it_is_no_parabola(softening: lw.Estimate, monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr(profiles, "_FARTHEST", 2.1)
    assert lw.likelihood.profile_interval(softening, "link.F")[1] == np.inf


def test_ends_at_a_bound(nearly_linear: lw.Estimate, decay: lw.Record) -> None:
    estimate = nearly_linear.coefficient("link.c")
    assert estimate.standard_error is not None
    edge = estimate.value - estimate.standard_error
    bounded = oscillator(
        "k*d + c*v", k=lw.Coefficient.unknown(), c=lw.Coefficient.unknown(lower=edge, upper=10.0)
    )
    again = lw.identify(decay, bounded)
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
def test_no_interval(nearly_linear: lw.Estimate, change: dict[str, Any], name: str, message: str) -> None:
    with pytest.raises(lw.IdentificationError, match=message):
        lw.likelihood.profile_interval(replace(nearly_linear, **change), name)


def released(speed: float, duration: float, decibel: float, seed: int) -> lw.Record:
    clean = lw.simulate(CHAIN, release={"v:m1": speed}, duration=duration, rate=1000.0)
    return clean.with_noise(decibel, seed=seed)


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
    assert_within(estimate, CHAIN, 3.5)
    assert "The likelihood falls slowly on one side of nes1.alpha (" in estimate.message


@pytest.mark.slow
def test_another_optimum_behind_the_wall_takes_trust_away() -> None:
    """At a low signal, the laws held loosely: where rounding leads the search, alpha was 7 standard errors off."""
    estimate = lw.identify(released(2.0, 2.0, 10.0, 5750348), UNKNOWN)
    off = np.abs(estimate.values - truth(CHAIN, UNKNOWN)) / np.sqrt(estimate.covariance.diagonal())
    assert off.max() < 4.5 or not estimate.trusted


@pytest.mark.parametrize("held", [0.05, 0.5, 0.95])
def test_scores_of_blocks_that_hold_unequal_information(held: float) -> None:
    """Intervals by blocks cover what white noise scatters by, where one of 20 blocks has a share `held` of the information.

    Where that is nearly all of it, blocks are said to tell nothing.
    """
    blocks, count, noise = 20, 2000, 3.0
    rng = np.random.default_rng(20)
    along = np.array([[1.0, 0.3], [0.3, 2.0]])
    shares = np.full(blocks, (1.0 - held) / (blocks - 1))
    shares[3] = held
    parts = shares[:, None, None] * along
    of_noise = (
        noise * np.sqrt(shares)[:, None] * (rng.normal(size=(count, blocks, 2)) @ np.linalg.cholesky(along).T)
    )
    off = of_noise.sum(axis=1) @ np.linalg.inv(along)
    free = np.ones(2, dtype=bool)
    # the optimum follows the noise, so that the scores there sum to zero
    errors = np.array(
        [
            BlockScores(own - parts @ moved, parts).by_scores()
            for own, moved in zip(of_noise, off, strict=True)
        ]
    )
    assert BlockScores(of_noise[0], parts).told(free).all() == (held < 0.9)
    if held > 0.9:
        return
    covered = np.mean(np.abs(off) < 1.96 * errors)
    assert 0.93 < covered < 0.99
    assert np.median(errors / (noise * np.sqrt(np.linalg.inv(along).diagonal()))) < 2.0


@pytest.mark.parametrize(
    ("moves", "held"), [((9.0, 3.0, 0.2), 3.0), ((0.2, 0.2, 0.3), 0.7), ((0.2, 3.0), 3.2)]
)
def test_approximate_intervals_hold_the_changes_along_the_path_from_the_horizon_before(
    monkeypatch: pytest.MonkeyPatch, moves: tuple[float, ...], held: float
) -> None:
    """`moves` from each horizon to the next, in standard errors: the answer is where the path is flat for the first time."""
    spring = oscillator("k*d + c*v", k=900.0, c=0.6)
    record = lw.simulate(spring, duration=4.0, rate=200.0, release={"x:m1": 0.03}).with_noise(40.0, seed=1)
    fit = likelihood_fit([record], spring.unknown("all"), np.array([900.0, 0.6]))
    errors = np.sqrt(fit.covariance.diagonal())
    values = [fit.values + move * errors for move in np.cumsum([0.0, *moves])]
    misfit = fit.optimum.misfit
    points = [replace(misfit, point=replace(misfit.point, theta=each)) for each in values]
    there = [replace(fit, optimum=replace(fit.optimum, misfit=each)) for each in points]
    path = [horizons._Horizon(each, errors) for each in there]
    monkeypatch.setattr(horizons, "_path", lambda _: path)
    answer = horizons.over_horizons(fit)
    assert isinstance(answer, LikelihoodFit)
    flat = next(number for number, move in enumerate(moves) if move <= 0.5)
    assert np.array_equal(answer.values, values[flat])
    assert np.allclose(answer.covariance - fit.covariance, np.diag((held * errors) ** 2), rtol=1e-9, atol=0.0)
