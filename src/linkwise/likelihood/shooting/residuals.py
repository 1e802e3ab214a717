"""Residuals of the samples and defects between segments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.clipped_readings import ClippedMisfit
from linkwise.likelihood.shooting.flow import Trajectories, flow
from linkwise.likelihood.shooting.late_sensors import late_motion
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.likelihood.shooting.segments import A, F, Iterate, S, Scales, Segments, V, X
from linkwise.likelihood.shooting.slider_starts import cost_of_starts
from linkwise.likelihood.shooting.system import NumericSystem


@dataclass(frozen=True, eq=False)
class Misfit:
    """Misfit at a point of the search.

    Attributes
    ----------
    point : Iterate
        The unknowns.
    trajectories : Trajectories
        The orbit.
    residuals : array of shape (M, C, K)
        Residuals in standard deviations of the noise; 0 where a sample is missing.
    defects : array of shape (2n + S, K - 1)
        Defects in units of the state; 0 between segments that are not linked.
    data, continuity : float
        Cost of the residuals, and of the defects for q = 1.
    prior : float
        Cost of the unknowns' distances from what is known of them beforehand, of random forces, and of sliders at the start.
    clipped : ClippedMisfit or None
        What clipped readings say, beside the samples.
    """

    point: Iterate
    trajectories: Trajectories
    residuals: Floats
    defects: Floats
    data: float
    continuity: float
    prior: float = 0.0
    clipped: ClippedMisfit | None = None

    @cached_property
    def pulling(self) -> Floats:
        """(M, C, K) residuals, also of the observations that stand for clipped readings."""
        return self.residuals if self.clipped is None else self.residuals + self.clipped.residuals

    def part(self, segments: slice) -> Misfit:
        """The misfit of some segments that follow each other, without clipped readings and whole costs, which are NaN."""
        return Misfit(
            replace(self.point, nodes=self.point.nodes[..., segments]),
            self.trajectories.part(segments),
            self.residuals[..., segments],
            self.defects[..., segments.start : segments.stop - 1],
            *(np.nan, np.nan),
        )

    def roots(self, segments: Segments, loss: Loss, part: slice) -> Floats:
        """(M, C, k) square roots of the weights of the residuals that pull, in some segments; 0 where there is none."""
        roots = segments.roots(loss.weight(self.residuals[..., part]), part)
        return roots if self.clipped is None else roots + self.clipped.roots[..., part]

    def cost(self, q: float) -> float:
        """Total cost.

        Parameters
        ----------
        q : float
            Relaxation.

        Returns
        -------
        float
            data + prior + continuity / q^2, and the cost of clipped readings.
        """
        return self.cost_of_samples(q) + (0.0 if self.clipped is None else self.clipped.cost)

    def cost_of_samples(self, q: float) -> float:
        """The cost without that of clipped readings, which is not that of as many residuals."""
        return self.data + self.prior + self.continuity / q**2


def _whitened(residuals: Floats, segments: Segments, scales: Scales, loss: Loss) -> ClippedMisfit | None:
    """Divide residuals (M, C, K) by the noise, with 0 for missing samples; gives the misfit of clipped readings."""
    unit = scales.sigma[:, None]
    if segments.relative_noise is not None:
        unit = unit * segments.relative_noise
    residuals /= unit
    clipped = None
    if segments.clipped is not None and isinstance(loss, Gaussian):
        clipped = segments.clipped.misfit(residuals, unit)
    residuals *= segments.observed
    return clipped


def evaluate(segments: Segments, point: Iterate, scales: Scales, loss: Loss) -> Misfit:
    """Misfit at a point.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    point : Iterate
        The unknowns.
    scales : Scales
        Units of the unknowns.
    loss : Loss
        Loss of a residual.

    Returns
    -------
    Misfit
        Residuals and defects; not finite where the motion diverges.
    """
    mechanics = segments.system.at(point.theta)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a mass may be 0 in a trial
        inputs = segments.inputs.at(point.gains, point.delays)
        orbit = flow(mechanics, point.nodes, segments.step, segments.steps, inputs)
    sensors, rate = segments.sensors.at(mechanics), 1.0 / segments.step
    shown_orbit = sensors.orbit_with_points(orbit)
    every = segments.at_samples
    residuals = np.empty_like(segments.samples)
    for kind, motion in (
        (X, shown_orbit.states[every, 0]),
        (V, shown_orbit.states[every, 1] * rate),
        (A, shown_orbit.accelerations[every]),
        (F, forces_at_samples(segments, mechanics, orbit)),
        (S, orbit.memory[every]),
    ):
        chosen = np.flatnonzero(sensors.kind == kind)
        residuals[:, chosen] = segments.samples[:, chosen] - motion[:, sensors.mass[chosen]]
    if segments.random is not None and segments.random.shown is not None:
        residuals[0] -= segments.random.shown @ point.nodes[segments.random.rows]
    for channel in sensors.late:
        shown, _ = late_motion(
            shown_orbit,
            segments.step * segments.refine,
            segments.refine,
            mass=int(sensors.mass[channel]),
            kind=int(sensors.kind[channel]),
            delay=float(point.delays[sensors.delay[channel]]),
        )
        residuals[:, channel] = segments.samples[:, channel] - shown
        if segments.carried is not None and segments.late_base is not None:
            carried, _ = segments.late_base.at(channel, float(point.delays[sensors.delay[channel]]))
            residuals[:, channel] += segments.carried[0, :, channel] - carried
    factors = sensors.factors(point.gains)
    for channel in sensors.scaled:
        shown = segments.samples[:, channel] - residuals[:, channel]
        if segments.carried is not None:
            shown = shown + segments.carried[0, :, channel]
        residuals[:, channel] -= (factors[channel] - 1.0) * shown
    for channel in np.flatnonzero(sensors.offset >= 0):
        residuals[:, channel] -= point.offsets[sensors.offset[channel]]
    if segments.waveforms is not None:
        for channel in np.unique(segments.waveforms.channel).tolist():
            residuals[:, channel] -= segments.waveforms.added(channel, point.offsets[sensors.constants :])
    clipped = _whitened(residuals, segments, scales, loss)
    ends = orbit.ends(segments.step)
    defects = (point.nodes[..., 1:] - ends[..., :-1]) / scales.state[:, None]
    defects *= segments.link_weights
    prior = 0.0 if segments.prior is None else segments.prior.cost(point.border)
    prior += cost_of_starts(segments, point.nodes, scales)
    if segments.random is not None:
        prior += segments.random.cost(point.nodes, point.border)
    data, continuity = loss.total(residuals), float(np.vdot(defects, defects))
    return Misfit(point, orbit, residuals, defects, data, continuity, prior, clipped)


def forces_at_samples(segments: Segments, mechanics: NumericSystem, orbit: Trajectories) -> Floats:
    """(M, L, K) forces in the links in N at the samples; zeros where no sensor shows one."""
    every = segments.at_samples
    links = orbit.links[every]
    forces = np.zeros_like(links[:, 0])
    if (segments.sensors.kind == F).any():
        memory = orbit.memory[every]
        mechanics.force(links[:, 0], links[:, 1], memory, forces, np.empty_like(memory))
    return forces
