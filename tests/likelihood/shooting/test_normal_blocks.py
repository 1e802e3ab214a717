"""Products of the linearised rows, each against those of whole rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.loss import Student
from linkwise.likelihood.shooting.normal_blocks import NormalBlocks
from linkwise.likelihood.shooting.normal_equations import linearise, whitened_jacobian
from linkwise.likelihood.shooting.sensor_errors import SensorErrors


def test_rows_in_single_precision_give_the_blocks_of_those_in_double_precision() -> None:
    """The former are multiplied segment by segment, the latter at once."""
    segments, m, p, samples = 7, 4, 60, 10
    rows = np.random.default_rng(5).normal(size=(segments, samples, m + p + 1)).astype(np.float32)
    by_segment, at_once = NormalBlocks.empty(segments, m, p), NormalBlocks.empty(segments, m, p)
    pieces = [slice(0, 3), slice(3, 7)]
    columns = np.arange(p + 1)
    corners = by_segment.put(slice(None), rows, pieces, columns)
    exact_corners = at_once.put(slice(None), rows.astype(float), pieces, columns)
    scale = np.sqrt(np.einsum("bii->bi", exact_corners))
    # a product of ten samples in single precision, relative to the lengths of both columns
    np.testing.assert_allclose(
        corners / scale[:, None] / scale[:, :, None],
        exact_corners / scale[:, None] / scale[:, :, None],
        atol=1e-6,
    )
    np.testing.assert_allclose(by_segment.state, at_once.state, atol=1e-5)
    np.testing.assert_allclose(by_segment.right, at_once.right, atol=1e-5)


def test_errors_of_sensors_multiply_the_rows_of_their_channels() -> None:
    """Against products of whole rows, with an unknown gain, which scales a channel, a robust loss and lost samples."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.3, rate=1000.0, sensors=("x", "v"))
    values = record.with_noise(30.0, seed=3).values.copy()
    values[100:110, 0] = np.nan
    record = replace(record, values=values)
    asked = chain.unknown("nes")
    theta = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    options = LikelihoodOptions(gains=("x:m1",), offsets=("v:m2",), loss=Student())
    fit = likelihood_fit([record], asked, theta, options=options)
    segments, errors = fit.segments, SensorErrors.of(fit.segments, fit.misfit)
    arguments = segments, fit.misfit, fit.optimum.scales, fit.optimum.loss
    linear = linearise(*arguments, errors=errors, blocks=3)
    rows, _ = whitened_jacobian(*arguments, slice(0, segments.count), errors=errors)
    m = segments.system.dimension
    of_states = rows[..., :m].transpose(0, 2, 1) @ rows[..., m:]
    border = rows[..., m:].reshape(-1, rows.shape[2] - m).astype(float)
    scale = np.sqrt(np.sum(border**2, axis=0))
    corner = border.T @ border / np.outer(scale, scale)
    ours = linear.data.corner / np.outer(scale[:-1], scale[:-1])
    # products in single precision, of 5 samples of 4 channels
    np.testing.assert_allclose(linear.data.right, of_states, rtol=1e-5, atol=1e-5 * np.abs(of_states).max())
    np.testing.assert_allclose(ours, corner[:-1, :-1], atol=1e-6)
    slope = linear.data.corner_gradient / scale[:-1] / scale[-1]
    np.testing.assert_allclose(slope, corner[-1, :-1], atol=1e-6)
    own = len(theta) + np.arange(len(errors.kind))
    assert not linear.right_ends[..., own].any()  # nothing that a sensor shows moves the masses
    assert np.delete(linear.right_ends, own, axis=2).any()
