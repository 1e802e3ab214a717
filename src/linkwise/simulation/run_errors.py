"""The errors that end a run: each names the time, the mass or link concerned, and what to change."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.expression import Call, Expression, Power, walk
from linkwise.model.link import Link
from linkwise.records.channel_units import unit_in
from linkwise.simulation.schedule import RunSchedule

_MOST_LINKS = 6  # whose elongations a message shows
_ROOT = (
    "; the law of link {} has a root or a power that is no integer, which the integrator cannot follow through 0: write "
    "(x**2 + 1e-14)**0.75 for abs(x)**1.5, as the named law hertz does"
)


def sticking(schedule: RunSchedule, time: float, link: Link | None) -> SimulationError:
    """A law changes its branch without end at `time` in s; `link` is that of the law, None if unknown."""
    subject = f"link {link.name!r} (law {link.law.text})" if link else "a law"
    masses = schedule.structure.mass_names
    mass = next((end for end in link.between if end in masses), None) if link else None
    return SimulationError(
        f"at {time:g} s {subject} sticks: its force jumps so that the motion is pushed back onto the jump from both sides, "
        "and the equations of motion have no solution; replace the jump by a steep slope, such as F*tanh(v/s) with a small s "
        "for F*sign(v)",
        time,
        mass,
    )


def diverged(schedule: RunSchedule, time: float, state: Floats) -> SimulationError:
    """The motion has gone too far at `time` in s, where the state is `state` (2n + S,) in m and m/s."""
    x = state[: schedule.structure.size]
    number = int(np.argmax(np.abs(x)))
    mass = schedule.structure.mass_names[number]
    unit = unit_in(schedule.structure, f"x:{mass}")
    return SimulationError(
        f"the motion diverges: at {time:g} s the displacement of mass {mass} is {abs(x[number]):.3g} {unit}; a link with "
        "negative stiffness or damping needs a term that limits the motion, or its sign is wrong",
        time,
        mass,
    )


def not_finite(schedule: RunSchedule, time: float, state: Floats) -> SimulationError:
    """A force is not a finite number after `time` in s, where the state is `state` (2n + S,) in m and m/s."""
    structure, base = schedule.structure, schedule.excitation.base
    x = state[: structure.size]
    d = structure.elongations(x, 0.0 if base is None else float(base.value(time)))
    number = int(np.argmax(np.abs(x)))
    unit = unit_in(structure, f"x:{structure.mass_names[number]}")
    elongations = list(zip(structure.links, d, strict=True))[:_MOST_LINKS]
    rooted = next((link for link in structure.links if any(map(_is_root, walk(link.law.expression)))), None)
    return SimulationError(
        f"a force is not finite after {time:g} s: the displacement of mass {structure.mass_names[number]} is "
        f"{x[number]:.3g} {unit} and the elongations are "
        + ", ".join(f"{link.name} {value:.3g} {link.law.motion_units[0]}" for link, value in elongations)
        + (_ROOT.format(rooted.name) if rooted else ""),
        time,
        structure.mass_names[number],
    )


def too_many_steps(schedule: RunSchedule, time: float, state: Floats, steps: int) -> SimulationError:
    """More than `steps` steps between two output times at `time` in s, where the scaled state is `state` (2n + S,)."""
    size = schedule.structure.size
    mass = schedule.structure.mass_names[int(np.argmax(np.abs(state[size : 2 * size])))]
    return SimulationError(
        f"at {time:g} s the motion takes more than {steps} steps between two output times, mass {mass} being the fastest: "
        "it diverges, or the structure is too stiff for this sampling rate; check stiffnesses, masses and their units",
        time,
        mass,
    )


def _is_root(node: Expression) -> bool:
    """Whether a node of a law has no Taylor series where its argument is 0."""
    if isinstance(node, Power):
        return not isinstance(node.exponent, int)
    return isinstance(node, Call) and node.function == "sqrt"
