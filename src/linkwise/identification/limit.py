"""The precision that a planned test allows: the Cramer-Rao bound of segments as long as their sensitivities are resolved."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import pairwise
from typing import Unpack

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, expect
from linkwise.expression import symbols
from linkwise.identification.limit_result import Limit, true_path
from linkwise.likelihood.fisher_information import Precision, RandomInputs, fisher_information
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.residuals import Gaussian, evaluate
from linkwise.likelihood.shooting.segmentation import Cut, cut_segments
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.likelihood.tests.columns import FittedMotion
from linkwise.model.excitation import Impulse
from linkwise.model.named_laws import LAG
from linkwise.model.structure import Structure, refuse_rig
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.channel import BASE
from linkwise.records.record import LARGEST_RATIO, Record
from linkwise.simulation.simulate import ExcitationKeywords, simulate

SHORTEST = 0.25  # s, over which sensitivities of the paper's chaotic chains stay finite (METHODS section 5)
_MOST_SEGMENT_STEPS = 50_000  # of the sensitivities, one after the other, in a segment that is not asked for
_NUMBERS = 10_000_000  # in the sensitivities of such a segment
# ratio of standard errors; those of longer segments are smaller, but for what is lost of digits
_WORSE = 1.02

Bound = Callable[[int], Precision | None]
"""The bound with segments of so many samples; None where sensitivities grow beyond all numbers."""


def longest_resolved(record: Record, least: int, refinement: int, bound: Bound) -> tuple[Precision, int]:
    """The bound with the longest segments that keep its digits, and their samples, no fewer than `least`.

    In chaotic motion sensitivities grow until the start of a segment cannot be told from a coefficient; a longer segment then
    seems to determine less than its two halves do.
    """
    lengths = _segment_lengths(record, least)
    length, precision = lengths[0], _of_the_shortest(record, lengths[0], bound)
    unknowns = len(precision.scale) + least * len(record.responses)
    for longer in lengths[1:]:
        steps = longer * refinement
        if steps > _MOST_SEGMENT_STEPS or longer * len(record.responses) * unknowns > _NUMBERS:
            break
        attempt = bound(longer)
        if attempt is None or _has_lost_digits(attempt, precision):
            break
        length, precision = longer, attempt
    return precision, length


def as_asked(record: Record, samples: int, least: int, bound: Bound) -> Precision:
    """The bound with segments of so many samples; IdentificationError if they determine less than the shortest do."""
    precision, shortest = bound(samples), _segment_lengths(record, least)[0]
    if precision is not None and (samples <= shortest or not precision.null_directions.shape[1]):
        return precision
    before = _of_the_shortest(record, min(samples, shortest), bound)
    if precision is None or _has_lost_digits(precision, before):
        raise IdentificationError(
            f"segments of {samples * record.step:g} s are too long: in chaotic motion sensitivities grow beyond the digits "
            f"of a computer, and what segments of {shortest * record.step:g} s determine would not be identifiable; take "
            "shorter segments, or none, for the longest that are resolved",
            arguments=("segment",),
        )
    return precision


def _of_the_shortest(record: Record, samples: int, bound: Bound) -> Precision:
    """The bound with the shortest segments there are; IdentificationError where sensitivities overflow even there."""
    precision = bound(samples)
    if precision is None:
        raise IdentificationError(
            f"sensitivities grow beyond all numbers within {samples * record.step:g} s: {record.rate:g} Hz are too few for "
            "the fastest motion of this structure; sample faster",
            arguments=("rate",),
        )
    return precision


def _segment_lengths(record: Record, least: int) -> list[int]:
    """Samples of segments: 0.25 s, but at least `least`, then twice as many and so on, and at last the whole record."""
    lengths = [max(least, round(SHORTEST / record.step))]
    while lengths[-1] < len(record):
        lengths.append(2 * lengths[-1])
    return [*lengths[:-1], len(record)]


def _has_lost_digits(longer: Precision, shorter: Precision) -> bool:
    """Whether longer segments determine fewer combinations, or anything less precisely."""
    if longer.null_directions.shape[1] > shorter.null_directions.shape[1]:
        return True
    unit = np.eye(len(longer.scale))
    errors, before = (np.sqrt(precision.variance(unit)) for precision in (longer, shorter))
    return bool((errors > _WORSE * before).any())


_LARGEST_PHASE = 0.25  # rad of the fastest motion in one step of the sensitivities
_MOST_STEPS = 64  # of the sensitivities between two samples
_SHORTEST = 8  # steps of a piece between two impulses that is used
_NOISY = 500  # samples of a segment beside noise of inputs that act in more, of which each sample is one more unknown
_ROUNDED = 1e-12  # of the largest force: less is none, as between hits
_STATE = 1e-6  # of the motion of the fastest mass: the unit of a state at rest


def limit(
    structure: Structure,
    *,
    duration: float,
    rate: float,
    noise: float | Mapping[str, float],
    unknown: Sequence[str] = (),
    sensors: Iterable[str] = ("x",),
    segment: float | None = None,
    progress: Progress = silent,
    **excitation: Unpack[ExcitationKeywords],
) -> Limit:
    """Compute the smallest standard errors that a planned test of a structure can reach.

    Parameters
    ----------
    structure : Structure
        The structure with the numbers that are expected, or starts.
    duration, rate : float
        Length of the test in s and samples per second in Hz.
    noise : float or mapping of str to float
        A signal-to-noise ratio in dB for every sensor (METHODS section 2), or standard deviations by channel, in SI units: of
        every sensor, and of inputs that are recorded with noise, such as ``"force:m1"``, ``"x:base"`` or ``"signal:u"``.
    unknown : sequence of str
        What is to be identified, as `Structure.unknown` takes it: "all", "nes", "nes1.alpha", "mass:m2". By default the
        unknowns of the structure, or every coefficient of its links if there are none.
    sensors : iterable of str
        What is measured: kinds ("x", "v", "a") or channels ("x:m1").
    segment : float, optional
        Length in s of the segments, each with a free start, that the bound is computed for. By default the whole record, or
        the longest of its halves, quarters and so on over which the sensitivities of chaotic motion are resolved.
    progress : Progress
        Called with a `ProgressReport` at every step.
    **excitation
        `release`, `impulses`, `forces`, `base` and `signals`, as in `simulate`.

    Returns
    -------
    Limit
        The smallest standard errors of the unknowns, the forces and the wells, and what the sensors do not determine.

    Raises
    ------
    IdentificationError
        If an unknown has no number, the noise does not fit the sensors, or the test or its segments are too short.
    SimulationError
        As `simulate`.
    TypeError
        If `structure` is no `Structure`.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> planned = lw.limit(chain, duration=0.5, rate=1000.0, noise=40.0, unknown=["nes"], release={"v:m1": 1.0})
    >>> alpha = planned.coefficient("nes1.alpha")
    >>> alpha.value, bool(alpha.standard_error < 1.0)
    (-100.0, True)
    """
    expect("limit(structure): structure", structure, Structure)
    true, unknown_structure = _true_and_unknown(structure, tuple(unknown))
    sensors = tuple(sensors.split() if isinstance(sensors, str) else sensors)
    test = partial(simulate, true, sensors=sensors, **excitation)
    record = test(duration=duration, rate=rate, progress=part(progress, 0.0, 0.2))
    of_inputs = _noise_of_inputs(record, true, noise if isinstance(noise, Mapping) else {})
    sigma = _sensor_noise(record, noise)
    states = System.of(true).dimension
    least = states // max(1, len(record.responses)) + 1
    samples = len(record) if segment is None else _segment_samples(segment, record)
    _require_values(record, samples, states)
    refinement = _refinement(record, true)
    fine = record
    if refinement > 1:
        fine = test(duration=record.duration, rate=rate * refinement, progress=part(progress, 0.2, 0.5))
    values = np.array([true.coefficient(p.name).value for p in unknown_structure.parameters], dtype=float)
    pieces = _between_impulses(_on_samples(fine, refinement), excitation.get("impulses", ()))
    if not pieces:
        raise IdentificationError(
            f"a test of {record.duration:g} s is too short: between two impulses, and from its start to its end, it needs "
            f"{_SHORTEST / (rate * refinement):.2g} s at {rate:g} Hz"
        )
    progress(ProgressReport(0.5, "sensitivities"))
    system = System.of(unknown_structure, lag=LAG * record.step)
    names = [f"{true.links[index].name}.{state}" for index, state in system.states]
    known = np.array([parameter.sigma for parameter in unknown_structure.parameters])
    units = np.where(values == 0.0, 1.0, np.abs(values))
    scales = Scales(np.array(list(sigma.values())), _state_units(record, names), units)

    def bound(count: int, of_inputs: Mapping[str, float] | None = None) -> Precision | None:
        steps = count * refinement
        segments = cut_segments(Cut(pieces, steps, 1), unknown_structure, system)
        point = Iterate(_true_nodes(pieces, steps, names), values, np.zeros(0))
        random = _random_inputs(segments, point, scales, true, of_inputs, refinement) if of_inputs else None
        with np.errstate(over="ignore", invalid="ignore"):
            information = fisher_information(segments, point, scales, random).with_prior(known)
        return information.precision if np.isfinite(information.fisher).all() else None

    if segment is None:
        precision, samples = longest_resolved(record, least, refinement, bound)
    else:
        precision = as_asked(record, samples, least, bound)
    if of_inputs:
        many = segment is None and max(_acting(record, name) for name in of_inputs) > _NOISY
        samples = min(samples, _NOISY) if many else samples
        precision = bound(samples, of_inputs) or precision
    length = samples * record.step if segment is None else segment
    return Limit(true, unknown_structure.parameters, values, precision, sigma, record, length)


def _true_and_unknown(structure: Structure, unknown: tuple[str, ...]) -> tuple[Structure, Structure]:
    """The structure with all its numbers, and the same with its unknowns."""
    refuse_rig(structure, "limits of accuracy")
    without_number = [parameter.name for parameter in structure.parameters if parameter.start is None]
    if without_number:
        raise IdentificationError(
            f"a test can be planned only around numbers that are expected, which {', '.join(without_number)} lack"
            f"{'s' if len(without_number) == 1 else ''}: write a number, or {{ start = ... }} for an unknown one"
        )
    true = structure.with_values({p.name: p.start for p in structure.parameters if p.start is not None})
    if unknown:
        return true, structure.unknown(*unknown)
    return true, structure if structure.parameters else structure.unknown("all")


def _sensor_noise(record: Record, noise: float | Mapping[str, float]) -> dict[str, float]:
    """Standard deviation by response channel."""
    if isinstance(noise, Mapping):
        missing = [name for name in record.responses if name not in noise]
        extra = [name for name in noise if name not in record.channels]
        wrong = [name for name, sigma in noise.items() if not (np.isfinite(sigma) and sigma > 0.0)]
        if missing or extra:
            raise IdentificationError(
                f"noise must be given for every sensor and no other; {', '.join(missing or extra)} is "
                f"{'missing' if missing else 'not a sensor of this test'} ({', '.join(record.responses)})"
            )
        if wrong:
            raise IdentificationError(
                f"the noise of {wrong[0]} is {noise[wrong[0]]!r}; it must be a positive number, in SI units"
            )
        return {name: float(noise[name]) for name in record.responses}
    if not abs(noise) <= LARGEST_RATIO:
        message = f"a signal-to-noise ratio must be within {LARGEST_RATIO:g} dB of zero, got {noise!r} dB"
        raise IdentificationError(message)
    power = np.mean(record.select(record.responses).values ** 2, axis=0)
    squares = dict(zip(record.responses, power.tolist(), strict=True))
    for name, square in squares.items():
        if square == 0.0:
            raise IdentificationError(
                f"{name} does not move in this test, so a noise level in dB is not defined for it: drive the structure, or "
                "give the noise in SI units by channel"
            )
    ratio = 10.0 ** (-float(noise) / 20.0)
    return {name: math.sqrt(square) * ratio for name, square in squares.items()}


def _require_values(record: Record, samples: int, states: int) -> None:
    """Raise IdentificationError if a segment of so many samples holds no more values than states at its start."""
    channels = len(record.responses)
    if samples * channels > states:
        return
    whole = samples == len(record)
    piece = f"a test of {record.duration:g} s" if whole else f"a segment of {samples * record.step:g} s"
    raise IdentificationError(
        f"{piece} is too short: it holds {samples * channels} values of {channels} channels, no more than the {states} states "
        f"at its start, and nothing would be left for the laws; sample faster or take "
        f"{'a longer test' if whole else 'longer segments'}"
    )


def _refinement(record: Record, structure: Structure) -> int:
    """Steps per sample, so that the phase of the fastest motion grows little in one step of the sensitivities."""
    masses, columns = structure.mass_values, structure.topology.columns
    fastest = 0.0
    for index, link in enumerate(structure.links):
        slopes = true_path(link, index, record).slopes()  # (N, 1 + S, 2 + S)
        # held by states, too
        stiffness = slopes[:, 0, 0] + np.sum(slopes[:, 0, 2:] * slopes[:, 1:, 1], axis=1)
        mobility = sum(part**2 / masses[mass] for mass, part in columns[index])
        fast, damping = (float(np.nanmax(np.abs(slope))) * mobility for slope in (stiffness, slopes[:, 0, 1]))
        decay = float(np.nanmax(np.abs(slopes[:, 1:, 2:]), initial=0.0))
        fastest = max(fastest, np.sqrt(fast), damping, decay)
    return int(np.clip(np.ceil(fastest * record.step / _LARGEST_PHASE), 1, _MOST_STEPS))


def _on_samples(record: Record, refinement: int) -> Record:
    """A refined record with values only at the samples that the sensors take."""
    values = record.values.copy()
    responses = [record.channels.index(name) for name in record.responses]
    between = np.arange(len(record)) % refinement != 0
    values[np.ix_(between, responses)] = np.nan
    return replace(record, values=values)


def _segment_samples(segment: float, record: Record) -> int:
    """Samples in a segment, no more than the record has."""
    if not segment > 0.0:
        raise IdentificationError(f"the length of a segment must be positive, got {segment:g} s")
    return max(1, round(min(segment * record.rate, float(len(record)))))


def _between_impulses(record: Record, impulses: Iterable[Impulse]) -> list[Record]:
    """The record cut after each impulse, where velocities jump."""
    times = [impulse.time for impulse in impulses]
    after = {int(np.floor(time * record.rate * (1.0 + 1e-12) + 1e-9)) + 1 for time in times}
    edges = pairwise([0, *sorted(after), len(record)])
    return [record[first:last] for first, last in edges if last - first >= _SHORTEST]


def _true_nodes(pieces: list[Record], samples: int, states: Sequence[str]) -> Floats:
    """(2n + S, K) the true states at the starts of the segments; `states` are those of links by full name."""
    starts = []
    for piece in pieces:
        truth = piece.simulated
        assert truth is not None
        rows = [*truth.displacement.T, *truth.velocity.T, *(truth.states[name] for name in states)]
        starts.append(np.stack(rows)[:, ::samples])
    return np.concatenate(starts, axis=1)


def _state_units(record: Record, states: Sequence[str]) -> Floats:
    """(2n + S,) m, m/s and units of states: the root mean square of each."""
    truth = record.simulated
    assert truth is not None
    motion = np.stack([truth.displacement, truth.velocity])
    size = np.sqrt(np.mean(motion**2, axis=1))
    largest = size.max(axis=1, keepdims=True)
    moving = np.maximum(size, np.where(largest > 0.0, _STATE * largest, 1.0)).ravel()
    inside = np.array([np.sqrt(np.mean(truth.states[name] ** 2)) for name in states])
    return np.concatenate([moving, np.where(inside > 0.0, inside, 1.0)])


def _noise_of_inputs(record: Record, structure: Structure, noise: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of the noise of the inputs among those of all channels.

    Raises IdentificationError for an input of which it cannot be allowed for.
    """
    stated = {name: float(sigma) for name, sigma in noise.items() if name in record.inputs}
    of_rates = {
        f"signal:{name}"
        for link in structure.links
        for _, rate in link.law.named_rates
        for name in link.law.signals
        if name in symbols(rate)
    }
    for name in stated:
        if name in of_rates or (name.endswith(f":{BASE}") and name != f"x:{BASE}"):
            raise IdentificationError(
                f"noise of {name} is not allowed for in limits of accuracy: that of forces, of x:{BASE} and of signals "
                "in forces of links is"
            )
    return stated


