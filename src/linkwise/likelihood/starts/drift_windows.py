"""Short windows of a link, and the lines that its law leaves to the elongation in each.

In a window the elongation is d(t) = D(t) + o + s t, D summed up from a velocity (s = 0) or an acceleration, and the law must
give the force that was measured. A law that is not monotone has several answers for a moment; over a window most drop out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals
from linkwise.model.link import Link

_REACH = 3.0  # of the largest motion within a window: how far off its centre may be
_OFFSETS, _SLOPES = 81, 15  # on the grid: basins of attraction are about a well wide
_COARSE = 12  # samples of a window that the grid looks at
_KEPT = 6  # minima a window: two wells, and two between them on either slope
_SWEEPS = 8
_DAMPING = 1e-2
_SAME = 1e-3  # of the largest offset: minima nearer than that are one


@dataclass(frozen=True, eq=False)
class DriftWindows:
    """K windows of T samples of a link: `d`, `v` (K, T) without their polynomial, `force` (K, T), `time` (T,) s from the
    centre.

    `removed_line` (2, K) is the polynomial that was taken out, value and slope at the centre; `center` (K,) its sample;
    `integration_order` how many of the two are unknown; `step` s a sample.
    """

    d: Floats
    v: Floats
    force: Floats
    time: Floats
    removed_line: Floats
    center: Indices
    integration_order: int
    step: float

    @classmethod
    def of(cls, seen: LinkSignals, link: int, *, half: int, stride: int) -> DriftWindows:
        """Windows of 2 `half` + 1 samples, `stride` apart, of one of the links."""
        length = 2 * half + 1
        pieces = [sliding_window_view(each[link], length)[::stride] for each in (seen.d, seen.v, seen.force)]
        at = (np.arange(length) - half) * seen.step
        d, v = pieces[0], pieces[1]
        lost = int(seen.integration_order[link])
        taken = np.zeros((2, len(d)))
        if lost > 0:
            taken[0] = d.mean(axis=1)
        if lost > 1:
            taken[1] = (d @ at) / (at @ at)
        return cls(
            d - taken[0][:, None] - np.outer(taken[1], at),
            v - taken[1][:, None],
            pieces[2],
            np.asarray(at),
            taken,
            half + stride * np.arange(len(d)),
            lost,
            seen.step,
        )

    def motion(self, line: Floats) -> tuple[Floats, Floats]:
        """d, v (..., K, T) with a line (2, ..., K) of value and slope at the centre put back."""
        offset, slope = line[0][..., None], line[1][..., None]
        return self.d + offset + slope * self.time, self.v + slope


@dataclass(frozen=True, eq=False)
class DriftCandidates:
    """Candidates: `lines` (2, C, K), squared force error `cost` (C, K), and `spread` (2, C, K) a unit of force error makes."""

    lines: Floats
    cost: Floats
    spread: Floats


def drift_candidates(
    windows: DriftWindows, link: Link, values: dict[str, float], *, rounds: int = 0
) -> DriftCandidates:
    """The best lines of every window under the law with `values`: coarse grid, local minima, Levenberg-Marquardt.

    In each of so many `rounds` a window also tries what its neighbours found.
    """
    if windows.integration_order == 0:
        line = np.zeros((2, 1, len(windows.d)))
        return DriftCandidates(line, _normal(windows, link, values, line)[0], np.zeros_like(line))
    lines = _distinct(_polished(windows, link, values, _minima(windows, link, values)))
    for _ in range(rounds):
        from_neighbours = _polished(windows, link, values, _passed_on(windows, lines.lines))
        lines = _distinct(
            DriftCandidates(
                np.concatenate([lines.lines, from_neighbours.lines], axis=1),
                np.concatenate([lines.cost, from_neighbours.cost]),
                np.concatenate([lines.spread, from_neighbours.spread], axis=1),
            )
        )
    return lines


def _passed_on(windows: DriftWindows, line: Floats) -> Floats:
    """(2, 2 C, K) what the line of a window is in the windows after and before it; at the ends they keep their own."""
    drift = line - windows.removed_line[:, None]
    lag = np.diff(windows.center) * windows.step
    after, before = drift.copy(), drift.copy()
    after[:, :, 1:] = drift[:, :, :-1]
    after[0, :, 1:] += drift[1, :, :-1] * lag
    before[:, :, :-1] = drift[:, :, 1:]
    before[0, :, :-1] -= drift[1, :, 1:] * lag
    return np.concatenate([after, before], axis=1) + windows.removed_line[:, None]


def _distinct(lines: DriftCandidates) -> DriftCandidates:
    """The `_KEPT` best lines of every window, of which no two are the same minimum."""
    order = np.argsort(lines.cost, axis=0)
    cost = np.take_along_axis(lines.cost, order, axis=0)
    line = np.take_along_axis(lines.lines, order[None], axis=1)
    spread = np.take_along_axis(lines.spread, order[None], axis=1)
    reach = np.abs(line[0]).max() * _SAME
    apart = np.abs(line[0][:, None] - line[0][None]) > reach
    copies = np.array(
        [(~apart[c, :c]).any(axis=0) if c else np.zeros(cost.shape[1], bool) for c in range(len(cost))]
    )
    chosen = np.argsort(copies, axis=0, kind="stable")[:_KEPT]
    cost = np.where(copies, np.inf, cost)
    return DriftCandidates(
        np.take_along_axis(line, chosen[None], axis=1),
        np.take_along_axis(cost, chosen, axis=0),
        np.take_along_axis(spread, chosen[None], axis=1),
    )


def _polished(windows: DriftWindows, link: Link, values: dict[str, float], line: Floats) -> DriftCandidates:
    """Each line (2, C, K) moved to the minimum near it."""
    cost, gradient, h = _normal(windows, link, values, line)
    cost = np.nan_to_num(cost, nan=np.inf)
    damping = np.full(cost.shape, _DAMPING)
    for _ in range(_SWEEPS):
        trial = line + np.einsum("ij...,j...->i...", _inverse(h, damping), gradient)
        after, steeper, bent = _normal(windows, link, values, trial)
        better = after < cost
        line, cost = np.where(better, trial, line), np.where(better, after, cost)
        gradient, h = np.where(better, steeper, gradient), np.where(better, bent, h)
        damping = np.where(better, 0.3 * damping, 10.0 * damping)
    inverse = _inverse(h, np.zeros_like(cost))
    return DriftCandidates(line, cost, np.sqrt(np.maximum(np.stack([inverse[0, 0], inverse[1, 1]]), 0.0)))


def _normal(
    windows: DriftWindows, link: Link, values: dict[str, float], line: Floats
) -> tuple[Floats, Floats, Floats]:
    """Squared force error (C, K), its gradient (2, C, K) and matrix (2, 2, C, K) by offset and slope."""
    d, v = windows.motion(line)
    found = link.law.partials(d, v, values)
    error = windows.force - found.force
    by_offset = np.broadcast_to(found.by_d, d.shape)
    by_slope = (
        by_offset * windows.time + found.by_v if windows.integration_order > 1 else np.zeros_like(by_offset)
    )
    rows = (by_offset, by_slope)
    h = np.array([[np.einsum("ckt,ckt->ck", a, b) for b in rows] for a in rows])
    gradient = np.array([np.einsum("ckt,ckt->ck", a, error) for a in rows])
    return np.einsum("ckt,ckt->ck", error, error), gradient, h


def _inverse(h: Floats, damping: Floats) -> Floats:
    """(2, 2, C, K) of a damped 2 by 2 matrix; the slope stays where nothing depends on it."""
    tiny = np.finfo(float).tiny
    a, b = h[0, 0] * (1.0 + damping) + tiny, h[1, 1] * (1.0 + damping)
    flat = b <= 0.0
    b = np.where(flat, 1.0, b)
    c = h[0, 1]
    det = np.maximum(a * b - c * c, 1e-12 * a * b)
    inverse = np.array([[b, -c], [-c, a]]) / det
    inverse[1, 1] = np.where(flat, 0.0, inverse[1, 1])
    return np.asarray(inverse)


def _minima(windows: DriftWindows, link: Link, values: dict[str, float]) -> Floats:
    """(2, C, K) the lowest local minima on a grid of offsets and slopes."""
    thin = slice(None, None, max(1, len(windows.time) // _COARSE))
    d, v, force, at = (
        windows.d[:, thin],
        windows.v[:, thin],
        windows.force[:, thin],
        windows.time[thin],
    )
    offsets = np.linspace(-1.0, 1.0, _OFFSETS) * _REACH * np.abs(d).max()
    slopes = (
        np.linspace(-1.0, 1.0, _SLOPES) * np.abs(v).max() if windows.integration_order > 1 else np.zeros(1)
    )
    cost = np.empty((len(slopes), len(offsets), len(d)))
    for i, slope in enumerate(slopes):
        with np.errstate(over="ignore", invalid="ignore"):  # an exponential, far off
            found = link.law.force(d + offsets[:, None, None] + slope * at, v + slope, values)
            cost[i] = np.einsum("okt,okt->ok", force - found, force - found)
    cost = np.nan_to_num(cost, nan=np.inf)
    lowest = cost <= scipy.ndimage.minimum_filter(cost, size=(3, 3, 1), mode="nearest")
    flat = np.where(lowest, cost, np.inf).reshape(-1, len(d))
    chosen = np.argsort(flat, axis=0)[:_KEPT]
    slope, offset = np.divmod(chosen, len(offsets))
    return np.stack([offsets[offset], slopes[slope]])
