"""Normal equations whose border moves all nodes along: what stays of a weakly determined direction after rounding.

A coefficient that sets where a mass rests moves it in every segment, by many times what the continuity of the segments allows.
The equations then hold numbers whose difference alone is information, and where it is less than their rounding a covariance
means nothing. In coordinates of the nodes relative to a shift by each unknown of the border, the same in all segments, they
are small from the start, and nothing else changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.normal_blocks import NormalBlocks
from linkwise.likelihood.shooting.normal_equations import Linearization, block_ends

_INDEPENDENT = (
    1e-12  # relative square of what a shift does to the ends of segments, below which it is nothing
)


def with_common_shift(linear: Linearization) -> Linearization:
    """The same linearised problem, its nodes relative to shifts by the border that leave the ends of segments least to fit.

    Parameters
    ----------
    linear : Linearization
        The linearised problem.

    Returns
    -------
    Linearization
        That in the other coordinates: the equations of its border alone, and so the covariance, are the same but for rounding.
        The same one where the motion overflows.
    """
    p, m = len(linear.data.corner), linear.data.state.shape[1]
    if not (np.isfinite(linear.state_ends).all() and np.isfinite(linear.right_ends).all()):
        return linear
    apart = linear.state_ends.copy()
    apart[:, range(m), range(m)] -= linear.joined
    shift = _least_left(apart, linear.right_ends[:, :, :p])
    right_ends = linear.right_ends.copy()
    right_ends[:, :, :p] += apart @ shift
    right = np.zeros_like(linear.defects.right)
    right[:-1] = linear.state_ends.transpose(0, 2, 1) @ right_ends
    ends = [slice(*pair) for pair in pairwise(block_ends(len(right), len(linear.data.corners)))]
    rows = (right_ends[block].reshape(-1, p + 1) for block in ends)
    products = np.stack([own.T @ own for own in rows])
    defects = replace(
        linear.defects, right=right, corners=products[:, :p, :p], corner_gradients=products[:, p, :p]
    )
    return replace(
        linear,
        data=_moved_along(linear.data, shift, ends),
        defects=defects,
        right_ends=right_ends,
        shift=shift,
    )


def _least_left(apart: Floats, by_border: Floats) -> Floats:
    """(m, p) the shift that, times `apart` (K - 1, m, m), leaves least of what the border does, (K - 1, m, p)."""
    rows = apart.reshape(-1, apart.shape[2])
    squares, products = rows.T @ rows, rows.T @ by_border.reshape(len(rows), -1)
    size = np.sqrt(np.maximum(squares.diagonal(), np.finfo(float).tiny))[:, None]
    solved = np.linalg.lstsq(squares / size / size.T, products / size, rcond=_INDEPENDENT)[0]
    return np.asarray(-solved / size)


def _moved_along(data: NormalBlocks, shift: Floats, blocks: Sequence[slice]) -> NormalBlocks:
    """The quadratic form of the samples, its corners by blocks of nodes, where the border moves nodes by `shift` (m, p)."""
    p = shift.shape[1]
    right = data.right.copy()
    right[:, :, :p] += data.state @ shift
    corners, gradients = data.corners.copy(), data.corner_gradients.copy()
    for number, block in enumerate(blocks):
        own = data.right[block].sum(axis=0)
        across = own[:, :p].T @ shift
        corners[number] += across + across.T + shift.T @ data.state[block].sum(axis=0) @ shift
        gradients[number] += shift.T @ own[:, p]
    return replace(data, right=right, corners=corners, corner_gradients=gradients)
