"""The columns of the linearised equations that a diagnosis tests: what each error of unit size adds along the fitted motion.

It adds forces on masses, samples of channels, or both; how they are weighed, scaled and joined is the same for all. There are
errors of masses and applied forces, of the recorded motion of the base, of shapes of hosts, and damping between their modes.

Damping ratios leave out what a damper at one place of a host adds between its modes (Caughey and O'Kelly, J. Appl. Mech. 32,
1965). It matters where modes are near each other, and there it looks like the damper of a link.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations, permutations

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import CLOCK, CROSSTALK, GAIN_DRIFT
from linkwise.expression import Number, substitute, symbols, to_text
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.flow import input_along
from linkwise.likelihood.shooting.residuals import (
    Misfit,
    carried_by,
    filtered_motion,
    motion_of,
    shown_motion,
)
from linkwise.likelihood.shooting.segments import Segments, SensorErrors
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangents import CandidateForces, Single
from linkwise.likelihood.terms import ERRORS, Shown
from linkwise.likelihood.tests.score_test import (
    BETWEEN_MODES,
    FILTER,
    CandidateForce,
    Hypothesis,
    Lacking,
    Quadratic,
    augmented_quadratic,
    candidate_forces,
    forces_along,
    states_along,
)
from linkwise.model.coefficient import SHAPE
from linkwise.model.host import DAMPING, damping_link
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import GROUND
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE, Channel
from linkwise.runtime import one_blas_thread


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """What is along the motion of an optimum, at the ends of the steps of the tangents and in their middles, in turn."""

    optimum: Optimum
    structure: Structure
    channels: Sequence[Channel] = ()

    @property
    def segments(self) -> Segments:
        return self.optimum.segments

    @property
    def misfit(self) -> Misfit:
        return self.optimum.misfit

    @cached_property
    def mechanics(self) -> NumericSystem:
        return self.segments.system.at(self.optimum.point.theta)

    @cached_property
    def states(self) -> Floats:
        """(2 J + 1, 2, n + 2, K) x and v of the masses, the base and the ground."""
        return states_along(self.segments, self.misfit)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats]:
        """(2 J + 1, L, K) derivatives of the forces of the links by their elongations and rates."""
        partials = self.mechanics.partials(*self.links)
        return partials.by_d, partials.by_v

    @cached_property
    def forces(self) -> Floats:
        """(2 J + 1, L, K) forces of the links in N."""
        d, v, memory = self.links
        force = np.empty_like(d)
        self.mechanics.force(d, v, memory, force, np.empty_like(memory))
        return force

    @cached_property
    def responses(self) -> list[Channel]:
        """The channels that are no inputs, in the order of their samples."""
        return [name for name in self.channels if not name.is_input]

    @cached_property
    def shown(self) -> list[Shown]:
        """What each channel shows."""
        return shown_motion(self.misfit)

    @cached_property
    def filtered(self) -> list[Floats]:
        """(M, K) what a filter of unit size that all sensors share does to each channel."""
        return filtered_motion(self.misfit)

    @property
    def attenuation(self) -> float:
        """Largest ratio, among the channels, of what that filter does to what a gain does."""
        power = [
            (np.mean(one.value**2), np.mean(own**2))
            for one, own in zip(self.shown, self.filtered, strict=True)
        ]
        return float(np.sqrt(max(changed / max(shown, np.finfo(float).tiny) for shown, changed in power)))

    @property
    def links(self) -> tuple[Floats, Floats, Floats]:
        """(2 J + 1, L, K) elongations and rates of the links, and (2 J + 1, S, K) states."""
        orbit = self.misfit.trajectories.thinned(self.segments.flow_steps_per_tangent)
        return orbit.half_links[:, 0], orbit.half_links[:, 1], orbit.half_memory

    def input(self, points: Floats) -> Floats:
        """(2 J + 1, ...) an input that is given at the points of every step of the flow."""
        return input_along(points, self.segments.flow_steps_per_tangent)

    @cached_property
    def applied(self) -> Floats:
        """(steps, points, n, K) applied forces and those of a moving frame in N."""
        return self.segments.inputs.applied(self.mechanics, slice(None))

    def rate(self, values: Floats) -> Floats:
        """(2 J + 1, K) rates of values."""
        step = self.segments.step * self.segments.flow_steps_per_tangent
        return np.asarray(np.gradient(values, axis=0, edge_order=2) / (0.5 * step))


@dataclass(frozen=True, eq=False)
class Added:
    """What an error of unit size adds: `forces` (2 J + 1, K) in N along the motion, each between two places and negative on
    the first, and `samples` (M, K) of channels by number.

    These are scaled so that the root mean square of the forces is 1, but where they are given in a `unit` of its size.
    """

    error: Hypothesis
    forces: Sequence[tuple[int, int, Floats | Single]] = ()
    samples: Sequence[tuple[int, Floats]] = ()
    unit: float | None = None

    @cached_property
    def scale(self) -> float:
        """What it is divided by; 1 of an error of sensors alone, and 0 where it adds nothing that is finite."""
        if self.unit is not None:
            return 1.0
        power = sum(float(np.mean(values[::2] ** 2)) for _, _, values in self.forces)
        if not 0.0 < power < np.inf:
            return float(bool(self.samples))
        return float(np.sqrt(power / len(self.forces)))

    @property
    def scaled(self) -> Added:
        """The same divided by its scale, in arrays of its own: of a long record, those that it was made of need not stay."""
        scale = self.scale
        forces = [(first, second, np.asarray(f / scale, np.float32)) for first, second, f in self.forces]
        samples = [(channel, values / scale) for channel, values in self.samples]
        return Added(self.error, forces, samples, self.unit or 1.0 / scale)


@dataclass(frozen=True, eq=False)
class TestedColumns:
    """h `hypotheses`, the `units` (h,) of their scaled sizes, and the columns of f candidate `forces` and e sensor `errors`.

    Their `owners` (f + e,) are the numbers of the hypotheses.
    """

    __test__ = False  # no test of pytest

    hypotheses: Sequence[Hypothesis]
    units: Floats
    forces: CandidateForces | None
    errors: SensorErrors | None
    owners: Sequence[int]

    @classmethod
    def of(cls, every: Iterable[Added]) -> TestedColumns:
        """What errors add in their units; without those that add nothing."""
        hypotheses, units = [], []
        forces, samples = list[tuple[int, list[int], Floats | Single]](), list[tuple[int, int, Floats]]()
        for k, one in enumerate(one.scaled for one in every if one.scale > 0.0):
            hypotheses.append(one.error)
            units.append(one.unit)
            forces += [(k, ends, values) for *ends, values in one.forces]
            samples += [(k, channel, values) for channel, values in one.samples]
        owners = [owner for owner, *_ in (*forces, *samples)]
        candidates, errors = None, None
        if forces:
            ends = np.array([ends for _, ends, _ in forces])
            candidates = CandidateForces(ends[:, 0], ends[:, 1], [along for *_, along in forces])
        if samples:
            channels = np.array([channel for _, channel, _ in samples])
            errors = SensorErrors(channels, [values for *_, values in samples])
        return cls(hypotheses, np.array(units), candidates, errors, owners)

    @np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite; results are checked
    def quadratic(self, optimum: Optimum, blocks: int = 1) -> Quadratic:
        """The cost in the parameters and, after them, the scaled sizes of the hypotheses; as `augmented_quadratic`."""
        forces = self.forces or candidate_forces(optimum.segments, optimum.misfit, [])[0]
        p, h = optimum.segments.system.parameters.size, len(self.hypotheses)
        sums = np.eye(p + h)[[*range(p), *(p + owner for owner in self.owners)]]
        return augmented_quadratic(optimum, forces, self.errors, blocks).summed(sums)


def terms_along(motion: FittedMotion, lacking: Lacking) -> Iterator[Added]:
    """Each missing force alone, in its root mean square, with what load cells show of it."""
    along, _ = forces_along(motion.segments, motion.misfit, [force for _, force in lacking])
    responses = enumerate(motion.responses)
    cells = {name.removeprefix("f:"): channel for channel, name in responses if name.kind == "f"}
    every, count = 2 * motion.segments.tangent_refine, len(motion.segments.samples)
    for k, (hypothesis, force) in enumerate(lacking):
        measured = hypothesis.kind == "term" and hypothesis.where in cells
        samples = [(cells[hypothesis.where], along[::every, k][:count].astype(float))] if measured else ()
        yield Added(hypothesis, [(force.first, force.second, along[:, k])], samples, unit=1.0)


_COUPLED = 8  # channels up to which crosstalk between every two of them is tested


def errors_of_sensors(motion: FittedMotion) -> Iterator[Added]:
    """All kinds of errors of each sensor alone, a gain of each or of all that drifts, the filter that they share, and the
    clock of the only input.

    A gain is relative, an offset in the unit of the channel, a drift the change from the start of a record to its end, a delay
    in s, crosstalk the part of another channel of the same kind that is seen as well.
    """
    shown, kinds = motion.shown, motion.segments.sensors.kind
    names, errors = motion.responses, [(kind, error) for kind, error in ERRORS.items() if kind != CROSSTALK]
    for channel, one in enumerate(shown):
        for kind, error in errors:
            yield Added(Hypothesis(kind, names[channel]), samples=[(channel, error.tested(one))])
    drifting = [(channel, one.value * one.ramp) for channel, one in enumerate(shown)]
    if len(drifting) > 1:
        yield Added(Hypothesis(GAIN_DRIFT, "all channels"), samples=drifting)
    for channel, source in permutations(range(len(shown) if len(shown) <= _COUPLED else 0), 2):
        if kinds[channel] == kinds[source]:
            crosstalk = Hypothesis(CROSSTALK, names[channel], source=names[source])
            yield Added(crosstalk, samples=[(channel, shown[source].value)])
    yield Added(Hypothesis(FILTER, "all channels"), samples=[*enumerate(motion.filtered)])
    if len(motion.channels) == len(names) + 1:
        [only] = {*motion.channels} - {*names}
        early = [(channel, -ERRORS[CLOCK].tested(one)) for channel, one in enumerate(shown)]
        yield Added(Hypothesis(CLOCK, only), samples=early)


_ROUNDING = 1e-9  # of a force


def inertia_and_inputs(motion: FittedMotion) -> Iterator[Added]:
    """Relative errors of masses and of applied forces, and delays of these."""
    segments, structure = motion.segments, motion.structure
    own = [place for place in enumerate(structure.mass_names) if place[1] not in structure.modes]
    orbit = motion.misfit.trajectories.thinned(segments.flow_steps_per_tangent)
    accelerations = segments.inputs.accelerations(orbit)
    for number, name in own:  # a mode has unit mass by definition; its frequency and damping are terms
        force = -float(structure.mass_values[number]) * accelerations[:, number]
        yield Added(Hypothesis("mass", name), [(-1, number, force)])
    if segments.inputs.force is None:
        return
    estimated = _estimated_inputs(motion)
    for number, name in own:  # on a mode a force acts at points
        applied, smallest = motion.applied[:, :, number], 0.0
        if segments.inputs.frame is not None:  # less the forces of inertia, which are no applied ones
            of_frame = float(structure.mass_values[number]) * segments.inputs.frame
            smallest = _ROUNDING * float(np.max(np.abs(of_frame)))
            applied = applied + of_frame
        force, channel = motion.input(applied), f"force:{name}"
        if not np.max(np.abs(force[::2])) > smallest:
            continue
        for kind, change in (("force gain", force), ("force delay", -motion.rate(force))):
            if (kind.removeprefix("force "), channel) not in estimated:
                yield Added(Hypothesis(kind, channel), [(-1, number, change)])


def _estimated_inputs(motion: FittedMotion) -> set[tuple[str, str]]:
    """The errors of inputs that are estimated, whose scores are rounding: their kinds and channels."""
    uncertain = motion.segments.inputs.uncertain
    if uncertain is None:
        return set()
    kinds = (("gain", uncertain.gains), ("delay", uncertain.delays))
    return {
        (kind, str(uncertain.channels[k])) for kind, unknowns in kinds for k in np.flatnonzero(unknowns >= 0)
    }


def base_errors(motion: FittedMotion) -> Iterator[Added]:
    """A record (1 + g) x(t) of the base, and one x(t - tau): on masses, and in channels that show moving coordinates."""
    segments, inputs = motion.segments, motion.segments.inputs
    if inputs.frame is not None:
        moved = motion.input(inputs.frame)
        masses = motion.mechanics.masses[:, None]
        forces = [masses * moved[:, None], masses * -motion.rate(moved)[:, None]]
    elif inputs.base is not None:
        x, v = np.moveaxis(motion.input(inputs.base), 1, 0)[:, :, None]
        on_base, (by_d, by_v) = segments.system.base[:, None], motion.slopes
        forces = [
            -segments.system.incidence @ (on_base * (by_d * change + by_v * rate))
            for change, rate in ((-x, -v), (v, motion.rate(v)))
        ]
    else:
        return
    base = next(f"{kind}:{BASE}" for kind in "xav" if f"{kind}:{BASE}" in motion.channels)
    estimated = _estimated_inputs(motion)
    carried = [
        carried_by(segments, motion.misfit.point, channel) for channel in range(segments.samples.shape[1])
    ]
    for order, (kind, sign) in enumerate((("gain", -1.0), ("delay", 1.0))):
        if (kind, base) in estimated:
            continue
        yield Added(
            Hypothesis(kind, base),
            [(-1, number, force) for number, force in enumerate(np.moveaxis(forces[order], 1, 0))],
            [(channel, sign * own[order]) for channel, own in enumerate(carried) if own is not None],
        )


_MODE_PAIRS = 30  # pairs of modes that are tested, the nearest ones


def damping_between_modes(motion: FittedMotion) -> Iterator[Added]:
    """Damping of pairs whose damping is not estimated, the nearest modes first: each mode feels the other's rate."""
    index, estimated = motion.structure.topology.index, motion.segments.system.parameters.names
    pairs = []
    for host in motion.structure.hosts:
        frequencies = [mode.frequency.value or 0.0 for mode in host.modes]
        for first, second in combinations(range(len(host.modes)), 2):
            link = damping_link(host.name, (first + 1, second + 1))
            if f"{link}.{DAMPING}" not in estimated:
                low, high = sorted((frequencies[first], frequencies[second]))
                places = (index[host.coordinates[first]], index[host.coordinates[second]])
                pairs.append(((high - low) / max(high + low, np.finfo(float).tiny), link, places))
    for _, link, (first, second) in sorted(pairs, key=lambda pair: pair[0])[:_MODE_PAIRS]:
        forces = [
            (mode, index[GROUND], motion.states[:, 1, other])
            for mode, other in ((first, second), (second, first))
        ]
        yield Added(Hypothesis(BETWEEN_MODES, link), forces)


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


