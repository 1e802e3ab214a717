"""Windows of a record: in each the state is fitted to the first samples, and the structure predicts the samples after.

All windows are integrated at once. A weak prior of the size of the motion holds what the first samples do not determine, such
as the state of a mass without a sensor; its uncertainty is then part of that of the prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.flow import POINTS, Inputs, Trajectories, flow
from linkwise.likelihood.shooting.segmentation import forces_at_points, sensor_arrays
from linkwise.likelihood.shooting.segments import A, F, S, Sensors, V, X
from linkwise.likelihood.shooting.system import NumericSystem, System
from linkwise.likelihood.shooting.tangents import shown_tangents, tangents
from linkwise.likelihood.starts.states import start_states
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import BAND_LIMITED, HELD, interpolated
from linkwise.records.record import Record

_PRIOR = 3.0  # deviation of the prior over the RMS of the motion: held only where samples say nothing
_FIRST = 16  # samples of the first fit; each next one takes more, so that chaos does not hide the minimum
_GROWTH = 3  # times as many
_ITERATIONS, _ROUGH_ITERATIONS = 12, 4  # at most, for all samples and before
_SETTLED = 0.01  # squared steps smaller than this part of a variance end a fit
_FLOW_ERROR = 0.01  # of the noise: by how much steps half as long may change a prediction
_MAX_REFINEMENT = 8  # steps per sample
_TESTED = 50  # windows whose predictions decide how fine the steps must be
_NUMBERS = 8_000_000  # in the sensitivities of one batch of windows
_FEWEST = 64  # samples of a window of a long run
_FARTHEST = 1e100  # times its unit: how far a departure that grows without end is followed


@dataclass(frozen=True, eq=False)
class WindowPrediction:
    """K windows of M samples and C channels: what the sensors would show (M, C, K) in SI units, and variances of it from
    the fitted state, the coefficients and the stated error of the laws. `motion` (M, 2, n, K) are displacements in m and
    velocities in m/s, `state` (2 n + S, K) is that at the first sample, the states of links last, `state_root` (K, 2 n +
    S, 2 n + S) the root R of its covariance R R', and `state_by_coefficients` (K, 2 n + S, p) how it follows the
    coefficients.
    """

    predicted: Floats
    by_state: Floats
    by_coefficients: Floats
    by_laws: Floats
    motion: Floats
    state: Floats
    state_root: Floats
    state_by_coefficients: Floats


@dataclass(frozen=True, eq=False)
class WindowPredictor:
    """Predicts windows of one record by a structure whose p uncertain coefficients are unknowns with `values` (p,) and a
    `root` (p, r) of their covariance. `sigma` (C,) is the noise of the responses, `law_error` the part of the forces of
    the links that the laws leave, by root mean squares.
    """

    record: Record
    structure: Structure
    values: Floats
    root: Floats
    sigma: Floats
    law_error: float = 0.0

    @np.errstate(over="ignore", invalid="ignore")  # a motion that runs away leaves states that are not finite
    def __call__(self, firsts: Indices, burn: int, samples: int) -> WindowPrediction:
        """The windows that begin at samples `firsts` (K,), with states from their first `burn` samples."""
        count = self._system.dimension
        size = max(1, _NUMBERS // (samples * count * (count + len(self.values) + 1)))
        parts = [firsts[first : first + size] for first in range(0, len(firsts), size)]
        refine = self._refinement(self._guess, firsts, samples)
        pieces = [self._predicted(part, burn, samples, refine) for part in parts]
        return WindowPrediction(
            *(np.concatenate([piece[i] for piece in pieces], axis=-1) for i in range(6)),
            *(np.concatenate([piece[i] for piece in pieces], axis=0) for i in (6, 7)),
        )

    @np.errstate(over="ignore", invalid="ignore")
    def variances_along(self, states: Floats, root: Floats, follow: Floats) -> tuple[Floats, Floats, Floats]:
        """Variances (N, C) of what a run with these `states` (2 n + S, N) of the whole record shows, by its start, the
        coefficients and the laws.

        `root` (2 n + S, 2 n + S) is that of the covariance of the first state, which follows the coefficients by `follow` (2 n
        + S, p). Departures of the run are carried from window to window, and the windows are integrated side by side.
        """
        count = states.shape[1]
        samples = max(_FEWEST, round(np.sqrt(count)))
        firsts = np.arange(0, count, samples)
        refine = self._refinement(states, firsts, samples)
        masses = len(self.structure.mass_names) if self.law_error else 0
        prior, unit = self._prior[:, None], self._unit[:, None]
        moved = np.hstack([root, follow @ self.root]) / prior
        fixed = np.hstack([np.zeros((len(unit), len(root))), self.root / unit])
        by_laws = np.zeros((len(root), masses))  # departures of the state
        size = max(1, _NUMBERS // (samples * refine * len(root) * (len(root) + len(unit) + 1)))
        parts = []
        for first in range(0, len(firsts), size):
            some = firsts[first : first + size]
            nodes, inputs = states[:, some], self._inputs(some, samples, refine)
            orbit = self._run(nodes, inputs, samples, refine)
            slopes, ends = self._slopes(orbit, inputs, refine)
            changes = list(self._changed_by_laws(nodes, inputs, orbit, samples, refine))
            for k in range(len(some)):
                of_laws = [shown[..., k].ravel() for shown, _ in changes]
                total = np.vstack([moved, fixed])
                by_both = slopes[k] @ total
                by_forces = slopes[k, :, : len(prior)] @ by_laws
                by_forces += np.transpose(of_laws or np.zeros((0, len(slopes[k]))))
                shown = by_both[:, : len(root)], by_both[:, len(root) :], by_forces
                parts.append([np.sum(part**2, axis=1) for part in shown])
                by_laws = ends[k, :, : len(prior)] @ by_laws
                for number, (_, end) in enumerate(changes):
                    by_laws[:, number] += end[:, k] / self._prior
                moved = np.clip(ends[k] @ total, -_FARTHEST, _FARTHEST)
        joined = map(np.concatenate, zip(*parts, strict=True))
        by_start, by_theta, by_force = (part.reshape(-1, len(self.sigma))[:count] for part in joined)
        return by_start, by_theta, by_force

    @cached_property
    def _system(self) -> System:
        return System.of(self.structure)

    @cached_property
    def _mechanics(self) -> NumericSystem:
        return self._system.at(self.values)

    @cached_property
    def _sensors(self) -> Sensors:
        return sensor_arrays(self.record.responses, self.structure, (), ())

    @cached_property
    def _unit(self) -> Floats:
        """(p,) units of parameters, their size."""
        return np.where(self.values != 0.0, np.abs(self.values), 1.0)

    @cached_property
    def _guess(self) -> Floats:
        """(2 n + S, N) rough states at all samples."""
        names = [parameter.name for parameter in self.structure.parameters]
        valued = self.structure.with_values(dict(zip(names, map(float, self.values), strict=True)))
        noise: dict[str, float] = dict(zip(self.record.responses, map(float, self.sigma), strict=True))
        rough = start_states(self.record, valued, noise, samples=5)
        return np.concatenate([rough.x, rough.v, rough.memory])

    @cached_property
    def _prior(self) -> Floats:
        """(2 n + S,) deviations of the prior of a state."""
        size, masses = np.sqrt(np.mean(self._guess**2, axis=1)), self.structure.size
        kinds = np.split(size, [masses, 2 * masses])
        unmeasured = np.concatenate([np.full(len(kind), kind.max(initial=0.0)) for kind in kinds])
        return _PRIOR * np.where(size > 0.0, size, np.where(unmeasured > 0.0, unmeasured, 1.0))

    def _inputs(self, firsts: Indices, samples: int, refine: int) -> Inputs:
        """Inputs at the points of all steps of some windows."""
        steps = np.arange(samples * refine)[:, None, None]
        index = firsts + (steps + POINTS[None, :, None]) / refine  # (J, 5, K)
        record, structure = self.record, self.structure
        force = base = None
        everywhere = (*structure.mass_names, *structure.points)
        forced = [name for name in everywhere if f"force:{name}" in record.channels]
        size = samples * refine, len(firsts)
        at_points = forces_at_points(structure, forced, size)
        if forced:
            force = np.zeros((samples * refine, len(POINTS), structure.size, len(firsts)))
            for name in forced:
                row = structure.topology.row(name)
                values = _at(record, f"force:{name}", index)
                force += row[:, None] * values[:, :, None]
                if at_points is not None and name in structure.points:
                    at_points[:, :, structure.points.index(name)] = values
        if np.any(structure.base_incidence):
            base = np.stack([_at(record, f"x:{BASE}", index, order) for order in (0, 1)], axis=2)
        signals = {name: _at(record, f"signal:{name}", index) for name in structure.signals}
        return Inputs(force, base, points=at_points, signals=signals)

    def _run(self, nodes: Floats, inputs: Inputs, samples: int, refine: int) -> Trajectories:
        """The motion from states (2 n + S, K)."""
        step = np.full(nodes.shape[-1], self.record.step / refine)
        return flow(self._mechanics, nodes, step, samples * refine, inputs)

    def _shown(self, orbit: Trajectories, refine: int) -> Floats:
        """(M, C, K) what the sensors show along an orbit."""
        every = slice(None, len(orbit.middle_links), refine)
        sensors = self._sensors.at(self._mechanics)
        orbit = sensors.orbit_with_points(orbit)
        links, memory = orbit.links[every], orbit.memory[every]
        motion = {
            X: orbit.states[every, 0],
            V: orbit.states[every, 1] * (refine * self.record.rate),
            A: orbit.accelerations[every],
            F: np.zeros_like(links[:, 0]),
            S: memory,
        }
        if (sensors.kind == F).any():
            self._mechanics.force(links[:, 0], links[:, 1], memory, motion[F], np.empty_like(memory))
        return np.stack([motion[kind][:, mass] for kind, mass in self._shown_places], axis=1)

    @property
    def _shown_places(self) -> list[tuple[int, int]]:
        """The kind and the number of what each sensor shows."""
        return list(zip(self._sensors.kind.tolist(), self._sensors.mass.tolist(), strict=True))

    def _end(self, orbit: Trajectories, refine: int) -> Floats:
        """(2 n + S, K) states at the end of an orbit."""
        x, u = orbit.states[-1]
        return np.concatenate([x, u * (refine * self.record.rate), orbit.memory[-1]])

    def _slopes(self, orbit: Trajectories, inputs: Inputs, refine: int) -> tuple[Floats, Floats]:
        """(K, M C, 2 n + S + p) sensitivities of what is shown to states in units of the prior, and to theta in its unit, and
        (K, 2 n + S, 2 n + S + p) those of the state at the end, in units of the prior.
        """
        step = np.full(orbit.states.shape[-1], self.record.step / refine)
        unit, mechanics = self._unit, self._mechanics
        sensors = self._sensors.at(mechanics)
        rates = {X: 1.0, V: 1.0 / step[0], A: 1.0 / step[0] ** 2, F: 1.0 / step[0] ** 2, S: 1.0}
        rows = []
        tangent_samples = tangents(mechanics, orbit, step, self._prior, unit, inputs=inputs)
        for number, tangent in enumerate(tangent_samples):
            if tangent.acceleration is None or number % refine:
                continue
            motion = shown_tangents(sensors, tangent, mechanics, orbit, number, (step, unit))
            rows += [motion[kind][mass].T * rates[kind] for kind, mass in self._shown_places]
        end = np.concatenate([tangent.state[0], tangent.state[1] / step, tangent.memory])
        ends = end.transpose(2, 0, 1) / self._prior[:, None]
        return np.stack(rows, axis=1).astype(float), ends.astype(float)

    def _refinement(self, states: Floats, firsts: Indices, samples: int) -> int:
        """Steps per sample that keep the error of the flow from `states` (2 n + S, N) well below the noise."""
        some = firsts[:: max(1, len(firsts) // _TESTED)]
        most = min(samples, 64)

        def shown(refine: int) -> Floats:
            orbit = self._run(states[..., some], self._inputs(some, most, refine), most, refine)
            return self._shown(orbit, refine)

        refine, coarse = 1, shown(1)
        while refine < _MAX_REFINEMENT:
            fine = shown(2 * refine)
            change = (fine - coarse) / self.sigma[:, None]
            if np.isfinite(change).all() and np.sqrt(np.mean(change**2)) < _FLOW_ERROR:
                break
            refine, coarse = 2 * refine, fine
        return refine

    def _predicted(self, firsts: Indices, burn: int, samples: int, refine: int) -> tuple[Floats, ...]:
        """The fields of `WindowPrediction` for some windows."""
        K, C, m = len(firsts), len(self.sigma), len(self._prior)
        inputs = self._inputs(firsts, samples, refine)
        nodes = self._guess[..., firsts].copy()
        values = self.record.select(self.record.responses).values
        observed = values[firsts + np.arange(burn)[:, None]].transpose(0, 2, 1)  # (burn, C, K)
        fitted = min(_FIRST, burn)
        while True:
            part = inputs.first(fitted * refine)
            most = _ITERATIONS if fitted == burn else _ROUGH_ITERATIONS
            nodes = self._fitted_states(nodes, part, observed[:fitted], refine, most)
            if fitted == burn:
                break
            fitted = min(_GROWTH * fitted, burn)
        orbit = self._run(nodes, inputs, samples, refine)
        slopes, _ = self._slopes(orbit, inputs, refine)
        weight = np.isfinite(observed).transpose(2, 0, 1) / self.sigma
        head = slopes[:, : burn * C] * weight.reshape(K, burn * C, 1)
        information = head[..., :m].transpose(0, 2, 1) @ head[..., :m] + np.eye(m)
        follow = -np.linalg.solve(information, head[..., :m].transpose(0, 2, 1) @ head[..., m:])
        state_root = np.linalg.inv(np.linalg.cholesky(information)).transpose(0, 2, 1)
        by_state = np.sum((slopes[..., :m] @ state_root) ** 2, axis=2)
        total = slopes[..., m:] + slopes[..., :m] @ follow
        by_theta = np.sum((total @ (self.root / self._unit[:, None])) ** 2, axis=2)
        shape = (K, samples, C)
        changes = self._changed_by_laws(nodes, inputs, orbit, samples, refine)
        motion = orbit.states[: len(orbit.middle_links) : refine].copy()
        motion[:, 1] *= refine * self.record.rate
        return (
            self._shown(orbit, refine),
            by_state.reshape(shape).transpose(1, 2, 0),
            by_theta.reshape(shape).transpose(1, 2, 0),
            sum((change**2 for change, _ in changes), np.zeros((samples, C, K))),
            motion,
            nodes,
            self._prior[:, None] * state_root,
            self._prior[:, None] * follow / self._unit,
        )

    def _changed_by_laws(
        self, nodes: Floats, inputs: Inputs, orbit: Trajectories, samples: int, refine: int
    ) -> Iterator[tuple[Floats, Floats]]:
        """What forces of the links that are off by a part of themselves change, mass after mass: (M, C, K) of what is shown,
        and (2 n + S, K) of the state at the end.
        """
        if self.law_error == 0.0:
            return
        shown, end = self._shown(orbit, refine), self._end(orbit, refine)
        ends, middles = orbit.accelerations, orbit.middle_accelerations
        at = POINTS[None, :, None, None]
        first, last, middle = ends[:-1, None], ends[1:, None], middles[:, None]
        acceleration = first * (1 - at) * (1 - 2 * at) + middle * 4 * at * (1 - at) + last * at * (2 * at - 1)
        applied = np.zeros_like(acceleration) if inputs.force is None else inputs.force
        for mass, size in enumerate(self._mechanics.masses):
            force = applied.copy()
            force[:, :, mass] += self.law_error * (size * acceleration[:, :, mass] - applied[:, :, mass])
            changed = self._run(nodes, replace(inputs, force=force), samples, refine)
            yield self._shown(changed, refine) - shown, self._end(changed, refine) - end

    def _fitted_states(
        self, nodes: Floats, inputs: Inputs, observed: Floats, refine: int, most: int
    ) -> Floats:
        """(2 n + S, K) states that fit samples (B, C, K) best from given ones, by damped Gauss-Newton steps in each window."""
        samples, C, K = observed.shape
        m, prior = len(self._prior), self._prior
        present = np.isfinite(observed)
        data = np.where(present, observed, 0.0)
        weight = present.transpose(2, 0, 1) / self.sigma
        damping = np.full(K, 1e-3)

        def misfit(states: Floats) -> tuple[Trajectories, Floats, Floats]:
            orbit = self._run(states, inputs, samples, refine)
            left = np.where(present, data - self._shown(orbit, refine), 0.0) / self.sigma[:, None]
            away = (states - nodes) / prior[:, None]
            cost = np.sum(left**2, axis=(0, 1)) + np.sum(away**2, axis=0)
            return orbit, left, np.where(np.isfinite(cost), cost, np.inf)

        states = nodes.copy()
        orbit, left, cost = misfit(states)
        better = np.ones(K, dtype=bool)
        for _ in range(most):
            if better.any():
                slopes = self._slopes(orbit, inputs, refine)[0][..., :m]
                rows = slopes * weight.reshape(K, samples * C, 1)
                normal = rows.transpose(0, 2, 1) @ rows + np.eye(m)
                right = np.einsum("kri,kr->ki", rows, left.transpose(2, 0, 1).reshape(K, -1))
                right -= ((states - nodes) / prior[:, None]).T
                valid = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
                normal[~valid], right[~valid] = np.eye(m), 0.0
            diagonal = np.einsum("kii->ki", normal)
            damped = normal.copy()
            damped[:, range(m), range(m)] += damping[:, None] * diagonal
            step = np.linalg.solve(damped, right[..., None])[..., 0]
            trial = states + (prior * step).T
            new_orbit, new_left, new_cost = misfit(trial)
            better = new_cost < cost
            states = np.where(better, trial, states)
            damping = np.where(better, damping / 10.0, damping * 10.0)
            size = np.einsum("ki,kij,kj->k", step, normal, step)  # squared, in standard errors
            if np.all((size < _SETTLED) | ~valid):
                break
            orbit = orbit.replaced(new_orbit, better)
            left, cost = np.where(better, new_left, left), np.where(better, new_cost, cost)
        return states


def _at(record: Record, name: str, index: Floats, order: int = 0) -> Floats:
    """Value or rate of an input at fractional samples (J, 5, K), the points of steps; held behind the last one."""
    values, kind = record.channel(name), record.interpolation.get(name, BAND_LIMITED)
    if kind == HELD:  # to the end of the last step in a sample, where the signal jumps
        sample = np.minimum(np.floor(index[:, len(POINTS) // 2]).astype(int), len(values) - 1)
        return np.zeros(index.shape) + (0.0 if order else values[sample][:, None])
    signal = interpolated(0.0, record.rate, values, kind)
    time = index / record.rate
    inside = np.minimum(time, signal.end)
    return np.where(time <= signal.end, signal.derivative(inside), 0.0) if order else signal.value(inside)
