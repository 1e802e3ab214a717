"""The restoring force per mass at a sensor over its displacement and velocity, from one channel and without a model.

Where no force acts, the acceleration of a mass is its restoring force over the mass, with the sign reversed. At a place of a
structure the other coordinates take part in it: points scatter about a surface, and where the structure is not linear near the
sensor the surface is bent.

References
----------
S. F. Masri and T. K. Caughey, J. Appl. Mech. 46, 433 (1979).
T. Dossogne, J. P. Noël, G. Kerschen, Nonlinear Dynamics 81, 1 (2015).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.levels.ring_down import decay_of, motions
from linkwise.model.link import ANGLE, LENGTH
from linkwise.records.channel import ANGULAR_UNITS, Channel
from linkwise.records.record import Record
from linkwise.signals.integrate import channel_motion, highpass

_SLOW = 0.2  # of the lowest mode: what is slower in an integral is drift
_EDGE = 2.0  # periods of the lowest mode at the ends of the record, where integrals are uncertain
_MOST = 4  # channels


@dataclass(frozen=True, eq=False)
class AccelerationSurface:
    """Restoring force per mass at one sensor, while no force acts.

    Attributes
    ----------
    channel : str
        The channel from which all three follow.
    displacement, velocity, acceleration : array of shape (N,)
        Its motion in m, m/s and m/s^2, or in rad and so on; integrals without what is slower than the modes.
    unit : str
        Unit of the displacement, ``"rad"`` of what turns.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> [surface] = found.surfaces
    >>> slope = -(surface.acceleration @ surface.displacement) / (surface.displacement @ surface.displacement)
    >>> round(float(slope**0.5 / 6.2832))  # Hz
    20
    """

    channel: str
    displacement: Floats
    velocity: Floats
    acceleration: Floats
    unit: str = LENGTH


def acceleration_surfaces(
    record: Record, frequencies: Floats, noise: Mapping[str, float]
) -> tuple[AccelerationSurface, ...]:
    """Those of the motions that move most, while no force acts; none where the record has no such part of a few periods.

    `frequencies` in Hz are those of the modes, `noise` holds the standard deviations of the noise of responses.
    """
    count = len(decay_of(record))
    slowest = float(frequencies.min())
    edge = round(_EDGE * record.rate / slowest)
    if count < 4 * edge:
        return ()
    inner = slice(max(len(record) - count, edge), len(record) - edge)
    surfaces = []
    for name in motions(record):
        motion = channel_motion(record, name, noise[name])
        kind = Channel.parse(name).kind
        integrated = "xva".index(kind)
        unit = ANGLE if record.unit(name) == ANGULAR_UNITS[kind] else LENGTH
        parts = [
            highpass(part, record.rate, _SLOW * slowest) if order < integrated else part
            for order, part in enumerate(motion)
        ]
        displacement, velocity, acceleration = (part[inner] for part in parts)
        surfaces.append(AccelerationSurface(name, displacement, velocity, acceleration, unit))
    surfaces.sort(key=lambda surface: -float(np.std(surface.displacement)))
    return tuple(surfaces[:_MOST])
