"""Sums over pieces of a record against those of the whole, and against the equations of a piece alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import some
from problems import chain_record

import linkwise as lw
from linkwise.weak import judgement
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations
from linkwise.weak.fit import assemble_blocks, normal_equations, residual_power, weak_fit
from linkwise.weak.judgement import PieceSums, piece_sums
from linkwise.weak.scatter import SlopeStatistics, residual_excess, score_blocks

CHAIN = lw.bnes_chain(4)
ASKED = CHAIN.unknown("all")


def sums_of_all(
    record: lw.Record, window_of: lw.Record | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Normal equations, their right-hand side, their covariance and the excess, at the values of the whole record."""
    whole = window_of or record
    motion = read_displacements(whole, ASKED)
    equations = weak_equations(whole, ASKED, motion)
    values = weak_fit(equations, ASKED).values
    weights = [1.0 / residual_power(patch, values) for patch in equations.patches]
    if window_of is not None:
        own = motion.of_piece(record, ASKED)
        equations = weak_equations(record, ASKED, own, window=equations.window)
    noisy = [(patch, SlopeStatistics.along(patch, equations, values)) for patch in equations.patches]
    blocks = ((which, block[0]) for which, block in score_blocks(noisy, weights, equations))
    normal, right = normal_equations(equations.patches, weights, len(values))
    scatter = assemble_blocks(blocks, len(values))
    assert isinstance(normal, np.ndarray) and isinstance(scatter, np.ndarray)
    return normal, right, scatter, float(residual_excess(noisy, values, equations)[0])


def test_one_piece_is_the_whole() -> None:
    record = chain_record(4).with_noise(20.0, seed=3)
    equations = weak_equations(record, ASKED, read_displacements(record, ASKED))
    sums = piece_sums(equations, weak_fit(equations, ASKED).values, [(0, equations.windows)])
    normal, right, scatter, excess = sums_of_all(record)
    np.testing.assert_allclose(sums.normal[0], normal, rtol=1e-8, atol=1e-12 * np.abs(normal).max())
    np.testing.assert_allclose(sums.right[0], right, rtol=1e-8)
    scale = np.abs(scatter).max()
    np.testing.assert_allclose(sums.linear[0] + sums.quadratic[0], scatter, rtol=1e-8, atol=1e-12 * scale)
    np.testing.assert_allclose(sums.excess[0], excess, rtol=1e-12)


def test_a_piece_is_a_record_of_its_own() -> None:
    """With the window, the weights and the noise of the whole; the smoothed motion is that of the same samples."""
    record = chain_record(4).with_noise(20.0, seed=3)
    equations = weak_equations(record, ASKED, read_displacements(record, ASKED))
    values, stride = weak_fit(equations, ASKED).values, equations.slope_stride
    first, last = 10 * stride, 50 * stride
    sums = piece_sums(equations, values, [(0, first), (first, last)])
    window = equations.window
    piece = record[first * window.stride : (last - 1) * window.stride + window.length]
    normal, right, scatter, excess = sums_of_all(piece, window_of=record)
    scale = np.sqrt(normal.diagonal())
    # same numerics
    np.testing.assert_allclose(
        sums.normal[1] / np.outer(scale, scale), normal / np.outer(scale, scale), atol=1e-8
    )
    np.testing.assert_allclose(sums.right[1], right, rtol=1e-8, atol=1e-8 * np.abs(right).max())
    # discretisation: sums of the covariance at every second window of the long record, and at every one of the short
    ours = np.sqrt((sums.linear[1] + sums.quadratic[1]).diagonal())
    np.testing.assert_allclose(ours, np.sqrt(scatter.diagonal()), rtol=0.1)
    np.testing.assert_allclose(sums.excess[1], excess, rtol=0.05)
    assert not np.allclose(sums.normal[0], sums.normal[1], rtol=0.1)


def test_some_points_give_a_little_less_of_the_covariance_and_all_else() -> None:
    """Of pieces that overlap: the points between centres near their ends are left out, so that it is a bound."""
    record = chain_record(4).with_noise(20.0, seed=3)
    equations = weak_equations(record, ASKED, read_displacements(record, ASKED))
    values, stride = weak_fit(equations, ASKED).values, equations.slope_stride
    ranges = [
        (0, 20 * stride + 3),
        (0, 60 * stride + 1),
        (20 * stride, 60 * stride + 1),
        (8 * stride, 11 * stride),
    ]
    whole = piece_sums(equations, values, ranges)
    least = piece_sums(equations, values, ranges, least=True)
    for name in ("normal", "right", "bias", "quadratic", "windows"):
        np.testing.assert_array_equal(getattr(least, name), getattr(whole, name))
    for ours, theirs in some(zip(least.linear, whole.linear, strict=True)):
        scale = 1.0 / np.sqrt(theirs.diagonal())
        missing = np.linalg.eigvalsh((theirs - ours) * np.outer(scale, scale))
        assert missing[0] > -1e-12 and missing[-1] > 1e-6
    assert np.all(least.linear[1].diagonal() > 0.9 * whole.linear[1].diagonal())
    assert np.all(least.excess == 1.0)


@pytest.mark.parametrize(("share", "expected"), [(1.0, [True, True]), (1e-3, [True, True, False, False])])
def test_a_bound_that_leaves_no_room_is_the_answer(
    share: float, expected: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pieces of a right record agree by the bound; where its variances leave room, the whole ones decide alike."""
    record = chain_record(4).with_noise(20.0, seed=3)
    equations = weak_equations(record, ASKED, read_displacements(record, ASKED))
    fit = weak_fit(equations, ASKED)
    asked: list[bool] = []

    def counted(*arguments: Any, least: bool = False) -> PieceSums:
        asked.append(least)
        sums = piece_sums(*arguments, least=least)
        return replace(sums, linear=share * sums.linear, quadratic=share * sums.quadratic) if least else sums

    monkeypatch.setattr(judgement, "piece_sums", counted)
    assert judgement.disagreement(record, ASKED, equations, fit) is None
    assert asked == expected
