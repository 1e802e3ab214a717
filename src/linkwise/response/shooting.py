"""Periodic motion by shooting: the start that comes back to itself after a number of turns of the excitation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Number
from linkwise.model.structure import LinkShape, Structure
from linkwise.records.channel import Channel
from linkwise.response.continuation import Equations, Point
from linkwise.response.options import FORCE, Drive
from linkwise.simulation.integrator.formulas import (
    BASE_INPUT,
    PhaseIntegrator,
    SystemShape,
    compiled_system,
    input_symbols,
    phase_integrator,
)
from linkwise.simulation.run import run_time_parameters

SAMPLES = 256  # of a turn
_FINER = 8  # times as many samples between which peaks are looked for
_COARSE = 16  # the same where the size of a motion is all that is asked
_FREQUENCY = 0.2  # of omega: its size, so that steps along a curve are a few per cent of it
_RANGE = 6.0  # the same as a part of the range of omega
_LEAST = 1e-12  # m: a motion that is smaller has this size


def driven_phase(structure: Structure, drive: Drive) -> PhaseIntegrator | None:
    """The compiled equations of a driven structure; None for laws with kinks, and where heyoka is missing."""
    topology = structure.topology
    inputs = [(topology.weights(topology.index[drive.place]), drive.expression)]
    if drive.kind == FORCE and np.any(structure.base_incidence):
        inputs.append((BASE_INPUT, Number(0.0)))
    shape = SystemShape(*structure.shape_key, tuple(inputs))
    return None if compiled_system(shape).kinks else phase_integrator(shape)


def free_phase(structure: Structure, links: tuple[LinkShape, ...]) -> PhaseIntegrator:
    """The compiled equations of free motion with links of these shapes. Raises StructureError for laws with kinks."""
    inputs = ((BASE_INPUT, Number(0.0)),) if np.any(structure.base_incidence) else ()
    shape = SystemShape(structure.size, links, inputs)
    motion = compiled_system(shape)
    if motion.kinks:
        number = motion.link_of(0)
        link = structure.links[0 if number is None else number]
        raise StructureError(
            f"the law {link.law.text} is not smooth (abs, sign, max, min, or flat parts of exp and tanh); free vibration is "
            "computed for smooth laws: follow its phase resonance under a force on a place (force), or write "
            "sqrt(x**2 + s**2) for abs(x), with a small s",
            f'link "{link.name}"',
        )
    integrator = phase_integrator(shape)
    if integrator is None:
        raise SimulationError(
            "free vibration of smooth laws is computed with heyoka, which is not installed: pip install heyoka where it has "
            "wheels (Linux), or conda install heyoka.py"
        )
    integrator.set_parameters(run_time_parameters(structure, integrator.layout))
    return integrator


def channel_rows(structure: Structure, channels: Sequence[Channel]) -> Floats:
    """(C, N) displacements and velocities of places as combinations of states."""
    rows = np.zeros((len(channels), structure.topology.dimension))
    for row, channel in zip(rows, channels, strict=True):
        first = channel.order * structure.size
        row[first : first + structure.size] = structure.topology.row(channel.place)
    return rows


@dataclass(frozen=True, eq=False)
class PeriodicEquations(Equations):
    """The equations of periodic motion of a structure driven at one `size`, by whatever method, with a period of so many
    `turns` of the excitation; unknowns end with omega in rad/s, of which `bounds` are the lowest and the highest.
    """

    drive: Drive
    size: float
    bounds: tuple[float, float]
    turns: int = field(default=1, kw_only=True)

    def base(self, omega: float, phases: Floats) -> tuple[Floats, Floats]:
        """Displacement in m and velocity in m/s of the base at `phases`."""
        return self.drive.base(self.size, omega, phases)

    @abstractmethod
    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(turns*samples + 1, N) the motion over a period, its end included."""

    @abstractmethod
    def multipliers(self, point: Point) -> NDArray[np.complex128]:
        """The Floquet multipliers (N,) of a motion."""


