"""Elongations from forces: where on its law a link must be for the force that was seen, the motion being known up to a line.

In a short window the elongation is d(t) = D(t) + o + s t, D summed up from a velocity (s = 0) or an acceleration, and the law
must give the force that was measured. A law that is not monotone has several answers for a moment; over a window most
drop out, and from window to window o and s may only drift as noise drives them, which picks the chain (Viterbi 1967).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from linkwise.likelihood.seen import SeenLinks
from linkwise.link import Link

Array = NDArray[np.float64]

STRIDE = 5
_REACH = 3.0
_OFFSETS, _SLOPES = 81, 15
_COARSE = 12
_KEPT = 6
_SWEEPS = 8
_DAMPING = 1e-3
_CAP = 30.0


@dataclass(frozen=True, eq=False)
class Windows:
    """K windows of T samples of a link: `d`, `v` (K, T) without their polynomial, `force` (K, T), `at` (T,) s from the centre.

    `taken` (2, K) is the polynomial that was taken out at the centre, value and slope; `center` (K,) its sample.
    """

    d: Array
    v: Array
    force: Array
    at: Array
    taken: Array
    center: NDArray[np.intp]
    lost: int

    @classmethod
    def of(cls, seen: SeenLinks, link: int, *, half: int, stride: int) -> Windows:
        length = 2 * half + 1
        pieces = [sliding_window_view(each[link], length)[::stride] for each in (seen.d, seen.v, seen.force)]
        at = (np.arange(length) - half) * seen.step
        d, v = pieces[0], pieces[1]
        lost = int(seen.lost[link])
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
        )

    def motion(self, line: Array) -> tuple[Array, Array]:
        """d, v (..., K, T) with a line (2, ..., K) of value and slope at the centre put back."""
        offset, slope = line[0][..., None], line[1][..., None]
        return self.d + offset + slope * self.at, self.v + slope


@dataclass(frozen=True, eq=False)
class Lines:
    """Candidates: `line` (2, C, K), squared force error `cost` (C, K), and `spread` (2, C, K) a unit of force error makes."""

    line: Array
    cost: Array
    spread: Array


def candidates(windows: Windows, link: Link, values: dict[str, float]) -> Lines:
    """The best lines of every window under the law with `values`: coarse grid, local minima, Levenberg-Marquardt."""
    if windows.lost == 0:
        line = np.zeros((2, 1, len(windows.d)))
        return Lines(line, _normal(windows, link, values, line)[0], np.zeros_like(line))
    trial = line = _minima(windows, link, values)
    cost, gradient, h = _normal(windows, link, values, line)
    damping = np.full(cost.shape, _DAMPING)
    for _ in range(_SWEEPS):
        inverse = _inverse(h, damping)
        trial = line + np.einsum("ij...,j...->i...", inverse, gradient)
        after, steeper, bent = _normal(windows, link, values, trial)
        better = after < cost
        line, cost = np.where(better, trial, line), np.where(better, after, cost)
        gradient, h = np.where(better, steeper, gradient), np.where(better, bent, h)
        damping = np.where(better, 0.3 * damping, 10.0 * damping)
    inverse = _inverse(h, np.zeros_like(cost))
    return Lines(line, cost, np.sqrt(np.maximum(np.stack([inverse[0, 0], inverse[1, 1]]), 0.0)))


def _normal(
    windows: Windows, link: Link, values: dict[str, float], line: Array
) -> tuple[Array, Array, Array]:
    """Squared force error (C, K), its gradient (2, C, K) and matrix (2, 2, C, K) by offset and slope."""
    d, v = windows.motion(line)
    found = link.law.partials(d, v, values)
    error = windows.force - found.force
    by_offset = np.broadcast_to(found.by_d, d.shape)
    by_slope = by_offset * windows.at + found.by_v if windows.lost > 1 else np.zeros_like(by_offset)
    rows = (by_offset, by_slope)
    h = np.array([[np.einsum("ckt,ckt->ck", a, b) for b in rows] for a in rows])
    gradient = np.array([np.einsum("ckt,ckt->ck", a, error) for a in rows])
    return np.einsum("ckt,ckt->ck", error, error), gradient, h


def _inverse(h: Array, damping: Array) -> Array:
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


def _minima(windows: Windows, link: Link, values: dict[str, float]) -> Array:
    """(2, C, K) the lowest local minima on a grid of offsets and slopes."""
    thin = slice(None, None, max(1, len(windows.at) // _COARSE))
    d, v, force, at = (
        windows.d[:, thin],
        windows.v[:, thin],
        windows.force[:, thin],
        windows.at[thin],
    )
    offsets = np.linspace(-1.0, 1.0, _OFFSETS) * _REACH * np.abs(d).max()
    slopes = np.linspace(-1.0, 1.0, _SLOPES) * np.abs(v).max() if windows.lost > 1 else np.zeros(1)
    cost = np.empty((len(slopes), len(offsets), len(d)))
    for i, slope in enumerate(slopes):
        found = link.law.force(d + offsets[:, None, None] + slope * at, v + slope, values)
        cost[i] = np.einsum("okt,okt->ok", force - found, force - found)
    lowest = cost <= minimum_filter(cost, size=(3, 3, 1), mode="nearest")
    flat = np.where(lowest, cost, np.inf).reshape(-1, len(d))
    chosen = np.argsort(flat, axis=0)[:_KEPT]
    slope, offset = np.divmod(chosen, len(offsets))
    return np.stack([offsets[offset], slopes[slope]])


def follow(windows: Windows, lines: Lines, seen: SeenLinks, link: int) -> Array:
    """(2, K) what to add to D and its rate at the centre of every window.

    It is the chain of candidates that explains the forces best while offset and slope drift no more than noise drives them.
    """
    dt = seen.step
    length = len(windows.at)
    best = lines.cost.min(axis=0)
    noise = float(np.median(best)) / max(length - windows.lost, 1)
    strides = np.diff(windows.center)
    weight = float(strides[0]) / length if len(strides) else 1.0
    price = np.minimum(lines.cost / max(noise, 1e-300), length * _CAP) * weight
    value, slope = lines.line - windows.taken[:, None]
    spread = lines.spread * np.sqrt(noise)
    total, back = price[:, 0], np.zeros(price.shape, dtype=np.intp)
    for k in range(1, price.shape[1]):
        h = strides[k - 1] * dt
        roam = seen.jitter[link] * dt * np.sqrt(strides[k - 1])
        drift = roam if windows.lost == 1 else roam * h
        jump = (
            value[None, :, k] - value[:, None, k - 1] - h * 0.5 * (slope[None, :, k] + slope[:, None, k - 1])
        )
        var = drift**2 + spread[0, None, :, k] ** 2 + spread[0, :, None, k - 1] ** 2
        toll = jump**2 / var
        if windows.lost > 1:
            turn = slope[None, :, k] - slope[:, None, k - 1]
            toll = toll + turn**2 / (roam**2 + spread[1, None, :, k] ** 2 + spread[1, :, None, k - 1] ** 2)
        toll = np.minimum(np.nan_to_num(toll, nan=1e4), 1e4)
        sums = total[:, None] + toll
        back[:, k] = sums.argmin(axis=0)
        total = sums.min(axis=0) + price[:, k]
    path = np.empty(price.shape[1], dtype=np.intp)
    path[-1] = total.argmin()
    for after, k in pairwise(range(len(path) - 1, -1, -1)):
        path[k] = back[path[after], after]
    which = np.arange(len(path))
    return np.stack([value[path, which], slope[path, which]])


def inverted(seen: SeenLinks, links: tuple[Link, ...], *, half: int = 20) -> tuple[Array, Array]:
    """Elongations and rates (L, N) of links whose coefficients are all numbers."""
    d, v = seen.d.copy(), seen.v.copy()
    at = np.arange(seen.d.shape[1])
    for number, link in enumerate(links):
        if seen.lost[number] == 0:
            continue
        windows = Windows.of(seen, number, half=half, stride=STRIDE)
        lines = candidates(windows, link, link.values)
        value, slope = follow(windows, lines, seen, number)
        inner = np.interp(at, windows.center, value)
        outside = (at - np.clip(at, windows.center[0], windows.center[-1])) * seen.step
        turned = np.interp(at, windows.center, slope)
        d[number] += inner + outside * turned
        v[number] += turned
    return d, v
