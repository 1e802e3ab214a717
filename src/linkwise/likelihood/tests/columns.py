"""Errors of the recorded motion of the base: what each does to the masses and to the sensors, per unit of its size.

Damping between modes that a host lacks: an entry of its modal damping matrix, whose force on each mode follows the other.

Damping ratios leave out what a damper at one place of a host adds between its modes (Caughey and O'Kelly, J. Appl. Mech. 32,
1965). It matters where modes are near each other, and there it looks like the damper of a link.

Errors of the shapes of hosts: what a mode that moves a point more than stated does to links, forces and sensors there.

Errors of masses and of applied forces: the force that each would add to its mass, per unit of its size.

The columns of the linearised equations that a diagnosis tests, alone or in sums of several.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from linkwise.arrays import Floats
from linkwise.expression import Number, substitute, symbols, to_text
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.shooting.flow import UncertainForces, at_ends_and_middles
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors, carried_by, evaluate, motion_of
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.likelihood.tests.score_test import (
    AugmentedQuadratic,
    CandidateForce,
    Hypothesis,
    LocalQuadratic,
    augmented_quadratic,
    candidate_forces,
    in_their_units,
    states_at_ends_and_middles,
)
from linkwise.model.coefficient import SHAPE
from linkwise.model.host import DAMPING, Host, Pair, damping_link
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import GROUND, Link
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.runtime import one_blas_thread

BASE_ERRORS = ("gain", "delay")


@dataclass(frozen=True, eq=False)
class BaseErrors:
    """Errors of BASE_ERRORS, each a column of `forces` on all masses and of `values` in all channels.

    starts (J + 1, n, e, K), middles (J, n, e, K) in N at the steps of the tangents, values (M, C, e, K) in the channel's unit.
    """

    starts: Floats
    middles: Floats
    values: Floats

    @classmethod
    def of(cls, optimum: Optimum, misfit: Misfit) -> BaseErrors | None:
        """What a record (1 + g) x(t) of the base, or x(t - tau), does; None where nothing of the base is recorded."""
        segments = optimum.segments
        if segments.inputs.frame is None and segments.inputs.base is None:
            return None
        forces = _inertia(optimum) if segments.inputs.frame is not None else _link_forces(optimum, misfit)
        values = np.zeros((*segments.samples.shape[:2], len(BASE_ERRORS), segments.count))
        for channel in range(values.shape[1]):
            carried = carried_by(segments, misfit, channel)
            if carried is not None:
                values[:, channel, 0], values[:, channel, 1] = -carried[0], carried[1]
        return cls(*forces, values)


def _inertia(optimum: Optimum) -> tuple[Floats, Floats]:
    segments = optimum.segments
    assert segments.inputs.frame is not None
    masses = segments.system.at(optimum.point.theta).masses[:, None, None]
    stride = segments.flow_steps_per_tangent
    ends, middles = at_ends_and_middles(segments.inputs.frame, stride)
    rates = _rates(ends, middles, segments.step * stride)
    return tuple(  # type: ignore[return-value]
        masses * np.stack([value, -rate], axis=1)[:, None]
        for value, rate in zip((ends, middles), rates, strict=True)
    )


def _link_forces(optimum: Optimum, misfit: Misfit) -> tuple[Floats, Floats]:
    segments = optimum.segments
    assert segments.inputs.base is not None
    mechanics, stride = segments.system.at(optimum.point.theta), segments.flow_steps_per_tangent
    orbit = misfit.trajectories.thinned(stride)
    bases = at_ends_and_middles(segments.inputs.base, stride)
    accelerations = _rates(bases[0][:, 1], bases[1][:, 1], segments.step * stride)
    forces = []
    links, memories = (orbit.links, orbit.middle_links), (orbit.memory, orbit.middle_memory)
    for motion, memory, base, acceleration in zip(links, memories, bases, accelerations, strict=True):
        slopes = mechanics.partials(motion[:, 0], motion[:, 1], memory)
        x, v, a = base[:, 0, None], base[:, 1, None], acceleration[:, None]
        on_base = segments.system.base[:, None]
        columns = [
            -segments.system.incidence @ (on_base * (slopes.by_d * change + slopes.by_v * rate))
            for change, rate in ((-x, -v), (v, a))
        ]
        forces.append(np.stack(columns, axis=2))
    return forces[0], forces[1]


def _rates(ends: Floats, middles: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Rates (J + 1, K) and (J, K) of values at the ends and middles of steps."""
    both = np.empty((len(ends) + len(middles), ends.shape[-1]))
    both[::2], both[1::2] = ends, middles
    rate = np.gradient(both, axis=0, edge_order=2) / (0.5 * step)
    return rate[::2], rate[1::2]