def _acting(record: Record, channel: str) -> int:
    """The samples in which an input has noise: of a force those in which it acts."""
    size = np.abs(record.channel(channel))
    is_force = channel.startswith("force:")
    return int(np.count_nonzero(size > _ROUNDED * size.max())) if is_force else len(record)


def _random_inputs(
    segments: Segments,
    point: Iterate,
    scales: Scales,
    structure: Structure,
    noise: Mapping[str, float],
    refinement: int,
) -> RandomInputs:
    """The forces on masses by the noise of the inputs, normal and below half the sampling rate, to the first order.

    Parameters
    ----------
    segments : Segments
        The test in segments, `refinement` steps of the flow a sample.
    point : Iterate
        The states and values that are expected.
    scales : Scales
        Units of the unknowns.
    structure : Structure
        The structure with its unknowns.
    noise : mapping of str to float
        Standard deviations of samples of the inputs, in SI units.
    refinement : int
        Steps in a sample.

    Returns
    -------
    RandomInputs
        Those, with an amplitude for each sample of each input.
    """
    misfit = evaluate(segments, point, scales, Gaussian())
    motion = FittedMotion(Optimum(misfit, 0.0, 1.0), structure)
    every, sums, steps = [], [], 2 * refinement // segments.flow_steps_per_tangent
    for name, sigma in noise.items():
        pulls = _pulls(motion, structure, name)  # (2 J + 1, n, K)
        masses, places = np.flatnonzero(np.any(pulls, axis=(0, 2))), np.arange(len(pulls))
        samples = places[::steps][np.any(pulls[::steps], axis=(1, 2))]
        shapes = sigma * np.sinc((places[:, None] - samples) / steps)  # (2 J + 1, d)
        forces = [
            (pulls[:, mass] * shape[:, None]).astype(np.float32) for mass in masses for shape in shapes.T
        ]
        acting = np.repeat(masses, len(samples))
        every.append(CandidateForces(np.full(len(acting), -1), acting, forces))
        sums.append(np.tile(np.eye(len(samples)), (len(masses), 1)))
    return RandomInputs(reduce(CandidateForces.joined, every), scipy.linalg.block_diag(*sums))


def _pulls(motion: FittedMotion, structure: Structure, channel: str) -> Floats:
    """(2 J + 1, n, K) forces on the masses in N by an error of one of an input; of hits none between these."""
    kind, _, place = channel.partition(":")
    incidence = motion.segments.system.incidence
    if kind == "force":
        number = structure.mass_names.index(place)
        acts = motion.segments.inputs.acts(number)
        halves = np.arange(2 * len(acts) // motion.segments.flow_steps_per_tangent + 1)
        begun = np.minimum(halves * motion.segments.flow_steps_per_tangent // 2, len(acts) - 1)
        return np.asarray(acts[begun][:, None] * np.eye(structure.size)[number][:, None])
    if kind == "signal":
        d, v, inside = motion.links
        number = len(motion.segments.system.states) + list(structure.signals).index(place)
        along = zip(d, v, inside, strict=True)
        by_input = np.stack([motion.mechanics.by_signal(number, *point) for point in along])
    else:
        by_input = motion.segments.system.base[:, None] * motion.slopes[0]
    return np.asarray(-np.einsum("nl,jlk->jnk", incidence, by_input))
