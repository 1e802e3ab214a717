"""Motions of several structures under one excitation, with the energy that went through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.crossings import begun, crossings
from linkwise.simulate import Motion

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Runs:
    """W runs: `x`, `v` (N, n, W) in m and m/s at `time` (N,) in s, energies in J counted from the start.

    `heat` (N, L, W) is what each link dissipated, `put_in` (N, W) what was there at the start, potentials counted from d = 0,
    and all work done since. `passages` holds, run by run and link by link, the times in s at which the link went from well to
    well.
    """

    time: Floats
    x: Floats
    v: Floats
    heat: Floats
    put_in: Floats
    passages: tuple[tuple[Floats, ...], ...]


def runs_of(motion: Motion, tops: list[Floats]) -> Runs:
    """One motion by itself, in the best precision there is and past the kinks of its laws; `tops` (K,) m of each link."""
    energy, course = motion.energy, motion.course
    base = course.excitation.base
    d = course.structure.elongations(motion.displacement, None if base is None else base.value(course.times))
    found = crossings(course, motion.run, tops)
    passages = tuple(begun(found[k], course.times, d[:, k], tops[k]) for k in range(len(tops)))
    return Runs(
        time=course.times,
        x=motion.displacement[..., None],
        v=motion.velocity[..., None],
        heat=energy.dissipated[..., None],
        put_in=energy.put_in[..., None],
        passages=(passages,),
    )
