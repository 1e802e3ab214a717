"""Inverse dynamics of a tree of links: their forces, and their elongations up to a polynomial, from sensors on every mass.

Accelerations of all masses give the force of every link by B f = w - M a if the links form no closed loops. An elongation is
known from displacements, up to a constant from velocities, and up to a line from accelerations; the latter two drift with the
integrated noise.

That drift follows from the law in short windows, in each of which the elongation is d(t) = D(t) + o + s t, with D integrated
from a velocity (s = 0) or an acceleration, and the law must give the measured force. A law that is not monotone has several
solutions at one moment; a whole window excludes most of them and leaves a few candidates (`DriftWindows`). From window to
window the drift is a random walk driven by the noise, so the Viterbi algorithm finds the most likely sequence of candidates.

References
----------
A. J. Viterbi, IEEE Trans. Inf. Theory 13, 260 (1967).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.link_states import link_motion
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import DRIFT_FREQUENCY, channel_motion, highpass

_OFFSET = 1e-4  # of the power of a parabola: noise, integrated twice, leaves more beside it
# samples on each side of a window's centre: fewer do not separate an offset and a slope from noise
_SHORTEST = 6
_FEWEST = 4 * _SHORTEST + 1  # samples of a record, of four such halves


@dataclass(frozen=True, eq=False)
class LinkSignals:
    """Signals of L links.

    Attributes
    ----------
    d, v, force : array of shape (L, N)
        Elongations in m, rates in m/s and forces in N.
    integration_order : array of int, shape (L,)
        Number of integrations behind each elongation, which is known up to a polynomial with as many coefficients.
    random_walk_intensity : array of shape (L,)
        Standard deviation per sample of the noise that drives this polynomial, in the unit of its highest derivative.
    step : float
        Sampling interval in s.
    """

    d: Floats
    v: Floats
    force: Floats
    integration_order: Indices
    random_walk_intensity: Floats
    step: float


def lacks_displacements(record: Record, structure: Structure) -> bool:
    """Whether every mass has a sensor, and some have none of displacement."""
    names = structure.mass_names
    displaced = all(f"x:{name}" in record.channels for name in names)
    return not displaced and all(record.motions_of(name) for name in names)


def needs_integration(record: Record, structure: Structure) -> bool:
    """Whether inverse dynamics applies and some displacement is known by integration only.

    It applies where each mass is known and has a sensor, and the links form a tree on a support.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.

    Returns
    -------
    bool
        Whether it does.
    """
    if not lacks_displacements(record, structure) or any(
        mass.mass.value is None for mass in structure.masses
    ):
        return False
    incidence = structure.incidence.toarray()
    square = incidence.shape[0] == incidence.shape[1]
    return square and bool(np.linalg.matrix_rank(incidence) == len(incidence))


def link_signals(record: Record, structure: Structure, sigma: dict[str, float]) -> LinkSignals:
    """Signals of the links, where `needs_integration` holds.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : dict of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    LinkSignals
        The signals.

    Raises
    ------
    IdentificationError
        If the record is shorter than the shortest windows, in which lines of integration are taken out.
    """
    if len(record) < _FEWEST:
        raise IdentificationError(
            f"the record has {len(record)} samples, too few to integrate sensors of velocity or acceleration; it needs at "
            f"least {_FEWEST}"
        )
    channels = [record.motions_of(name)[0] for name in structure.mass_names]
    x, v, a = np.stack([channel_motion(record, channel, sigma[channel]) for channel in channels], axis=1)
    orders, noise = ([channel.order for channel in channels], [sigma[channel] for channel in channels])
    pushed = [f"force:{name}" for name in structure.mass_names]
    none = np.zeros(len(record))
    applied = np.stack([record.channel(name) if name in record.channels else none for name in pushed])
    incidence = structure.incidence.toarray()
    connected = incidence.T != 0.0
    order = np.where(connected, orders, 0).max(axis=1)
    driven = connected & (np.asarray(orders) == order[:, None])
    d, rate = (np.array(motion.T) for motion in link_motion(record, structure, x, v))
    for number in np.flatnonzero(order == 2).tolist():
        d[number], rate[number] = _without_offset(d[number], rate[number])
    return LinkSignals(
        d=d,
        v=rate,
        force=np.linalg.solve(incidence, applied - structure.mass_values[:, None] * a),
        integration_order=order,
        random_walk_intensity=np.sqrt((driven * np.square(noise)).sum(axis=1)),
        step=record.step,
    )


def _without_offset(d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Elongation and rate without the curvature that the offset of an accelerometer leaves, where it dwarfs the motion."""
    time = np.linspace(-1.0, 1.0, len(d))
    legendre = np.polynomial.legendre
    parabola, line = legendre.legfit(time, d, 2), legendre.legfit(time, v, 1)
    motion = np.mean((d - legendre.legval(time, parabola)) ** 2)
    parabola[:2], line[0] = 0.0, 0.0  # a line is an unknown of every window
    bend = legendre.legval(time, parabola)
    return (d, v) if motion > _OFFSET * np.mean(bend**2) else (d - bend, v - legendre.legval(time, line))


