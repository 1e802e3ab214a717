"""The multiple-shooting problem of some records: segments with sufficiently small steps, start and scales.

Before the work it asks for the memory that a fit takes, and whether anything sets the scale of forces: the motion alone tells
only ratios of masses and coefficients. Sensors of several records have noise and unknowns in common.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.random_forces import (
    RandomForce,
    first_deviations,
    shown_directly,
    system_with,
    with_random_forces,
)
from linkwise.likelihood.shooting.residuals import Gaussian, Misfit, evaluate, with_bounds_for
from linkwise.likelihood.shooting.segmentation import (
    Cut,
    cut_segments,
    in_moving_coordinates,
    numbers_among,
    require_same_channels,
    with_uncertain_forces,
)
from linkwise.likelihood.shooting.segments import (
    A,
    Iterate,
    Prior,
    RandomStates,
    Scales,
    Segments,
    SensorErrors,
    Sensors,
)
from linkwise.likelihood.shooting.system import MANY, System
from linkwise.likelihood.shooting.tangents import tangents
from linkwise.likelihood.starts.states import start_states
from linkwise.likelihood.terms import Block, Unknown, with_integrated
from linkwise.model.coefficient import MASS
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE, COMMON, Channel
from linkwise.records.record import Record
from linkwise.runtime import available_memory, keep_freed_memory
from linkwise.signals.base_frame import FramedRecord, framed
from linkwise.signals.noise import channel_noise, noise_floor
from linkwise.weak.fit import NO_FORCE_SCALE

_BLOCKS = 4  # of a node with itself, or with the border, that are kept at the same time, of few masses
_OF_MANY = 3, 2  # blocks of a node with itself, and with the border: a half of these are in single precision
_OUTSIDE = 1e-3  # of the noise of a force, outside of its window: the equations take no zero


def fit_bytes(segments: int, masses: int, states: int, border: int) -> int:
    """Least memory of a fit.

    Parameters
    ----------
    segments, masses, states, border : int
        Numbers of segments, masses, states of a node, and unknowns of the border.

    Returns
    -------
    int
        Bytes.
    """
    if masses < MANY:
        return 8 * _BLOCKS * segments * states * (states + border)
    return 8 * segments * states * (_OF_MANY[0] * states + _OF_MANY[1] * border)


def require_room(segments: int, masses: int, states: int, border: int, *, free: int | None = None) -> None:
    """Refuse a fit that the memory cannot hold.

    Parameters
    ----------
    segments, masses, states, border : int
        As of `fit_bytes`.
    free : int, optional
        Bytes that are free; those of this machine by default.

    Raises
    ------
    IdentificationError
        If the fit needs more.
    """
    needed = fit_bytes(segments, masses, states, border)
    free = available_memory() if free is None else free
    if needed > free:
        raise IdentificationError(
            f"maximum likelihood for {masses} masses over {segments} segments of the record needs {needed / 1e9:.3g} GB, and "
            f"{free / 1e9:.3g} GB are free: fit a shorter part of the record, fewer records together, or take the weak form"
        )


# in a segment: shorter ones have more unknowns, longer ones a steeper cost where motion is chaotic
SAMPLES = 5


@dataclass(frozen=True, eq=False)
class Problem:
    """A structure and records of it, with what is unknown of sensors and inputs, and their noise.

    Attributes
    ----------
    structure : Structure
        The structure.
    frames : tuple of FramedRecord
        The records in the coordinates of the equations.
    records : sequence of Record
        Those of the frames, with clipped readings where the likelihood of bounds is that of the loss.
    unknowns : tuple of Unknown
        What the errors put among the unknowns, in the order of these.
    noise : tuple of dict of str to float
        For each record the standard deviations of the noise by channel, in SI units.
    random : tuple of RandomForce
        Random forces on masses.
    sparse : bool
        Whether the records have so few samples a period that a flow over several is far from linear in its start.
    """

    structure: Structure
    frames: tuple[FramedRecord, ...]
    records: Sequence[Record]
    unknowns: tuple[Unknown, ...]
    noise: tuple[dict[str, float], ...]
    random: tuple[RandomForce, ...]
    sparse: bool = False

    @classmethod
    def of(cls, options: LikelihoodOptions, records: Sequence[Record], structure: Structure) -> Problem:
        """The problem that options pose of records and a structure.

        Raises IdentificationError for an error that the records do not show, and for random forces beside integrals.
        """
        frames = tuple(framed(record, structure, integrated=True) for record in records)
        drifting = [name for frame in frames for name in frame.drifting]
        if drifting and options.random:
            raise IdentificationError(
                f"random forces and noise of inputs are not supported beside {drifting[0]}, which is not relative to the "
                "base and shows integrals of its motion, noise of which counts as a drift: leave them out, state shorter "
                "pieces of that (drift), or record the motion relative to the base"
            )
        noise = tuple(channel_noise(frame.record) for frame in frames)
        for error in options.errors:
            if refusal := error.refusal(records):
                raise IdentificationError(refusal, arguments=(error.argument,))
        errors, noisy = with_integrated(options.errors, frames), tuple(zip(frames, noise, strict=True))
        every = (one for error in errors for one in error.unknowns(noisy))
        unknowns = tuple(sorted(every, key=lambda unknown: (unknown.term.block, unknown.record or 0)))
        bounded = with_bounds_for(options.loss, [frame.record for frame in frames])
        return cls(structure, frames, bounded, unknowns, noise, tuple(options.random))

    def of_block(self, block: Block) -> list[Unknown]:
        """The unknowns of one block."""
        return [unknown for unknown in self.unknowns if unknown.term.block is block]

    def channels(self, block: Block) -> list[str]:
        """Those of the unknowns of one block, which have one size each."""
        return [unknown.channel for unknown in self.of_block(block)]

    @property
    def units(self) -> Floats:
        """(o + w + g + l,) units of the unknowns in a search: the noise of the channel, 1 of a gain, and a step of time."""
        of_block = {Block.GAINS: 1.0, Block.DELAYS: self.records[0].step}
        units = [of_block.get(one.term.block, self.noise[0].get(one.channel, 1.0)) for one in self.unknowns]
        return np.repeat(units, [unknown.count for unknown in self.unknowns])

    @property
    def prior(self) -> Prior | None:
        """What is known beforehand of parameters and of the other unknowns; None where nothing is known."""
        parameters = self.structure.parameters
        known = [(0.0 if one.start is None else one.start, one.sigma) for one in parameters]
        known += [pair for unknown in self.unknowns for pair in unknown.known]
        mean, deviation = np.array(known).reshape(-1, 2).T
        prior = Prior(mean, deviation)
        return prior if prior.count else None

    @property
    def samples(self) -> int:
        """Samples in a segment: one with random forces, each of which is constant in a segment, and of sparse samples."""
        return 1 if self.random or self.sparse else SAMPLES

    @property
    def centred(self) -> bool:
        """Whether samples are in the middle of segments: accelerations show ambient forces, as a mean over the time around."""
        record = self.records[0]
        alone = bool(self.random) and not record.inputs
        return alone and any(channel.kind == "a" for channel in record.responses)

    @property
    def sigma(self) -> Floats:
        """(C,) standard deviations of the noise in the first record; those of others are relative to it."""
        return np.array(list(self.noise[0].values()))

    @property
    def stated(self) -> Bools:
        """(C,) whether a record states the noise of a channel."""
        return np.array([any(name in record.noise for record in self.records) for name in self.noise[0]])

    @property
    def lowest(self) -> Floats:
        """(C,) the least deviations of the noise that residuals may show: infinite where a record states it."""
        floors = [noise_floor(record) for record in self.records]
        least = [max(floor[name] for floor in floors) for name in self.noise[0]]
        return np.where(self.stated, np.inf, least)

    def segments(self, system: System, refine: int) -> Segments:
        """The records in segments, by the structure as arrays, with so many steps of the flow per sample."""
        records = self.records
        structure = with_random_forces(self.structure, [force.place for force in self.random])
        require_same_channels(records)
        noise = [np.array(list(own.values())) / self.sigma for own in self.noise[1:]]
        pieces = Cut(records, self.samples, refine)
        segments = cut_segments(pieces, structure, system, noise)
        segments = replace(
            segments,
            sensors=self._sensors(segments.sensors, records[0].responses),
            prior=self.prior,
            errors=self._errors(pieces),
            clipped=None if self.random else segments.clipped,
            centred=self.centred,
        )
        gains, delays = self.channels(Block.GAINS), self.channels(Block.DELAYS)
        late = any(Channel.parse(name).place == BASE for name in delays)
        segments = in_moving_coordinates(segments, pieces, self.frames, late=late)
        return with_uncertain_forces(segments, pieces, structure, gains, delays)

    def _sensors(self, sensors: Sensors, channels: Sequence[Channel]) -> Sensors:
        """The sensors with the numbers of the unknowns that act on each."""
        factors, delays = self.channels(Block.GAINS), self.channels(Block.DELAYS)
        acting = [[float(factor in (name, COMMON)) for factor in factors] for name in channels]
        return replace(
            sensors,
            gain=np.reshape(acting, (len(channels), len(factors))),
            delay=numbers_among(delays, channels),
            offsets=self.offsets,
            delays=len(delays),
        )

    @property
    def offsets(self) -> int:
        """How many sizes are unknown of what sensors add."""
        return sum(unknown.count for unknown in self.of_block(Block.ADDED))

    def _errors(self, pieces: Cut) -> SensorErrors:
        """What sensors add per unit of the unknown sizes: at the samples of all records, or of one."""
        channels, values = list[int](), list[Floats]()
        for unknown in self.of_block(Block.ADDED):
            series = (unknown.in_record(number, len(record)) for number, record in enumerate(self.records))
            values += [*np.nan_to_num(pieces.of(series)).transpose(1, 0, 2)]
            channels += [self.records[0].responses.index(unknown.channel)] * unknown.count
        return SensorErrors(np.array(channels, dtype=int), values)


_OF_FORCE = re.compile(r"\b(N|kg)\b")
_TRIED = np.array([-0.7, -0.2, 0.3, 0.9])  # elongations and rates
_ANY, _FACTOR = 0.5, 2.0  # value of an unknown, and what it is multiplied by


def require_force_scale(
    records: Sequence[Record], structure: Structure, unknown_gains: Sequence[str] = ()
) -> None:
    """Raise IdentificationError where one factor to all masses and coefficients would not change the motion.

    Forces of `unknown_gains`, of which nothing is known, would change with them.
    """
    channels = dict.fromkeys(name for record in records for name in record.channels)
    forces = [name for name in channels if name.kind in ("force", "f")]
    free = {member for parameter in structure.parameters for member in parameter.members}
    told = (
        structure.hosts
        or not set(forces) <= set(unknown_gains)
        or any(parameter.sigma < np.inf for parameter in structure.parameters)
        or not all((-1 - index, MASS) in free for index in range(len(structure.masses)))
        or not all(
            link.law.is_plain and _scales(link, {name for index, name in free if index == number})
            for number, link in enumerate(structure.links)
        )
    )
    if told:
        return
    if not forces:
        raise IdentificationError(NO_FORCE_SCALE)
    raise IdentificationError(
        f"nothing tells the gain of {', '.join(forces)}: every mass and coefficient is unknown, and a larger force on larger "
        "ones makes the same motion. Give one mass or coefficient a number, or state how well the gain is known, by a "
        "calibration",
        arguments=("calibration",),
    )


def _scales(link: Link, free: set[str]) -> bool:
    """Whether the force of a link is proportional to those of its `free` coefficients that have a unit of force or mass."""
    values = {name: _ANY if own.value is None else own.value for name, own in link.coefficients.items()}
    of_force = {name for name in free if _OF_FORCE.search(link.law.units[name])}
    larger = {name: value * _FACTOR if name in of_force else value for name, value in values.items()}
    force, more = (link.law.force(_TRIED, _TRIED[::-1], own) for own in (values, larger))
    return bool(np.allclose(more, _FACTOR * force, rtol=1e-9, atol=0.0))


_FLOW_ERROR = 1e-3  # of the standard deviation of the noise: errors of the steps are systematic over thousands of segments
_TANGENT_ERROR = 0.002  # of a sensitivity over a segment
_MAX_REFINEMENT = 8  # steps per sample
_TESTED_SEGMENTS = 75  # whose residuals decide how fine the steps must be
_TESTED_NUMBERS = 1_000_000  # in the sensitivities that do, with many masses


@dataclass(frozen=True, eq=False)
class ShootingProblem:
    """A multiple-shooting problem.

    Attributes
    ----------
    segments : Segments
        The records in segments.
    start : Iterate
        Starting values.
    scales : Scales
        Units of the unknowns.
    """

    segments: Segments
    start: Iterate
    scales: Scales


def shooting_problem(problem: Problem, theta: Floats, spread: Floats | None) -> ShootingProblem:
    """The multiple-shooting problem of some records.

    Parameters
    ----------
    problem : Problem
        Records and structure, what is unknown of the channels, and their noise.
    theta : array of shape (p,)
        Starting values of the parameters.
    spread : array of shape (p,) or None
        Their standard deviations, where known.

    Returns
    -------
    ShootingProblem
        The problem.

    Raises
    ------
    IdentificationError
        If it needs more memory than is free.
    """
    records, structure = problem.records, problem.structure
    places = [force.place for force in problem.random]
    system = system_with(structure, places, min(record.step for record in records))
    count = sum(-(-len(record) // problem.samples) for record in records)
    require_room(count, structure.size, system.dimension, system.parameters.size)
    keep_freed_memory()
    valued = structure.with_values(dict(zip(system.parameters.names, map(float, theta), strict=True)))
    pairs = zip(records, problem.noise, strict=True)
    starts = [start_states(record, valued, noise, problem.samples) for record, noise in pairs]
    deviations = first_deviations(problem.random, problem.frames[0], valued, starts[0].v)
    unit = np.maximum(np.abs(theta), 0.0 if spread is None else spread)
    if system.shapes is not None:  # which may be small, beside a node
        priors = np.array([parameter.sigma for parameter in structure.parameters])[system.shapes.columns]
        unit[system.shapes.columns] = np.maximum(
            unit[system.shapes.columns], np.where(np.isfinite(priors), priors, 0.0)
        )
    scales = Scales(
        problem.sigma,
        # the record with the least noise needs the tightest flow
        np.append(np.min([start.scale for start in starts], axis=0), deviations),
        np.concatenate([np.where(unit > 0.0, unit, 1.0), problem.units]),
    )
    every = slice(None, None, problem.samples)
    nodes = np.hstack([np.vstack([start.x, start.v, start.memory])[:, every] for start in starts])
    point = Iterate(
        np.concatenate([nodes, np.zeros((len(places), nodes.shape[1]))]),
        np.clip(theta, system.parameters.lower, system.parameters.upper),
        np.zeros(problem.offsets),
        np.ones(len(problem.of_block(Block.GAINS))),
        np.zeros(len(problem.of_block(Block.DELAYS))),
    )
    cut = partial(problem.segments, system)
    segments = _fine_segments(cut, point, scales, least=2 if problem.centred else 1)
    if problem.random:
        segments = replace(segments, random=_random_states(segments, problem, deviations))
    return ShootingProblem(segments, point, scales)


def _random_states(segments: Segments, problem: Problem, deviations: Floats) -> RandomStates:
    """Random forces with `deviations` (r,) in the first record; those of ambient ones follow the rate of each."""
    rate = np.sqrt(problem.records[0].step / (segments.step * segments.refine))
    ambient = np.array([force.ambient for force in problem.random])
    acting = np.stack([_noisy_part(segments, problem.structure, force) for force in problem.random])
    return RandomStates(
        rows=np.arange(segments.system.dimension - len(deviations), segments.system.dimension),
        deviation=deviations[:, None] * np.where(ambient[:, None], rate, acting),
        is_estimated=np.array([force.deviation is None for force in problem.random]),
        absent=np.zeros(len(deviations), dtype=bool),
        varying=ambient & (segments.centred or not (segments.sensors.kind == A).any()),
        shown=shown_directly(problem.random, problem.frames[0]),
    )


def _noisy_part(segments: Segments, structure: Structure, force: RandomForce) -> Floats:
    """(K,) the part of the deviation of a force that acts in each segment: little outside of a force window."""
    if force.ambient or force.of_base or segments.inputs.force is None:
        return np.ones(segments.count)
    acts = segments.inputs.acts(structure.mass_names.index(force.place))[:: segments.refine]
    return np.asarray(np.maximum(np.sqrt(np.mean(acts, axis=0)), _OUTSIDE))


def _fine_segments(
    segments_of: Callable[[int], Segments], point: Iterate, scales: Scales, *, least: int
) -> Segments:
    """The segments in steps that are fine enough, for the flow and for its tangents.

    `segments_of` makes the segments with a number of steps of the flow a sample, of which there are the `least` or more.
    """
    cut = cache(segments_of)
    tests = cache(lambda refine: _tested_flow(cut(refine), point, scales))
    refine = least
    while refine < _MAX_REFINEMENT and not _same_residuals(tests(refine), tests(2 * refine)):
        refine *= 2
    steps = least
    while steps < _MAX_REFINEMENT and not _same_tangents(tests(max(refine, 2 * steps)), steps):
        steps *= 2
    return replace(cut(max(refine, steps)), tangent_refine=steps)


def _tested_flow(segments: Segments, point: Iterate, scales: Scales) -> Misfit:
    """The flow from the nodes of `point` in some of the `segments`, which decide how fine the steps must be."""
    which = np.arange(segments.count)[:: max(1, segments.count // _TESTED_SEGMENTS)]
    some = segments.chosen(which)
    some = replace(some, linked=np.zeros(some.count - 1, dtype=bool))
    return evaluate(some, replace(point, nodes=point.nodes[..., which]), scales, Gaussian())


def _end_sensitivities(misfit: Misfit, steps: int) -> Floats:
    """(2n + S, P, k) of the states at the segments' ends, by tangents in `steps` steps a sample.

    Of many masses, each of which has as many to test, they are those of fewer segments.
    """
    segments, scales, part = replace(misfit.segments, tangent_refine=steps), misfit.scales, slice(None)
    n, links = segments.system.incidence.shape
    if n >= MANY:
        numbers = links * (len(scales.state) + len(scales.theta)) * segments.count
        part = slice(None, None, -(-numbers // _TESTED_NUMBERS))
    orbit, step, inputs = replace(misfit, segments=segments).along_tangents(part)
    unit = scales.theta[: len(misfit.point.theta)]
    for tangent in tangents(misfit.mechanics, orbit, step, scales.state, unit, inputs=inputs):
        ends = tangent
    return ends.ends(1.0 / step) / scales.state[:, None, None]


def _same_residuals(coarse: Misfit, fine: Misfit) -> bool:
    """Whether steps half as long change the residuals by no more than a small part of the noise."""
    change = fine.residuals - coarse.residuals
    size = np.sqrt(np.mean(change[np.isfinite(change)] ** 2))
    return bool(np.isfinite(fine.residuals).all() and size < _FLOW_ERROR)


def _same_tangents(tested: Misfit, steps: int) -> bool:
    """Whether twice as many steps than `steps` a sample change no column of the sensitivities by more than a small part.

    Segments are tied to each other by them: where they are wrong the search creeps, and ends beside the optimum.
    """
    fine = _end_sensitivities(tested, 2 * steps)
    change = fine - _end_sensitivities(tested, steps)
    power, error = np.sum(fine**2, axis=(0, 2)), np.sum(change**2, axis=(0, 2))
    return not bool((error > _TANGENT_ERROR**2 * power).any())
