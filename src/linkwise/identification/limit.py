"""What a planned test can tell at best: the segment Cramer-Rao bound, before anybody measures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Unpack

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.identification.limit_result import Limit
from linkwise.likelihood.fisher_information import Precision, fisher_information
from linkwise.likelihood.segmentation import cut_segments
from linkwise.likelihood.segments import Iterate, Scales
from linkwise.likelihood.system import System
from linkwise.model.excitation import Impulse
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.record import Record
from linkwise.records.synthetic_noise import LARGEST_RATIO
from linkwise.simulation.simulate import ExcitationKeywords, simulate

SEGMENT = 0.25  # s, over which sensitivities of the paper's chaotic chains stay finite (METHODS section 5)
_TURN = 0.25  # radians of the fastest motion in one step of the tangents
_FINEST = 64  # steps a sample at most
_SHORTEST = 8  # steps of a piece between two impulses that is worth a look
_STATE = 1e-6  # of the fastest mass's motion: the unit of a state that never moves


def limit(
    structure: Structure,
    *,
    duration: float,
    rate: float,
    noise: float | Mapping[str, float],
    unknown: Sequence[str] = (),
    sensors: Iterable[str] = ("x",),
    segment: float = SEGMENT,
    progress: Progress = silent,
    **excitation: Unpack[ExcitationKeywords],
) -> Limit:
    """The smallest standard errors that a planned test of `structure`, whose numbers are those expected, can reach.

    The test is that of `simulate`: `duration` in s at `rate` in Hz, seen by `sensors`, driven by `release`, `impulses`,
    `forces`, `base`. `noise` is a signal-to-noise ratio in dB for every channel (METHODS section 2) or standard deviations in
    SI units by channel. `unknown` is what `Structure.unknown` takes ("all", "nes", "nes1.alpha", "mass:m2"); without it the
    unknowns of the structure, at their starts, or every coefficient of its links. `progress` is told the part that is done.

    Raises IdentificationError for unknowns without a number, for noise that does not fit the sensors, and for a test or
    segments too short to tell anything; SimulationError as `simulate` does.
    """
    true, asked = _planned(structure, tuple(unknown))
    sensors = tuple(sensors.split() if isinstance(sensors, str) else sensors)
    record = simulate(
        true, duration=duration, rate=rate, sensors=sensors, progress=part(progress, 0.0, 0.2), **excitation
    )
    sigma = _noise(record, noise)
    samples = _samples(segment, record)
    states = 2 * true.size
    if samples * len(record.responses) <= states:
        whole = samples == len(record)
        piece = f"a test of {record.duration:g} s" if whole else f"a segment of {segment:g} s"
        raise IdentificationError(
            f"{piece} is too short: it holds {samples * len(record.responses)} values of {len(record.responses)} channels, "
            f"no more than the {states} states at its start, and nothing would be left for the laws; sample faster or take "
            f"{'a longer test' if whole else 'longer segments'}"
        )
    fineness = _fineness(record, true)
    fine = record
    if fineness > 1:
        fine = simulate(
            true,
            duration=record.duration,
            rate=rate * fineness,
            sensors=sensors,
            progress=part(progress, 0.2, 0.5),
            **excitation,
        )
    values = np.array([true.coefficient(parameter.name).value for parameter in asked.parameters], dtype=float)
    pieces = _pieces(_thinned(fine, fineness), excitation.get("impulses", ()))
    if not pieces:
        raise IdentificationError(
            f"a test of {record.duration:g} s is too short: between two impulses, and from its start to its end, it needs "
            f"{_SHORTEST / (rate * fineness):.2g} s at {rate:g} Hz"
        )
    progress(ProgressReport(0.5, "sensitivities"))
    told = fisher_information(
        cut_segments(pieces, asked, System.of(asked), samples=samples * fineness, refine=1, offsets=()),
        Iterate(_nodes(pieces, samples * fineness), values, np.zeros(0)),
        Scales(np.array(list(sigma.values())), _units(record), np.where(values == 0.0, 1.0, np.abs(values))),
    )
    return Limit(true, asked.parameters, values, Precision.of(told), sigma, record, segment)


def _planned(structure: Structure, unknown: tuple[str, ...]) -> tuple[Structure, Structure]:
    """The structure with all its numbers, and the same as whoever identifies it will see it."""
    nameless = [parameter.name for parameter in structure.parameters if parameter.start is None]
    if nameless:
        raise IdentificationError(
            f"a test can be planned only around numbers that are expected, and {', '.join(nameless)} has none: write a "
            "number, or { start = ... } for an unknown one"
        )
    true = structure.with_values({p.name: p.start for p in structure.parameters if p.start is not None})
    if unknown:
        return true, structure.unknown(*unknown)
    return true, structure if structure.parameters else structure.unknown("all")


def _noise(record: Record, noise: float | Mapping[str, float]) -> dict[str, float]:
    """Standard deviation by response channel."""
    if isinstance(noise, Mapping):
        lost = [name for name in record.responses if name not in noise]
        extra = [name for name in noise if name not in record.responses]
        wrong = [name for name, sigma in noise.items() if not (np.isfinite(sigma) and sigma > 0.0)]
        if lost or extra:
            raise IdentificationError(
                f"noise must be given for every sensor and no other; {', '.join(lost or extra)} is "
                f"{'missing' if lost else 'no sensor of this test'} ({', '.join(record.responses)})"
            )
        if wrong:
            raise IdentificationError(
                f"the noise of {wrong[0]} is {noise[wrong[0]]!r}; it is a number above 0, in SI units"
            )
        return {name: float(noise[name]) for name in record.responses}
    if not abs(noise) <= LARGEST_RATIO:
        raise IdentificationError(
            f"a signal-to-noise ratio must be within {LARGEST_RATIO:g} dB of zero, got {noise!r} dB"
        )
    power = np.mean(record.select(record.responses).values ** 2, axis=0)
    for name, square in zip(record.responses, power, strict=True):
        if square == 0.0:
            raise IdentificationError(
                f"{name} does not move in this test, so no noise in dB can be had of it: drive the structure, or give the "
                "noise in SI units by channel"
            )
    ratio = 10.0 ** (-float(noise) / 20.0)
    return {
        name: float(np.sqrt(square) * ratio) for name, square in zip(record.responses, power, strict=True)
    }


def _fineness(record: Record, structure: Structure) -> int:
    """Steps a sample, so that the stiffest link turns little in one step of the tangents."""
    truth = record.simulated
    assert truth is not None
    d = structure.elongations(truth.displacement, truth.base)
    base_rate = None if truth.base is None else np.gradient(truth.base, record.step)
    v = structure.elongations(truth.velocity, base_rate)
    masses = dict(zip(structure.mass_names, structure.mass_values, strict=True))
    fastest = 0.0
    for index, link in enumerate(structure.links):
        by_d, by_v = link.tangent(d[:, index], v[:, index])
        yielding = sum(1.0 / masses[end] for end in link.between if end in masses)
        stiffness, damping = (float(np.nanmax(np.abs(slope))) * yielding for slope in (by_d, by_v))
        fastest = max(fastest, np.sqrt(stiffness), damping)
    return int(np.clip(np.ceil(fastest * record.step / _TURN), 1, _FINEST))


def _thinned(record: Record, fineness: int) -> Record:
    """The record with the samples that the sensors do not take missing."""
    values = record.values.copy()
    responses = [record.channels.index(name) for name in record.responses]
    lost = np.arange(len(record)) % fineness != 0
    values[np.ix_(lost, responses)] = np.nan
    return Record(record.start, record.rate, record.channels, values, simulated=record.simulated)


def _samples(segment: float, record: Record) -> int:
    """Samples in a segment, no more than the record has."""
    if not segment > 0.0:
        raise IdentificationError(f"the length of a segment must be positive, got {segment:g} s")
    return max(1, round(min(segment * record.rate, float(len(record)))))


def _pieces(record: Record, impulses: Iterable[Impulse]) -> list[Record]:
    """The record cut after each impulse, across which no flow goes."""
    times = [impulse.time for impulse in impulses]
    after = {int(np.floor(time * record.rate * (1.0 + 1e-12) + 1e-9)) + 1 for time in times}
    edges = [0, *sorted(after), len(record)]
    spans = [(first, last) for first, last in pairwise(edges) if last - first >= _SHORTEST]
    return [record[first:last] for first, last in spans]


def _nodes(pieces: list[Record], samples: int) -> Floats:
    """(2, n, K) the true states at the starts of the segments."""
    starts = []
    for piece in pieces:
        assert piece.simulated is not None
        motion = np.stack([piece.simulated.displacement.T, piece.simulated.velocity.T])
        starts.append(motion[..., ::samples])
    return np.concatenate(starts, axis=2)


def _units(record: Record) -> Floats:
    """(2n,) m and m/s: the root mean square of each state."""
    assert record.simulated is not None
    motion = np.stack([record.simulated.displacement, record.simulated.velocity])
    size = np.sqrt(np.mean(motion**2, axis=1))
    largest = size.max(axis=1, keepdims=True)
    return np.maximum(size, np.where(largest > 0.0, _STATE * largest, 1.0)).ravel()
