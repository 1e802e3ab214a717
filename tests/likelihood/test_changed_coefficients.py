"""Coefficients that change in a record: told with the moment, and not trusted; those that do not change are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from problems import truth
from structures import NES, link, structure

import linkwise as lw
from linkwise.likelihood.block_scores import BLOCKS, BlockScores
from linkwise.likelihood.changed_coefficients import _Changes, likeliest_change
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.record_judgement import judge

MASSES = {"m1": 1.0, "m2": 0.01}
SENSORS = ("x:m1", "x:m2", "v:m1", "v:m2")
BLOCK = 6.0 / BLOCKS[0]  # s


def chain(alpha: float = -100.0, k: float = 3e4, g: float = 0.0) -> lw.Structure:
    """A sink on a mass whose spring may harden."""
    spring = link("spring1", "m1-ground", "k*d + c*v + g*d**3", k=k, c=1.0, g=g)
    return structure(MASSES, spring, link("nes1", "m2-m1", NES, alpha=alpha, beta=1e6, c=0.02))


STATED = structure(
    MASSES, link("spring1", "m1-ground", "k*d + c*v", k=3e4, c=1.0), chain().link("nes1")
).unknown("all")


@cache
def motion(*parts: tuple[float, lw.Structure]) -> lw.Record:
    """Displacements without noise while one structure turns into another, each for some seconds."""
    release, pieces = {"v:m1": 1.0}, list[np.ndarray]()
    for duration, subject in parts:
        piece = lw.simulate(subject, release=release, duration=duration, rate=1000.0, sensors=SENSORS)
        release = dict(zip(piece.channels, piece.values[-1].tolist(), strict=True))
        pieces.append(piece.values[:, :2] if not pieces else piece.values[1:, :2])
    return lw.Record(0.0, 1000.0, SENSORS[:2], np.concatenate(pieces))


@pytest.mark.parametrize(
    ("parts", "where", "size", "moment"),
    [
        (((3.0, chain()), (3.0, chain(alpha=-98.0))), "nes1.alpha", 2.0, 3.0),
        (((3.0, chain()), (3.0, chain(k=29000.0))), "spring1.k", -1000.0, 3.0),
        (((2.0, chain()), (4.0, chain(alpha=-97.0))), "nes1.alpha", 3.0, 2.0),
    ],
)
def test_a_change_is_told_with_its_moment(
    parts: tuple[tuple[float, lw.Structure], ...], where: str, size: float, moment: float
) -> None:
    """Trusted with a model error before, 10 and 12 standard errors from either value."""
    fit = lw.identify(motion(*parts).with_noise(30.0, seed=71), STATED)
    assert fit.verdicts == (lw.Verdict.COEFFICIENT_CHANGES,) and not fit.trusted
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where) == ("change", where)
    assert cause.size == pytest.approx(size, abs=max(4.0 * cause.standard_error, 0.2 * abs(size)))
    assert float(cause.source.removesuffix(" s")) == pytest.approx(moment, abs=2.0 * BLOCK)
    assert fit.coefficient(where).interval is None
    assert f"One value of {where} does not explain all of the record: a change of {where} by " in fit.message


def test_a_coefficient_that_drifts_is_told_as_well() -> None:
    parts = tuple((0.5, chain(alpha=alpha)) for alpha in np.linspace(-100.0, -97.0, 12))
    fit = lw.identify(motion(*parts).with_noise(30.0, seed=72), STATED)
    assert fit.verdicts == (lw.Verdict.COEFFICIENT_CHANGES,)
    assert fit.diagnosis[0].kind == "change" and fit.diagnosis[0].where in ("nes1.alpha", "nes1.beta")


def test_a_change_between_records_is_told_with_the_record() -> None:
    first, second = (motion((3.0, chain(alpha=alpha))).with_noise(30.0, seed=73) for alpha in (-100.0, -98.0))
    fit = lw.identify([first, replace(second, start=10.0)], STATED)
    assert fit.verdicts == (lw.Verdict.COEFFICIENT_CHANGES,)
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].source) == ("change", "10 s of record 2")
    assert "nes1.alpha" in fit.diagnosis[0].description


@pytest.mark.parametrize("relaxation", [1e-3, 2e-2])
def test_a_change_that_a_model_error_hides_is_told_of_a_motion_held_closer(relaxation: float) -> None:
    """It lets the motion of one value follow both, so that no change is significant beside it."""
    first, second = (motion((3.0, chain(alpha=alpha))).with_noise(30.0, seed=73) for alpha in (-100.0, -98.0))
    records = [first, replace(second, start=10.0)]
    options = LikelihoodOptions(relaxation=relaxation)
    fit = likelihood_fit(records, STATED, truth(chain(), STATED), options=options)
    assert fit.model_error > 0.0 and likeliest_change(fit, records, None, ()) is None
    values = dict(zip(fit.segments.system.parameters.names, fit.values.tolist(), strict=True))
    judgement = judge(fit, STATED.with_values(values), [STATED], records)
    assert judgement.verdict is lw.Verdict.COEFFICIENT_CHANGES
    assert judgement.message.startswith("Held closer to the laws, one value of nes1.alpha does not explain")
    change = judgement.diagnosis[0]
    assert change.size == pytest.approx(2.0, abs=4.0 * change.standard_error)


def test_a_change_beside_a_missing_term_is_told_by_laws_with_the_term() -> None:
    """The term gains more, and hides it: trusted before, with a wrong interval."""
    parts = ((3.0, chain(g=2e7)), (3.0, chain(alpha=-97.0, g=2e7)))
    fit = lw.identify(motion(*parts).with_noise(30.0, seed=80), STATED)
    assert fit.verdicts == (lw.Verdict.COEFFICIENT_CHANGES,)
    assert fit.message.startswith("With d**3 in spring1, one value of nes1.alpha does not explain")
    assert [cause.kind for cause in fit.diagnosis[:2]] == ["change", "term"]


@pytest.mark.parametrize("calibration", [{}, {"all": 0.01}])
@pytest.mark.parametrize("seed", [74, 75, 76])
def test_no_change_is_told_of_exact_laws(calibration: dict[str, float], seed: int) -> None:
    """What is known beforehand of gains pulls as blocks do."""
    record = motion((6.0, chain())).with_noise(30.0, seed=seed)
    fit = lw.identify(record, STATED, calibration=calibration)
    assert fit.trusted and "change" not in [cause.kind for cause in fit.diagnosis]


def test_a_missing_term_is_no_change() -> None:
    """Of the spring, whose force falls with the amplitude as the motion decays."""
    fit = lw.identify(motion((6.0, chain(g=2e7))).with_noise(30.0, seed=77), STATED)
    assert fit.trusted and fit.diagnosis[0].term == "d**3"
    errors = (fit.values - truth(chain(), fit.given_structure)) / np.sqrt(fit.covariance.diagonal())
    assert np.abs(errors).max() < 3.0


@pytest.mark.parametrize("known", [0.0, 4.0])
def test_changes_are_those_of_linear_regression(known: float) -> None:
    """With a value `known` beforehand of the first of three unknowns, by so much information."""
    random = np.random.default_rng(78)
    regressors, noise = random.normal(size=(20, 15, 3)), random.normal(size=(20, 15))
    prior = np.diag([known, 0.0, 0.0])
    flat = regressors.reshape(-1, 3)
    samples = np.einsum("bnp,p->bn", regressors, [1.0, 2.0, 3.0]) + noise

    def least(columns: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, float]:
        values = np.linalg.solve(columns.T @ columns + information, columns.T @ samples.ravel())
        left = samples.ravel() - columns @ values
        return values, float(left @ left + values @ information @ values)

    values, cost = least(flat, prior)
    left = samples - regressors @ values
    scores = BlockScores(
        np.einsum("bnp,bn->bp", regressors, left), np.einsum("bnp,bnq->bpq", regressors, regressors)
    )
    changes = _Changes.of(scores, prior, 3)
    early = np.repeat(np.arange(20) <= 6, 15)
    for number in range(3):
        information = np.zeros((4, 4))
        information[:3, :3] = prior
        changed, lower = least(np.column_stack([flat, flat[:, number] * early]), information)
        assert changes.gains[6, number] == pytest.approx(cost - lower, rel=1e-9)
        assert changes.sizes[6, number] == pytest.approx(-changed[3], rel=1e-9)
    assert np.all(changes.scatter < 2.5)
