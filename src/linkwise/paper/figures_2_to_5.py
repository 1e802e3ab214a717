"""Figures 2 to 5 of the paper: how the chains move, with their sinks and without."""

from __future__ import annotations

from functools import lru_cache

from matplotlib.figure import Figure

from linkwise.absorption.sinks import find_sinks
from linkwise.absorption.without_sinks import without_sinks
from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Excitation
from linkwise.paper.published import DURATION, RATE, start
from linkwise.plot import displacements_figure
from linkwise.simulation.envelope import OrbitEnvelope, orbit_envelope


@lru_cache(maxsize=4)
def chain_motion(masses: int, *, sinks: bool = True) -> OrbitEnvelope:
    """The paper's run of the chain of so many masses, with its sinks or without the masses that they are."""
    structure = bnes_chain(masses)
    if not sinks:
        drive = Excitation.of(release=start(masses))
        structure = without_sinks(structure, find_sinks(structure), drive, "removed").structure
    return orbit_envelope(structure, start(masses), duration=DURATION, rate=RATE)


def figure_2() -> Figure:
    """Responses of the chain of two masses."""
    return displacements_figure(chain_motion(2), titles=("primary mass m1", "sink m2"))


def figure_3() -> Figure:
    """The primary mass of the chain of two with its sink and without."""
    return displacements_figure(
        chain_motion(2), without=chain_motion(2, sinks=False), titles=("primary mass m1",)
    )


def figure_4() -> Figure:
    """Responses of the chain of eight masses: primary masses on the left, their sinks on the right."""
    motion = chain_motion(8)
    titles = [
        f"primary mass {mass}" if number % 2 == 0 else f"sink {mass}"
        for number, mass in enumerate(motion.masses)
    ]
    return displacements_figure(motion, columns=2, titles=titles)


def figure_5() -> Figure:
    """The primary masses of the chain of eight with their sinks and without."""
    without = chain_motion(8, sinks=False)
    titles = [f"primary mass {mass}" for mass in without.masses]
    return displacements_figure(chain_motion(8), without=without, columns=2, titles=titles)