_SHAPES = 60  # modes and points of which the shapes are tested


def shape_errors(motion: FittedMotion) -> Iterator[Added]:
    """Relative errors of the shapes at points with a link, a force or a sensor; none where there are too many."""
    structure, channels = motion.structure, motion.channels
    used = {end for link in structure.links for end in link.between} | {channel.place for channel in channels}
    estimated = motion.segments.system.parameters.names
    places = [
        (point, mode, shape)
        for host in structure.hosts
        for point in host.points
        if point in used
        for mode, shape in host.shape(point).items()
        if shape and f"{mode}.{SHAPE}{point.removeprefix(f'{host.name}.')}" not in estimated
    ]
    if len(places) > _SHAPES:
        return
    applied = _applied_at_points(motion)
    for point, mode, shape in places:
        number = structure.topology.index[mode]
        kinds = [
            (k, int(motion.segments.sensors.kind[k]))
            for k, name in enumerate(motion.responses)
            if name.place == point
        ]
        yield Added(
            Hypothesis("shape", point, source=mode),
            _by_shape(motion, (point, mode, shape), applied.get(point)),
            [(k, shape * motion_of(motion.misfit, kind, number)[0]) for k, kind in kinds],
        )


def _applied_at_points(motion: FittedMotion) -> dict[str, Floats]:
    """(2 J + 1, K) the force that is applied at each point or mass, in N."""
    forced = [channel.place for channel in motion.channels if channel.is_force]
    if motion.segments.inputs.force is None or not forced:
        return {}
    # few points by modes
    known = np.linalg.pinv(np.stack([motion.structure.topology.row(name) for name in forced]).T)
    return {
        name: motion.input(np.einsum("n,jpnk->jpk", row, motion.applied))
        for name, row in zip(forced, known, strict=True)
    }


