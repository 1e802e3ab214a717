"""Score tests in longer segments and half the samples: those of the segments of the search, at a part of the cost."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood import diagnosis
from linkwise.likelihood.fit import LikelihoodFit, Optimum, likelihood_fit
from linkwise.likelihood.shooting import halved_samples
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.single_tests import SingleTests, single_tests
from linkwise.likelihood.starts.values import starting_values
from linkwise.likelihood.tested_causes import TestedCauses


def in_short_segments(fit: LikelihoodFit, *, longest: bool = False) -> tuple[Optimum, Misfit]:
    return fit.optimum, fit.misfit


def in_all_samples(
    optimum: Optimum, misfit: Misfit, filtered: SensorErrors
) -> tuple[Optimum, Misfit, SensorErrors]:
    return optimum, misfit, filtered


class Tests:
    """Score tests of all coefficients of a chain in a record of so many seconds."""

    __test__ = False  # no test of pytest

    def __init__(self, masses: int, duration: float) -> None:
        self.record = chain_record(masses, duration=duration).with_noise(25.0, seed=71)
        self.asked = lw.bnes_chain(masses).unknown("all")
        theta, spread = starting_values([self.record], self.asked, None)
        self.fit = likelihood_fit([self.record], self.asked, theta, spread=spread)
        assert self.fit.model_error == 0.0
        values = {p.name: float(v) for p, v in zip(self.asked.parameters, self.fit.values, strict=True)}
        self.identified = self.asked.with_values(values)

    def __call__(self) -> tuple[TestedCauses, SingleTests]:
        """What is tested, and the tests of each."""
        tested = diagnosis.tested_causes(self.fit, self.identified, self.record.channels, terms=False)
        size = len(self.fit.values)
        return tested, single_tests(tested.curvature, tested.slope, tested.scatter, size)

    def scores(self) -> Floats:
        """(h,) normal scores of the causes."""
        _, tests = self()
        return np.asarray(np.sign(tests.sizes) * np.sqrt(tests.gains) / self.fit.optimum.noise)

    def in_finer_steps(self, refine: int) -> Tests:
        """These with the motion and its tangents in so many steps a sample."""
        optimum, other = self.fit.optimum, copy(self)
        segments = optimum.segments
        assert segments.refine == 1
        segments = replace(segments, refine=refine, tangent_refine=refine, step=segments.step / refine)
        misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
        optimum = replace(optimum, segments=segments)
        other.fit = replace(self.fit, segments=segments, misfit=misfit, optimum=optimum)
        return other


@pytest.mark.parametrize(
    ("masses", "duration", "joined"), [(2, 2.0, 4), (4, 2.0, 4), (2, 3.0, 6), (4, 1.5, 8)]
)
def test_score_tests_are_those_of_short_segments(
    monkeypatch: pytest.MonkeyPatch, masses: int, duration: float, joined: int
) -> None:
    """Gains to within a hundredth of what chance gives them, sizes and deviations to a tenth of the latter.

    Of causes that hardly differ from coefficients, single precision leaves no more.
    """
    tests = Tests(masses, duration)
    monkeypatch.setattr(diagnosis, "in_half_the_samples", in_all_samples)
    tested, longer = tests()
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    of_short, short = tests()
    many = of_short.errors.values.shape[-1]
    assert tested.errors.values.shape[-1] == -(-many // joined)
    assert np.max(np.abs(longer.gains - short.gains)) < 0.02
    assert np.max(np.abs(longer.sizes - short.sizes) / short.deviations) < 0.1
    assert np.max(np.abs(longer.deviations / short.deviations - 1.0)) < 0.1


def test_score_tests_of_many_masses_are_those_of_short_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    """In standard deviations to a twentieth: columns reach parts of the structure only, and farther in longer segments."""
    tests = Tests(26, 2.0)
    monkeypatch.setattr(diagnosis, "in_half_the_samples", in_all_samples)
    tested, longer = tests()
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    of_short, short = tests()
    assert tested.errors.values.shape[-1] == -(-of_short.errors.values.shape[-1] // 4)
    scores = [np.sign(own.sizes) * np.sqrt(own.gains) for own in (longer, short)]
    assert np.max(np.abs(scores[0] - scores[1])) < 0.05 * tests.fit.optimum.noise
    assert np.max(np.abs(longer.deviations / short.deviations - 1.0)) < 0.1


@pytest.mark.parametrize("masses", [2, 4])
def test_score_tests_in_half_the_samples_are_those_in_all(
    monkeypatch: pytest.MonkeyPatch, masses: int
) -> None:
    """In standard deviations to a twentieth, of the filter, whose column is the roughest, to a tenth; both marched."""
    monkeypatch.setattr(halved_samples, "_linear_in_masses", lambda segments: False)
    tests = Tests(masses, 3.0)
    half, of_half = tests()
    monkeypatch.setattr(diagnosis, "in_half_the_samples", in_all_samples)
    tested, of_all = tests()
    assert 2 * len(half.errors.values) == len(tested.errors.values)
    scores = [
        np.sign(each.sizes) * np.sqrt(each.gains) / tests.fit.optimum.noise for each in (of_half, of_all)
    ]
    is_filter = np.array([hypothesis.kind == "filter" for hypothesis in tested.hypotheses])
    assert np.max(np.abs(scores[0] - scores[1])[~is_filter]) < 0.05
    assert np.max(np.abs(scores[0] - scores[1])[is_filter]) < 0.1
    assert np.max(np.abs(of_half.deviations / of_all.deviations - 1.0)) < 0.01


@pytest.mark.parametrize("masses", [2, 4])
def test_transitions_are_as_good_as_a_march(monkeypatch: pytest.MonkeyPatch, masses: int) -> None:
    """Beside tests in steps a quarter as long, which hardly err, both err alike: steps of a sample are long for a sink."""
    tests = Tests(masses, 3.0)
    scores = {}
    scores["transitions"] = tests.scores()
    monkeypatch.setattr(halved_samples, "_linear_in_masses", lambda segments: False)
    scores["march"] = tests.scores()
    exact = tests.in_finer_steps(4).scores()
    errors = {name: np.sqrt(np.mean((own - exact) ** 2)) for name, own in scores.items()}
    assert 0.0 < errors["transitions"] < 1.2 * errors["march"] < 0.1


def test_segments_are_shorter_where_states_grow_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer are joined; segments of the search keep all samples."""
    tests = Tests(2, 3.0)
    grown, _ = tests()
    monkeypatch.setattr(diagnosis, "_GROWTH", 1.0)
    slowly, _ = tests()
    assert slowly.errors.values.shape[-1] * 4 > grown.errors.values.shape[-1] * 5
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    short, _ = tests()
    assert len(short.errors.values) == len(tests.fit.optimum.segments.samples)
