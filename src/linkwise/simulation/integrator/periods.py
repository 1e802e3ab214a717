"""Where a structure is after a turn of its excitation, and the derivatives of that: what shooting for periodic motion needs.

Time is the phase, omega*t, so that a turn ends at 2 pi whatever its frequency, and the frequency is a parameter like others.
Variational equations are integrated with the motion, several of its tangent vectors at once.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import heyoka
import numpy as np

from linkwise.arrays import Floats
from linkwise.simulation.integrator.formulas import SCALE, MotionFormulas, SystemShape, Turn, input_symbols
from linkwise.simulation.integrator.taylor import HeyokaAlgebra

OMEGA = "omega"  # the symbol of an input that is the angular frequency in rad/s
_TOLERANCE = 1e-13
_UNROLLED = 60  # equations up to which code is compiled without loops
_LANES = 4  # numbers in a register of most processors
_MOST_STEPS = 2_000  # in a turn: a motion that needs more diverges


class HeyokaPhase:
    """heyoka's integrator of one shape without kinks over phase, see `formulas.PhaseIntegrator`."""

    def __init__(self, shape: SystemShape) -> None:
        self._motion = motion = MotionFormulas(shape, HeyokaAlgebra())
        self.layout = motion.layout
        self._parameters = np.zeros(self.layout.size + 1)  # omega last

    @cached_property
    def _equations(self) -> list[tuple[Any, Any]]:
        """Pairs of variable and derivative by phase."""
        omega = heyoka.par[self.layout.size]
        replaced = {heyoka.time: heyoka.time / omega}
        for (_, kind), where in zip(self._motion.shape.inputs, self.layout.inputs, strict=True):
            if not isinstance(kind, int) and OMEGA in input_symbols(kind):
                replaced[heyoka.par[where.start + input_symbols(kind).index(OMEGA)]] = omega
        return [(variable, heyoka.subs(rate, replaced) / omega) for variable, rate in self._motion.equations]

    @cached_property
    def _plain(self) -> Any:
        equations = self._equations
        return heyoka.taylor_adaptive(
            equations,
            np.zeros(len(equations)),
            tol=_TOLERANCE,
            compact_mode=len(equations) > _UNROLLED,
            fast_math=True,
        )

    @cached_property
    def _columns(self) -> int:
        """The tangent vectors in a lane: such that all are in one batch, if that is not too long to be compiled."""
        size = self._motion.shape.dimension
        columns = -(-(size + 1) // _LANES)
        return columns if size * (1 + columns) <= _UNROLLED else 1

    @cached_property
    def _tangent(self) -> Any:
        """The motion, and some tangent vectors to it in each lane."""
        equations = self._equations
        size, first = len(equations), self.layout.size
        variables = [variable for variable, _ in equations]
        inside = [{str(name) for name in heyoka.get_variables(rate)} for _, rate in equations]
        slopes = [
            [(k, heyoka.diff(rate, other)) for k, other in enumerate(variables) if str(other) in names]
            for (_, rate), names in zip(equations, inside, strict=True)
        ]
        by_omega = [heyoka.diff(rate, heyoka.par[first]) for _, rate in equations]
        varied = []
        for column in range(self._columns):
            tangent = [heyoka.expression(f"tangent{column}_{k}") for k in range(size)]
            share = heyoka.par[first + 1 + column]  # 1 in the lane whose tangent is that by omega
            for k in range(size):
                by_tangent = [slope * tangent[j] for j, slope in slopes[k]]
                varied.append((tangent[k], heyoka.sum([by_omega[k] * share, *by_tangent])))
        return heyoka.taylor_adaptive_batch(
            [*equations, *varied],
            np.zeros((size + len(varied), _LANES)),
            tol=_TOLERANCE,
            compact_mode=size + len(varied) > _UNROLLED,
            fast_math=True,
        )

    @cached_property
    def _starts(self) -> list[tuple[Floats, Floats]]:
        """For each batch the tangent vectors at the start (columns*N, lanes), and which are by omega (columns, lanes)."""
        size, columns = self._motion.shape.dimension, self._columns
        batches = -(-(size + 1) // (_LANES * columns))
        unit = np.eye(size + 1, batches * columns * _LANES)
        parts = unit.reshape(size + 1, batches, columns, _LANES)
        tangents = parts[:-1].transpose(1, 2, 0, 3).reshape(batches, -1, _LANES)
        return list(zip(tangents.copy(), parts[-1].copy(), strict=True))

    def set_parameters(self, parameters: Floats) -> None:
        self._parameters[:-1] = parameters

    def turn(self, start: Floats, omega: float, phase: float) -> Turn:
        taylor, size = self._tangent, len(start)
        pars, state = taylor.pars, taylor.state
        derivatives = []
        self._parameters[-1] = omega
        most_steps = math.ceil(_MOST_STEPS * phase / (2.0 * math.pi))
        for tangents, by_omega in self._starts:
            taylor.set_time(0.0)
            pars[: len(self._parameters)] = self._parameters[:, None]
            pars[len(self._parameters) :] = by_omega
            state[:size] = start[:, None] / SCALE
            state[size:] = tangents
            taylor.propagate_until(phase, max_steps=most_steps)
            if any(result[0] != heyoka.taylor_outcome.time_limit for result in taylor.propagate_res):
                return Turn(np.full(size, np.nan), np.full((size, size), np.nan), np.full(size, np.nan))
            derivatives.append(state[size:].reshape(self._columns, size, _LANES).transpose(1, 0, 2).copy())
        columns = np.stack(derivatives, axis=1).reshape(size, -1)
        return Turn(state[:size, 0] * SCALE, columns[:, :size], columns[:, size] * SCALE)

    def motion(self, start: Floats, omega: float, phases: Floats) -> Floats:
        taylor = self._plain
        self._parameters[-1] = omega
        taylor.pars[:] = self._parameters[: len(taylor.pars)]
        taylor.time = phases[0]
        taylor.state[:] = start / SCALE
        most_steps = math.ceil(_MOST_STEPS * float(phases[-1] - phases[0]) / (2.0 * math.pi))
        *_, states = taylor.propagate_grid(phases, max_steps=most_steps)
        result = np.full((len(phases), len(start)), np.nan)
        result[: len(states)] = states * SCALE
        return result
