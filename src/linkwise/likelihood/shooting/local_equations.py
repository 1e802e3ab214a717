"""The Gauss-Newton model of structures of many masses, from the products of groups of columns that meet in a row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.neighbourhoods import LocalRows, Neighbourhood
from linkwise.likelihood.shooting.normal_equations import Linearization, Sums, empty_model, filled, summed
from linkwise.likelihood.shooting.segments import as_slice

_AT_ONCE = 400_000  # numbers in the sensitivities of a group in a chunk
_HELD = 8_000_000  # numbers in the rows of all groups in a chunk


def local_linearization(rows: LocalRows, executor: Executor | None = None, blocks: int = 1) -> Linearization:
    """Gauss-Newton model at a point, chunk by chunk of segments, in single precision.

    Parameters
    ----------
    rows : LocalRows
        The Jacobian.
    executor : Executor, optional
        Threads.
    blocks : int, optional
        Consecutive blocks of segments by which the corner is summed.

    Returns
    -------
    Linearization
        The model.
    """
    segments, groups = rows.segments, rows.groups
    pairs, p = _pairs(groups), sum(len(group.border) for group in groups)
    model = empty_model(segments, rows.misfit, p, blocks, np.float32)
    estimated = np.ones(p, dtype=bool)
    if rows.errors is not None:  # what is tested beside these is asked for in no blocks
        estimated[segments.system.parameters.size : rows.fixed] = False

    def work(part: slice, pieces: list[slice]) -> list[Sums]:
        by_group, residuals = rows.part(part)
        ends, sums = [], list[Sums]()
        for group, own in zip(groups, by_group, strict=True):
            a = len(group.states)
            moved = own.ends * model.joined[part][:, group.rows, None].astype(np.float32)
            model.state_ends[part, group.rows[:, None], group.states] = moved[..., :a]
            model.right_ends[part, group.rows[:, None], group.moving_border] = moved[..., a:]
            ends.append(moved.astype(float))
            by_data = _gradient(own.data, residuals[:, group.channels].astype(np.float32))
            by_ends = _gradient(ends[-1], model.right_ends[part, :, p][:, group.rows])
            model.right[part, group.states, p] = by_data[:, :a]
            for corners, columns, own_sums in (
                (model.of_data, group.border, by_data),
                (model.of_defects, group.moving_border, by_ends),
            ):
                slopes = [own_sums[piece, a:].sum(axis=0, dtype=float) for piece in pieces]
                sums.append((corners.gradients, (slice(None), columns), np.stack(slopes)))
        for pair in pairs:
            shown = _common_rows([by_group[number].data for number in pair.groups], pair.channels)
            moving = _common_rows([ends[number] for number in pair.groups], pair.rows)
            first, second = (groups[number] for number in pair.groups)
            _put(model, part, (first, second), shown)
            states = len(first.states), len(second.states)
            for corners, both in ((model.of_data, shown), (model.of_defects, moving)):
                (a, b), (own_rows, other_rows) = states, both
                corner = np.stack([summed(own_rows[at, :, a:], other_rows[at, :, b:]) for at in pieces])
                own_columns, others = first.border[: corner.shape[1]], second.border[: corner.shape[2]]
                by_blocks = _by_blocks(corner, estimated[own_columns], estimated[others])
                for at, own_places, other_places, added in by_blocks:
                    places = (at, own_columns[own_places, None], others[other_places])
                    sums.append((corners.matrices, places, added))
                    if first is not second:
                        places = (at, others[other_places, None], own_columns[own_places])
                        sums.append((corners.matrices, places, added.transpose(0, 2, 1)))
        return sums

    parts = _chunks(groups, segments.count, len(segments.samples))
    return filled(model, parts, work, executor, (segments, rows.misfit, rows.scales))


def _by_blocks(
    corner: Floats, first: Bools, second: Bools
) -> Iterator[tuple[slice, Indices, Indices, Floats]]:
    """The blocks to which a corner (b, q, q') adds, the places of its rows and columns, and what: to the first block of a part
    all that is not estimated, `first` (q,) and `second` (q',), on both sides.
    """
    elsewhere = np.where(np.outer(first, second), 0.0, corner[1:].sum(axis=0))
    yield slice(0, 1), np.arange(len(first)), np.arange(len(second)), corner[:1] + elsewhere
    rows, columns = np.flatnonzero(first), np.flatnonzero(second)
    yield slice(1, None), rows, columns, corner[1:, rows[:, None], columns]


def _put(
    model: Linearization,
    part: slice,
    groups: tuple[Neighbourhood, Neighbourhood],
    rows: tuple[NDArray[Any], NDArray[Any]],
) -> None:
    """Put the products of common `rows` (k, r, P) and (k, r, P') of two groups into a model."""
    (first, second), (own, others) = groups, rows
    a, b = len(first.states), len(second.states)
    states = own[:, :, :a].transpose(0, 2, 1) @ others
    model.state[part, first.states[:, None], second.states] = states[..., :b]
    model.right[part, first.states[:, None], second.border] = states[..., b:]
    if first is not second:
        model.state[part, second.states[:, None], first.states] = states[..., :b].transpose(0, 2, 1)
        border = others[:, :, :b].transpose(0, 2, 1) @ own[:, :, a:]
        model.right[part, second.states[:, None], first.border] = border


@dataclass(frozen=True, eq=False)
class _MeetingGroups:
    """Two groups of columns, by number, whose columns meet in some rows: the places of these rows in each of them."""

    groups: tuple[int, int]
    channels: tuple[Indices, Indices]
    rows: tuple[Indices, Indices]


def _pairs(groups: Sequence[Neighbourhood]) -> list[_MeetingGroups]:
    """The pairs of groups whose columns meet."""
    pairs = []
    for first, first_group in enumerate(groups):
        for second in range(first, len(groups)):
            second_group = groups[second]
            _, *channels = np.intersect1d(first_group.channels, second_group.channels, return_indices=True)
            _, *rows = np.intersect1d(first_group.rows, second_group.rows, return_indices=True)
            if len(channels[0]) or len(rows[0]):
                pairs.append(_MeetingGroups((first, second), (channels[0], channels[1]), (rows[0], rows[1])))
    return pairs


def _chunks(groups: Sequence[Neighbourhood], K: int, samples: int) -> list[slice]:
    """The segments in an even number of parts of about equal length, for two threads.

    The sensitivities of the largest group stay in a core's cache, and the rows of all groups, of so many `samples` of a
    segment, do not take more memory where there are more masses.
    """
    largest = max(2 * len(group.masses) * group.size for group in groups)
    numbers = sum((samples * len(group.channels) + len(group.rows)) * group.size for group in groups)
    pairs = max(1, -(-K * largest // (2 * _AT_ONCE)), -(-K * numbers // (2 * _HELD)))
    size = max(16, -(-K // (2 * pairs * 16)) * 16)
    return [slice(first, min(first + size, K)) for first in range(0, K, size)]


def _gradient(rows: NDArray[Any], missed: NDArray[Any]) -> NDArray[Any]:
    """(k, P) products of rows (k, ..., P) with what they leave (k, ...)."""
    k, size = len(rows), rows.shape[-1]
    return np.asarray((missed.reshape(k, 1, -1) @ rows.reshape(k, -1, size))[:, 0])


def _common_rows(
    rows: Sequence[NDArray[Any]], common: tuple[Indices, Indices]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows (k, r, P) and (k, r, P') of two groups: those (k, r, ..., P) that they have in `common`."""
    first, second = (
        block[:, own] if isinstance(own := as_slice(which), slice) else np.take(block, own, axis=1)
        for block, which in zip(rows, common, strict=True)
    )
    k, r = len(first), int(np.prod(first.shape[1:-1]))
    return first.reshape(k, r, first.shape[-1]), second.reshape(k, r, second.shape[-1])
