"""Curves of a link: its elastic force with a band, its force along the motion of a record, the equivalent linear spring
and damper, and mean residuals over a range of motion.

For the force f(d, v) of a motion d = A sin(w t) the describing function is the first harmonic of the force over that of
the motion (Krylov and Bogoliubov 1943):

    k(A) = 1/(pi A) int_0^{2 pi} f sin,   c(A) = 1/(pi A w) int_0^{2 pi} f cos
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import RecordError, StructureError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95, LinkEstimate, true_motion
from linkwise.model.link import refuse_memory
from linkwise.model.structure import Link, Structure
from linkwise.records.record import SimulationTruth

GRID = 401
BEYOND = 0.08  # of the visited range, shown on both sides of it


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """The elastic force f(d, 0) in N of one link over G elongations `d` in m, from below to above the range `visited` in
    the record, with its 95 % band from `lower` to `upper`, NaN where no interval can be trusted. `identified` says whether
    a coefficient was unknown, `wells` are stable equilibria in m, and `true` is the true force where it is known.
    `sample_d` and `sample_force` (P,) are forces at samples less the identified damping and memory, empty where none is
    known, and simulated rather than measured if `samples_are_true`.
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
        return _force_limits(curves if self.true is None else [*curves, self.true])

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
        return (low, high), _force_limits([self.force[near], self.lower[near], self.upper[near]])


def force_curve(estimate: Estimate, name: str, truth: Structure | None = None) -> ForceCurve:
    """Elastic force of an identified link, beside that of `truth`, which is the true structure of a simulated record by
    default.
    """
    link = estimate.link(name)
    low, high = link.d_range
    margin = BEYOND * (high - low)
    d = np.linspace(low - margin, high + margin, GRID)
    force, lower, upper = estimate.force_band(name, d)
    simulated = _simulated(estimate, name)
    known_truth = truth or (simulated.structure if simulated else None)
    sample_d, sample_force = _samples(estimate, name, simulated)
    return ForceCurve(
        link=link.link,
        identified=bool(link.free),
        d=d,
        force=force,
        lower=lower,
        upper=upper,
        visited=(low, high),
        wells=tuple(well.value for well in link.wells),
        true=None if known_truth is None else _elastic_force(known_truth.link(name), d),
        sample_d=sample_d,
        sample_force=sample_force,
        samples_are_true=simulated is not None,
    )


def _elastic_force(link: Link, d: Floats) -> Floats:
    """Force in N at rest; with memory, at states of 0."""
    return link.force(d, 0.0, link.zero_states)


def _simulated(estimate: Estimate, name: str) -> SimulationTruth | None:
    """The motion of a simulated record, where what was simulated has a link of that name."""
    simulated = estimate.record.simulated
    known = simulated is not None and name in [link.name for link in simulated.structure.links]
    return simulated if known else None


def _samples(estimate: Estimate, name: str, simulated: SimulationTruth | None) -> tuple[Floats, Floats]:
    """Elongation (P,) m and force minus the identified damping and memory (P,) N at the samples of the record.

    The force is the true one of the `simulated` motion, else the measured one, else there is none.
    """
    link = estimate.link(name).link
    index = [link.name for link in (simulated or estimate).structure.links].index(name)
    states, motion = link.zero_states, estimate.motion
    if simulated is not None:
        true, (d, v) = simulated.structure.links[index], true_motion(estimate.record, index)
        true_states = {key: simulated.states[f"{name}.{key}"] for key in true.law.states}
        true_states |= {key: estimate.record.channel(f"signal:{key}") for key in true.law.signals}
        force = true.force(d, v, true_states)
        known = {state: true_states.get(state, at_rest) for state, at_rest in states.items()}
        identified = link.force(d, v, known)
    elif motion.force is not None:
        d, v, force = motion.d[:, index], motion.v[:, index], motion.force[:, index]
        with_memory = motion.identified_force if states else None
        identified = link.force(d, v, states) if with_memory is None else with_memory[:, index]
    else:
        return np.empty(0), np.empty(0)
    elastic = force - (identified - _elastic_force(link, d))
    finite = np.isfinite(elastic) & np.isfinite(d)
    return d[finite], elastic[finite]


