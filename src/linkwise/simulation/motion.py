"""The motion that a run gives, with energies and horizon computed on first use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.truth import EnergyBalance
from linkwise.simulation.energy_balance import energy_balance
from linkwise.simulation.horizon import horizon
from linkwise.simulation.run import RunLog, integrate
from linkwise.simulation.schedule import RunSchedule


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """Displacements in m and velocities in m/s (N, n), and states of links (N, S), at the output times of a schedule.

    `run` is the log of the run.
    """

    schedule: RunSchedule
    displacement: Floats
    velocity: Floats
    states: Floats
    run: RunLog

    @classmethod
    def of(cls, schedule: RunSchedule, progress: Progress = silent) -> SimulatedMotion:
        """Run a schedule. Raises SimulationError if the run cannot be completed."""
        size = schedule.structure.size
        motion = np.empty((len(schedule.times), schedule.structure.topology.dimension))

        def receive(first: int, states: Floats) -> None:
            motion[first : first + len(states)] = states
            progress(ProgressReport((first + len(states)) / len(schedule.times), "simulating"))

        run = integrate(schedule, schedule.times, receive)
        x, v, states = (np.ascontiguousarray(part) for part in np.split(motion, [size, 2 * size], axis=1))
        x.flags.writeable = v.flags.writeable = states.flags.writeable = False
        return cls(schedule, x, v, states, run)

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at every output time."""
        return energy_balance(self.schedule, self.displacement, self.velocity, self.run)

    @cached_property
    def horizon(self) -> float | None:
        """Time in s past which the orbit cannot be trusted; None where it can throughout."""
        return horizon(self.schedule, self.displacement, self.run)
