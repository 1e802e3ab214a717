"""What there is to see of a link's force, computed once for paper and page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Link, Structure
from linkwise.plot.downsample import scattered

GRID = 401
BEYOND = 0.08  # of the visited range, drawn on both sides of it


@dataclass(frozen=True, eq=False)
class ForceView:
    """The elastic force of one link, f(d, 0), over its elongation d; SI units throughout.

    `identified` tells whether anything of it was. `d` (G,) is the grid, `force`, `lower`, `upper` (G,) the curve
    and its 95 % band (NaN where none can be trusted), `true` (G,) the true curve where it is known. `cloud_d`,
    `cloud` (P,) are samples of the record: force less identified damping, measured or, where `cloud_is_true`,
    simulated; empty where no such force is known. `outside` is the part of the cloud beyond `frame`, the least
    and greatest force to show.
    """

    link: Link
    identified: bool
    d: Floats
    force: Floats
    lower: Floats
    upper: Floats
    visited: tuple[float, float]
    wells: tuple[float, ...]
    true: Floats | None
    cloud_d: Floats
    cloud: Floats
    cloud_is_true: bool
    frame: tuple[float, float]
    outside: float

    @property
    def has_band(self) -> bool:
        """Whether there is a band to draw: something was identified, and its intervals can be trusted."""
        return bool(np.isfinite(self.lower).all() and np.any(self.lower < self.upper))

    @property
    def between_wells(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges of d and force that show the wells large; None where there are no two or the whole view does."""
        if len(self.wells) < 2:
            return None
        span = max(self.wells) - min(self.wells)
        low, high = min(self.wells) - 0.3 * span, max(self.wells) + 0.3 * span
        near = (self.d >= low) & (self.d <= high)
        if high - low > 0.8 * (self.d[-1] - self.d[0]) or near.sum() < 10:
            return None
        return (low, high), _frame([self.force[near], self.lower[near], self.upper[near]])


def force_view(estimate: Estimate, name: str, truth: Structure | None = None) -> ForceView:
    """The view of link `name`; `truth` is the true structure where it is known (of a simulated record it is)."""
    found = estimate.link(name)
    link = found.link
    low, high = found.d_range
    margin = BEYOND * (high - low)
    d = np.linspace(low - margin, high + margin, GRID)
    force, lower, upper = estimate.force_band(name, d)
    simulated = estimate.record.simulated
    known_truth = truth or (simulated.structure if simulated else None)
    true = None if known_truth is None else known_truth.link(name).force(d)
    cloud_d, cloud, is_true = _cloud(estimate, name)
    frame = _frame([force, lower, upper] if true is None else [force, lower, upper, true])
    hidden = np.mean((cloud < frame[0]) | (cloud > frame[1])) if len(cloud) else 0.0
    wells = tuple(well.value for well in found.wells)
    return ForceView(
        link,
        bool(found.free),
        d,
        force,
        lower,
        upper,
        (low, high),
        wells,
        true,
        cloud_d,
        cloud,
        is_true,
        frame,
        float(hidden),
    )


def _cloud(estimate: Estimate, name: str) -> tuple[Floats, Floats, bool]:
    """Elongation (P,) and force less the identified damping (P,) at samples of the record, thinned.

    The force is the true one of a simulated record, else the measured one, else there is none.
    """
    index = [link.name for link in estimate.structure.links].index(name)
    simulated, motion = estimate.record.simulated, estimate.motion
    if simulated is not None:
        which = scattered(len(simulated.displacement))
        truth, base = simulated.structure, simulated.base
        d = truth.elongations(simulated.displacement, base)[which, index]
        v = truth.elongations(simulated.velocity, _rate(base, estimate.record.rate))[which, index]
        force = truth.link(name).force(d, v)
    elif motion.force is not None:
        which = scattered(len(motion.d))
        d, v, force = motion.d[which, index], motion.v[which, index], motion.force[which, index]
    else:
        return np.empty(0), np.empty(0), False
    link = estimate.link(name).link
    elastic = force - (link.force(d, v) - link.force(d))
    there = np.isfinite(elastic) & np.isfinite(d)
    return d[there], elastic[there], simulated is not None


def _rate(base: Floats | None, rate: float) -> Floats | None:
    """Velocity (N,) of the base from its displacement (N,), for the eye only."""
    return None if base is None else np.gradient(base, 1.0 / rate)


def _frame(curves: list[Floats]) -> tuple[float, float]:
    """The least and greatest force of the curves, and a margin."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.12 * (high - low) or 1.0
    return low - margin, high + margin
