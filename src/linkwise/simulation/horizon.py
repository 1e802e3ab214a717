"""How long a simulated orbit can be believed: the predictability horizon.

A chaotic structure doubles every error in a fraction of a second, rounding included, so past some time no orbit computed in
double precision is the true one. A second run shows when: with steps bounded to a part of those the integrator would take,
each Taylor series is cut off thousands of times closer (the remainder of order p goes with the step to p + 1), which is a
tighter tolerance without compiling anew, and every rounding error is another one.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.simulation.run import RunLog, RunOptions, integrate
from linkwise.simulation.schedule import RunSchedule

DEPARTURE = 1e-3  # of the largest displacement
_PART = 0.6  # of the mean step of the first run


def horizon(schedule: RunSchedule, displacement: Floats, run: RunLog) -> float | None:
    """The first output time in s at which a second run is away from `displacement` (N, n) by `DEPARTURE` of its largest
    value, or None where it never is. The second run starts in double precision; the first went as `run`.
    """
    size = schedule.structure.size
    allowed = DEPARTURE * np.abs(displacement).max()
    found: list[float] = []

    def receive(first: int, states: Floats) -> bool:
        apart = np.abs(states[:, :size] - displacement[first : first + len(states)]).max(axis=1) > allowed
        if apart.any():
            found.append(float(schedule.times[first + int(np.argmax(apart))]))
        return bool(found)

    longest = _PART * schedule.end / max(run.steps, 1)
    integrate(schedule, schedule.times, receive, RunOptions(longest, extended=False))
    return found[0] if found else None