def _force_limits(curves: list[Floats]) -> tuple[float, float]:
    """Smallest and largest force of the curves, with a margin."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.12 * (high - low) or 1.0
    return low - margin, high + margin


@dataclass(frozen=True, eq=False)
class ForceLoop:
    """Force of a link at the N samples of the first record, a `step` in s apart: elongations `d` in m, rates `v` in m/s,
    the `identified` force in N, and the one that a load cell `measured`, less its offset, or None.
    """

    d: Floats
    v: Floats
    identified: Floats
    measured: Floats | None
    step: float

    @property
    def largest(self) -> float:
        """The largest force in N."""
        shown = self.identified if self.measured is None else np.concatenate([self.identified, self.measured])
        return float(np.nanmax(np.abs(shown)))

    @property
    def cycles(self) -> int:
        """Complete cycles: from one time the elongation rises through the middle of its range to the next."""
        return max(len(self._rises) - 1, 0)

    @property
    def energy(self) -> float:
        """Work in J done on the link a cycle, or over the record where there is no complete cycle."""
        power = self.identified * self.v * self.step
        if not self.cycles:
            return float(np.nansum(power))
        return float(np.nansum(power[self._rises[0] : self._rises[-1]])) / self.cycles

    @property
    def energy_text(self) -> str:
        """What it dissipates, in words."""
        if not self.cycles:
            return f"work done on it over the record: {self.energy:.4g} J"
        many = f"mean of {self.cycles} cycles" if self.cycles > 1 else "of one cycle"
        return f"energy dissipated a cycle: {self.energy:.4g} J ({many})"

    @property
    def _rises(self) -> list[int]:
        low, high = float(np.nanmin(self.d)), float(np.nanmax(self.d))
        middle, band = 0.5 * (low + high), 0.05 * (high - low)
        side = np.where(self.d < middle - band, -1, np.where(self.d >= middle, 1, 0))
        outside = np.flatnonzero(side)
        rises: list[int] = outside[1:][np.diff(side[outside]) > 0].tolist()
        return rises


def force_loop(estimate: Estimate, name: str) -> ForceLoop:
    """The force of an identified link along the motion of the first record.

    Raises StructureError if there is no such link, or the force in it is not known along the motion.
    """
    link = estimate.link(name).link
    motion, count = estimate.motion, len(estimate.record)
    index = [candidate.name for candidate in motion.structure.links].index(name)
    d, v = motion.d[:count, index], motion.v[:count, index]
    if motion.identified_force is not None:
        force = motion.identified_force[:count, index]
    elif link.law.is_plain:
        force = link.force(d, v)
    else:
        message = "the force of a link with states or signals is not known without these"
        raise StructureError(message, f'link "{name}"')
    measured = None if motion.measured_force is None else motion.measured_force[:count, index]
    return ForceLoop(d, v, np.asarray(force), measured, estimate.record.step)


def has_loop(estimate: Estimate, name: str) -> bool:
    """Whether the force of a link forms loops that are known: of links with memory and of those on a rig."""
    index = [link.name for link in estimate.structure.links].index(name)
    forces = estimate.motion.identified_force
    return forces is not None and bool(np.isfinite(forces[:, index]).any())


def fitted_channels(estimate: Estimate) -> dict[str, tuple[Floats, Floats]]:
    """Channels (N,) of the first record as measured, and what the fit says that they show: those of a fit to samples, or the
    load cells of links whose forces are known.
    """
    motion, record = estimate.motion, estimate.record
    if motion.residuals:
        scaled = ((name, estimate.noise[name].sigma * one) for name, one in motion.residuals.items())
        left = ((record.channel(name), name, residuals[: len(record)]) for name, residuals in scaled)
        return {name: (samples, samples - residuals) for samples, name, residuals in left}
    if motion.measured_force is None or motion.identified_force is None:
        return {}
    names = [f"f:{link.name}" for link in motion.structure.links]
    forces = zip(names, motion.measured_force.T, motion.identified_force.T, strict=True)
    return {name: (a[: len(record)], b[: len(record)]) for name, a, b in forces if name in record.channels}


def force_error(true: Floats, identified: Floats, link: str) -> float:
    """The mean square of the difference of two forces (N,) over the variance of the true one, in %: the paper's Eq. 8.

    Raises RecordError where that does not vary.
    """
    variance = float(np.var(true))
    if variance == 0.0:
        raise RecordError(
            f'the true force of link "{link}" does not vary over the record, so no relative error exists'
        )
    return float(100.0 * np.mean((true - identified) ** 2) / variance)


_POINTS = 512  # of a cycle: exact for polynomials, and 1e-5 for laws with kinks


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Equivalent linear spring and damper of a link at A amplitudes.

    Attributes
    ----------
    amplitude : array of shape (A,)
        Amplitudes in m.
    stiffness : array of shape (A,)
        Equivalent stiffness in N/m.
    stiffness_band : array of shape (A, 2)
        Ends of its 95 % band; NaN where no interval can be trusted.
    damping : array of shape (A,)
        Equivalent damping in N s/m.
    damping_band : array of shape (A, 2)
        Ends of its 95 % band.

    See Also
    --------
    equivalent : Compute it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> lw.estimates.equivalent(estimate.link("nes1"), [0.005], 5.0).stiffness_band.shape
    (1, 2)
    """

    amplitude: Floats
    stiffness: Floats
    stiffness_band: Floats
    damping: Floats
    damping_band: Floats


