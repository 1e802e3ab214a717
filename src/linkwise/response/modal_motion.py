"""Motions of one mode: free vibration of the undamped structure, and the phase resonance of the damped one.

Both are curves of periodic motions through a linear mode. What a motion loses in a period, over 4 pi times its energy, is the
damping ratio, as that of a linear mode at any amplitude (Krack 2015, Computers and Structures 154).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from linkwise.analysis.linear_modes import Modes, modes, natural_frequencies
from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.model.link import refuse_memory
from linkwise.model.structure import Structure
from linkwise.response.continuation import Equations, Point
from linkwise.response.harmonic_balance import HarmonicBalance
from linkwise.response.options import FORCE, Drive
from linkwise.response.shooting import SAMPLES, amplitudes, free_phase
from linkwise.simulation.energy import potential_energy
from linkwise.simulation.integrator.formulas import PhaseIntegrator
from linkwise.simulation.run import run_time_parameters

_FREQUENCY = 0.2  # of omega: its size
_HARMONICS = 15
_WIDTH = 2 * _HARMONICS + 1  # coefficients of a displacement or a state
_SETTLING = 5  # steps to states of a given motion
_HELD = 1e-9  # singular value, relative to the largest, of what is held
_ROUNDING = 1e-13  # of the energy: a loss that is none
_SMALL_FORCE = 0.01  # of mass times acceleration: the first guess of the force in resonance


@dataclass(frozen=True, eq=False)
class ModalMotion(Equations):
    """The equations of a periodic motion of a `structure`, the last unknown of which is omega in rad/s."""

    near_linear: ClassVar[float]
    """How far a small motion is from the frequency of the linear mode at most, as a part of that."""
    without_small: ClassVar[str]
    """Why mode {} may have no small motion, and what to do."""

    @abstractmethod
    def small(self, linear: Modes, mode: int, size: float) -> tuple[Floats, Floats]:
        """The unknowns of a small motion of a linear mode, counted from 1, with displacements to within `size` in m, and the
        way to larger ones (n + 1,).
        """

    @abstractmethod
    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(samples + 1, N) the motion over a period, its end included, from where the mode is farthest from rest."""

    @abstractmethod
    def energy(self, point: Point) -> float:
        """Energy in J of a motion."""

    @abstractmethod
    def loss(self, point: Point) -> float:
        """What a motion loses in a period in J."""

    def damping(self, point: Point) -> float:
        """The damping ratio of a motion; 0 where it loses no more of its energy than rounding."""
        loss, energy = self.loss(point), self.energy(point)
        return 0.0 if abs(loss) < _ROUNDING * abs(energy) else loss / (4.0 * np.pi * energy)

    def amplitude(self, point: Point, row: Floats) -> float:
        """Half of peak to peak of a channel that is a `row` (1, N) of states."""
        return float(amplitudes(self.motion(point.unknowns), row, 1)[0][0])


