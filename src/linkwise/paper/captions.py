"""What the figures of a study show, in sentences with figures that are worked out from the same motions."""

from __future__ import annotations

import numpy as np

from linkwise.paper.figures_2_to_5 import chain_motion
from linkwise.simulation.envelope import NEIGHBOURS, OrbitEnvelope


def motion_captions() -> dict[str, str]:
    """Captions of Figures 2 to 5 by the names of their files."""
    two, eight = chain_motion(2), chain_motion(8)
    return {
        "figure_2": _two_masses(two),
        "figure_3": _compared(
            two, chain_motion(2, sinks=False), "The paper: faster decay and smaller amplitudes."
        ),
        "figure_4": _many(eight),
        "figure_5": _compared(
            eight, chain_motion(8, sinks=False), 'The paper: "always lower than the linear" chain.'
        ),
    }


def _two_masses(motion: OrbitEnvelope) -> str:
    d = motion.record.channel("x:m2") - motion.record.channel("x:m1")
    crossings = motion.record.time[1:][np.diff(np.sign(d)) != 0]
    return (
        f"The sink crosses between its wells until {crossings[-1]:.2f} s and comes to rest at {1e3 * d[-1]:.1f} mm "
        "(the paper: until about 2.5 s, +10 mm). "
        + (
            "Double precision follows this orbit to its end."
            if motion.horizon is None
            else _past(motion.horizon)
        )
    )


def _many(motion: OrbitEnvelope) -> str:
    if motion.horizon is None:
        return "Double precision follows these orbits to their end."
    return (
        f"{_past(motion.horizon)} The band is the range of {NEIGHBOURS} neighbours whose starts differ by parts in 10¹²: the "
        "well that a sink falls into changes from one to the next, so the paper's curves can be compared with these up to the "
        "dashed line only."
    )


def _past(horizon: float) -> str:
    return (
        f"Up to {horizon:.2f} s the curves are the solution; past it every rounding error has grown to the size of the "
        "motion, and the curve is one of many."
    )


def _compared(motion: OrbitEnvelope, without: OrbitEnvelope, paper: str) -> str:
    shares = [
        (
            mass,
            np.sqrt(
                np.mean(motion.record.channel(f"x:{mass}") ** 2)
                / np.mean(without.record.channel(f"x:{mass}") ** 2)
            ),
        )
        for mass in without.masses
    ]
    listed = ", ".join(f"{mass} {100.0 * share:.0f} %" for mass, share in shares)
    higher = [mass for mass, share in shares if share > 1.0]
    remark = f" That does not hold for {', '.join(higher)} of this orbit." if higher else " So it is here."
    return f"Root mean square over {motion.record.duration:g} s against the same mass without sinks: {listed}. {paper}{remark}"
