"""Records cut into segments: samples by channel, sensors, and inputs at the points of the flow.

Where a base moves and no link ends at the ground, segments are in coordinates that move with it: sensors then show its motion
as well, and every mass carries a force of inertia. Applied forces whose channels have unknown gains or delays become
`UncertainForces`, and so does the acceleration of such coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.delay_polynomials import EDGE, LARGEST, at_delays, powers_through
from linkwise.likelihood.shooting.flow import POINTS, Inputs, UncertainForces
from linkwise.likelihood.shooting.segments import A, ClippedReadings, F, LateBase, S, Segments, Sensors, V, X
from linkwise.likelihood.shooting.system import System
from linkwise.model.structure import FIRST_POINT, Structure
from linkwise.records.channel import BAND_LIMITED, BASE, COMMON, HELD, MOTIONS, Channel, interpolated
from linkwise.records.channel_units import signals_of
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_complete
from linkwise.signals.base_frame import FramedRecord, frame_acceleration
from linkwise.units import base_exponents

_BLOCK = 100_000  # samples of a signal that are interpolated at once
_AROUND = 200  # samples: splines forget what is farther away, to the last digit, and a windowed sinc does not reach it
_KINDS = {"x": X, "v": V, "a": A, "f": F, "state": S}


@dataclass(frozen=True, eq=False)
class Cut:
    """Records in segments of so many `samples`, with `refine` steps of the flow a sample."""

    records: Sequence[Record]
    samples: int
    refine: int

    @cached_property
    def counts(self) -> list[int]:
        """Segments of each record."""
        return [-(-len(record) // self.samples) for record in self.records]

    def of(self, series: Iterable[Floats]) -> Floats:
        """(samples, ..., K) of a series (N, ...) of each record; NaN behind its end."""
        parts = []
        for values, count in zip(series, self.counts, strict=True):
            padded = np.full((count * self.samples, *values.shape[1:]), np.nan)
            padded[: len(values)] = values
            parts.append(padded.reshape(count, self.samples, *values.shape[1:]))
        return np.ascontiguousarray(np.moveaxis(np.concatenate(parts), 0, -1))

    def time(self, number: int, first: int, last: int) -> Floats:
        """(steps, points, segments) in s from the start of a record, of its segments from the first to the last."""
        steps = np.arange(first * self.samples * self.refine, last * self.samples * self.refine)
        points = steps.reshape(last - first, -1).T[:, None, :] + POINTS[None, :, None]
        return np.asarray((self.records[number].step / self.refine) * points)

    def at_points(self, name: str, series: Iterable[Floats], *, derivative: bool = False) -> Floats:
        """(steps, points, K) an input at the points of steps, from a series (N,) of each record, or its rate; held behind the
        last sample, and interpolated as the records state for the channel of a name.
        """
        pieces = [
            self._of_record(number, record.interpolation.get(name, BAND_LIMITED), values, derivative)
            for number, (record, values) in enumerate(zip(self.records, series, strict=True))
        ]
        return np.concatenate(pieces, axis=2) if len(pieces) > 1 else pieces[0]

    def _of_record(self, number: int, kind: str, values: Floats, derivative: bool) -> Floats:
        """That of one record; a long band-limited signal is interpolated block by block, with as many samples around each as
        the interpolation reaches.
        """
        record, count, samples = self.records[number], self.counts[number], self.samples
        result = np.zeros((samples * self.refine, len(POINTS), count))
        if kind == HELD and not derivative:  # which jumps at a sample
            steps = np.arange(count * samples * self.refine).reshape(count, -1)
            result[:] = values[np.minimum(steps.T // self.refine, len(values) - 1)][:, None, :]
        if kind == HELD:
            return result
        end = (len(values) - 1) / record.rate
        size = count if len(values) <= _BLOCK or kind != BAND_LIMITED else _BLOCK // samples
        for first in range(0, count, size):
            last = min(first + size, count)
            begin, behind = max(first * samples - _AROUND, 0), min(last * samples + _AROUND, len(values))
            begin = min(begin, max(behind - _AROUND, 0))  # where little is left behind a block
            signal = interpolated(begin * record.step, record.rate, values[begin:behind], kind)
            time = self.time(number, first, last)
            inside = np.minimum(time, end)
            shown = signal.derivative(inside) if derivative else signal.value(inside)
            result[..., first:last] = np.where(time <= end, shown, 0.0) if derivative else shown
        return result

    def at_delays(self, series: Iterable[Floats]) -> Floats:
        """(P, steps, points, K) coefficients of powers of the delay of an input at the points of steps, constant first.

        Beyond the ends of the record it runs straight on, and stays from the last sample on where no delay counts.
        """
        pieces = []
        for number, (record, values) in enumerate(zip(self.records, series, strict=True)):
            signal = interpolated(0.0, record.rate, values)
            time = np.minimum(self.time(number, 0, self.counts[number]), signal.end)
            pieces.append(at_delays(signal, time, -LARGEST / record.rate))
        return powers_through(np.concatenate(pieces, axis=3))


def cut_segments(pieces: Cut, structure: Structure, system: System, noise: Sequence[Floats] = ()) -> Segments:
    """Records with the same response channels in segments, one record after the other.

    Parameters
    ----------
    pieces : Cut
        The records, and how they are cut.
    structure : Structure
        The structure.
    system : System
        The structure as arrays.
    noise : sequence of array of shape (C,), optional
        For each record behind the first the noise of its channels relative to that in the first.

    Returns
    -------
    Segments
        The segments.

    Raises
    ------
    IdentificationError
        If channels differ between records, inputs have gaps, or a response belongs to no mass.
    """
    records, counts = pieces.records, pieces.counts
    channels = records[0].responses
    _require_known_channels(records, structure, channels)
    data = pieces.of(record.select(channels).values for record in records)
    observed = np.isfinite(data)
    linked = np.ones(sum(counts) - 1, dtype=bool)
    linked[np.cumsum(counts)[:-1] - 1] = (
        False  # between the last segment of a record and the first of the next
    )
    return Segments(
        system=system,
        sensors=sensor_arrays(channels, structure),
        samples=np.where(observed, data, 0.0),
        observed=observed,
        step=np.repeat([record.step / pieces.refine for record in records], counts),
        linked=linked,
        inputs=flow_inputs(pieces, structure),
        refine=pieces.refine,
        relative_noise=np.repeat(np.stack([np.ones(len(channels)), *noise], 1), counts, 1) if noise else None,
        clipped=ClippedReadings.of(records, channels, pieces.of),
    )


def sensor_arrays(channels: Sequence[Channel], structure: Structure) -> Sensors:
    """Kind and mass of channels, of whose errors none is unknown.

    Parameters
    ----------
    channels : sequence of str
        Names of the channels.
    structure : Structure
        The structure.

    Returns
    -------
    Sensors
        The sensors.
    """
    index = _places(structure)
    points = dict.fromkeys(c.place for c in channels if c.is_motion and c.place in structure.points)
    index |= {(kind, name): structure.size + i for i, name in enumerate(points) for kind in MOTIONS}
    return Sensors(
        shapes=np.stack([structure.topology.row(name) for name in points]) if points else None,
        points=np.array([structure.points.index(name) for name in points], dtype=int),
        kind=np.array([_KINDS[channel.kind] for channel in channels]),
        mass=np.array([index[channel.kind, channel.place] for channel in channels]),
        gain=np.empty((len(channels), 0)),
    )


def _places(structure: Structure) -> dict[tuple[str, str], int]:
    """Number of each mass, and positions of links and states in the order of `System`, by kind of channel and name."""
    places = {(kind, name): i for i, name in enumerate(structure.mass_names) for kind in MOTIONS}
    links = [number for _, numbers in structure.topology.by_law for number in numbers.tolist()]
    places |= {("f", structure.links[number].name): i for i, number in enumerate(links)}
    states = [
        f"{structure.links[number].name}.{name}"
        for law, numbers in structure.topology.by_law
        for name in law.states
        for number in numbers.tolist()
    ]
    return places | {("state", name): i for i, name in enumerate(states)}


def require_same_channels(records: Sequence[Record]) -> None:
    """Raise IdentificationError for records that are fitted together and do not have the same channels in the same order."""
    for record in records[1:]:
        if record.responses != records[0].responses or record.inputs != records[0].inputs:
            raise IdentificationError(
                f"records that are fitted together need the same channels in the same order: {', '.join(records[0].channels)} "
                f"in the first, {', '.join(record.channels)} in another; select the common ones with record.select"
            )


def _require_known_channels(
    records: Sequence[Record], structure: Structure, channels: tuple[Channel, ...]
) -> None:
    if not channels:
        raise IdentificationError(
            f"the record has no response, only {', '.join(records[0].channels)}: give a channel x:MASS, v:MASS or a:MASS"
        )
    require_same_channels(records)
    places = _places(structure)
    places |= {(kind, name): structure.size for name in structure.points for kind in MOTIONS}
    unknown = [channel for channel in channels if (channel.kind, channel.place) not in places]
    if unknown:
        owner, kind = ("link or state", unknown[0].kind) if unknown[0].of_link else ("mass", "x")
        available = [name for own, name in places if own == kind]
        raise IdentificationError(
            f"channel {unknown[0]} belongs to no {owner} of the structure, whose "
            f"{'masses' if owner == 'mass' else owner + 's'} are {', '.join(available) or 'none'}"
        )


def require_units_of_states(record: Record, structure: Structure) -> None:
    """Raise IdentificationError for a channel of a state whose stated unit is not of the kind that the state has."""
    laws = {link.name: link.law for link in structure.links}
    for channel in record.channels:
        if channel.kind != "state" or channel not in record.units:
            continue
        unit, state = record.units[channel], channel.state
        expected = laws[channel.link].state_units.get(state, "?") if channel.link in laws else "?"
        if expected != "?" and base_exponents(unit) != base_exponents(expected or "1"):
            raise IdentificationError(
                f"channel {channel} is stated in {unit}, and the state {state} of {channel.link} is in {expected or '1'}: "
                "correct the unit of the channel, or that of the state"
            )


def flow_inputs(pieces: Cut, structure: Structure) -> Inputs:
    """Applied forces, motion of the base and signals at the points of every step, interpolated as the records state.

    Raises IdentificationError if an input has missing samples, or the displacement of the base is needed and not recorded.
    """

    def along(name: str, *, derivative: bool = False) -> Floats:
        series = [record.channel(name) for record in pieces.records]
        for record, values in zip(pieces.records, series, strict=True):
            require_complete(name, values, record.start, record.rate)
        return pieces.at_points(name, series, derivative=derivative)

    size = pieces.samples * pieces.refine, sum(pieces.counts)
    return inputs_along(pieces.records[0], structure, size, along)


def inputs_along(
    record: Record, structure: Structure, size: tuple[int, int], along: Callable[..., Floats]
) -> Inputs:
    """The inputs that a record has, at the points of J steps of K segments, `size` being (J, K).

    `along(name, derivative=False)` gives the values (J, 5, K) of a channel there, or its rates. Raises IdentificationError if
    the displacement of the base is needed and not recorded.
    """
    forced = [
        (structure.topology.row(name), Channel("force", name))
        for name in (*structure.mass_names, *structure.points)
        if f"force:{name}" in record.channels
    ]
    force = base = at_points = None
    uncertain = any(mode.shape_sigma for host in structure.hosts for mode in host.modes)
    if uncertain and any(name.place in structure.points for _, name in forced):
        at_points = np.zeros((size[0], len(POINTS), len(structure.points), size[1]))
    if forced:
        force = np.zeros((size[0], len(POINTS), structure.size, size[1]))
        for row, name in forced:
            values = along(name)
            for mass in np.flatnonzero(row).tolist():
                force[:, :, mass] += row[mass] * values
            if at_points is not None and name.place in structure.points:
                at_points[:, :, structure.points.index(name.place)] = values
    if np.any(structure.base_incidence):
        if "x:base" not in record.channels:
            has = [name for name in record.inputs if name.endswith(":base")]
            advice = (
                f"; {has[0]} determines it only up to drift: integrate it, remove the drift, and"
                if has
                else ":"
            )
            raise IdentificationError(
                f"a link ends at the base, whose displacement the record lacks{advice} give a channel x:base"
            )
        motion = np.stack([along("x:base"), along("x:base", derivative=True)], axis=2)
        base = motion if motion.any() else None
    signals = {name: along(Channel("signal", name)) for name in signals_of(record, structure)}
    return Inputs(force, base, points=at_points, signals=signals)


def in_moving_coordinates(
    segments: Segments, pieces: Cut, frames: Sequence[FramedRecord], *, late: bool = False
) -> Segments:
    """Add to segments of records in coordinates that move what their sensors show of that, and its acceleration.

    Parameters
    ----------
    segments : Segments
        The segments of all records.
    pieces : Cut
        How these are cut.
    frames : sequence of FramedRecord
        The records.
    late : bool, optional
        Whether the record of the coordinates' motion has an unknown delay, so that all sensors show it late.

    Returns
    -------
    Segments
        The segments; the same where no coordinates move.
    """
    accelerations = [frame.acceleration for frame in frames if frame.acceleration is not None]
    frame = pieces.at_points("", accelerations) if accelerations else None
    segments = replace(segments, inputs=replace(segments.inputs, frame=frame))
    if not any(frame.carried for frame in frames):
        return segments
    carried = [np.nan_to_num(pieces.of(_carried(frame, rate) for frame in frames)) for rate in (0, 1)]
    segments = replace(segments, carried=carried)
    which = np.arange(len(segments.sensors.kind)) if late else segments.sensors.late
    if not len(which):
        return segments
    base, inside = _late_base(segments, pieces, frames, which)
    observed = segments.observed & inside
    samples = np.where(observed, segments.samples, 0.0)
    return replace(segments, observed=observed, samples=samples, clipped=None, late_base=base)


def _carried(frame: FramedRecord, rate: int) -> Floats:
    """(N, C) what the sensors show of moving coordinates, or the rate of that."""
    nothing = np.zeros((2, len(frame.record)))
    return np.stack([frame.carried.get(name, nothing)[rate] for name in frame.names.values()], axis=1)


def _late_base(
    segments: Segments, pieces: Cut, frames: Sequence[FramedRecord], late: Indices
) -> tuple[LateBase, Bools]:
    """What late sensors show of moving coordinates, and (M, C, K) where the record of the base reaches far enough for it."""
    delayed, inside = [], []
    for frame in frames:
        rate, time = frame.record.rate, np.arange(len(frame.record)) / frame.record.rate
        signals = (interpolated(0.0, rate, values) for values in _carried(frame, 0).T[late])
        shown = [at_delays(signal, time, LARGEST / rate).T for signal in signals]
        delayed.append(np.stack(shown, axis=1))  # (N, L, P)
        reaches = np.ones((len(frame.record), len(frame.names)))
        for channel in late.tolist():
            if list(frame.names.values())[channel] in frame.carried:
                reaches[:EDGE, channel] = reaches[-EDGE:, channel] = 0.0
        inside.append(reaches)
    through = np.moveaxis(np.nan_to_num(pieces.of(delayed)), 2, 0)
    base = LateBase(tuple(late.tolist()), powers_through(through), segments.step * segments.refine)
    return base, np.nan_to_num(pieces.of(inside)) > 0.0


def with_uncertain_forces(
    segments: Segments, pieces: Cut, structure: Structure, gains: Sequence[str], delays: Sequence[str]
) -> Segments:
    """Add to segments the applied forces of which a gain or a delay is among the unknowns.

    Parameters
    ----------
    segments : Segments
        The segments of all records.
    pieces : Cut
        The records, in the coordinates of the equations, and how they are cut.
    structure : Structure
        The structure.
    gains, delays : sequence of str
        Channels with an unknown gain or delay, of sensors and of forces, in the order of the unknowns.

    Returns
    -------
    Segments
        The segments; the same where no channel of a force is among these.

    Raises
    ------
    IdentificationError
        If a force with an unknown delay is not band-limited between its samples.
    """
    channels = tuple(
        channel
        for channel in dict.fromkeys(Channel.parse(name) for name in (*gains, *delays) if name != COMMON)
        if channel.is_input
    )
    if not channels:
        return segments
    shown = [_shown(segments, pieces, structure, name, name in delays) for name in channels]
    coefficients = np.zeros((max(map(len, shown)), *shown[0][0].shape[:2], len(shown), segments.count))
    for number, own in enumerate(shown):
        coefficients[: len(own), :, :, number] = own
    places = [channel.place for channel in channels]
    points = numbers_among(structure.points, places)
    ends = np.where(points >= 0, FIRST_POINT - points, numbers_among(structure.mass_names, places))
    of_base = np.array([name == BASE for name in places])
    inertia, topology = -segments.system.parameters.stated_masses, structure.topology
    assert segments.inputs.force is not None
    uncertain = UncertainForces(
        channels=channels,
        ends=np.where(of_base, FIRST_POINT - len(structure.points), ends),
        rows=np.array([inertia if name == BASE else topology.row(name) for name in places]),
        points=points,
        gains=numbers_among(gains, channels),
        delays=numbers_among(delays, channels),
        certain=np.zeros_like(segments.inputs.force),
        coefficients=[*coefficients],
        unit=LARGEST * segments.step * segments.refine,
    )
    nothing = np.zeros(len(delays))
    of_these = uncertain.on_masses(uncertain.acting(np.ones(len(gains)), nothing)[0])
    uncertain = replace(uncertain, certain=segments.inputs.force - of_these)
    return replace(segments, inputs=replace(segments.inputs, uncertain=uncertain))


def numbers_among(known: Sequence[str], names: Sequence[str]) -> Indices:
    """The places of names among those that are known, -1 of others."""
    return np.array([known.index(name) if name in known else -1 for name in names], dtype=int)


def _shown(segments: Segments, pieces: Cut, structure: Structure, name: Channel, late: bool) -> Floats:
    """(1, J, 5, K) what a channel shows, less forces of inertia, or the acceleration of moving coordinates, at the points of
    every step; where late, powers of the delay. IdentificationError for a base whose acceleration is not that, and for a late
    channel that is not band-limited.
    """
    series = []
    for record in pieces.records:
        acceleration = frame_acceleration(record)
        if name.place == BASE and acceleration is None:
            raise IdentificationError(
                f"no gain or delay of {name} can be estimated: the equations take no acceleration from it, as it moves no "
                "link or its displacement is recorded. Record its acceleration alone, or leave its gain and delay out"
            )
        kind = record.interpolation.get(name, BAND_LIMITED)
        if late and kind != BAND_LIMITED:
            raise IdentificationError(
                f"no delay of {name}, which is {kind} between its samples, can be estimated beside other inputs: state it as "
                "band-limited if it is, or take the delay out (without_delays)"
            )
        values = record.channel(f"a:{BASE}" if name.place == BASE else name)
        if acceleration is not None and name.place in structure.mass_names:
            number = structure.mass_names.index(name.place)
            values = values + segments.system.parameters.stated_masses[number] * acceleration
        series.append(values)
    return pieces.at_delays(series) if late else pieces.at_points(name, series)[None]