_MODE_PAIRS = 30  # pairs of modes that are tested, the nearest ones


@dataclass(frozen=True, eq=False)
class DampingErrors:
    """Damping between h pairs of modes: `links` that would hold it, as named in a structure, and its `forces`.

    Each pair has two of these in a row, one on each of its modes, in scaled sizes of which `units` (h,) are in N s/m.
    """

    links: tuple[str, ...]
    forces: CandidateForces
    units: Floats

    @classmethod
    def of(cls, optimum: Optimum, misfit: Misfit, structure: Structure) -> DampingErrors | None:
        """Of pairs whose damping is not estimated, the nearest modes first; None without any."""
        nearest = nearest_pairs(structure, optimum.segments.system.parameters.names)
        if not nearest:
            return None
        segments, index = optimum.segments, structure.topology.index
        modes = np.array(
            [[index[host.coordinates[number - 1]] for number in pair] for host, pair in nearest], dtype=int
        )
        motion = states_at_ends_and_middles(
            misfit.trajectories, segments.flow_steps_per_tangent, segments.step, segments.inputs
        )
        starts, middles = (part[:, 1, modes[:, ::-1]] for part in motion)  # each mode feels the other's rate
        power = np.mean(np.square(starts), axis=(0, 2, 3))
        units = 1.0 / np.sqrt(np.where(power > 0.0, power, 1.0))
        starts, middles = (
            (part * units[:, None, None]).reshape(len(part), -1, part.shape[-1]) for part in (starts, middles)
        )
        forces = CandidateForces(modes.ravel(), np.full(modes.size, index[GROUND]), starts, middles)
        return cls(tuple(damping_link(host.name, pair) for host, pair in nearest), forces, units)

    @property
    def weights(self) -> Floats:
        """(2 h, h) 1 where a force is one of those of a pair."""
        return np.repeat(np.eye(len(self.links)), 2, axis=0)


def nearest_pairs(structure: Structure, estimated: Collection[str] = ()) -> list[tuple[Host, Pair]]:
    """Pairs of modes of a host whose damping is not among the coefficients `estimated`, the nearest first; 30 at most."""
    pairs = [
        (host, pair)
        for host in structure.hosts
        for pair in combinations(range(1, len(host.modes) + 1), 2)
        if f"{damping_link(host.name, pair)}.{DAMPING}" not in estimated
    ]
    return sorted(pairs, key=lambda place: _distance(*place))[:_MODE_PAIRS]


def largest_damping(structure: Structure) -> dict[str, float]:
    """The largest damping in N s/m between two modes that dissipates, by the link that would hold it.

    It is the geometric mean of the damping of the two: a larger one would feed energy into a motion of both.
    """
    largest = {}
    for host in structure.hosts:
        entries = {first: entry.value for (first, second), entry in host.entries.items() if first == second}
        own = [
            4.0 * np.pi * (mode.frequency.value or 0.0) * (mode.damping.value or 0.0)
            + (entries.get(number) or 0.0)
            for number, mode in enumerate(host.modes, 1)
        ]
        for first, second in combinations(range(1, len(own) + 1), 2):
            product = max(own[first - 1], 0.0) * max(own[second - 1], 0.0)
            largest[damping_link(host.name, (first, second))] = float(np.sqrt(product))
    return largest


def _distance(host: Host, pair: Pair) -> float:
    """How far apart two modes are: the difference of their frequencies relative to the sum."""
    first, second = (host.modes[number - 1].frequency.value or 0.0 for number in pair)
    return abs(first - second) / max(first + second, np.finfo(float).tiny)


_SHAPES = 60  # modes and points of which the shapes are tested


