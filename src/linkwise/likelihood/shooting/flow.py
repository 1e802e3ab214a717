"""Flow of the equations of motion over all segments at once, and the inputs that act along it.

The accuracy of the flow limits that of the estimate, so it is integrated with order 8 to well below the noise. Velocities are
carried as u = h v and accelerations as h^2 a, so that no stage is multiplied by h; states of links as they are. The eleven
stages have their abscissae at the five Lobatto points of the step, so inputs are needed at five times a step, and stages 0, 8
and 10 are accurate states at its start, middle and end, along which Nystroem's method of order 4 carries sensitivities.

What a late sensor shows of the fitted motion is the polynomial of degree 11 that agrees with displacement, velocity and
acceleration at four samples around.

References
----------
G. J. Cooper and J. H. Verner, SIAM J. Numer. Anal. 9, 389 (1972).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.delay_polynomials import value_and_slope
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.records.channel import BASE, Channel

_s = np.sqrt(21.0)

#: Lobatto points of a step, fractions of it.
POINTS = np.array([0.0, (7 - _s) / 14, 0.5, (7 + _s) / 14, 1.0])
#: Which of POINTS each stage is evaluated at.
STAGE_POINT = (0, 2, 2, 3, 3, 2, 1, 1, 2, 3, 4)
#: The stage whose state is the middle of the step.
MIDDLE = 8

#: One row a stage, its weights of the stages before.
_ROWS = (
    (),
    (1 / 2,),
    (1 / 4, 1 / 4),
    (1 / 7, (-7 - 3 * _s) / 98, (21 + 5 * _s) / 49),
    ((11 + _s) / 84, 0, (18 + 4 * _s) / 63, (21 - _s) / 252),
    ((5 + _s) / 48, 0, (9 + _s) / 36, (-231 + 14 * _s) / 360, (63 - 7 * _s) / 80),
    ((10 - _s) / 42, 0, (-432 + 92 * _s) / 315, (633 - 145 * _s) / 90, (-504 + 115 * _s) / 70, (63 - 13 * _s) / 35),
    (1 / 14, 0, 0, 0, (14 - 3 * _s) / 126, (13 - 3 * _s) / 63, 1 / 9),
    (1 / 32, 0, 0, 0, (91 - 21 * _s) / 576, 11 / 72, (-385 - 75 * _s) / 1152, (63 + 13 * _s) / 128),
    (1 / 14, 0, 0, 0, 1 / 9, (-733 - 147 * _s) / 2205, (515 + 111 * _s) / 504, (-51 - 11 * _s) / 56, (132 + 28 * _s) / 245),
    (0, 0, 0, 0, (-42 + 7 * _s) / 18, (-18 + 28 * _s) / 45, (-273 - 53 * _s) / 72, (301 + 53 * _s) / 72,
     (28 - 28 * _s) / 45, (49 - 7 * _s) / 18),
)  # fmt: skip
STAGES = len(_ROWS)
WEIGHTS = np.array([1 / 20, 0, 0, 0, 0, 0, 0, 49 / 180, 16 / 45, 49 / 180, 1 / 20])


def _second_order() -> tuple[np.ndarray, np.ndarray]:
    """Rewrite the table for x'' = a: stage values as rows over (x, u, k_0, k_1, ...) with u = h v, k = h^2 a.

    Returns (STAGES, 2, 2 + STAGES) for the stages and (2, STAGES) for the closing sums of k.
    """
    table = np.zeros((STAGES, STAGES))
    for i, row in enumerate(_ROWS):
        table[i, : len(row)] = row
    stages = np.zeros((STAGES, 2, 2 + STAGES))
    stages[:, 0, 0] = 1.0
    stages[:, 0, 1] = table.sum(axis=1)
    stages[:, 1, 1] = 1.0
    stages[:, 0, 2:] = table @ table
    stages[:, 1, 2:] = table
    return stages, np.stack([WEIGHTS @ table, WEIGHTS])


STAGE_ROWS, CLOSING = _second_order()

#: Nystroem's method of order 4 (order 3 in the rates): rows over (d, h v, k_0, k_1) and closing sums of the pulls.
TANGENT_MIDDLE = np.array([[1, 1 / 2, 1 / 8], [0, 1, 1 / 2]], np.float32)
TANGENT_END = np.array([[1, 1, 0, 1 / 2], [0, 1, -1, 2]], np.float32)
TANGENT_CLOSING = np.array([[1 / 6, 1 / 3, 0], [1 / 6, 2 / 3, 1 / 6]], np.float32)


class OverSegments:
    """A dataclass with arrays over the steps or samples of segments, and others of one value a segment, both last."""

    along: ClassVar[Sequence[str]] = ()
    of_each: ClassVar[Sequence[str]] = ()

    def mapped(
        self, change: Callable[[NDArray[Any]], NDArray[Any]], firsts: slice | Indices = slice(None)
    ) -> Self:
        """With each array `along` segments changed, to segments that begin with those whose numbers are `firsts`."""

        def changed(value: Any) -> Any:
            if isinstance(value, OverSegments):
                return value.mapped(change, firsts)
            if isinstance(value, Mapping):
                return {name: change(own) for name, own in value.items()}
            if isinstance(value, Sequence):
                return [*map(change, value)]
            return None if value is None else change(value)

        own: Any = self
        values = {name: changed(getattr(self, name)) for name in self.along}
        each = {name: getattr(self, name) for name in self.of_each}
        values |= {name: None if value is None else value[..., firsts] for name, value in each.items()}
        return cast("Self", replace(own, **values))

    def part(self, segments: slice | Indices) -> Self:
        """That of some segments."""
        return self.mapped(lambda values: values[..., segments], segments)


@dataclass(frozen=True, eq=False)
class UncertainForces(OverSegments):
    """f applied forces with unknown errors; the acceleration of moving coordinates, in m/s^2, is one that acts on all masses.

    Attributes
    ----------
    channels : tuple of Channel
        Their channels.
    ends : array of int, shape (f,)
        The masses that they act on; points of hosts from -3 down, and moving coordinates below these.
    rows : array of shape (f, n)
        How each acts on the masses, with the shapes that the structure states.
    points : array of int, shape (f,)
        Numbers of their points among those of the system, -1 for others.
    gains, delays : array of int, shape (f,)
        Numbers of their unknown gains and delays, -1 for none.
    certain : array of shape (J, 5, n, K)
        What acts on the masses beside them at the points of every step, in N.
    coefficients : sequence of array of shape (J, 5, f, K)
        What the channels show there, in N; with delays, the coefficients of powers of the delay over its `unit`.
    unit : array of shape (K,)
        The largest delay in s for which these hold.
    """

    along, of_each = ("certain", "coefficients"), ("unit",)

    channels: tuple[Channel, ...]
    ends: Indices
    rows: Floats
    points: Indices
    gains: Indices
    delays: Indices
    certain: Floats
    coefficients: Sequence[Floats]
    unit: Floats

    @property
    def base(self) -> int | None:
        """The number of the acceleration of moving coordinates; None where that is not among them."""
        return next((number for number, name in enumerate(self.channels) if name.place == BASE), None)

    def of_base(self, gains: Floats, delays: Floats) -> tuple[float, float]:
        """The gain of the motion of the base, and its delay in s."""
        if self.base is None:
            return 1.0, 0.0
        gain, delay = self.gains[self.base], self.delays[self.base]
        return float(np.append(gains, 1.0)[gain]), float(np.append(delays, 0.0)[delay])

    def acting(self, gains: Floats, delays: Floats) -> tuple[Floats, Floats]:
        """(J, 5, f, K) the forces in N at gains (g,) and delays (l,) in s, and their rates; straight on beyond `unit`."""
        factors = np.append(gains, 1.0)[self.gains, None]
        late = np.append(delays, 0.0)[self.delays, None] / self.unit
        value, slope = value_and_slope(self.coefficients, late)
        return value / factors, slope / (self.unit * factors)

    def on_masses(self, acting: Floats) -> Floats:
        """(J, 5, n, K) all forces on the masses, with those (J, 5, f, K) of the uncertain ones."""
        force = self.certain.copy()
        for number, row in enumerate(self.rows):
            for mass in np.flatnonzero(row).tolist():
                force[:, :, mass] += row[mass] * acting[:, :, number]
        return force


#: The stages that close a step, and the weights (2, 1, 1) of their accelerations in x and u.
_CLOSING_WEIGHTS = [(i, CLOSING[:, i, None, None]) for i in map(int, np.flatnonzero(CLOSING[1]))]

_ROUNDED = 1e-12  # of the largest force, which interpolation leaves at samples of zero


@dataclass(frozen=True, eq=False)
class Inputs(OverSegments):
    """Applied forces, motion of the base and signals at the five POINTS of every step.

    Attributes
    ----------
    force : array of shape (J, 5, n, K) or None
        Forces on the masses in N.
    base : array of shape (J, 5, 2, K) or None
        Displacement in m and velocity in m/s of the base.
    frame : array of shape (J, 5, K) or None
        Acceleration in m/s^2 of the coordinates; `force` has its forces of inertia by the masses that the structure states.
    points : array of shape (J, 5, k, K) or None
        Forces on points of hosts in N, where shapes are parameters; `force` has them by the shapes that the structure states.
    signals : mapping of str to array of shape (J, 5, K)
        The U recorded signals by name, those that laws name first.
    uncertain : UncertainForces or None
        Those of the forces whose channels have unknown errors; `force` and `points` have them at some values of these.
    """

    along = ("force", "base", "frame", "points", "signals", "uncertain")

    force: Floats | None = None
    base: Floats | None = None
    frame: Floats | None = None
    points: Floats | None = None
    signals: Mapping[str, Floats] = field(default_factory=dict)
    uncertain: UncertainForces | None = None

    def first(self, steps: int) -> Inputs:
        """The inputs of the first steps."""
        return self.mapped(lambda values: values[:steps], slice(None))

    def at(self, gains: Floats, delays: Floats) -> Inputs:
        """The inputs with uncertain forces at gains (g,) and delays (l,) in s of channels."""
        uncertain, points, frame = self.uncertain, self.points, self.frame
        if uncertain is None:
            return self
        acting, _ = uncertain.acting(gains, delays)
        if (base := uncertain.base) is not None:
            frame = acting[:, :, base]
        if points is not None:
            points = points.copy()
            for number, point in enumerate(uncertain.points.tolist()):
                if point >= 0:
                    points[:, :, point] = acting[:, :, number]
        return replace(self, force=uncertain.on_masses(acting), points=points, frame=frame)

    def applied(self, mechanics: NumericSystem, steps: int | slice) -> Floats:
        """Forces on the masses (..., 5, n, K) in N in some steps; there must be some."""
        assert self.force is not None
        force = self.force[steps]
        if self.points is not None and mechanics.shape_change is not None:
            force = force + mechanics.shape_change.T @ self.points[steps]
        more = mechanics.masses - mechanics.system.parameters.stated_masses
        if self.frame is not None and more.any():
            force = force - more[:, None] * self.frame[steps][..., None, :]
        return np.asarray(force)

    def acts(self, mass: int) -> Bools:
        """(J, K) whether a force acts on a mass where steps begin: none does outside of a force window, but for rounding."""
        assert self.force is not None
        size = np.abs(self.force[:, 0, mass])
        return np.asarray(size > _ROUNDED * size.max(initial=0.0))

    def accelerations(self, orbit: Trajectories) -> Floats:
        """Accelerations (2 J + 1, n, K) of the masses at the ends and in the middles of steps of an orbit in turn, in m/s^2.

        Those of the orbit are relative to the coordinates.
        """
        along = orbit.half_accelerations
        return (
            along
            if self.frame is None
            else along + input_along(self.frame, orbit.flow_steps(self.frame))[:, None]
        )


@dataclass(frozen=True, eq=False)
class Trajectories(OverSegments):
    """J steps from the nodes of K segments; SI units except u = h v.

    Attributes
    ----------
    states : array of shape (J + 1, 2, n, K)
        x and u at the ends of the steps.
    half_links : array of shape (2 J + 1, 2, L, K)
        d and v at the ends of the steps and in their middles, in turn.
    half_accelerations : array of shape (2 J + 1, n, K)
        Accelerations there.
    half_memory : array of shape (2 J + 1, S + U, K)
        States of links there, and the signals that laws name.
    """

    along = ("states", "half_links", "half_accelerations", "half_memory")

    states: Floats
    half_links: Floats
    half_accelerations: Floats
    half_memory: Floats

    @property
    def links(self) -> Floats:
        """(J + 1, 2, L, K) d and v at the ends of the steps."""
        return self.half_links[::2]

    @property
    def accelerations(self) -> Floats:
        """(J + 1, n, K) accelerations there."""
        return self.half_accelerations[::2]

    @property
    def memory(self) -> Floats:
        """(J + 1, S + U, K) states of links there, and the signals that laws name."""
        return self.half_memory[::2]

    def flow_steps(self, points: Floats) -> int:
        """How many steps of an input (J', 5, ...) one of these is."""
        return len(points) // (len(self.states) - 1)

    def half_states(self, step: Floats) -> Floats:
        """(2 J + 1, 2, n, K) x and u = h v at the ends of steps (K,) in s and in their middles, in turn; these from x, u and
        a at both ends, to the sixth order.
        """
        x, u, a = self.states[:, 0], self.states[:, 1], self.accelerations * step**2
        middle_x = 0.5 * (x[1:] + x[:-1]) - (5.0 / 32.0) * (u[1:] - u[:-1]) + (a[1:] + a[:-1]) / 64.0
        middle_u = (15.0 / 8.0) * (x[1:] - x[:-1]) - (7.0 / 16.0) * (u[1:] + u[:-1]) + (a[1:] - a[:-1]) / 32.0
        return _in_turn(self.states, np.stack([middle_x, middle_u], axis=1))

    def ends(self, step: Floats) -> Floats:
        """(2n + S + U, K) displacements in m, velocities in m/s, states, signals at the ends of segments, steps (K,) in s."""
        x, u = self.states[-1]
        return np.concatenate([x, u * (1.0 / step), self.memory[-1]])

    def replaced(self, others: Trajectories, where: Bools) -> Trajectories:
        """The trajectories, those of some segments by those of `others`; `where` is (K,)."""
        if where.all():
            return others
        if not where.any():
            return self
        pairs = ((getattr(others, name), getattr(self, name)) for name in self.along)
        return Trajectories(*(np.where(where, *pair) for pair in pairs))

    def thinned(self, refine: int) -> Trajectories:
        """The same orbit in longer steps: ends of old steps become middles of new ones.

        Parameters
        ----------
        refine : int
            Factor on the step, 1 or even.

        Returns
        -------
        Trajectories
            The orbit.
        """
        if refine == 1:
            return self
        states = self.states[::refine].copy()
        states[:, 1] *= refine
        halves = (self.half_links, self.half_accelerations, self.half_memory)
        return Trajectories(states, *(values[::refine] for values in halves))


def end_to_end(values: NDArray[Any], parts: Indices, *, shared: int = 0) -> NDArray[Any]:
    """(f J, ..., K') of values (J, ..., K) in segments of which `parts` (K', f) are joined.

    The values at the end that are `shared` with the next segment, 1 of an orbit, are those of the last part.
    """
    steps = len(values) - shared
    both = np.empty((parts.shape[1] * steps + shared, *values.shape[1:-1], len(parts)), values.dtype)
    for number, own in enumerate(parts.T):
        np.take(values[:steps], own, axis=-1, out=both[number * steps : (number + 1) * steps])
    both[len(both) - shared :] = values[steps:][..., parts[:, -1]]
    return both


def flow(mechanics: NumericSystem, start: Floats, step: Floats, steps: int, inputs: Inputs) -> Trajectories:
    """Integrate the equations of motion.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    start : array of shape (2n + S, K)
        Displacements in m, velocities in m/s and states of links at the nodes.
    step : array of shape (K,)
        Steps in s.
    steps : int
        Number of steps J.
    inputs : Inputs
        Applied forces, motion of the base and signals.

    Returns
    -------
    Trajectories
        The motion; not finite where it diverges.

    References
    ----------
    G. J. Cooper and J. H. Verner, SIAM J. Numer. Anal. 9, 389 (1972).
    """
    start = start.reshape(-1, start.shape[-1])
    K = start.shape[-1]
    n, L = mechanics.gain.shape
    S = len(start) - 2 * n
    halves = ((2, L), (n,), (S + len(inputs.signals),))
    along = (np.empty((2 * steps + 1, *shape, K)) for shape in halves)
    orbit = Trajectories(np.empty((steps + 1, 2, n, K)), *along)
    orbit.states[0, 0] = start[:n]
    np.multiply(start[n : 2 * n], step, out=orbit.states[0, 1])
    orbit.memory[0, :S] = start[2 * n :]
    stages = _Stages(mechanics, step, inputs, S)
    with np.errstate(all="ignore"):
        for j in range(steps):
            stages.integrate(orbit, j)
        stages.close(orbit, steps)
    return orbit


class _Stages:
    """The stages of a step, in arrays that all steps share: small arrays cost their handling, not their arithmetic.

    For the same reason nothing that all steps need is broadcast.
    """

    def __init__(self, mechanics: NumericSystem, step: Floats, inputs: Inputs, S: int) -> None:
        (n, L), K = mechanics.gain.shape, len(step)
        self.mechanics, self.inputs, self.has_memory = mechanics, inputs, S > 0
        self.on_base = inputs.base is not None or mechanics.system.base_error is not None
        self.step, self.step2, self.rate = (np.tile(a, (L, 1)) for a in (step, step * step, 1.0 / step))
        self.step_of_states, self.step2_of_masses = np.tile(step, (S, 1)), np.tile(step * step, (2, n, 1))
        self.into_links = mechanics.incidence.T
        self.stack = np.empty((2 + STAGES, L, K))
        self.forces, self.slopes = np.empty((STAGES, L, K)), np.empty((STAGES, S, K))
        flat, inner = self.stack.reshape(2 + STAGES, L * K), self.slopes.reshape(STAGES, S * K)
        #: Per stage its point, its row of the table and what this combines, and the same for states of links.
        self.combined = [
            (
                STAGE_POINT[i],
                STAGE_ROWS[i, :, : 2 + i],
                flat[: 2 + i],
                STAGE_ROWS[i, 1:, 2 : 2 + i],
                inner[:i],
            )
            for i in range(STAGES)
        ]
        self.motion, self.force, self.closing = np.empty((2, L, K)), np.empty((L, K)), np.empty((2, L, K))
        self.inside, self.change = np.empty((S + len(inputs.signals), K)), np.empty((S, K))
        self.memory, self.signals, self.gone = self.inside[:S], self.inside[S:], np.empty((1, S * K))
        self.law_operations = mechanics.force_operations(
            self.motion[0], self.motion[1], self.inside, self.force, self.change
        )

    def integrate(self, orbit: Trajectories, j: int) -> None:
        """From the start of step j to its end, where floating-point warnings are ignored."""
        states, at, forces = orbit.states, 2 * j, self.forces
        memory, accelerations = orbit.half_memory[at, : len(self.memory)], orbit.half_accelerations
        mechanics, motion, force, operations = self.mechanics, self.motion, self.force, self.law_operations
        row_of_motion, v = motion.reshape(2, -1), motion[1]
        gain, link_gain = mechanics.gain, mechanics.link_gain
        applied = pushed = None
        if self.inputs.force is not None:
            applied = self.inputs.applied(mechanics, j) / mechanics.masses[:, None]
            pushed = self.into_links @ applied
        np.matmul(self.into_links, states[j], out=self.stack[:2])
        for i, (point, row, above, inner_row, inner_above) in enumerate(self.combined):
            np.dot(row, above, row_of_motion)
            np.multiply(v, self.rate, v)
            if self.on_base:
                _add_base(mechanics, motion, self.inputs, (j, point), memory)
            if self.has_memory:
                np.add(memory, np.dot(inner_row, inner_above, self.gone).reshape(memory.shape), self.memory)
            for signal, values in zip(self.signals, self.inputs.signals.values(), strict=True):
                signal[:] = values[j, point]
            if i in (0, MIDDLE):
                half = at + (i == MIDDLE)
                orbit.half_links[half], orbit.half_memory[half] = motion, self.inside
            for operation in operations:
                operation()
            forces[i] = force
            if self.has_memory:
                np.multiply(self.change, self.step_of_states, self.slopes[i])
            own = np.dot(link_gain, force, self.stack[2 + i])
            if pushed is not None:
                np.add(own, pushed[point], own)
            np.multiply(own, self.step2, own)
        np.dot(CLOSING, forces.reshape(STAGES, -1), self.closing.reshape(2, -1))
        after = np.matmul(gain, self.closing, out=states[j + 1])
        np.dot(gain, forces[0], accelerations[at])
        np.dot(gain, forces[MIDDLE], accelerations[at + 1])
        if applied is not None:
            for i, weights in _CLOSING_WEIGHTS:
                after += weights * applied[STAGE_POINT[i]]
            accelerations[at] += applied[0]
            accelerations[at + 1] += applied[2]
        after *= self.step2_of_masses
        after += states[j]
        after[0] += states[j, 1]
        if self.has_memory:
            np.dot(CLOSING[1:], self.slopes.reshape(STAGES, -1), self.gone)
            np.add(memory, self.gone.reshape(memory.shape), orbit.half_memory[at + 2, : len(memory)])

    def close(self, orbit: Trajectories, steps: int) -> None:
        """Elongations and accelerations at the end of the last step, where floating-point warnings are ignored."""
        np.matmul(self.into_links, orbit.states[steps], out=self.motion)
        self.motion[1] *= self.rate
        _add_base(self.mechanics, self.motion, self.inputs, (steps - 1, 4), orbit.memory[steps])
        orbit.links[steps] = self.motion
        self.memory[:] = orbit.memory[steps, : len(self.memory)]
        for signal, values in zip(self.signals, self.inputs.signals.values(), strict=True):
            signal[:] = values[steps - 1, 4]
        orbit.memory[steps] = self.inside
        for operation in self.law_operations:
            operation()
        np.matmul(self.mechanics.gain, self.force, out=orbit.accelerations[steps])
        if self.inputs.force is not None:
            applied = self.inputs.applied(self.mechanics, steps - 1)[4]
            orbit.accelerations[steps] += applied / self.mechanics.masses[:, None]


def _in_turn(ends: Floats, middles: Floats) -> Floats:
    """(2 J + 1, ...) of values at the ends (J + 1, ...) of steps and in their middles (J, ...)."""
    both = np.empty((len(ends) + len(middles), *ends.shape[1:]))
    both[::2], both[1::2] = ends, middles
    return both


def input_along(points: Floats, refine: int) -> Floats:
    """(2 J + 1, ...) of an input (J refine, 5, ...) that is given at the POINTS of every step of the flow."""
    ends = np.concatenate([points[::refine, 0], points[-1:, 4]])
    return _in_turn(ends, points[:, 2] if refine == 1 else points[refine // 2 :: refine, 0])


def _add_base(
    mechanics: NumericSystem, motion: Floats, inputs: Inputs, place: tuple[int, int], memory: Floats
) -> None:
    """Add what the base stretches at a `place`, the step and its point; the error of its record is a constant state."""
    system = mechanics.system
    if inputs.base is not None:
        motion += system.base[:, None] * inputs.base[*place, :, None]
    if system.base_error is not None:
        motion[0] -= system.base[:, None] * memory[system.base_error]


_POINTS = 4  # samples of a polynomial: before a segment, fewer would leave more of accelerations at a third of the rate


def late_motion(
    orbit: Trajectories, step: Floats, stride: int, *, mass: int, kind: int, delay: float
) -> tuple[Floats, Floats]:
    """(M, K) what a sensor of this `kind` shows of a mass at the samples, `delay` s late, and the rate of it.

    `step` (K,) is that of the samples, with `stride` steps of the flow.
    """
    x = orbit.states[::stride, 0, mass]
    v = orbit.states[::stride, 1, mass] * stride
    a = orbit.accelerations[::stride, mass] * step**2
    points = min(_POINTS, len(x))
    sample = np.arange(len(x) - 1)[:, None]
    around = np.floor(-delay / step).astype(int) + 1 - points // 2
    first = np.clip(sample + around, 0, len(x) - points)
    at_points = [
        np.take_along_axis(signal, first + point, axis=0) for point in range(points) for signal in (x, v, a)
    ]
    place = sample - delay / step - first
    polynomial = np.tensordot(_through(points), np.stack(at_points), axes=1)
    shown, rate = (
        np.polynomial.polynomial.polyval(
            place, np.polynomial.polynomial.polyder(polynomial, order), tensor=False
        )
        / step**order
        for order in (kind, kind + 1)
    )
    return shown, rate


@cache
def _through(points: int) -> Floats:
    """(3P, 3P) coefficients of the polynomial with values, slopes and curvatures, point by point, at 0, 1, .. P - 1."""
    degrees, places = np.arange(3 * points), np.arange(points)
    rows = []
    for place in places:
        for order in range(3):
            factor = np.prod([degrees - lower for lower in range(order)], axis=0)
            rows.append(factor * float(place) ** np.maximum(degrees - order, 0))
    return np.asarray(np.linalg.solve(np.array(rows, dtype=float), np.eye(3 * points)))
