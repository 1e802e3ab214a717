"""How fine the steps of flow and tangents are, by the samples that a record has in a period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import row_of_masses

import linkwise as lw
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.problem import shooting_problem
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.starts.values import starting_values

COARSE, FINE = 5.5, 40.0  # samples a period of the highest mode


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    """Two masses on hardening springs."""
    first, second = {"k": 2e4, "k3": 1e7, "c": 1.0}, {"k": 3e4, "k3": 2e7, "c": 1.5}
    law = "k*d + k3*d**3 + c*v"
    return row_of_masses([1.0, 0.5], first=(law, first), second=(law, second))


def recorded(chain: lw.Structure, per_period: float, seed: int) -> lw.Record:
    rate = per_period * float(np.max(lw.analysis.modes(chain).frequencies))
    record = lw.simulate(chain, release={"v:m1": 2.0, "v:m2": -2.0}, duration=1500 / rate, rate=rate)
    return record.with_noise(30.0, seed=seed)


def fitted(chain: lw.Structure, record: lw.Record) -> LikelihoodFit:
    unknown = chain.unknown("all")
    theta, spread = starting_values([record], unknown)
    return likelihood_fit([record], unknown, theta, spread=spread)


@pytest.mark.parametrize(("per_period", "finer"), [(COARSE, True), (FINE, False)])
def test_steps_follow_the_samples_of_a_period(chain: lw.Structure, per_period: float, finer: bool) -> None:
    segments = fitted(chain, recorded(chain, per_period, 1)).segments
    assert (segments.tangent_refine > 1) == finer
    ratio = segments.flow_steps_per_tangent
    assert ratio == 1 or ratio % 2 == 0


def test_the_slope_is_the_costs_where_samples_are_few(chain: lw.Structure) -> None:
    """The gradient by single nodes that the normal equations hold, against differences of the cost."""
    record, unknown = recorded(chain, COARSE, 2), chain.unknown("all")
    theta, spread = starting_values([record], unknown)
    problem = shooting_problem([record], unknown, theta, spread, SensorModel.of([record], (), ()))
    segments, point, scales, q = problem.segments, problem.start, problem.scales, 1e-2

    def apart(steps: int) -> float:
        stepped = replace(segments, tangent_refine=steps)
        misfit = evaluate(stepped, point, scales, Gaussian())
        equations = linearise(stepped, misfit, scales, Gaussian()).equations(q)
        slopes, errors, eps = [], [], 1e-4
        for node in (10, 50, 100):
            for row in range(4):
                change = np.zeros_like(point.nodes)
                change.reshape(4, -1)[row, node] = eps * scales.state[row]
                ahead, behind = (
                    evaluate(segments, replace(point, nodes=point.nodes + sign * change), scales, Gaussian())
                    for sign in (1.0, -1.0)
                )
                slope = -(ahead.cost(q) - behind.cost(q)) / (4.0 * eps)
                slopes.append(slope)
                errors.append(equations.right[node, row, -1] - slope)
        return float(np.abs(errors).max() / np.abs(slopes).max())

    # halved until a sensitivity over a segment stays the same to 0.002, of which order 4 leaves a sixteenth
    assert apart(segments.tangent_refine) < 2e-3
    assert apart(1) > 2e-2  # steps of a sample


def test_a_search_where_samples_are_few_ends_at_once_at_the_optimum(chain: lw.Structure) -> None:
    """Newton's steps gain digits faster and faster; with tangents in steps of a sample each left a fifth of the cost."""
    fit = fitted(chain, recorded(chain, COARSE, 3))
    assert fit.status.name == "CONVERGED" and fit.model_error == 0.0
    # the search ends at a step that could gain no more than this; at a linear rate a fifth was left
    assert fit.path[-1].remaining < 1e-2 * fit.path[-1].cost
    true = np.array([chain.coefficient(p.name).value for p in chain.unknown("all").parameters])
    z = (fit.values - true) / np.sqrt(fit.covariance.diagonal())
    assert np.abs(z).max() < 4.0  # by chance once in 2600 seeds
    last = [step for step in fit.path if step.q == fit.path[-1].q and step.reduction > 0.0]
    assert len(last) <= 4