@dataclass(frozen=True, eq=False)
class ShapeErrors:
    """h relative errors of shapes: `places` (point, mode), and `weights` (c, h) of candidate `forces` and sensor `errors`."""

    places: tuple[tuple[str, str], ...]
    forces: CandidateForces
    errors: SensorErrors
    weights: Floats

    @classmethod
    def of(
        cls, optimum: Optimum, misfit: Misfit, structure: Structure, channels: Sequence[Channel]
    ) -> ShapeErrors | None:
        """The shapes at points with a link, a force or a sensor; None where there are none, or too many."""
        used = {end for link in structure.links for end in link.between}
        used |= {channel.place for channel in channels}
        parameter_names = optimum.segments.system.parameters.names
        places = [
            (point, mode, shape)
            for host in structure.hosts
            for point in host.points
            if point in used
            for mode, shape in host.shape(point).items()
            if shape and f"{mode}.{SHAPE}{point.removeprefix(f'{host.name}.')}" not in parameter_names
        ]
        if not 0 < len(places) <= _SHAPES:
            return None
        parts = _Parts.of(optimum, misfit, structure, channels)
        rows = [parts.candidate_forces(point, mode, shape) for point, mode, shape in places]
        shown = [parts.shown(point, mode, shape) for point, mode, shape in places]
        first, second, starts, middles = zip(*chain.from_iterable(rows), strict=True)
        sensors = list(chain.from_iterable(shown))
        empty = np.zeros((len(optimum.segments.samples), 0, optimum.segments.count))
        return cls(
            tuple((point, mode) for point, mode, _ in places),
            CandidateForces(np.array(first), np.array(second), np.stack(starts, 1), np.stack(middles, 1)),
            SensorErrors(
                np.array([channel for channel, _ in sensors], dtype=int),
                ("shape",) * len(sensors),
                np.full(len(sensors), -1),
                np.stack([values for _, values in sensors], 1) if sensors else empty,
            ),
            np.concatenate([_ownership(rows), _ownership(shown)]),
        )


def _ownership(parts: Sequence[Sequence[object]]) -> Floats:
    """(c, h) 1 where a column is one of those of a hypothesis."""
    owners = [number for number, members in enumerate(parts) for _ in members]
    return np.asarray(np.eye(len(parts))[owners])


