"""Checks of the arguments of a simulation: output times, and an excitation that fits the structure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import SimulationError
from linkwise.model.excitation import Excitation
from linkwise.model.input_signal import Sampled
from linkwise.model.link import BASE, GROUND
from linkwise.model.structure import Structure
from linkwise.runtime import available_memory

_SAMPLE_BYTES = 32  # at least: time, and displacement, velocity and acceleration of one mass
_SHOWN = 12  # masses listed in a message


def output_times(duration: float | None, rate: float | None, times: ArrayLike | None = None) -> Floats:
    """Output times (N,) in s at `rate` in Hz over `duration` in s, or `times` (N,). Raises SimulationError if invalid."""
    if times is None:
        return _even_times(duration, rate)
    if duration is not None or rate is not None:
        raise SimulationError("times cannot be combined with duration or rate")
    grid = np.array(times, dtype=float)
    valid = grid.ndim == 1 and grid.size >= 2 and bool(np.all(np.isfinite(grid)))
    if not valid or grid[0] < 0.0 or np.any(np.diff(grid) <= 0.0):
        raise SimulationError(
            "times must be a one-dimensional array of at least two increasing numbers, not negative"
        )
    even = np.linspace(grid[0], grid[-1], grid.size)
    if np.abs(grid - even).max() > 1e-6 * (even[1] - even[0]):
        raise SimulationError("times must be evenly spaced, since a record has one sampling rate")
    return grid


def _even_times(duration: float | None, rate: float | None) -> Floats:
    if duration is None or rate is None:
        raise SimulationError("duration in s and rate in Hz, or times, must be given")
    for quantity, value, unit in (("duration", duration, "s"), ("rate", rate, "Hz")):
        if not (np.isfinite(value) and value > 0.0):
            raise SimulationError(f"{quantity} must be positive and finite, got {value!r} {unit}")
    if _SAMPLE_BYTES * duration * rate > available_memory():
        raise SimulationError(
            f"{duration:g} s at {rate:g} Hz are {duration * rate:.3g} samples, more than memory can hold; simulate a shorter "
            "time, or at a lower rate"
        )
    count = int(np.floor(duration * rate * (1.0 + 1e-12) + 1e-9)) + 1
    if count < 2:
        raise SimulationError(
            f"{duration:g} s at {rate:g} Hz is less than one sampling interval; simulate a longer time, or at a higher rate"
        )
    return np.arange(count) / float(rate)


def check_excitation(structure: Structure, excitation: Excitation, end: float) -> None:
    """Raise SimulationError for an excitation that does not fit the structure, or ends before `end` in s."""
    names = structure.mass_names or ("m1",)
    for channel in excitation.release:
        kind, colon, mass = channel.partition(":")
        if kind == "state" and colon:
            check_state(mass, structure, "a release")
            continue
        if kind not in ("x", "v") or not colon:
            raise SimulationError(
                f"unknown release {channel!r}; expected a displacement, such as x:{names[0]}, or a velocity, v:{names[0]}"
            )
        check_mass(mass, structure, "a release")
        _check_released(channel, mass, structure)
    for impulse in excitation.impulses:
        check_mass(impulse.mass, structure, "an impulse")
        if impulse.time >= end:
            raise SimulationError(
                f"the impulse on {impulse.mass} at {impulse.time:g} s is after the end of the simulation ({end:g} s)",
                impulse.time,
                impulse.mass,
            )
    for mass in excitation.forces:
        check_mass(mass, structure, "a force")
    _check_base(structure, excitation)
    for name, given in excitation.drives.items():
        if isinstance(given, Sampled) and (given.start > 0.0 or given.end < end - 1e-6 / given.rate):
            drive = "the motion of the base" if name == BASE else f"the force on {name}"
            raise SimulationError(
                f"{drive} is sampled from {given.start:g} to {given.end:g} s, but the simulation runs from 0 to {end:g} s; "
                "give more samples or simulate a shorter time"
            )


def _check_released(channel: str, place: str, structure: Structure) -> None:
    """A point of a host moves as its modes do, so these are released."""
    host = next((host for host in structure.hosts if place in host.points), None)
    if host is not None:
        kind = channel.partition(":")[0]
        raise SimulationError(
            f"the release {channel} is that of a point, which moves as the modes of {host.name} do; release these, such as "
            f"{kind}:{host.coordinates[0]}, or give an impulse or a force",
            mass=place,
        )


def check_link(name: str, structure: Structure, where: str) -> None:
    """Raise SimulationError unless `name` is one of the links; `where` says what names it."""
    names = [link.name for link in structure.links]
    if name not in names:
        shown = ", ".join(names if len(names) <= _SHOWN else (*names[: _SHOWN - 2], "...", names[-1]))
        raise SimulationError(
            f"unknown link {name!r} in {where}{near_miss(name, names)}; the links are {shown}"
        )


def check_state(name: str, structure: Structure, where: str) -> None:
    """Raise SimulationError unless `name`, such as "joint.z", is a state of a link; `where` says what names it."""
    states = [f"{structure.links[number].name}.{state}" for number, state in structure.topology.states]
    if name not in states:
        raise SimulationError(
            f"unknown state {name!r} in {where}{near_miss(name, states)}; the states are {', '.join(states) or 'none'}"
        )


def check_mass(name: str, structure: Structure, where: str) -> None:
    """Raise SimulationError unless `name` is one of the masses or points; `where` says what names it."""
    if name in (GROUND, BASE) or name not in structure.topology.index:
        names = structure.places
        kinds = "masses and points" if structure.hosts else "masses"
        shown = ", ".join(names if len(names) <= _SHOWN else (*names[: _SHOWN - 2], "...", names[-1]))
        raise SimulationError(
            f"unknown mass {name!r} in {where}{near_miss(name, names)}; the {kinds} are {shown or 'none'}",
            mass=name,
        )


def _check_base(structure: Structure, excitation: Excitation) -> None:
    """The motion of the base must be given if, and only if, a link has the base as an end."""
    on_base = np.flatnonzero(structure.base_incidence)
    if excitation.base is not None and not on_base.size:
        raise SimulationError(
            'the motion of the base is given, but no link has "base" as an end; write "base" instead of "ground" in `between`'
        )
    if excitation.base is None and on_base.size:
        raise SimulationError(
            f'link {structure.links[int(on_base[0])].name!r} has "base" as an end, but the motion of the base is not given; '
            'give base=..., its displacement as an expression of t or Sampled, or "0" for a base at rest'
        )