@dataclass(frozen=True, eq=False)
class Shooting(PeriodicEquations):
    """The same by shooting: unknowns are the start (N,), displacements in m, velocities in m/s and states of links at phase 0,
    and omega.
    """

    integrator: PhaseIntegrator

    @cached_property
    def parameters(self) -> Floats:
        """The run-time parameters."""
        layout = self.integrator.layout
        parameters = run_time_parameters(self.structure, layout)
        names = input_symbols(self.drive.expression)
        parameters[layout.inputs[0].start + names.index("size")] = self.size
        return parameters

    def with_turns(self, turns: int) -> Shooting:
        """The same with another period."""
        return replace(self, turns=turns)

    @cached_property
    def period(self) -> float:
        """The phase in rad after which the motion repeats."""
        return 2.0 * np.pi * self.turns

    def __call__(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """What is missing to a return (N,), and its Jacobian (N, N + 1)."""
        self.integrator.set_parameters(self.parameters)
        start, omega = unknowns[:-1], float(unknowns[-1])
        turn = self.integrator.turn(start, omega, self.period)
        by_start = turn.by_start - np.eye(len(start))
        return turn.end - start, np.column_stack([by_start, turn.by_omega])

    def sizes(self, unknowns: Floats) -> Floats:
        """The largest amplitudes of displacements, velocities and each state, and that of omega."""
        motion = self.motion(unknowns, _COARSE)
        half = 0.5 * np.ptp(motion, axis=0)
        count = self.structure.size
        sizes = np.empty(len(unknowns))
        sizes[:count] = max(half[:count].max(), _LEAST)
        sizes[count : 2 * count] = max(half[count : 2 * count].max(), _LEAST * abs(unknowns[-1]))
        sizes[2 * count : -1] = np.maximum(half[2 * count :], _LEAST)
        sizes[-1] = frequency_size(float(unknowns[-1]), self.bounds)
        return sizes

    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(turns*samples + 1, N) the motion over a period, its end included."""
        self.integrator.set_parameters(self.parameters)
        phases: Floats = np.linspace(0.0, self.period, self.turns * samples + 1)
        return self.integrator.motion(unknowns[:-1], float(unknowns[-1]), phases)

    def multipliers(self, point: Point) -> NDArray[np.complex128]:
        """The Floquet multipliers (N,) of a motion."""
        return np.asarray(
            np.linalg.eigvals(point.jacobian[:, :-1] + np.eye(len(point.jacobian))), dtype=complex
        )

    def after(self, start: Floats, omega: float, turns: int) -> Floats:
        """(turns, N) the states after each of a number of turns from a start (N,)."""
        self.integrator.set_parameters(self.parameters)
        return self.integrator.motion(start, omega, np.asarray(2.0 * np.pi * np.arange(turns + 1)))[1:]


def frequency_size(omega: float, bounds: tuple[float, float]) -> float:
    """The size of omega: a part of it, and of its range."""
    return min(_FREQUENCY * abs(omega), (bounds[1] - bounds[0]) / _RANGE)


def amplitudes(motion: Floats, rows: Floats, turns: int) -> tuple[Floats, NDArray[np.complex128]]:
    """Half of peak to peak (C,) and first harmonic (C,) of channels that are `rows` (C, N) of states (M + 1, N) over a
    period.
    """
    values = motion[:-1] @ rows.T
    return half_height(values), 2.0 * np.fft.rfft(values, axis=0)[turns] / len(values)


def half_height(values: Floats) -> Floats:
    """Half of peak to peak (..., C) of periodic samples (..., M, C): of their trigonometric interpolation."""
    count = values.shape[-2]
    fine = np.fft.irfft(np.fft.rfft(values, axis=-2), _FINER * count, axis=-2) * _FINER
    return 0.5 * (_peak(fine) + _peak(-fine))


def _peak(values: Floats) -> Floats:
    """The largest value (..., C) of periodic samples (..., M, C), by a parabola through the three about it."""
    at = values.argmax(axis=-2, keepdims=True)
    before, here, after = (
        np.take_along_axis(values, (at + shift) % values.shape[-2], axis=-2)[..., 0, :]
        for shift in (-1, 0, 1)
    )
    slope, bend = 0.5 * (after - before), after - 2.0 * here + before
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(bend < 0.0, -0.5 * slope**2 / bend, 0.0)
    return np.asarray(here + rise)