HostForce = tuple[int, int, Floats, Floats]
"""Numbers of the places on which a force acts, negative on the first, and its values at ends and middles of steps."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """Motion and forces along the fitted orbit, at the ends of steps and in their middles."""

    optimum: Optimum
    misfit: Misfit
    structure: Structure
    channels: Sequence[Channel]
    motion: tuple[Floats, Floats]
    slopes: tuple[tuple[Floats, Floats], ...]
    forces: tuple[Floats, ...]
    applied: dict[str, tuple[Floats, Floats]]

    @classmethod
    def of(
        cls, optimum: Optimum, misfit: Misfit, structure: Structure, channels: Sequence[Channel]
    ) -> _Parts:
        segments = optimum.segments
        stride = segments.flow_steps_per_tangent
        mechanics = segments.system.at(optimum.point.theta)
        orbit = misfit.trajectories.thinned(stride)
        motion = states_at_ends_and_middles(misfit.trajectories, stride, segments.step, segments.inputs)
        slopes, forces = [], []
        for links, memory in ((orbit.links, orbit.memory), (orbit.middle_links, orbit.middle_memory)):
            partials = mechanics.partials(links[:, 0], links[:, 1], memory)
            slopes.append((partials.by_d, partials.by_v))
            force = np.empty_like(links[:, 0])
            mechanics.force(links[:, 0], links[:, 1], memory, force, np.empty_like(memory))
            forces.append(force)
        applied: dict[str, tuple[Floats, Floats]] = {}
        forced = [channel.place for channel in channels if channel.is_force]
        if segments.inputs.force is not None and forced:
            rows = np.stack([structure.topology.row(name) for name in forced])
            known = np.linalg.pinv(rows.T)  # a few points by modes
            on_modes = segments.inputs.applied(mechanics, slice(None))
            for name, row in zip(forced, known, strict=True):
                at_place = np.einsum("n,jpnk->jpk", row, on_modes)
                applied[name] = at_ends_and_middles(at_place, stride)
        return cls(optimum, misfit, structure, channels, motion, tuple(slopes), tuple(forces), applied)

    def candidate_forces(self, point: str, mode: str, shape: float) -> list[HostForce]:
        """The forces that follow from a shape that is larger by its own size: one on the mode, and one of each link there."""
        topology, order = self.structure.topology, self.optimum.segments.system.order.tolist()
        place, number = topology.index[point], topology.index[mode]
        on_mode = [np.zeros_like(motion[:, 0, 0]) for motion in self.motion]
        if point in self.applied:
            on_mode = [shape * force for force in self.applied[point]]
        candidates: list[HostForce] = []
        for link, (first, second) in enumerate(topology.ends.tolist()):
            if place not in (first, second):
                continue
            part, column = (shape if first == place else -shape), order.index(link)
            change = [
                part * (by_d[:, column] * motion[:, 0, number] + by_v[:, column] * motion[:, 1, number])
                for (by_d, by_v), motion in zip(self.slopes, self.motion, strict=True)
            ]
            on_mode = [
                total - part * force[:, column] for total, force in zip(on_mode, self.forces, strict=True)
            ]
            candidates.append((first, second, change[0], change[1]))
        return [*candidates, (-1, number, on_mode[0], on_mode[1])]

    def shown(self, point: str, mode: str, shape: float) -> list[tuple[int, Floats]]:
        """What sensors at the point show more of."""
        segments, number = self.optimum.segments, self.structure.topology.index[mode]
        responses = [name for name in self.channels if not name.is_input]
        return [
            (
                channel,
                shape * motion_of(segments, self.misfit, int(segments.sensors.kind[channel]), number)[0],
            )
            for channel, name in enumerate(responses)
            if name.place == point
        ]


_ROUNDING = 1e-9  # of a force
_NOTHING = Number(0.0)
_OF_MODES = (("frequency", "d", 2.0), ("damping", "v", 1.0))
"""Coefficients of modes, and by how many times a relative error of one changes the stiffness or damping."""


def force_errors(
    optimum: Optimum, misfit: Misfit, identified: Structure
) -> tuple[list[Hypothesis], CandidateForces, Floats]:
    """The errors of all masses and applied forces, as forces of root mean square 1; with the size of that in its own unit."""
    hypotheses, masses, units, starts, middles = [], [], [], [], []
    for hypothesis, mass, at_ends, between in _inertia_and_inputs(optimum, misfit, identified):
        scale = float(np.sqrt(np.mean(at_ends**2)))
        if not 0.0 < scale < np.inf:
            continue
        hypotheses.append(hypothesis)
        masses.append(mass)
        units.append(1.0 / scale)
        starts.append(at_ends / scale)
        middles.append(between / scale)
    steps, count = len(misfit.trajectories.middle_links), optimum.segments.count
    steps //= optimum.segments.flow_steps_per_tangent
    forces = CandidateForces(
        np.full(len(masses), -1),
        np.array(masses, dtype=int),
        np.stack(starts, axis=1) if starts else np.empty((steps + 1, 0, count)),
        np.stack(middles, axis=1) if middles else np.empty((steps, 0, count)),
    )
    return hypotheses, forces, np.array(units)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def errors_of_stated_values(
    optimum: Optimum, structure: Structure, identified: Structure
) -> tuple[list[Hypothesis], LocalQuadratic]:
    """Relative errors of masses, of applied forces and of coefficients of laws that `structure` has as known, and delays.

    With the local model, at the `identified` structure, in the parameters and, after them, the sizes of these errors. Raises
    numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        hypotheses, errors, units = force_errors(optimum, misfit, identified)
        of_coefficients, forces, sizes = _known_terms(structure)
        terms, of_terms = candidate_forces(optimum, misfit, forces)
        augmented = augmented_quadratic(optimum, misfit, errors.joined(terms))
    units = np.concatenate([units, of_terms / np.array(sizes)])
    return hypotheses + of_coefficients, in_their_units(optimum, augmented, units)


