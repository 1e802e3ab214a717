"""The elastic force of a link over its elongation: the identified curve, its band, and samples of the record."""

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
    """The elastic force f(d, 0) of one link over its elongation d.

    Attributes
    ----------
    link : Link
        The identified link.
    identified : bool
        Whether one of its coefficients was unknown.
    d : array of shape (G,)
        Elongations in m, from below to above the visited range.
    force, lower, upper : array of shape (G,)
        Force in N and its 95 % band; NaN where no interval can be trusted.
    visited : tuple of float
        Range of the elongations in the record, in m.
    wells : tuple of float
        Stable equilibria in m.
    true : array of shape (G,) or None
        The true force in N, where known.
    sample_d, sample_force : array of shape (P,)
        Elongations in m and forces in N less the identified damping and memory, at samples of the record; empty where no
        force is known.
    samples_are_true : bool
        Whether these forces are simulated rather than measured.
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
        """Whether a coefficient was identified with a trusted interval."""
        return bool(np.isfinite(self.lower).all() and np.any(self.lower < self.upper))

    @property
    def frame(self) -> tuple[float, float]:
        """Smallest and largest force of the curves in N, with a margin."""
        curves = [self.force, self.lower, self.upper]
        return _frame(curves if self.true is None else [*curves, self.true])

    @property
    def outside(self) -> float:
        """Fraction of the samples outside the frame."""
        low, high = self.frame
        hidden = (self.sample_force < low) | (self.sample_force > high)
        return float(np.mean(hidden)) if len(hidden) else 0.0

    @property
    def between_wells(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges of d in m and force in N around the wells; None with fewer than two, or where they fill the whole curve."""
        if len(self.wells) < 2:
            return None
        span = max(self.wells) - min(self.wells)
        low, high = min(self.wells) - 0.3 * span, max(self.wells) + 0.3 * span
        near = (self.d >= low) & (self.d <= high)
        if high - low > 0.8 * (self.d[-1] - self.d[0]) or near.sum() < 10:
            return None
        return (low, high), _frame([self.force[near], self.lower[near], self.upper[near]])


def force_curve(estimate: Estimate, name: str, truth: Structure | None = None) -> ForceCurve:
    """Elastic force of an identified link.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    name : str
        Name of the link.
    truth : Structure, optional
        The true structure; by default that of a simulated record.

    Returns
    -------
    ForceCurve
        The curve.

    Raises
    ------
    StructureError
        If there is no such link.
    """
    link = estimate.link(name)
    low, high = link.d_range
    margin = BEYOND * (high - low)
    d = np.linspace(low - margin, high + margin, GRID)
    force, lower, upper = estimate.force_band(name, d)
    simulated = estimate.record.simulated
    known_truth = truth or (simulated.structure if simulated else None)
    sample_d, sample_force = _samples(estimate, name)
    return ForceCurve(
        link=link.link,
        identified=bool(link.free),
        d=d,
        force=force,
        lower=lower,
        upper=upper,
        visited=(low, high),
        wells=tuple(well.value for well in link.wells),
        true=None if known_truth is None else _elastic(known_truth.link(name), d),
        sample_d=sample_d,
        sample_force=sample_force,
        samples_are_true=simulated is not None,
    )


def _elastic(link: Link, d: Floats) -> Floats:
    """Force in N at rest; with memory, at states of 0."""
    return link.force(d, 0.0, link.zero_states)


def _samples(estimate: Estimate, name: str) -> tuple[Floats, Floats]:
    """Elongation (P,) m and force minus the identified damping and memory (P,) N at the samples of the record.

    The force is the true one of a simulated record, else the measured one, else there is none.
    """
    link = estimate.link(name).link
    index = [link.name for link in estimate.structure.links].index(name)
    states = link.zero_states
    simulated, motion = estimate.record.simulated, estimate.motion
    if simulated is not None:
        truth, base = simulated.structure, simulated.base
        rate = None if base is None else np.gradient(base, 1.0 / estimate.record.rate)
        d = truth.elongations(simulated.displacement, base)[:, index]
        v = truth.elongations(simulated.velocity, rate)[:, index]
        true_states = {
            key.rpartition(".")[2]: s for key, s in simulated.states.items() if key.startswith(f"{name}.")
        }
        force = truth.link(name).force(d, v, true_states)
        known = {state: true_states.get(state, at_rest) for state, at_rest in states.items()}
        identified = link.force(d, v, known)
    elif motion.force is not None:
        d, v, force = motion.d[:, index], motion.v[:, index], motion.force[:, index]
        with_memory = motion.identified_force if states else None
        identified = link.force(d, v, states) if with_memory is None else with_memory[:, index]
    else:
        return np.empty(0), np.empty(0)
    elastic = force - (identified - _elastic(link, d))
    finite = np.isfinite(elastic) & np.isfinite(d)
    return d[finite], elastic[finite]


def _frame(curves: list[Floats]) -> tuple[float, float]:
    """Smallest and largest force of the curves, with a margin."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.12 * (high - low) or 1.0
    return low - margin, high + margin
