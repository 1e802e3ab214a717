"""Products of the Jacobian of structures of many masses: those of groups of columns that meet in a row, no others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.local_blocks import (
    LocalQuadraticForm,
    MeetingGroups,
    Order,
    PairBlocks,
    common_rows,
    corners_of,
    in_one_piece,
    sums_over,
)
from linkwise.likelihood.shooting.local_equations import LocalLinearization
from linkwise.likelihood.shooting.local_rows import LocalRows
from linkwise.likelihood.shooting.neighbourhoods import Neighbourhood
from linkwise.likelihood.shooting.normal_equations import block_ends, blocks_of, border_columns

_AT_ONCE = 400_000  # numbers in the sensitivities of a group in a chunk
_HELD = 8_000_000  # numbers in the rows of all groups in a chunk


def local_linearization(
    rows: LocalRows, executor: Executor | None = None, blocks: int = 1
) -> LocalLinearization:
    """Gauss-Newton blocks at a point, chunk by chunk of segments.

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
    LocalLinearization
        The blocks.
    """
    segments, groups = rows.segments, rows.groups
    order, pairs, K = Order(groups), _pairs(groups), segments.count
    ends_of_blocks = block_ends(K, blocks)
    products = PairBlocks.room(K, pairs, groups)
    gradients = np.zeros((2, K, len(order.states)))
    joined = np.append(segments.linked, False).astype(float)
    missed = np.zeros((K, len(order.states)))
    missed[:-1] = rows.misfit.defects.reshape(len(order.states), -1).T
    missed = missed[:, order.states] * joined[:, None]
    ends = in_one_piece([(K, len(group.rows), group.moving) for group in groups])

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(part: slice) -> list[list[Floats]]:
        pieces = [piece for _, piece in blocks_of(part, ends_of_blocks)]
        by_group, residuals = rows.part(part)
        for end, group_rows in zip(ends, by_group, strict=True):
            end[part] = group_rows.ends * joined[part, None, None].astype(np.float32)
        exact = [end[part].astype(float) for end in ends]
        slopes = []
        for number, (group, own) in enumerate(zip(groups, by_group, strict=True)):
            at, a = order.of_states[number], len(group.states)
            by_data = _gradient(own.data, residuals[:, group.channels].astype(np.float32))
            by_ends = _gradient(exact[number], missed[part][:, order.places[group.rows]])
            gradients[0, part, at], gradients[1, part, at] = by_data[:, :a], by_ends[:, :a]
            slopes.append([sums_over(by_data[:, a:], pieces), sums_over(by_ends[:, a:], pieces)])
        corners = []
        for pair, own_products in zip(pairs, products, strict=True):
            shown = common_rows([by_group[i].data for i in pair.groups], pair.channels)
            moved = common_rows([exact[i] for i in pair.groups], pair.rows)
            own_products.put(part, shown)
            states = len(groups[pair.first].states), len(groups[pair.second].states)
            corners.append([corners_of(rows_of_both, states, pieces) for rows_of_both in (shown, moved)])
        return slopes + corners

    parts = _chunks(groups, K, len(segments.samples))
    by_part = map(work, parts) if executor is None else executor.map(work, parts)
    sums = _by_blocks(
        by_part, [[block for block, _ in blocks_of(part, ends_of_blocks)] for part in parts], blocks
    )
    of_data, of_defects = (
        _form(gradient, [totals[kind] for totals in sums], groups, pairs)
        for kind, gradient in enumerate(gradients)
    )
    _add_prior(of_data, rows)
    unconstrained = segments.unconstrained.astype(float)
    return LocalLinearization(
        groups, pairs, products, of_data, of_defects, ends, missed, joined, unconstrained
    )


def _by_blocks(
    by_part: Iterable[list[list[Floats]]], numbers: Sequence[Sequence[int]], blocks: int
) -> list[list[Floats]]:
    """The sums over blocks of segments, of each group and then of each pair, of both forms.

    They come part by part of the segments, for the blocks, by `numbers`, that each part meets.
    """
    sums: list[list[Floats]] = []
    for own_numbers, of_part in zip(numbers, by_part, strict=True):
        if not sums:
            sums = [[np.zeros((blocks, *own.shape[1:])) for own in both] for both in of_part]
        for totals, both in zip(sums, of_part, strict=True):
            for total, own in zip(totals, both, strict=True):
                total[own_numbers[0] : own_numbers[-1] + 1] += own
    return sums


def _add_prior(form: LocalQuadraticForm, rows: LocalRows) -> None:
    prior, scales, point = rows.segments.prior, rows.scales, rows.misfit.point
    if prior is not None:
        columns = border_columns(scales, len(point.theta), len(form.prior))
        form.prior[columns] += prior.curvature(scales.theta)
        form.corner_gradients[0, columns] += prior.gradient(point.border, scales.theta)


def _form(
    gradient: Floats,
    sums: Sequence[Floats],
    groups: Sequence[Neighbourhood],
    pairs: Sequence[MeetingGroups],
) -> LocalQuadraticForm:
    """The form with `sums` over blocks of segments: gradients (B, q) of groups, corners (B, q, q') of pairs."""
    p = sum(len(group.border) for group in groups)
    gradients = np.zeros((len(sums[0]), p))
    for group, total in zip(groups, sums, strict=False):
        gradients[:, group.border[: total.shape[1]]] = total
    corners, places = sums[len(groups) :], []
    for pair, total in zip(pairs, corners, strict=True):
        first = groups[pair.first].border[: total.shape[1]]
        second = first if pair.first == pair.second else groups[pair.second].border[: total.shape[2]]
        places.append((first, second))
    return LocalQuadraticForm(gradient, corners, places, gradients, np.zeros(p))


def _pairs(groups: Sequence[Neighbourhood]) -> list[MeetingGroups]:
    """The pairs of groups whose columns meet."""
    pairs = []
    for first, first_group in enumerate(groups):
        for second in range(first, len(groups)):
            second_group = groups[second]
            _, *channels = np.intersect1d(first_group.channels, second_group.channels, return_indices=True)
            _, *rows = np.intersect1d(first_group.rows, second_group.rows, return_indices=True)
            if len(channels[0]) or len(rows[0]):
                pairs.append(MeetingGroups(first, second, (channels[0], channels[1]), (rows[0], rows[1])))
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
