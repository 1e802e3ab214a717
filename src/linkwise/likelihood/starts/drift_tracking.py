"""Elongations from forces, where they are known up to drift: Viterbi paths through candidates.

Each short window has a few candidates (`drift_windows`). From window to window the drift is a random walk driven by the noise,
so the Viterbi algorithm finds the most likely sequence of candidates.

References
----------
A. J. Viterbi, IEEE Trans. Inf. Theory 13, 260 (1967).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.drift_windows import DriftCandidates, DriftWindows, drift_candidates
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals, window_half
from linkwise.model.link import Link

# length of a window: shorter ones have more candidates, in longer ones the drift is not a line
_PERIODS = 0.8
_OVERLAP = 3
_ROUNDS = 2  # of sharing candidates between neighbouring windows
_LARGEST_MISFIT = 30.0  # times the noise of a window: upper limit of the misfit of a candidate
_LARGEST_TRANSITION = 1e4


def viterbi_path(
    windows: DriftWindows, candidates: DriftCandidates, signals: LinkSignals, link: int
) -> Floats:
    """The sequence of candidates with the smallest misfit of the forces plus transition cost of a random walk.

    Parameters
    ----------
    windows : DriftWindows
        The K windows.
    candidates : DriftCandidates
        Their candidates.
    signals : LinkSignals
        Signals of all links.
    link : int
        Index of the link.

    Returns
    -------
    array of shape (2, K)
        Corrections of the integrated elongation and its rate at the centres of the windows.
    """
    length = len(windows.time)
    noise = float(np.median(candidates.cost.min(axis=0))) / max(length - windows.integration_order, 1)
    strides = np.diff(windows.center)
    weight = float(strides[0]) / length if len(strides) else 1.0
    misfit = candidates.cost / max(noise, np.finfo(float).tiny)
    misfit = np.minimum(misfit, length * _LARGEST_MISFIT) * weight
    offset, slope = candidates.lines - windows.removed_line[:, None]
    spread = candidates.spread * np.sqrt(noise)
    total, back = misfit[:, 0], np.zeros(misfit.shape, dtype=np.intp)
    for k in range(1, misfit.shape[1]):
        lag = strides[k - 1] * signals.step
        # standard deviation of the random walk of the integrated signal from one window to the next
        deviation = signals.random_walk_intensity[link] * signals.step * np.sqrt(strides[k - 1])
        jump = offset[:, k] - offset[:, k - 1, None] - 0.5 * lag * (slope[:, k] + slope[:, k - 1, None])
        drift = deviation if windows.integration_order == 1 else deviation * lag
        transition = jump**2 / (drift**2 + spread[0, :, k] ** 2 + spread[0, :, k - 1, None] ** 2)
        if windows.integration_order > 1:
            change = slope[:, k] - slope[:, k - 1, None]
            transition += change**2 / (deviation**2 + spread[1, :, k] ** 2 + spread[1, :, k - 1, None] ** 2)
        sums = total[:, None] + np.minimum(transition, _LARGEST_TRANSITION)
        back[:, k] = sums.argmin(axis=0)
        total = sums.min(axis=0) + misfit[:, k]
    path = np.empty(misfit.shape[1], dtype=np.intp)
    path[-1] = total.argmin()
    for after, k in pairwise(range(len(path) - 1, -1, -1)):
        path[k] = back[path[after], after]
    window = np.arange(len(path))
    return np.stack([offset[path, window], slope[path, window]])


def elongations_from_forces(signals: LinkSignals, links: tuple[Link, ...]) -> tuple[Floats, Floats]:
    """Elongations of links of known laws.

    Parameters
    ----------
    signals : LinkSignals
        Signals of the L links.
    links : tuple of Link
        The links, all coefficients numbers.

    Returns
    -------
    d, v : array of shape (L, N)
        Elongations in m and rates in m/s.
    """
    d, v = signals.d.copy(), signals.v.copy()
    sample = np.arange(signals.d.shape[1])
    for number, link in enumerate(links):
        if signals.integration_order[number] == 0:
            continue
        half = window_half(signals, number, _PERIODS)
        windows = DriftWindows.of(signals, number, half=half, stride=max(1, half // _OVERLAP))
        candidates = drift_candidates(windows, link, link.values, rounds=_ROUNDS)
        offset, slope = viterbi_path(windows, candidates, signals, number)
        rate = np.interp(sample, windows.center, slope)
        outside = (sample - np.clip(sample, windows.center[0], windows.center[-1])) * signals.step
        d[number] += np.interp(sample, windows.center, offset) + outside * rate
        v[number] += rate
    return d, v
