"""The predictability horizon: how long a simulated orbit can be trusted.

A chaotic structure doubles every error in a fraction of a second, rounding errors included, so past some time no orbit
computed in double precision is the true one. A second run shows when: with steps bounded to a fraction of those the integrator
would take, each Taylor series is truncated with an error thousands of times smaller (the remainder of order p is proportional
to the step to p + 1), which is a tighter tolerance without a new compilation, and every rounding error is a different one.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.simulation.run import RunLog, RunOptions, integrate
from linkwise.simulation.schedule import RunSchedule

DEPARTURE = 1e-3  # of the largest displacement
_STEP = 0.6  # of the mean step of the first run


def horizon(schedule: RunSchedule, displacement: Floats, run: RunLog) -> float | None:
    """The first output time in s at which a second run departs from `displacement` (N, n) in m by more than `DEPARTURE` of its
    largest value, or None. `run` is the log of the first run; the second starts in double precision.
    """
    size = schedule.structure.size
    allowed = DEPARTURE * np.abs(displacement).max()
    departures: list[float] = []

    def receive(first: int, states: Floats) -> bool:
        apart = np.abs(states[:, :size] - displacement[first : first + len(states)]).max(axis=1) > allowed
        if apart.any():
            departures.append(float(schedule.times[first + int(np.argmax(apart))]))
        return bool(departures)

    longest = _STEP * schedule.end / max(run.steps, 1)
    integrate(schedule, schedule.times, receive, RunOptions(longest, extended=False))
    return departures[0] if departures else None
