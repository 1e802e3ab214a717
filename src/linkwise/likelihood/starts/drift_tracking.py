"""Elongations from forces: where on its law a link must be for the force that was seen, its motion being known up to a drift.

Every short window has a few candidates (`lines`). From window to window the drift may only move as noise moves it, which picks
the chain of candidates (Viterbi 1967).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.drift_windows import DriftCandidates, DriftWindows, drift_candidates
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals, window_half
from linkwise.model.link import Link

_PERIODS = 0.8  # that a window spans: shorter ones have more candidates, longer ones bend with the drift
_OVERLAP = 3
_ROUNDS = 2  # of passing candidates on to neighbours
_DEAR = 30.0  # times the noise of a window: a candidate so bad is as bad as any
_IMPASSABLE = 1e4


def viterbi_path(windows: DriftWindows, lines: DriftCandidates, seen: LinkSignals, link: int) -> Floats:
    """(2, K) what to add to D and its rate at the centre of every window.

    It is the chain of candidates that explains the forces best while offset and slope drift no more than noise drives them.
    """
    length = len(windows.time)
    best = lines.cost.min(axis=0)
    noise = float(np.median(best)) / max(length - windows.integration_order, 1)
    strides = np.diff(windows.center)
    weight = float(strides[0]) / length if len(strides) else 1.0
    price = np.minimum(lines.cost / max(noise, np.finfo(float).tiny), length * _DEAR) * weight
    value, slope = lines.lines - windows.removed_line[:, None]
    spread = lines.spread * np.sqrt(noise)
    total, back = price[:, 0], np.zeros(price.shape, dtype=np.intp)
    for k in range(1, price.shape[1]):
        lag = strides[k - 1] * seen.step
        roam = (
            seen.random_walk_intensity[link] * seen.step * np.sqrt(strides[k - 1])
        )  # of the rate that was summed up
        jump = value[:, k] - value[:, k - 1, None] - 0.5 * lag * (slope[:, k] + slope[:, k - 1, None])
        drift = roam if windows.integration_order == 1 else roam * lag
        toll = jump**2 / (drift**2 + spread[0, :, k] ** 2 + spread[0, :, k - 1, None] ** 2)
        if windows.integration_order > 1:
            turn = slope[:, k] - slope[:, k - 1, None]
            toll += turn**2 / (roam**2 + spread[1, :, k] ** 2 + spread[1, :, k - 1, None] ** 2)
        sums = total[:, None] + np.minimum(toll, _IMPASSABLE)
        back[:, k] = sums.argmin(axis=0)
        total = sums.min(axis=0) + price[:, k]
    path = np.empty(price.shape[1], dtype=np.intp)
    path[-1] = total.argmin()
    for after, k in pairwise(range(len(path) - 1, -1, -1)):
        path[k] = back[path[after], after]
    which = np.arange(len(path))
    return np.stack([value[path, which], slope[path, which]])


def elongations_from_forces(seen: LinkSignals, links: tuple[Link, ...]) -> tuple[Floats, Floats]:
    """Elongations and rates (L, N) of links whose coefficients are all numbers."""
    d, v = seen.d.copy(), seen.v.copy()
    at = np.arange(seen.d.shape[1])
    for number, link in enumerate(links):
        if seen.integration_order[number] == 0:
            continue
        half = window_half(seen, number, _PERIODS)
        windows = DriftWindows.of(seen, number, half=half, stride=max(1, half // _OVERLAP))
        lines = drift_candidates(windows, link, link.values, rounds=_ROUNDS)
        value, slope = viterbi_path(windows, lines, seen, number)
        turned = np.interp(at, windows.center, slope)
        outside = (at - np.clip(at, windows.center[0], windows.center[-1])) * seen.step
        d[number] += np.interp(at, windows.center, value) + outside * turned
        v[number] += turned
    return d, v