def equivalent(link: LinkEstimate, amplitude: ArrayLike, frequency: float) -> Equivalent:
    """Equivalent linear spring and damper of an identified link: its describing function.

    Parameters
    ----------
    link : LinkEstimate
        The link, from `Estimate.link`.
    amplitude : array_like of shape (A,)
        Amplitudes of the elongation in m.
    frequency : float
        Frequency in Hz.

    Returns
    -------
    Equivalent
        Stiffness and damping with their 95 % bands.

    Raises
    ------
    StructureError
        If the link has memory, amplitudes have more than one dimension, or the frequency is not positive.

    Notes
    -----
    For d = A sin(w t), k(A) = 1/(pi A) int_0^{2 pi} f sin and c(A) = 1/(pi A w) int_0^{2 pi} f cos over one cycle. The bands
    follow by the delta method.

    References
    ----------
    N. Krylov and N. Bogoliubov, Introduction to Non-linear Mechanics (1943).

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> lw.estimates.equivalent(estimate.link("nes1"), [0.005, 0.01], 5.0).stiffness.round()
    array([-81., -25.])
    """
    refuse_memory([link.link], "equivalent springs and dampers")
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    if a.ndim > 1:
        raise StructureError(f"amplitude must be a number or have the shape (A,), got the shape {a.shape}")
    if not frequency > 0.0:
        raise StructureError(f"frequency must be positive, got {frequency} Hz")
    omega = 2.0 * np.pi * frequency
    phase = 2.0 * np.pi * np.arange(_POINTS) / _POINTS
    d, v = np.outer(a, np.sin(phase)), omega * np.outer(a, np.cos(phase))
    partials = link.link.law.partials(d, v, link.link.values)
    slopes = np.array([np.broadcast_to(partials.by_coefficient[name], d.shape) for name in link.free])
    slopes = slopes.reshape(len(link.free), *d.shape)
    results = []
    for harmonic, unit in ((np.sin(phase), a), (np.cos(phase), a * omega)):
        weight = 2.0 * harmonic / _POINTS
        value = partials.force @ weight / unit
        half = NORMAL_95 * link.deviation(slopes @ weight / unit)
        results += [value, np.stack([value - half, value + half], axis=1)]
    return Equivalent(a, *results)


_PARTS = 24
_FEWEST = 20  # samples in a part
_TWO = 2.0  # standard errors of a mean, between which noise leaves 95 % of them


@dataclass(frozen=True, eq=False)
class MeanResiduals:
    """Mean residuals (P,) in standard deviations of the noise over the mean motion, the `place`, in P parts of its range
    with equally many samples; white noise alone leaves at most `by_chance` in 95 % of the parts, to both sides of zero.
    """

    place: Floats
    mean: Floats
    by_chance: Floats

    @classmethod
    def along(cls, motion: Floats, residuals: Floats) -> MeanResiduals:
        """Those of residuals (N,), NaN where a sample is missing, along a motion (N,); of none there is one part, of NaN."""
        present = np.flatnonzero(~np.isnan(residuals))
        if not len(present):
            return cls(*np.full((3, 1), np.nan))
        order = present[np.argsort(motion[present], kind="stable")]
        parts = np.array_split(order, max(min(_PARTS, len(order) // _FEWEST), 1))
        return cls(
            np.array([motion[part].mean() for part in parts]),
            np.array([residuals[part].mean() for part in parts]),
            np.array([_TWO / np.sqrt(len(part)) for part in parts]),
        )