def masses_from_links(record: Record, structure: Structure, d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Motion of the masses from that of a tree of links.

    Parameters
    ----------
    record : Record
        The record, for the motion of the base.
    structure : Structure
        The structure.
    d, v : array of shape (L, N)
        Elongations in m and rates in m/s.

    Returns
    -------
    x, x_rate : array of shape (n, N)
        Displacements in m and velocities in m/s.
    """
    at_rest = np.zeros((2, structure.size, len(record)))
    d_of_base, v_of_base = link_motion(record, structure, *at_rest)
    transposed = structure.incidence.toarray().T
    return np.linalg.solve(transposed, d - d_of_base.T), np.linalg.solve(transposed, v - v_of_base.T)


_REACH = 3.0  # of the largest motion within a window: how far its centre may be displaced
_OFFSETS, _SLOPES = 81, 15  # of the grid: a basin of attraction is about as wide as a well
_COARSE = 12  # samples of a window that the grid uses
_MINIMA = 6  # minima per window: two wells, and two between them on each slope
_STEPS = 8  # of Levenberg-Marquardt
_DAMPING = 1e-2
_AT_ONCE = 2**16  # values on the grid, which the processor keeps near
_NEAR = 1e-3  # of the largest offset: minima that are closer count as one


@dataclass(frozen=True, eq=False)
class DriftWindows:
    """K windows of T samples of a link.

    Attributes
    ----------
    d, v : array of shape (K, T)
        Elongations in m and rates in m/s without a line.
    force : array of shape (K, T)
        Forces in N.
    time : array of shape (T,)
        Times in s from the centre.
    removed_line : array of shape (2, K)
        Value and slope of the line at the centre.
    center : array of int, shape (K,)
        Samples at the centres.
    integration_order : int
        Number of unknowns of a line: 0, 1 (value) or 2 (value and slope).
    step : float
        Sampling interval in s.
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
    def of(cls, signals: LinkSignals, link: int, *, periods: float, overlap: int = 1) -> DriftWindows:
        """Windows of one of the links.

        Parameters
        ----------
        signals : LinkSignals
            Signals of all links.
        link : int
            Index of the link.
        periods : float
            Half the length of a window in periods of the motion, by its zero crossings.
        overlap : int
            How many windows begin within half of one.

        Returns
        -------
        DriftWindows
            The windows.
        """
        motion = highpass(signals.d[link], 1.0 / signals.step, DRIFT_FREQUENCY)
        crossings = int(np.count_nonzero(np.diff(np.signbit(motion))))
        longest = (len(motion) - 1) // 4
        samples = round(periods * len(motion) / max(crossings, 1))
        half = int(np.clip(samples, min(_SHORTEST, longest), longest))
        stride = max(1, half // overlap)
        length = 2 * half + 1
        d, v, force = (
            sliding_window_view(signal[link], length)[::stride]
            for signal in (signals.d, signals.v, signals.force)
        )
        time = (np.arange(length) - half) * signals.step
        order = int(signals.integration_order[link])
        line = np.zeros((2, len(d)))
        if order > 0:
            line[0] = d.mean(axis=1)
        if order > 1:
            line[1] = (d @ time) / (time @ time)
        return cls(
            d=d - line[0][:, None] - np.outer(line[1], time),
            v=v - line[1][:, None],
            force=force,
            time=np.asarray(time),
            removed_line=line,
            center=half + stride * np.arange(len(d)),
            integration_order=order,
            step=signals.step,
        )

    def motion(self, line: Floats) -> tuple[Floats, Floats]:
        """Motion with a line added.

        Parameters
        ----------
        line : array of shape (2, ..., K)
            Value and slope at the centre.

        Returns
        -------
        d, v : array of shape (..., K, T)
            Elongations in m and rates in m/s.
        """
        offset, slope = line[0][..., None], line[1][..., None]
        return self.d + offset + slope * self.time, self.v + slope


@dataclass(frozen=True, eq=False)
class DriftCandidates:
    """C lines in each of K windows.

    Attributes
    ----------
    lines : array of shape (2, C, K)
        Value in m and slope in m/s at the centre.
    cost : array of shape (C, K)
        Squared force errors in N^2.
    spread : array of shape (2, C, K)
        Standard deviations of the lines for a force error of 1 N.
    """

    lines: Floats
    cost: Floats
    spread: Floats

    def taken(self, order: Indices) -> DriftCandidates:
        """Those of each window with numbers in `order` (C, K)."""
        lines, spread = (np.take_along_axis(both, order[None], axis=1) for both in (self.lines, self.spread))
        return DriftCandidates(lines, np.take_along_axis(self.cost, order, axis=0), spread)


def drift_candidates(
    windows: DriftWindows, link: Link, values: dict[str, float], *, rounds: int = 0, reach: float = 0.0
) -> DriftCandidates:
    """The best lines of each window, by grid search and Levenberg-Marquardt iterations.

    Parameters
    ----------
    windows : DriftWindows
        The windows.
    link : Link
        The link.
    values : dict of str to float
        Its coefficients.
    rounds : int, optional
        How often a window also tries the lines of its neighbours.
    reach : float, optional
        How far in m a centre may be displaced at least.

    Returns
    -------
    DriftCandidates
        The lines.
    """
    if windows.integration_order == 0:
        line = np.zeros((2, 1, len(windows.d)))
        return DriftCandidates(line, _normal_equations(windows, link, values, line)[0], np.zeros_like(line))
    distinct = _distinct(_minimised(windows, link, values, _grid_minima(windows, link, values, reach)))
    for _ in range(rounds):
        new = _minimised(windows, link, values, _lines_of_neighbours(windows, distinct.lines))
        lines = np.concatenate([distinct.lines, new.lines], axis=1)
        spread = np.concatenate([distinct.spread, new.spread], axis=1)
        distinct = _distinct(DriftCandidates(lines, np.concatenate([distinct.cost, new.cost]), spread))
    return distinct


def _lines_of_neighbours(windows: DriftWindows, lines: Floats) -> Floats:
    """(2, 2 C, K) the lines (2, C, K) of the previous and of the next window; the first and the last keep their own."""
    drift = lines - windows.removed_line[:, None]
    lag = np.diff(windows.center) * windows.step
    previous, following = drift.copy(), drift.copy()
    previous[:, :, 1:] = drift[:, :, :-1]
    previous[0, :, 1:] += drift[1, :, :-1] * lag
    following[:, :, :-1] = drift[:, :, 1:]
    following[0, :, :-1] -= drift[1, :, 1:] * lag
    return np.concatenate([previous, following], axis=1) + windows.removed_line[:, None]


def _distinct(candidates: DriftCandidates) -> DriftCandidates:
    """The `_MINIMA` best lines of every window, each minimum once."""
    ordered = candidates.taken(np.argsort(candidates.cost, axis=0))
    cost, offset = ordered.cost, ordered.lines[0]
    apart = np.abs(offset[:, None] - offset[None]) > np.abs(offset).max() * _NEAR
    none = np.zeros(cost.shape[1], bool)
    copies = np.array([(~apart[c, :c]).any(axis=0) if c else none for c in range(len(cost))])
    chosen = np.argsort(copies, axis=0, kind="stable")[:_MINIMA]
    return replace(ordered, cost=np.where(copies, np.inf, cost)).taken(chosen)


def _minimised(windows: DriftWindows, link: Link, values: dict[str, float], line: Floats) -> DriftCandidates:
    """Each line (2, C, K) moved to the nearest minimum of the force error by Levenberg-Marquardt."""
    cost, gradient, h = _normal_equations(windows, link, values, line)
    cost = np.nan_to_num(cost, nan=np.inf)
    damping = np.full(cost.shape, _DAMPING)
    for _ in range(_STEPS):
        trial = line + np.einsum("ij...,j...->i...", _inverse(h, damping), gradient)
        trial_cost, trial_gradient, trial_h = _normal_equations(windows, link, values, trial)
        better = trial_cost < cost
        line, cost = np.where(better, trial, line), np.where(better, trial_cost, cost)
        gradient, h = np.where(better, trial_gradient, gradient), np.where(better, trial_h, h)
        damping = np.where(better, 0.3 * damping, 10.0 * damping)
    inverse = _inverse(h, np.zeros_like(cost))
    return DriftCandidates(line, cost, np.sqrt(np.maximum(np.stack([inverse[0, 0], inverse[1, 1]]), 0.0)))


def _normal_equations(
    windows: DriftWindows, link: Link, values: dict[str, float], line: Floats
) -> tuple[Floats, Floats, Floats]:
    """Squared force error (C, K), its gradient (2, C, K) and matrix (2, 2, C, K) by offset and slope."""
    d, v = windows.motion(line)
    partials = link.law.partials(d, v, values, by=())
    error = windows.force - partials.force
    by_offset = np.broadcast_to(partials.by_d, d.shape)
    by_slope = np.zeros_like(by_offset)
    if windows.integration_order > 1:
        by_slope = by_offset * windows.time + partials.by_v
    rows = (by_offset, by_slope)
    mixed = np.einsum("ckt,ckt->ck", *rows)
    own = [np.einsum("ckt,ckt->ck", row, row) for row in rows]
    h = np.array([[own[0], mixed], [mixed, own[1]]])
    gradient = np.array([np.einsum("ckt,ckt->ck", a, error) for a in rows])
    return np.einsum("ckt,ckt->ck", error, error), gradient, h


def _inverse(h: Floats, damping: Floats) -> Floats:
    """Inverse (2, 2, C, K) of a damped 2 by 2 matrix; 0 for the slope if nothing depends on it."""
    tiny = np.finfo(float).tiny
    a, b = h[0, 0] * (1.0 + damping) + tiny, h[1, 1] * (1.0 + damping)
    flat = b <= 0.0
    b = np.where(flat, 1.0, b)
    c = h[0, 1]
    det = np.maximum(a * b - c * c, 1e-12 * a * b)
    inverse = np.array([[b, -c], [-c, a]]) / det
    inverse[1, 1] = np.where(flat, 0.0, inverse[1, 1])
    return np.asarray(inverse)


def _grid_minima(windows: DriftWindows, link: Link, values: dict[str, float], reach: float) -> Floats:
    """(2, C, K) the lowest local minima on a grid of offsets and slopes."""
    thin = slice(None, None, max(1, len(windows.time) // _COARSE))
    d, v, force = windows.d[:, thin], windows.v[:, thin], windows.force[:, thin]
    time = windows.time[thin]
    offsets = np.linspace(-1.0, 1.0, _OFFSETS) * max(_REACH * np.abs(d).max(), reach)
    slopes = (
        np.linspace(-1.0, 1.0, _SLOPES) * np.abs(v).max() if windows.integration_order > 1 else np.zeros(1)
    )
    cost = np.empty((len(slopes), len(offsets), len(d)))
    count = max(1, _AT_ONCE // (len(offsets) * len(time)))
    for rows in (slice(first, first + count) for first in range(0, len(d), count)):
        for i, slope in enumerate(slopes):
            with np.errstate(over="ignore", invalid="ignore"):  # an exponential far from the motion
                moved = d[rows] + slope * time + offsets[:, None, None]
                error = force[rows] - link.law.force(moved, v[rows] + slope, values)
                cost[i, :, rows] = np.einsum("okt,okt->ok", error, error)
    cost = np.nan_to_num(cost, nan=np.inf)
    lowest = cost <= scipy.ndimage.minimum_filter(cost, size=(3, 3, 1), mode="nearest")
    flat = np.where(lowest, cost, np.inf).reshape(-1, len(d))
    chosen = np.argsort(flat, axis=0)[:_MINIMA]
    slope, offset = np.divmod(chosen, len(offsets))
    return np.stack([offsets[offset], slopes[slope]])


# length of a window: shorter ones have more candidates, in longer ones the drift is not a line
_PERIODS = 0.8
_OVERLAP = 3
_ROUNDS = 2  # of sharing candidates between neighbouring windows: elongations of six masses are six times as near with them
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
        windows = DriftWindows.of(signals, number, periods=_PERIODS, overlap=_OVERLAP)
        values = {**link.values, **link.zero_states}
        candidates = drift_candidates(windows, link, values, rounds=_ROUNDS)
        offset, slope = viterbi_path(windows, candidates, signals, number)
        rate = np.interp(sample, windows.center, slope)
        outside = (sample - np.clip(sample, windows.center[0], windows.center[-1])) * signals.step
        d[number] += np.interp(sample, windows.center, offset) + outside * rate
        v[number] += rate
    return d, v
