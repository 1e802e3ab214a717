"""Equations in coordinates of the nodes relative to a common shift: the same but for rounding."""

from __future__ import annotations

import numpy as np
import pytest
from structures import CANTILEVER, CANTILEVER_SHAPES, NES, host, link, structure

import linkwise as lw
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.hidden_wells import fit_about_rest
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.block_information import block_information
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.common_shift import with_common_shift
from linkwise.likelihood.shooting.linear_model import covariance, firm_border
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise

BLOCKS = 3


@pytest.fixture(scope="module")
def fit() -> LikelihoodFit:
    """A fit of a chain about rest, whose coefficients the record determines well."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0).with_noise(
        30.0, seed=5205301
    )
    asked = chain.unknown("nes")
    return likelihood_fit(
        [record], asked, np.array([chain.coefficient(p.name).value for p in asked.parameters])
    )


def _linear(fit: LikelihoodFit) -> Linearization:
    optimum = fit.optimum
    return linearise(optimum.segments, fit.misfit, optimum.scales, optimum.loss, blocks=BLOCKS)


def test_a_common_shift_changes_no_equation_of_the_border(fit: LikelihoodFit) -> None:
    linear, q = _linear(fit), 1e-2  # where nothing is small enough for rounding to matter
    shifted = with_common_shift(linear)
    own, other = linear.factor(q), shifted.factor(q)
    assert isinstance(own, BorderedFactor) and isinstance(other, BorderedFactor)
    size = np.sqrt(own.schur.diagonal())
    # products of single precision that cancel by a factor of 1e2 at most
    np.testing.assert_allclose(
        other.schur / size / size[:, None], own.schur / size / size[:, None], atol=1e-8
    )
    np.testing.assert_allclose(other.reduced / size, own.reduced / size, atol=1e-8)


def test_steps_by_shifted_equations_are_those_by_the_others(fit: LikelihoodFit) -> None:
    linear, q = _linear(fit), 1e-2
    own, other = linear.factor(q), with_common_shift(linear).factor(q)
    assert isinstance(own, BorderedFactor) and isinstance(other, BorderedFactor)
    random = np.random.default_rng(5215302)
    pulls = random.normal(size=own.shape), random.normal(size=len(own.schur))
    free = np.arange(len(own.schur)) > 0
    steps = [factor.moved(*pulls).solve(free) for factor in (own, other)]
    assert steps[0] is not None and steps[1] is not None
    for first, second in zip(*steps, strict=True):
        np.testing.assert_allclose(second, first, rtol=1e-6, atol=1e-8 * np.abs(first).max())
    predicted = [
        equations.drop(*steps[0])
        for equations in (linear.equations(q), with_common_shift(linear).equations(q))
    ]
    assert predicted[1] == pytest.approx(predicted[0], rel=1e-8)


def test_blocks_of_shifted_equations_have_the_information_of_the_others(fit: LikelihoodFit) -> None:
    linear, q = _linear(fit), 1e-2
    own, other = block_information(linear, q), block_information(with_common_shift(linear), q)
    assert own is not None and other is not None
    scale = np.abs(own[1]).max(axis=0)
    np.testing.assert_allclose(other[1] / scale, own[1] / scale, atol=1e-8)
    np.testing.assert_allclose(other[0], own[0], atol=1e-8 * np.abs(own[0]).max())


def test_motion_that_overflows_is_left_as_it_is(fit: LikelihoodFit) -> None:
    linear = _linear(fit)
    linear.state_ends[3, 0, 0] = np.inf
    assert with_common_shift(linear) is linear


def test_a_covariance_where_a_hidden_mass_rests_far_away_does_not_depend_on_rounding() -> None:
    """A bistable sink that moves by a fiftieth of the distance to its well, seen by accelerometers: a coefficient that moves
    the well moves all nodes, by far more than the continuity of the segments lets pass.
    """
    sink = {"alpha": -60.0, "beta": 2e6, "c": 0.1}
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    true = structure({"sink": 0.03}, link("nes", "beam.tip-sink", NES, **sink), hosts=[beam])
    asked = structure({"sink": 0.03}, link("nes", "beam.tip-sink", NES), hosts=[beam])
    record = lw.simulate(
        true,
        forces={"beam.root": "0.3*exp(-((t - 0.1)/0.003)**2)"},
        release={"x:sink": -((60.0 / 2e6) ** 0.5)},
        duration=1.5,
        rate=1000.0,
        sensors=("a:beam.tip", "a:beam.mid", "a:beam.root"),
    ).with_noise(30.0, seed=5215301)
    fit = fit_about_rest([record], asked, LikelihoodOptions(model_error=False))
    assert fit is not None
    linear, tight, loose = _linear(fit), 1e-5, 1e-3  # both far below where the laws are loosened
    errors = [
        np.sqrt(covariance(factor, fit.optimum.scales, fit.free).diagonal())
        for factor in (linear.factor(tight), firm_border(linear, tight), firm_border(linear, loose))
    ]
    assert not np.allclose(errors[0], errors[1], rtol=0.2)  # what rounding makes of the same equations
    np.testing.assert_allclose(errors[1], errors[2], rtol=0.01)  # the noise of a loosened law
    np.testing.assert_allclose(np.sqrt(fit.covariance.diagonal()), errors[1], rtol=0.1)  # at a step before
