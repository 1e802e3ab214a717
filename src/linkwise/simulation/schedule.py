"""What a run needs that does not depend on where it stands: stops, jumps, polynomials of the inputs, parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.expression import Expression
from linkwise.model.excitation import Excitation, Sampled
from linkwise.model.link import BASE
from linkwise.model.structure import Structure
from linkwise.simulation.shape import SCALE, ParameterLayout, Shape

BLOCK = 4096  # output samples between two stops, for progress and to look whether the motion diverges ...
_HELD = 500_000  # ... and no more than this over the number of masses, to bound memory


@dataclass(frozen=True, eq=False)
class RunSchedule:
    """A structure and what drives it, from 0 to `end` in s, ready to run.

    `times` (N,) are the output times that cut the run into blocks.
    """

    structure: Structure
    excitation: Excitation
    times: Floats

    @property
    def end(self) -> float:
        """The time of the last output in s."""
        return float(self.times[-1])

    @cached_property
    def shape(self) -> Shape:
        """What to compile for."""
        ends = {**self._place, BASE: -2}
        inputs = tuple(
            (ends[name], drive.order if isinstance(drive, Sampled) else drive.expression)
            for name, drive in self.excitation.drives.items()
        )
        masses, links = cast(tuple[int, tuple[tuple[int, int, Expression], ...]], self.structure.shape_key)
        return Shape(masses, links, inputs)

    @cached_property
    def block(self) -> int:
        """Output samples between two stops."""
        return min(max(_HELD // self.structure.size, 64), BLOCK)

    @cached_property
    def stops(self) -> Floats:
        """(S,) times at which a stretch ends, 0 and `end` included."""
        inner = [
            self.times[self.block : -1 : self.block],
            [impulse.time for impulse in self.excitation.impulses],
        ]
        inner += [drive.pieces.edges for drive in self._sampled]
        stops = np.unique(np.concatenate([np.asarray(part, dtype=float) for part in inner]))
        return np.concatenate([[0.0], stops[(stops > 0.0) & (stops < self.end)], [self.end]])

    @cached_property
    def _place(self) -> dict[str, int]:
        return {name: number for number, name in enumerate(self.structure.mass_names)}

    @property
    def _sampled(self) -> list[Sampled]:
        return [drive for drive in self.excitation.drives.values() if isinstance(drive, Sampled)]

    @cached_property
    def start(self) -> Floats:
        """(2n,) displacements and velocities that the structure is released with."""
        state = np.zeros(2 * self.structure.size)
        for channel, value in self.excitation.release.items():
            kind, _, mass = channel.partition(":")
            state[self._place[mass] + (self.structure.size if kind == "v" else 0)] = value
        return state

    @cached_property
    def jumps(self) -> dict[int, Floats]:
        """(2n,) jump of the state at each stop where something is struck."""
        jumps: dict[int, Floats] = {}
        for impulse in self.excitation.impulses:
            stop = int(np.searchsorted(self.stops, impulse.time))
            jump = jumps.setdefault(stop, np.zeros(2 * self.structure.size))
            mass = self._place[impulse.mass]
            jump[self.structure.size + mass] += impulse.momentum / self.structure.mass_values[mass]
        return jumps

    @cached_property
    def pieces(self) -> Floats:
        """(S - 1, w) parameters of the sampled inputs on each stretch, in the order of `ParameterLayout.inputs`."""
        middle = 0.5 * (self.stops[1:] + self.stops[:-1])
        columns = [np.empty((middle.size, 0))]
        for drive in self._sampled:
            edges, coefficients = drive.pieces
            piece = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, len(coefficients) - 1)
            columns += [edges[piece, None], coefficients[piece]]
        return np.hstack(columns)

    def parameters(self, layout: ParameterLayout, kind: type = np.float64) -> NDArray[Any]:
        """Every parameter but branches and pieces. In extended precision a number is what its decimals say."""
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
