"""Errors of the recorded motion of the base: what each does to the masses and to the sensors, per unit of its size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.shooting.flow import at_ends_and_middles
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.sensor_errors import carried_by

BASE_ERRORS = ("gain", "delay")


@dataclass(frozen=True, eq=False)
class BaseErrors:
    """Errors of BASE_ERRORS, each a column of `forces` on all masses and of `values` in all channels.

    starts (J + 1, n, e, K), middles (J, n, e, K) in N at the steps of the tangents, values (M, C, e, K) in the channel's unit.
    """

    starts: Floats
    middles: Floats
    values: Floats

    @classmethod
    def of(cls, optimum: Optimum, misfit: Misfit) -> BaseErrors | None:
        """What a record (1 + g) x(t) of the base, or x(t - tau), does; None where nothing of the base is recorded."""
        segments = optimum.segments
        if segments.inputs.frame is None and segments.inputs.base is None:
            return None
        forces = _inertia(optimum) if segments.inputs.frame is not None else _link_forces(optimum, misfit)
        values = np.zeros((*segments.samples.shape[:2], len(BASE_ERRORS), segments.count))
        for channel in range(values.shape[1]):
            carried = carried_by(segments, misfit, channel)
            if carried is not None:
                values[:, channel, 0], values[:, channel, 1] = -carried[0], carried[1]
        return cls(*forces, values)


def _inertia(optimum: Optimum) -> tuple[Floats, Floats]:
    segments = optimum.segments
    assert segments.inputs.frame is not None
    masses = segments.system.at(optimum.point.theta).masses[:, None, None]
    stride = segments.flow_steps_per_tangent
    ends, middles = at_ends_and_middles(segments.inputs.frame, stride)
    rates = _rates(ends, middles, segments.step * stride)
    return tuple(  # type: ignore[return-value]
        masses * np.stack([value, -rate], axis=1)[:, None]
        for value, rate in zip((ends, middles), rates, strict=True)
    )


def _link_forces(optimum: Optimum, misfit: Misfit) -> tuple[Floats, Floats]:
    segments = optimum.segments
    assert segments.inputs.base is not None
    mechanics, stride = segments.system.at(optimum.point.theta), segments.flow_steps_per_tangent
    orbit = misfit.trajectories.thinned(stride)
    bases = at_ends_and_middles(segments.inputs.base, stride)
    accelerations = _rates(bases[0][:, 1], bases[1][:, 1], segments.step * stride)
    forces = []
    links, memories = (orbit.links, orbit.middle_links), (orbit.memory, orbit.middle_memory)
    for motion, memory, base, acceleration in zip(links, memories, bases, accelerations, strict=True):
        slopes = mechanics.partials(motion[:, 0], motion[:, 1], memory)
        x, v, a = base[:, 0, None], base[:, 1, None], acceleration[:, None]
        on_base = segments.system.base[:, None]
        columns = [
            -segments.system.incidence @ (on_base * (slopes.by_d * change + slopes.by_v * rate))
            for change, rate in ((-x, -v), (v, a))
        ]
        forces.append(np.stack(columns, axis=2))
    return forces[0], forces[1]


def _rates(ends: Floats, middles: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Rates (J + 1, K) and (J, K) of values at the ends and middles of steps."""
    both = np.empty((len(ends) + len(middles), ends.shape[-1]))
    both[::2], both[1::2] = ends, middles
    rate = np.gradient(both, axis=0, edge_order=2) / (0.5 * step)
    return rate[::2], rate[1::2]