@dataclass(frozen=True, eq=False)
class FreeMotion(ModalMotion):
    """A motion of the undamped structure from rest to rest, half a period long.

    Unknowns are the displacements (n,) in m from which it is released and omega. What is released from rest and comes to rest
    again goes back the same way, since no law depends on velocities.
    """

    integrator: PhaseIntegrator
    near_linear = 1e-4
    without_small = (
        "mode {} has no small vibration near its linear shape: its frequency may be a whole part of another's; take another "
        "mode"
    )

    @classmethod
    def of_undamped(cls, structure: Structure) -> FreeMotion:
        """Those of a structure without its damping. Raises StructureError for laws with memory or kinks."""
        refuse_memory(
            structure.links, "free vibration", "follow its phase resonance under a force on a place (force)"
        )
        links = zip(structure.shape_key[1], structure.links, strict=True)
        elastic = (shape._replace(law=link.law.elastic) for shape, link in links)
        return cls(structure, free_phase(structure, tuple(elastic)))

    @cached_property
    def parameters(self) -> Floats:
        """The run-time parameters."""
        return run_time_parameters(self.structure, self.integrator.layout)

    def _start(self, unknowns: Floats) -> Floats:
        return np.concatenate([unknowns[:-1], np.zeros(self.structure.size)])

    def __call__(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """The velocities (n,) after half a period, over omega, and their Jacobian (n, n + 1)."""
        self.integrator.set_parameters(self.parameters)
        size, omega = self.structure.size, float(unknowns[-1])
        turn = self.integrator.turn(self._start(unknowns), omega, np.pi)
        jacobian = np.column_stack([turn.by_start[size:, :size], turn.by_omega[size:]])
        jacobian[:, -1] -= turn.end[size:] / omega
        return turn.end[size:] / omega, jacobian / omega

    def sizes(self, unknowns: Floats) -> Floats:
        """The largest amplitude for all displacements, and that of omega."""
        half = 0.5 * np.ptp(self.motion(unknowns, 8)[:, : self.structure.size], axis=0).max()
        sizes = np.full(len(unknowns), half)
        sizes[-1] = _FREQUENCY * abs(unknowns[-1])
        return sizes

    def small(self, linear: Modes, mode: int, size: float) -> tuple[Floats, Floats]:
        """The displacements of the shape of the mode."""
        shape = linear.shapes[:, mode - 1] / np.abs(linear.shapes[:, mode - 1]).max()
        omega = 2.0 * np.pi * linear.frequencies[mode - 1]
        return np.append(linear.at + size * shape, omega), np.append(shape, 0.0) / np.linalg.norm(shape)

    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(samples + 1, 2n) the motion over a period, its end included."""
        self.integrator.set_parameters(self.parameters)
        phases: Floats = np.linspace(0.0, np.pi, samples // 2 + 1)
        there = self.integrator.motion(self._start(unknowns), float(unknowns[-1]), phases)
        back = there[-2::-1].copy()
        back[:, self.structure.size :] *= -1.0
        return np.concatenate([there, back])

    @cached_property
    def _at_rest(self) -> float:
        """The potential energy in J at rest."""
        return float(potential_energy(self.structure, modes(self.structure).at, 0.0).sum())

    def energy(self, point: Point) -> float:
        """Energy in J above rest: all of it is potential when the motion begins."""
        return float(potential_energy(self.structure, point.unknowns[:-1], 0.0).sum()) - self._at_rest

    def loss(self, point: Point) -> float:
        """What the laws with their damping would take from the motion: along a closed way elastic forces take nothing."""
        structure, motion = self.structure, self.motion(point.unknowns)[:-1]
        at_rest = np.zeros(len(motion))
        d = structure.elongations(motion[:, : structure.size], at_rest)
        v = structure.elongations(motion[:, structure.size :], at_rest)
        power = sum(
            (link.force(d[:, number], v[:, number]) * v[:, number]).mean()
            for number, link in enumerate(structure.links)
        )
        return float(power) * 2.0 * np.pi / point.parameter


@dataclass(frozen=True, eq=False)
class PhaseResonance(ModalMotion):
    """A motion of the damped structure under a harmonic force on a `place`, a quarter of a period behind it there.

    Unknowns are those of harmonic balance, the size of the force in N and omega. Laws may have kinks and memory.
    """

    place: str
    near_linear = 0.3  # with damping, and states that follow the motion
    without_small = (
        "a force on this place brings mode {} into no motion a quarter of a period behind it: other modes move the place "
        "more, so give one that moves far in this mode"
    )

    @cached_property
    def _balance(self) -> HarmonicBalance:
        return HarmonicBalance(self.structure, Drive(FORCE, self.place), 0.0, (0.0, np.inf), _HARMONICS)

    @cached_property
    def _onto(self) -> Floats:
        """(n,) how much of a displacement, or of a force there, belongs to each mass."""
        return np.asarray(self.structure.topology.row(self.place))

    def _unforced(self, unknowns: Floats) -> Floats:
        """The unknowns of harmonic balance."""
        return np.append(unknowns[:-2], unknowns[-1])

    def __call__(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """What the balance of each harmonic lacks, and the displacement in phase with the force; and the Jacobian."""
        residual, jacobian = self._balance(self._unforced(unknowns))
        count, size = len(residual), self.structure.size
        cosines = np.arange(size) * _WIDTH + 1
        force = np.zeros(count)
        force[cosines] = -self._onto
        in_phase = np.zeros(count + 2)
        in_phase[cosines] = self._onto
        balanced = np.column_stack([jacobian[:, :-1], force, jacobian[:, -1]])
        driven = np.append(residual + unknowns[-2] * force, in_phase @ unknowns)
        return driven, np.vstack([balanced, in_phase])

    def sizes(self, unknowns: Floats) -> Floats:
        """Those of harmonic balance, and the force itself."""
        return np.insert(self._balance.sizes(self._unforced(unknowns)), -1, abs(unknowns[-2]))

    def small(self, linear: Modes, mode: int, size: float) -> tuple[Floats, Floats]:
        """A sine of the shape of the mode, as far on as the place moves with it."""
        shape = linear.shapes[:, mode - 1] / np.abs(linear.shapes[:, mode - 1]).max()
        share = float(self._onto @ shape)
        if abs(share) < _SMALL_FORCE:
            raise SimulationError(
                f"{self.place} hardly moves in mode {mode}, so that a force there does not drive it: give another place",
                arguments=("force",),
            )
        omega = 2.0 * np.pi * natural_frequencies(self.structure)[mode - 1]
        unknowns = self._balance.at_rest(linear.at, omega)
        along = np.zeros(len(unknowns))
        sines = np.arange(len(shape)) * _WIDTH + 2
        unknowns[sines] += np.sign(share) * size * shape
        along[sines] = np.sign(share) * shape
        states = slice(len(shape) * _WIDTH, -1)
        for _ in range(_SETTLING):
            # nothing holds the mean of a state that only follows a small motion, as that of friction
            residual, jacobian = self._balance(unknowns)
            unknowns[states] -= np.linalg.lstsq(jacobian[states, states], residual[states], rcond=_HELD)[0]
        inertia = float(shape**2 @ self.structure.mass_values)
        force = _SMALL_FORCE * size * omega**2 * inertia / abs(share)
        return np.insert(unknowns, -1, force), np.insert(along, -1, 0.0) / np.linalg.norm(shape)

    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(samples + 1, N) the motion over a period from a quarter after the largest force on."""
        motion = self._balance.motion(self._unforced(unknowns), samples)[:-1]
        motion = np.roll(motion, -samples // 4, axis=0)
        return np.concatenate([motion, motion[:1]])

    def energy(self, point: Point) -> float:
        """The largest kinetic energy in J."""
        size = self.structure.size
        v = self.motion(point.unknowns)[:, size : 2 * size]
        return float((0.5 * v**2 @ self.structure.mass_values).max())

    def loss(self, point: Point) -> float:
        """What the force supplies in a period."""
        sines = point.unknowns[2 : self.structure.size * _WIDTH : _WIDTH]
        return float(np.pi * point.unknowns[-2] * (self._onto @ sines))
