"""Sensitivities of what sensors show: those of the motion, and of points whose shapes are parameters."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.flow import Trajectories
from linkwise.likelihood.shooting.segments import Sensors
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangent_forces import Single
from linkwise.likelihood.shooting.tangents import TangentStep


def shown_tangents(
    sensors: Sensors,
    tangent: TangentStep,
    mechanics: NumericSystem,
    orbit: Trajectories,
    number: int,
    scales: tuple[Floats, Floats],
) -> list[Single]:
    """Sensitivities of what sensors of each kind show, with points of hosts behind the masses.

    Parameters
    ----------
    sensors : Sensors
        The sensors, with the shapes that `mechanics` has.
    tangent : TangentStep
        Sensitivities at the start of a step.
    mechanics : NumericSystem
        The system.
    orbit : Trajectories
        The orbit of the tangents.
    number : int
        The step.
    scales : tuple of array
        Steps (K,) in s, and units (p,) of the parameters.

    Returns
    -------
    list of array
        Those of x, h v, h^2 a, h^2 f and states of links, (places, P, K) each.
    """
    motions = sensors.shown(tangent.shown(), 0)
    shapes = mechanics.system.shapes
    if shapes is None or sensors.shapes is None:
        return motions
    step, unit = scales
    first, n = mechanics.system.dimension, len(mechanics.masses)
    x, u = orbit.states[number]
    for row, point in enumerate(sensors.points.tolist()):
        own = np.flatnonzero(shapes.points == point)
        modes, columns = shapes.modes[own], first + shapes.columns[own]
        size = unit[shapes.columns[own], None]
        of_modes = (x[modes], u[modes], orbit.accelerations[number, modes] * step**2)
        for kind, motion in enumerate(of_modes):
            motions[kind][n + row, columns] += (size * motion).astype(np.float32)
    return motions
