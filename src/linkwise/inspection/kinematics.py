"""What must hold between two channels of one place: one is a derivative of the other.

Against test functions p of bounded support, integral(p v) = -integral(p' x) for v = dx/dt, without any derivative of samples.
A gain g, a delay tau, an offset b and a slope s of the higher channel give

    integral(p v) = g (-integral(p' x)) + g tau (-integral(p'' x)) + b integral(p) + s integral(p t),

for small tau, and likewise for v and a, and with one more derivative for x and a. A tau that is not small is found in
steps, with test functions of the higher channel that are moved by what is known of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.bump import bumps, projections
from linkwise.inspection.channel_signal import ChannelSignal

_PERIODS = 1.0  # of the fastest motion that half a test function spans
_FEWEST = 24  # test functions side by side
_BLOCKS = 12  # of the record that are left out in turn, for standard errors
# condition of normal equations without a block, from which on the motion of one block decides
_SINGULAR = 1e10
_STEPS = 8  # until what is left of the delay is small
_SMALL = 0.02  # samples
_FAR = 0.1  # of the fastest period: a delay beyond it is searched from several starts
_KINDS = "xva"


@dataclass(frozen=True)
class KinematicFit:
    """How the channel `upper` follows from `lower`: each parameter with its standard error.

    `delay` is in s, positive where `upper` comes late; `offset` in the unit of `upper`, `trend` in that per s, both at the
    middle of the record; `share` is the part of the power of `upper` that this explains.
    """

    lower: ChannelSignal
    upper: ChannelSignal
    gain: tuple[float, float]
    delay: tuple[float, float]
    offset: tuple[float, float]
    trend: tuple[float, float]
    share: float


def kinematic_fits(channels: Iterable[ChannelSignal]) -> Iterator[KinematicFit]:
    """A fit for each place with two channels or more, of neighbours in displacement, velocity and acceleration."""
    places: dict[tuple[str, bool], list[ChannelSignal]] = {}
    for signal in channels:
        if signal.channel.kind in _KINDS:
            places.setdefault((signal.channel.mass, signal.channel.relative), []).append(signal)
    for beside in places.values():
        ordered = sorted(beside, key=lambda signal: _KINDS.index(signal.channel.kind))
        for lower, upper in pairwise(ordered):
            fit = _fit(lower, upper)
            if fit is not None:
                yield fit


def _fit(lower: ChannelSignal, upper: ChannelSignal) -> KinematicFit | None:
    """The fit of two channels; None where the record is too short or has too few complete pieces.

    A delay as long as a part of the fastest period has several valleys, of which the one that explains most is taken. Where
    none settles, the fit about no delay stands.
    """
    width = _width(lower, upper)
    first = _fit_about(lower, upper, 0.0)
    if first is None:
        return None
    far = abs(first.delay[0]) * upper.rate > _FAR * width
    starts = np.arange(-1.0, 1.25, 0.25) * width if far else (0.0,)
    settled = [fit for fit in (_settled(lower, upper, float(start)) for start in starts) if fit is not None]
    return max(settled, key=lambda fit: fit.share, default=first)


def _settled(lower: ChannelSignal, upper: ChannelSignal, late: float) -> KinematicFit | None:
    """The fit about its own delay, which enters to first order, searched from `late` samples; None if there is none."""
    for _ in range(_STEPS):
        fit = _fit_about(lower, upper, late)
        if fit is None:
            return None
        rest = fit.delay[0] * upper.rate
        late += rest
        if abs(rest) < _SMALL:
            return replace(fit, delay=(late / upper.rate, fit.delay[1]))
        if not abs(late) < len(upper.values) // 4:
            return None
    return None


def _width(lower: ChannelSignal, upper: ChannelSignal) -> int:
    """Samples that half a test function spans; 0 where nothing moves."""
    highest = max(lower.highest, min(upper.highest, 0.1 * upper.rate))
    return max(8, round(_PERIODS * lower.rate / highest)) if highest > 0.0 else 0


def _fit_about(lower: ChannelSignal, upper: ChannelSignal, late: float) -> KinematicFit | None:
    """The fit of two channels, of which `upper` comes `late` by so many samples and by the delay of the fit."""
    shift = round(late)
    order = _KINDS.index(upper.channel.kind) - _KINDS.index(lower.channel.kind)
    width = _width(lower, upper)
    count = len(lower.values) - abs(shift)
    if not width or count < width * _FEWEST:
        return None
    of_lower, of_upper = (slice(start, start + count) for start in (max(-shift, 0), max(shift, 0)))
    tests = bumps(width, order + 1, 1.0 / lower.rate)
    hop = max(width // 4, 1)
    reached = (np.isnan(lower.values[of_lower]) | np.isnan(upper.values[of_upper])).astype(float)
    complete = projections(reached, np.ones((1, tests.shape[1])), hop)[0] == 0.0
    sign = (-1.0) ** order
    x = projections(lower.filled[of_lower], tests, hop)
    half = 0.5 * (count - 1) / lower.rate
    time = np.linspace(-half, half, count)
    columns = np.column_stack(
        [
            sign * x[order],
            sign * x[order + 1],
            projections(np.ones(count), tests[:1], hop)[0],
            projections(time, tests[:1], hop)[0],
        ]
    )[complete]
    moved = bumps(width, 0, 1.0 / lower.rate, late - shift)
    target = projections(upper.filled[of_upper], moved, hop)[0][complete]
    if len(target) < 4 * _FEWEST or not target.any():
        return None
    noise = np.array([lower.sigma**2 * float(row @ row) for row in tests[order : order + 2]])
    return _solved(lower, upper, columns, target, noise)


def _solved(
    lower: ChannelSignal, upper: ChannelSignal, columns: Floats, target: Floats, noise: Floats
) -> KinematicFit | None:
    """Least squares without the bias of the `noise` (2,) in the first two columns, with errors by a jackknife over blocks."""
    blocks = np.array_split(np.arange(len(target)), _BLOCKS)
    grams = np.array([columns[rows].T @ columns[rows] for rows in blocks])
    right = np.array([columns[rows].T @ target[rows] for rows in blocks])
    for gram, rows in zip(grams, blocks, strict=True):
        gram[[0, 1], [0, 1]] -= len(rows) * np.nan_to_num(noise)
    scale = 1.0 / np.sqrt(np.abs(np.diagonal(grams.sum(axis=0))))
    if not np.all(np.isfinite(scale)) or grams.sum(axis=0)[0, 0] <= 0.5 * float(
        columns[:, 0] @ columns[:, 0]
    ):
        return None

    left_out = grams.sum(axis=0) - grams  # one block each
    if np.linalg.cond(left_out * np.outer(scale, scale)).max() > _SINGULAR:
        return None

    def solve(gram: Floats, side: Floats) -> Floats:
        solution = scale * np.linalg.solve(gram * np.outer(scale, scale), side * scale)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a gain of 0
            return np.array([solution[0], solution[1] / solution[0], solution[2], solution[3]])

    whole = solve(grams.sum(axis=0), right.sum(axis=0))
    without = np.array([solve(g, right.sum(axis=0) - r) for g, r in zip(left_out, right, strict=True)])
    if not np.isfinite(whole).all() or not np.isfinite(without).all():
        return None
    spread = np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    coefficients = np.array([whole[0], whole[0] * whole[1], whole[2], whole[3]])
    left = target - columns @ coefficients
    share = 1.0 - float(left @ left) / float(target @ target)
    pairs = [(float(value), float(error)) for value, error in zip(whole, spread, strict=True)]
    return KinematicFit(lower, upper, pairs[0], pairs[1], pairs[2], pairs[3], share)