def _by_shape(
    motion: FittedMotion, place: tuple[str, str, float], applied: Floats | None
) -> list[tuple[int, int, Floats]]:
    """The forces that follow from a shape that is larger by its own size: one on the mode, and one of each link there."""
    point, mode, shape = place
    topology, order = motion.structure.topology, motion.segments.system.order.tolist()
    at, number, (by_d, by_v) = topology.index[point], topology.index[mode], motion.slopes
    x, v = motion.states[:, 0, number], motion.states[:, 1, number]
    on_mode, forces = np.zeros_like(x) if applied is None else shape * applied, []
    for link, (first, second) in enumerate(topology.ends.tolist()):
        if at in (first, second):
            part, column = (shape if first == at else -shape), order.index(link)
            forces.append((first, second, part * (by_d[:, column] * x + by_v[:, column] * v)))
            on_mode = on_mode - part * motion.forces[:, column]
    return [*forces, (-1, number, on_mode)]


_OF_MODES = (("frequency", "d", 2.0), ("damping", "v", 1.0))
"""Coefficients of modes, and by how many times a relative error of one changes the stiffness or damping."""


def errors_of_stated_values(
    optimum: Optimum, structure: Structure, identified: Structure, others: Iterable[Added] = ()
) -> tuple[Sequence[Hypothesis], Quadratic]:
    """Relative errors of masses, of applied forces and of coefficients of laws that `structure` has as known, and delays.

    With `others`, and the local model at the `identified` structure. Raises numpy.linalg.LinAlgError where its equations are
    singular.
    """
    motion = FittedMotion(optimum, identified)
    with one_blas_thread():
        columns = TestedColumns.of(chain(inertia_and_inputs(motion), _known_terms(motion, structure), others))
        return columns.hypotheses, columns.quadratic(optimum).in_units(optimum, columns.units)