def _known_terms(structure: Structure) -> tuple[list[Hypothesis], list[CandidateForce], list[float]]:
    """The terms of links whose coefficients are known and not 0, by the names of these, with the size of a relative error.

    Of modes of hosts these are frequencies and damping.
    """
    hypotheses, forces, sizes = [], [], []
    for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True):
        known_values = {
            name: Number(coefficient.value or 0.0)
            for name, coefficient in link.coefficients.items()
            if coefficient.known
        }
        for name in () if link.name in structure.modes else link.law.linear:
            basis = substitute(
                link.law.basis[name], {key: known_values[key] for key in known_values if key != name}
            )
            if known_values.get(name, _NOTHING) == _NOTHING or not set(symbols(basis)) <= set(VARIABLES):
                continue
            hypotheses.append(Hypothesis("coefficient", f"{link.name}.{name}"))
            forces.append(CandidateForce(first, second, Law.parse(to_text(basis))))
            sizes.append(known_values[name].value)
        for name, variable, weight in _OF_MODES if link.name in structure.mass_names else ():
            if (value := _weight(link, variable) * weight) and link.coefficients[name].known:
                hypotheses.append(Hypothesis(name, link.name))
                forces.append(CandidateForce(first, second, Law.parse(variable)))
                sizes.append(value)
    return hypotheses, forces, sizes


def _weight(link: Link, variable: str) -> float:
    """The stiffness, of the variable "d", or the damping, of "v", of a mode in SI units."""
    slopes = link.law.partials(
        0.0, 0.0, {name: coefficient.value or 0.0 for name, coefficient in link.coefficients.items()}
    )
    return float(slopes.by_d if variable == "d" else slopes.by_v)


def _inertia_and_inputs(
    optimum: Optimum, misfit: Misfit, identified: Structure
) -> Iterator[tuple[Hypothesis, int, Floats, Floats]]:
    """What a relative error of a mass, or of an applied force, or a delay of it, does to the mass.

    Yields the hypothesis, the number of the mass, and the force on it at the ends (J + 1, K) and in the middles (J, K) of the
    steps of the tangents, per unit of the error.
    """
    segments, names = optimum.segments, identified.mass_names
    stride = segments.flow_steps_per_tangent
    accelerations = segments.inputs.accelerations(misfit.trajectories.thinned(stride))
    for i, name in enumerate(names):
        if name in identified.modes:  # of unit mass by definition; its frequency and damping are terms
            continue
        inertia = -float(identified.mass_values[i])
        ends, middles = (inertia * acceleration[:, i] for acceleration in accelerations)
        yield Hypothesis("mass", name), i, ends, middles
    if segments.inputs.force is None:
        return
    scaled, late = _estimated(segments.inputs.uncertain)
    step, forces = (
        segments.step * stride,
        segments.inputs.applied(segments.system.at(optimum.point.theta), slice(None)),
    )
    for i, name in enumerate(names):
        if name in identified.modes:  # on which a force acts at points
            continue
        applied = forces[:, :, i]
        smallest = 0.0
        if segments.inputs.frame is not None:  # less the forces of inertia, which are no applied ones
            of_frame = float(identified.mass_values[i]) * segments.inputs.frame
            smallest = _ROUNDING * float(np.max(np.abs(of_frame)))
            applied = applied + of_frame
        ends, middles = at_ends_and_middles(applied, stride)
        if not np.max(np.abs(ends)) > smallest:
            continue
        if f"force:{name}" not in scaled:
            yield Hypothesis("force gain", f"force:{name}"), i, ends, middles
        if f"force:{name}" in late:
            continue
        both = np.empty((len(ends) + len(middles), ends.shape[-1]))
        both[::2], both[1::2] = ends, middles
        rate = np.gradient(both, axis=0, edge_order=2) / (0.5 * step)
        yield Hypothesis("force delay", f"force:{name}"), i, -rate[::2], -rate[1::2]


def _estimated(uncertain: UncertainForces | None) -> tuple[list[str], list[str]]:
    """The forces whose gains, and those whose delays, are among the unknowns: their scores are rounding."""
    if uncertain is None:
        return [], []
    gains, delays = (
        [name for name, number in zip(uncertain.channels, numbers, strict=True) if number >= 0]
        for numbers in (uncertain.gains, uncertain.delays)
    )
    return gains, delays


