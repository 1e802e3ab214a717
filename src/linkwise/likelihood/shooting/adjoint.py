"""The gradient of the cost of multiple shooting by the adjoint of its sensitivities, which does not need these.

The scheme of the sensitivities is linear, and run backwards it carries what the samples and the ends of a segment pull at to
its node and to the parameters: all in one sweep of a single column, which costs a part of what the flow does.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Scales, Segments, V, X
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangent_forces import TangentForces
from linkwise.likelihood.shooting.tangents import tangent_forces

_AT_ONCE = 20_000  # elongations of links that are swept together


def has_adjoint(segments: Segments) -> bool:
    """Whether samples are displacements and velocities of masses that nothing but laws, forces and offsets determines.

    Parameters
    ----------
    segments : Segments
        The records in segments.

    Returns
    -------
    bool
        Whether `gradient` knows everything that they depend on.
    """
    system, sensors = segments.system, segments.sensors
    others = (
        system.states
        or system.shapes is not None
        or sensors.shapes is not None
        or segments.random is not None
        or segments.clipped is not None
    )
    uncertain = sensors.gains or sensors.delays or sensors.waveforms or segments.inputs.uncertain is not None
    return not others and not uncertain and bool(np.isin(sensors.kind, (X, V)).all())


def gradient(
    segments: Segments, misfit: Misfit, scales: Scales, loss: Loss, pulls: Floats
) -> tuple[Floats, Floats]:
    """Half the gradient of the cost at a relaxation, its sign reversed: the right-hand side of normal equations.

    Parameters
    ----------
    segments, misfit, scales, loss
        As of `evaluate`, where segments have an adjoint.
    pulls : array of shape (K - 1, m)
        What the ends of segments pull at: defects over the square of the relaxation, at the optimum.

    Returns
    -------
    nodes, border : array of shape (K, m) and (P,)
        The gradient in scaled unknowns.
    """
    system, p = segments.system, segments.system.parameters.size
    mechanics, K = system.at(misfit.point.theta), segments.count
    pulled = loss.weight(misfit.residuals) * misfit.residuals / scales.sigma[:, None]
    if segments.counts is not None:
        pulled = pulled * segments.counts
    if segments.relative_noise is not None:
        pulled = pulled / segments.relative_noise
    defects = pulls.T
    nodes, border = np.zeros((system.dimension, K)), np.zeros(segments.parameters)
    size = max(_AT_ONCE // len(system.incidence.T), 16)
    for first in range(0, K, size):
        part = slice(first, min(first + size, K))
        _sweep(segments, misfit, scales, part, mechanics, (pulled, defects), nodes, border[:p])
    nodes *= scales.state[:, None]
    nodes[:, 1:] -= defects
    offset = segments.sensors.offset
    by_channel = pulled.sum(axis=(0, 2))
    np.add.at(border[p:], offset[offset >= 0], by_channel[offset >= 0])
    border[p:] *= scales.theta[p:]
    if segments.prior is not None:
        border += segments.prior.gradient(misfit.point.border, scales.theta)
    return nodes.T, border


def _sweep(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    part: slice,
    mechanics: NumericSystem,
    pulls: tuple[Floats, Floats],
    nodes: Floats,
    border: Floats,
) -> None:
    """Put what samples (M, C, K) and defects (m, K - 1), the `pulls`, add to the `nodes` of some segments, in their own units,
    and add it to the `border` (p,) of scaled parameters.
    """
    pulled, defects = pulls
    sensors, n = segments.sensors, len(mechanics.gain)
    step = segments.step[part] * segments.flow_steps_per_tangent
    orbit = misfit.trajectories.part(part).thinned(segments.flow_steps_per_tangent)
    unit = scales.theta[: len(border)]
    starts, middles = tangent_forces(mechanics, orbit, step, unit, inputs=segments.inputs.part(part))
    backward = _Backward(mechanics, starts, middles, border)
    motion = np.zeros((2, n, len(step)))
    later = defects[:, part]
    motion[:, :, : later.shape[1]] = (later / scales.state[:, None]).reshape(2, n, -1)
    motion[1] /= step
    kinds = [(kind, sensors.kind == own) for kind, own in enumerate((X, V))]
    for j in reversed(range(middles.steps)):
        backward.step(j, motion)
        sample, between = divmod(j, segments.tangent_refine)
        if between:
            continue
        for kind, chosen in kinds:
            if chosen.any():
                shown = pulled[sample, chosen, part]
                np.add.at(motion[kind], sensors.mass[chosen], shown if kind == 0 else shown / step)
    nodes[:n, part], nodes[n:, part] = motion[0], motion[1] * step


class _Backward:
    """Nystroem's steps of `march`, transposed: what acts on the end of a step carried to its start and to `border`."""

    def __init__(
        self, mechanics: NumericSystem, starts: TangentForces, middles: TangentForces, border: Floats
    ) -> None:
        self.into_masses, self.onto_links = mechanics.incidence, mechanics.gain.T
        self.starts, self.middles, self.border = starts, middles, border
        self.states = mechanics.system.dimension

    def step(self, j: int, motion: Floats) -> None:
        """Carry (2, n, k) pulls at x and u = h v at the end of step j to its start."""
        starts, middles, into_masses = self.starts, self.middles, self.into_masses
        x, u = motion
        pull = self._pull(starts, j + 1, u / 6.0)
        d, v = starts.by_d[j + 1] * pull, starts.by_v[j + 1] * pull
        at_start, rate_at_start = d, d + v
        by_first, by_second = -v, 0.5 * d + 2.0 * v
        pull = self._pull(middles, j, (x + 2.0 * u) / 3.0 + into_masses @ by_second)
        d, v = middles.by_d[j] * pull, middles.by_v[j] * pull
        at_start, rate_at_start = at_start + d, rate_at_start + 0.5 * d + v
        by_first += 0.125 * d + 0.5 * v
        pull = self._pull(starts, j, (x + u) / 6.0 + into_masses @ by_first)
        at_start += starts.by_d[j] * pull
        rate_at_start += starts.by_v[j] * pull
        u += x
        x += into_masses @ at_start
        u += into_masses @ rate_at_start

    def _pull(self, forces: TangentForces, j: int, of_masses: Floats) -> Floats:
        """(L, k) what acts on the links, from what acts on accelerations of the masses; parameters have their share."""
        pull = self.onto_links @ of_masses
        by_parameter = np.einsum("ik,ik->i", forces.by_parameter[j], pull[forces.rows])
        np.add.at(self.border, forces.columns - self.states, by_parameter)
        for mass, column, change in forces.masses:
            self.border[column - self.states] += change[j] @ of_masses[mass]
        return np.asarray(pull)
