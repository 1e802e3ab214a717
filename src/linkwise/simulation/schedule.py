"""The schedule of a run: stops, jumps, polynomials of the inputs and parameters, all that does not depend on the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.model.excitation import Excitation
from linkwise.model.input_signal import Sampled
from linkwise.model.structure import Structure
from linkwise.simulation.integrator.shape import SCALE, ParameterLayout, SystemShape

BLOCK = 4096  # output samples between two stops, at which progress is reported and divergence detected ...
_BUFFER = 500_000  # ... but at most this over the number of masses, to limit memory


@dataclass(frozen=True, eq=False)
class RunSchedule:
    """A structure and its excitation from 0 to `end` in s, ready to run; `times` (N,) in s are the output times."""

    structure: Structure
    excitation: Excitation
    times: Floats

    @property
    def end(self) -> float:
        """Last output time in s."""
        return float(self.times[-1])

    @cached_property
    def shape(self) -> SystemShape:
        """The key of the compiled equations of motion."""
        topology = self.structure.topology
        inputs = tuple(
            (
                topology.weights(topology.index[name]),
                drive.order if isinstance(drive, Sampled) else drive.expression,
            )
            for name, drive in self.excitation.drives.items()
        )
        return SystemShape(*self.structure.shape_key, inputs)

    @cached_property
    def block(self) -> int:
        """Output samples between two stops."""
        return min(max(_BUFFER // self.structure.size, 64), BLOCK)

    @cached_property
    def stops(self) -> Floats:
        """Times (S,) in s at which integration stops, including 0 and `end`."""
        inner = [
            self.times[self.block : -1 : self.block],
            [impulse.time for impulse in self.excitation.impulses],
        ]
        inner += [drive.pieces.edges for drive in self._sampled]
        stops = np.unique(np.concatenate([np.asarray(part, dtype=float) for part in inner]))
        return np.concatenate([[0.0], stops[(stops > 0.0) & (stops < self.end)], [self.end]])

    @property
    def _sampled(self) -> list[Sampled]:
        return [drive for drive in self.excitation.drives.values() if isinstance(drive, Sampled)]

    @cached_property
    def start(self) -> Floats:
        """Initial displacements in m, velocities in m/s and states of links, (2n + S,).

        Raises StructureError for a state whose initial value is neither known nor released.
        """
        size, topology = self.structure.size, self.structure.topology
        state = np.zeros(topology.dimension)
        release = dict(self.excitation.release)
        for column, (number, name) in enumerate(topology.states):
            link = self.structure.links[number]
            given = release.pop(f"state:{link.name}.{name}", None)
            state[2 * size + column] = link.initial_state(name) if given is None else given
        for channel, value in release.items():
            kind, _, mass = channel.partition(":")
            state[topology.index[mass] + (size if kind == "v" else 0)] = value
        return state

    @cached_property
    def jumps(self) -> dict[int, Floats]:
        """Jump (2n + S,) of the state in m and m/s at each stop with an impulse."""
        jumps: dict[int, Floats] = {}
        for impulse in self.excitation.impulses:
            stop = int(np.searchsorted(self.stops, impulse.time))
            jump = jumps.setdefault(stop, np.zeros(self.structure.topology.dimension))
            topology = self.structure.topology
            for mass, part in topology.weights(topology.index[impulse.mass]):
                jump[self.structure.size + mass] += part * impulse.momentum / self.structure.mass_values[mass]
        return jumps

    @cached_property
    def pieces(self) -> Floats:
        """Parameters (S - 1, w) of the sampled inputs between stops, in the order of `ParameterLayout.inputs`."""
        middle = 0.5 * (self.stops[1:] + self.stops[:-1])
        columns = [np.empty((middle.size, 0))]
        for drive in self._sampled:
            edges, coefficients = drive.pieces
            piece = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, len(coefficients) - 1)
            columns += [edges[piece, None], _without_rounding(edges, coefficients)[piece]]
        return np.hstack(columns)

    def parameters(self, layout: ParameterLayout, kind: type = np.float64) -> NDArray[Any]:
        """All run-time parameters (P,) except branches and pieces; in extended precision a number is what its decimals say."""
        double = kind is np.float64
        exact: Callable[[float], Any] = float if double else lambda value: kind(repr(float(value)))
        values: NDArray[Any] = np.zeros(layout.size, dtype=kind)
        laws = zip(self.structure.links, layout.coefficients, strict=True)
        coefficients = [exact(link.values[name]) for link, names in laws for name in names]
        masses: NDArray[Any] = np.array([exact(mass) for mass in self.structure.mass_values], dtype=kind)
        values[layout.values] = coefficients
        values[layout.inverse_masses] = 1.0 / (masses * kind(SCALE))
        values[layout.branches] = 1.0
        return values


def _without_rounding(edges: Floats, coefficients: Floats) -> Floats:
    """Coefficients (S, w), 0 where they add less to a piece than its rounding: a spline never rests, and Taylor series of
    motions that are nearly at rest underflow.
    """
    lengths = np.diff(edges)[: len(coefficients), None]
    added = np.abs(coefficients) * lengths ** np.arange(coefficients.shape[1])
    return np.where(added > np.finfo(float).eps * added.max(initial=0.0), coefficients, 0.0)