@dataclass(frozen=True, eq=False)
class TestedColumns:
    """Columns of candidate `forces`, then of sensor `errors`, and the `units` (h,) of h hypotheses.

    `weights` (c, h) is what each hypothesis has of the c columns.
    """

    __test__ = False  # no test of pytest

    forces: CandidateForces
    errors: SensorErrors
    units: Floats
    weights: Floats

    @classmethod
    def separate(cls, forces: CandidateForces, errors: SensorErrors, units: Floats) -> TestedColumns:
        """Every column alone, in this order."""
        return cls(forces, errors, units, np.eye(len(units)))

    def with_sum(self, errors: SensorErrors) -> TestedColumns:
        """These and the sum of the columns of `errors`, as one hypothesis in their unit."""
        nobody = CandidateForces(
            self.forces.first[:0],
            self.forces.second[:0],
            self.forces.starts[:, :0],
            self.forces.middles[:, :0],
        )
        return self._with(nobody, errors, np.ones((len(errors.kind), 1)), np.ones(1))

    def with_load_cells(self, forces: Sequence[int], channels: Sequence[int], refine: int) -> TestedColumns:
        """These, where load cells show the `forces`, by number, in `channels`, with `refine` steps between their samples."""
        values = self.forces.starts[::refine, list(forces)]
        added = len(forces)
        shown = np.zeros((added, self.weights.shape[1]))
        shown[np.arange(added), list(forces)] = 1.0
        errors = self.errors
        return replace(
            self,
            errors=SensorErrors(
                np.append(errors.channel, np.array(channels, dtype=int)),
                (*errors.kind, *("load cell",) * added),
                np.append(errors.source, np.full(added, -1)),
                np.concatenate([errors.values, values[: len(errors.values)]], axis=1),
            ),
            weights=np.concatenate([self.weights, shown]),
        )

    def with_base(self, base: BaseErrors) -> TestedColumns:
        """These and the errors of the base, each of which acts on all masses and in all channels."""
        n, count = base.starts.shape[1:3]
        channels = base.values.shape[1]
        power = np.mean(base.starts**2, axis=(0, 1, 3))
        scale = np.sqrt(np.where(power > 0.0, power, 1.0))
        starts, middles, values = (
            (part / scale[:, None]).reshape(len(part), -1, part.shape[-1])
            for part in (base.starts, base.middles, base.values)
        )
        masses, sensors = np.repeat(np.arange(n), count), np.repeat(np.arange(channels), count)
        forces = CandidateForces(np.full(len(masses), -1), masses, starts, middles)
        errors = SensorErrors(sensors, BASE_ERRORS * channels, np.full(len(sensors), -1), values)
        return self._with(forces, errors, np.tile(np.eye(count), (n + channels, 1)), 1.0 / scale)

    def with_shapes(self, shapes: ShapeErrors) -> TestedColumns:
        """These and errors of the shapes of hosts, each of which acts on several places and channels."""
        return self._with(shapes.forces, shapes.errors, shapes.weights, np.ones(len(shapes.places)))

    def with_damping(self, damping: DampingErrors) -> TestedColumns:
        """These and damping between modes of hosts, which acts on both modes."""
        nowhere = SensorErrors(self.errors.channel[:0], (), self.errors.source[:0], self.errors.values[:, :0])
        return self._with(damping.forces, nowhere, damping.weights, damping.units)

    def _with(
        self, forces: CandidateForces, errors: SensorErrors, weights: Floats, units: Floats
    ) -> TestedColumns:
        """These and hypotheses of which each has `weights` (c, h) of more columns, forces first."""
        before, added = len(self.forces.first), len(forces.first)
        own = np.pad(self.weights, ((0, 0), (0, len(units))))
        more = np.pad(weights, ((0, 0), (self.weights.shape[1], 0)))
        return TestedColumns(
            self.forces.joined(forces) if added else self.forces,
            SensorErrors(
                np.append(self.errors.channel, errors.channel),
                (*self.errors.kind, *errors.kind),
                np.append(self.errors.source, errors.source),
                np.concatenate([self.errors.values, errors.values], axis=1),
            ),
            np.append(self.units, units),
            np.concatenate([own[:before], more[:added], own[before:], more[added:]]),
        )

    def joined(self, augmented: AugmentedQuadratic, parameters: int) -> tuple[Floats, Floats, Floats]:
        """Curvature, slope and its covariance in the parameters and the sizes of the hypotheses."""
        columns, hypotheses = self.weights.shape
        weights = np.eye(parameters + columns, parameters + hypotheses)
        weights[parameters:, parameters:] = self.weights
        curvature = weights.T @ augmented.curvature @ weights
        white = augmented.scatter is augmented.curvature
        return (
            curvature,
            weights.T @ augmented.slope,
            curvature if white else weights.T @ augmented.scatter @ weights,
        )