def _known_terms(motion: FittedMotion, structure: Structure) -> Iterator[Added]:
    """Relative errors of the coefficients of terms of links that are known and not 0, by the names of these.

    Of modes of hosts these are frequencies and damping.
    """
    known = list(_known_coefficients(structure))
    along, units = forces_along(motion.segments, motion.misfit, [force for _, force, _ in known])
    for k, (hypothesis, force, size) in enumerate(known):
        yield Added(hypothesis, [(force.first, force.second, along[:, k])], unit=float(units[k]) / size)


def _known_coefficients(structure: Structure) -> Iterator[tuple[Hypothesis, CandidateForce, float]]:
    """The force of each such coefficient, and that by which it goes with a relative error."""
    for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True):
        values = {name: coefficient.value or 0.0 for name, coefficient in link.coefficients.items()}
        known = {name: value for name, value in values.items() if link.coefficients[name].known}
        for name in () if link.name in structure.modes else link.law.linear:
            others = {key: Number(value) for key, value in known.items() if key != name}
            basis = substitute(link.law.basis[name], others)
            if known.get(name) and set(symbols(basis)) <= set(VARIABLES):
                force = CandidateForce(first, second, Law.parse(to_text(basis)))
                yield Hypothesis("coefficient", f"{link.name}.{name}"), force, known[name]
        for name, variable, weight in _OF_MODES if link.name in structure.mass_names else ():
            slopes = link.law.partials(0.0, 0.0, values)
            size = weight * float(slopes.by_d if variable == "d" else slopes.by_v)
            if size and name in known:
                yield Hypothesis(name, link.name), CandidateForce(first, second, Law.parse(variable)), size
