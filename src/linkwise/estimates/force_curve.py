"""The elastic force of a link over its elongation: the identified curve, its band, and what the record shows of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Link, Structure

GRID = 401
BEYOND = 0.08  # of the visited range, shown on both sides of it


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """The elastic force f(d, 0) of one link over its elongation d; SI units throughout.

    `identified` tells whether anything of it was. `d` (G,) is the grid, `force`, `lower`, `upper` (G,) the curve and its 95 %
    band (NaN where no interval can be trusted), `true` (G,) the true curve where it is known. `sample_d`, `sample_force` (P,)
    are samples of the record: force less identified damping, measured or, where `samples_are_true`, simulated; empty where no
    such force is known.
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
    sample_d: Floats
    sample_force: Floats
    samples_are_true: bool

    @property
    def has_band(self) -> bool:
        """Whether something was identified, with intervals that can be trusted."""
        return bool(np.isfinite(self.lower).all() and np.any(self.lower < self.upper))

    @property
    def frame(self) -> tuple[float, float]:
        """The least and the greatest force of the curves, with a margin."""
        curves = [self.force, self.lower, self.upper]
        return _frame(curves if self.true is None else [*curves, self.true])

    @property
    def outside(self) -> float:
        """The part of the samples that lie beyond the frame."""
        low, high = self.frame
        hidden = (self.sample_force < low) | (self.sample_force > high)
        return float(np.mean(hidden)) if len(hidden) else 0.0

    @property
    def between_wells(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges of d and force that show the wells large; None where there are no two or the whole curve does."""
        if len(self.wells) < 2:
            return None
        span = max(self.wells) - min(self.wells)
        low, high = min(self.wells) - 0.3 * span, max(self.wells) + 0.3 * span
        near = (self.d >= low) & (self.d <= high)
        if high - low > 0.8 * (self.d[-1] - self.d[0]) or near.sum() < 10:
            return None
        return (low, high), _frame([self.force[near], self.lower[near], self.upper[near]])


def force_curve(estimate: Estimate, name: str, truth: Structure | None = None) -> ForceCurve:
    """The curve of link `name`; `truth` is the true structure where it is known (of a simulated record it is)."""
    found = estimate.link(name)
    low, high = found.d_range
    margin = BEYOND * (high - low)
    d = np.linspace(low - margin, high + margin, GRID)
    force, lower, upper = estimate.force_band(name, d)
    simulated = estimate.record.simulated
    known_truth = truth or (simulated.structure if simulated else None)
    sample_d, sample_force = _samples(estimate, name)
    return ForceCurve(
        link=found.link,
        identified=bool(found.free),
        d=d,
        force=force,
        lower=lower,
        upper=upper,
        visited=(low, high),
        wells=tuple(well.value for well in found.wells),
        true=None if known_truth is None else known_truth.link(name).force(d),
        sample_d=sample_d,
        sample_force=sample_force,
        samples_are_true=simulated is not None,
    )


def _samples(estimate: Estimate, name: str) -> tuple[Floats, Floats]:
    """Elongation (P,) m and force less the identified damping (P,) N at the samples of the record.

    The force is the true one of a simulated record, else the measured one, else there is none.
    """
    index = [link.name for link in estimate.structure.links].index(name)
    simulated, motion = estimate.record.simulated, estimate.motion
    if simulated is not None:
        truth, base = simulated.structure, simulated.base
        rate = None if base is None else np.gradient(base, 1.0 / estimate.record.rate)
        d = truth.elongations(simulated.displacement, base)[:, index]
        v = truth.elongations(simulated.velocity, rate)[:, index]
        force = truth.link(name).force(d, v)
    elif motion.force is not None:
        d, v, force = motion.d[:, index], motion.v[:, index], motion.force[:, index]
    else:
        return np.empty(0), np.empty(0)
    link = estimate.link(name).link
    elastic = force - (link.force(d, v) - link.force(d))
    there = np.isfinite(elastic) & np.isfinite(d)
    return d[there], elastic[there]


def _frame(curves: list[Floats]) -> tuple[float, float]:
    """The least and greatest force of the curves, and a margin."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.12 * (high - low) or 1.0
    return low - margin, high + margin
