"""Records cut into segments: samples by channel, sensors, and inputs at the points of the flow.

Where a base moves and no link ends at the ground, segments are in coordinates that move with it: sensors then show its motion
as well, and every mass carries a force of inertia. Applied forces whose channels have unknown gains or delays become
`UncertainForces`, and so does the acceleration of such coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from linkwise.arrays import Bools, Floats
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


def cut_segments(
    records: Sequence[Record],
    structure: Structure,
    system: System,
    *,
    samples: int,
    refine: int,
    noise: Sequence[Floats] = (),
) -> Segments:
    """Cut records with the same response channels into segments, one record after the other.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    system : System
        The structure as arrays.
    samples : int
        Samples in a segment.
    refine : int
        Steps of the flow per sample.
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
    channels = records[0].responses
    _require_known_channels(records, structure, channels)
    parts = [cut(record.select(channels).values, samples) for record in records]
    counts = [part.shape[2] for part in parts]
    data = np.concatenate(parts, axis=2)
    observed = np.isfinite(data)
    step = np.repeat([record.step / refine for record in records], counts)
    return Segments(
        system=system,
        sensors=sensor_arrays(channels, structure),
        samples=np.where(observed, data, 0.0),
        observed=observed,
        step=step,
        linked=_linked(counts),
        inputs=flow_inputs(records, structure, counts, samples=samples, refine=refine),
        refine=refine,
        relative_noise=np.repeat(np.stack([np.ones(len(channels)), *noise], 1), counts, 1) if noise else None,
        clipped=ClippedReadings.of(records, channels, partial(cut, samples=samples)),
    )


def _linked(counts: Sequence[int]) -> Bools:
    """(K - 1,) False between the last segment of a record and the first of the next."""
    linked = np.ones(sum(counts) - 1, dtype=bool)
    linked[np.cumsum(counts)[:-1] - 1] = False
    return linked


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


def cut(values: Floats, samples: int) -> Floats:
    """Cut series into segments.

    Parameters
    ----------
    values : array of shape (N, C)
        The series.
    samples : int
        Samples in a segment.

    Returns
    -------
    array of shape (samples, C, K)
        The segments; NaN behind the end of the series.
    """
    count = -(-len(values) // samples)
    padded = np.full((count * samples, values.shape[1]), np.nan)
    padded[: len(values)] = values
    return np.ascontiguousarray(padded.reshape(count, samples, values.shape[1]).transpose(1, 2, 0))


def flow_inputs(
    records: Sequence[Record], structure: Structure, counts: Sequence[int], *, samples: int, refine: int
) -> Inputs:
    """Applied forces, motion of the base and signals at the points of every step, interpolated as the records state.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    counts : sequence of int
        Number of segments of each record.
    samples : int
        Samples in a segment.
    refine : int
        Steps of the flow per sample.

    Returns
    -------
    Inputs
        The inputs.

    Raises
    ------
    IdentificationError
        If an input has missing samples, or the displacement of the base is needed and not recorded.
    """
    grid = samples, refine

    def along(name: str, *, derivative: bool = False) -> Floats:
        pieces = []
        for record, count in zip(records, counts, strict=True):
            values, kind = record.channel(name), record.interpolation.get(name, BAND_LIMITED)
            require_complete(name, values, record.start, record.rate)
            pieces.append(value_at_points(record, values, count, grid, kind, derivative=derivative))
        return np.concatenate(pieces, axis=2) if len(pieces) > 1 else pieces[0]

    return inputs_along(records[0], structure, (samples * refine, sum(counts)), along)


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
    force = base = None
    at_points = forces_at_points(structure, [name.place for _, name in forced], size)
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


def forces_at_points(structure: Structure, places: Sequence[str], size: tuple[int, int]) -> Floats | None:
    """Room (J, 5, k, K) for forces on the k points of hosts, `size` being (J, K); None where `channels` or shapes need none.

    Parameters
    ----------
    structure : Structure
        The structure.
    places : sequence of str
        Where forces are applied.
    size : tuple of int
        Number of steps, and of segments.

    Returns
    -------
    array or None
        Zeros.
    """
    uncertain = any(mode.shape_sigma for host in structure.hosts for mode in host.modes)
    if not uncertain or not any(name in structure.points for name in places):
        return None
    return np.zeros((size[0], len(POINTS), len(structure.points), size[1]))


def value_at_points(
    record: Record,
    values: Floats,
    count: int,
    grid: tuple[int, int],
    kind: str = BAND_LIMITED,
    *,
    derivative: bool = False,
) -> Floats:
    """(steps, points, segments) an input at the points of steps, held behind the last sample, or its rate.

    `grid` are the samples in a segment and the steps in a sample. A long band-limited signal is interpolated block by block,
    with as many samples around each as the interpolation reaches.
    """
    samples, refine = grid
    result = np.zeros((samples * refine, len(POINTS), count))
    if kind == HELD and not derivative:  # which jumps at a sample
        steps = np.arange(count * samples * refine).reshape(count, samples * refine)
        result[:] = values[np.minimum(steps.T // refine, len(values) - 1)][:, None, :]
    if kind == HELD:
        return result
    end_of_signal = record.start + (len(values) - 1) / record.rate
    size = count if len(values) <= _BLOCK or kind != BAND_LIMITED else _BLOCK // samples
    for first in range(0, count, size):
        last = min(first + size, count)
        begin, end = max(first * samples - _AROUND, 0), min(last * samples + _AROUND, len(values))
        begin = min(begin, max(end - _AROUND, 0))  # where little is left behind a block
        signal = interpolated(record.start + begin * record.step, record.rate, values[begin:end], kind)
        steps = np.arange(first * samples * refine, last * samples * refine).reshape(last - first, -1)
        time = record.start + record.step / refine * (steps.T[:, None, :] + POINTS[None, :, None])
        inside = np.minimum(time, end_of_signal)
        shown = signal.derivative(inside) if derivative else signal.value(inside)
        result[..., first:last] = np.where(time <= end_of_signal, shown, 0.0) if derivative else shown
    return result


def in_moving_coordinates(
    segments: Segments, frames: Sequence[FramedRecord], *, late: bool = False
) -> Segments:
    """Add to segments of records in coordinates that move what their sensors show of that, and its acceleration.

    Parameters
    ----------
    segments : Segments
        The segments of all records.
    frames : sequence of FramedRecord
        The records.
    late : bool, optional
        Whether the record of the coordinates' motion has an unknown delay, so that all sensors show it late.

    Returns
    -------
    Segments
        The segments; the same where no coordinates move.
    """
    samples, refine = len(segments.samples), segments.refine
    accelerations = [
        value_at_points(frame.record, frame.acceleration, -(-len(frame.record) // samples), (samples, refine))
        for frame in frames
        if frame.acceleration is not None
    ]
    frame = np.concatenate(accelerations, axis=2) if accelerations else None
    inputs = replace(segments.inputs, frame=frame)
    carried = _carried(frames, samples)
    which = np.arange(len(segments.sensors.kind)) if late else segments.sensors.late
    if carried is None or not len(which):
        return replace(segments, inputs=inputs, carried=carried)
    base, inside = _late_base(segments, frames, which.tolist())
    observed = segments.observed & inside
    samples_inside = np.where(observed, segments.samples, 0.0)
    segments = replace(segments, observed=observed, samples=samples_inside, clipped=None)
    return replace(segments, inputs=inputs, carried=carried, late_base=base)


def _late_base(
    segments: Segments, frames: Sequence[FramedRecord], late: Sequence[int]
) -> tuple[LateBase, Bools]:
    """What late sensors show of moving coordinates, and (M, C, K) where the record of the base reaches far enough for it."""
    values, inside = [], []
    for frame in frames:
        names, nothing = list(frame.names.values()), np.zeros((1, len(frame.record)))
        shown = [frame.carried.get(names[channel], nothing)[0] for channel in late]
        rate, time = frame.record.rate, np.arange(len(frame.record)) / frame.record.rate
        signals = (interpolated(0.0, rate, values) for values in shown)
        delayed = np.stack([at_delays(signal, time, LARGEST / rate) for signal in signals], axis=2)
        values.append(np.stack([cut(signal, len(segments.samples)) for signal in delayed]))
        reaches = np.ones((len(frame.record), len(names)))
        for channel in late:
            if names[channel] in frame.carried:
                reaches[:EDGE, channel] = reaches[-EDGE:, channel] = 0.0
        inside.append(np.nan_to_num(cut(reaches, len(segments.samples))))
    through = np.nan_to_num(np.concatenate(values, axis=3))
    base = LateBase(tuple(late), powers_through(through), segments.step * segments.refine)
    return base, np.concatenate(inside, axis=2) > 0.0


def _carried(frames: Sequence[FramedRecord], samples: int) -> Sequence[Floats] | None:
    """(M, C, K), twice: what the sensors show of moving coordinates, and its rate; 0 behind the end of a record."""
    if not any(frame.carried for frame in frames):
        return None
    parts = []
    for frame in frames:
        nothing = np.zeros((2, len(frame.record)))
        shown = np.stack([frame.carried.get(name, nothing) for name in frame.names.values()], axis=2)
        parts.append(np.stack([cut(values, samples) for values in shown]))
    return [*np.nan_to_num(np.concatenate(parts, axis=3))]


def with_uncertain_forces(
    segments: Segments,
    records: Sequence[Record],
    structure: Structure,
    gains: Sequence[str],
    delays: Sequence[str],
) -> Segments:
    """Add to segments the applied forces of which a gain or a delay is among the unknowns.

    Parameters
    ----------
    segments : Segments
        The segments of all records.
    records : sequence of Record
        The records, in the coordinates of the equations.
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
    late = [name for name in channels if name in delays]
    _require_band_limited(records, late)
    shown = [_shown(segments, records, structure, name, name in delays) for name in channels]
    powers = max(map(len, shown))
    coefficients = tuple(
        np.stack([own[power] if power < len(own) else np.zeros_like(own[0]) for own in shown], axis=2)
        for power in range(powers)
    )
    places = [channel.place for channel in channels]
    points = np.array([structure.points.index(name) if name in structure.points else -1 for name in places])
    masses = [structure.mass_names.index(name) if name in structure.mass_names else -1 for name in places]
    ends = np.where(points >= 0, FIRST_POINT - points, masses)
    of_base = np.array([name == BASE for name in places])
    inertia, topology = -segments.system.parameters.stated_masses, structure.topology
    assert segments.inputs.force is not None
    uncertain = UncertainForces(
        channels=channels,
        ends=np.where(of_base, FIRST_POINT - len(structure.points), ends),
        rows=np.array([inertia if name == BASE else topology.row(name) for name in places]),
        points=points,
        gains=np.array([gains.index(name) if name in gains else -1 for name in channels]),
        delays=np.array([delays.index(name) if name in delays else -1 for name in channels]),
        certain=np.zeros_like(segments.inputs.force),
        coefficients=coefficients,
        unit=LARGEST * segments.step * segments.refine,
    )
    nothing = np.zeros(len(delays))
    of_these = uncertain.on_masses(uncertain.acting(np.ones(len(gains)), nothing)[0])
    uncertain = replace(uncertain, certain=segments.inputs.force - of_these)
    return replace(segments, inputs=replace(segments.inputs, uncertain=uncertain))


def _require_band_limited(records: Sequence[Record], late: Sequence[str]) -> None:
    for name in late:
        kinds = {record.interpolation.get(name, BAND_LIMITED) for record in records} - {BAND_LIMITED}
        if kinds:
            raise IdentificationError(
                f"no delay of {name}, which is {kinds.pop()} between its samples, can be estimated beside other inputs: state "
                "it as band-limited if it is, or take the delay out (without_delays)"
            )


def _shown(
    segments: Segments, records: Sequence[Record], structure: Structure, name: Channel, late: bool
) -> tuple[Floats, ...]:
    """(J, 5, K) what a channel shows, less forces of inertia, or the acceleration of moving coordinates, at the points of
    every step; where late, powers of the delay. IdentificationError for a base whose acceleration is not that.
    """
    samples = len(segments.samples)
    pieces = []
    for record in records:
        acceleration = frame_acceleration(record)
        if name.place == BASE:
            _require_moving(name, acceleration)
        values = record.channel(f"a:{BASE}" if name.place == BASE else name)
        if acceleration is not None and name.place in structure.mass_names:
            number = structure.mass_names.index(name.place)
            values = values + segments.system.parameters.stated_masses[number] * acceleration
        count, grid = -(-len(record) // samples), (samples, segments.refine)
        kind = record.interpolation.get(name, BAND_LIMITED)
        if late:
            pieces.append(_at_delays(record, values, count, grid))
        else:
            pieces.append(value_at_points(record, values, count, grid, kind)[None])
    joined = np.concatenate(pieces, axis=3)
    return tuple(powers_through(joined)) if late else (joined[0],)


def _require_moving(name: Channel, acceleration: Floats | None) -> None:
    if acceleration is None:
        raise IdentificationError(
            f"no gain or delay of {name} can be estimated: the equations take no acceleration from it, as it moves no link or "
            "its displacement is recorded. Record its acceleration alone, or leave its gain and delay out"
        )


def _at_delays(record: Record, values: Floats, count: int, grid: tuple[int, int]) -> Floats:
    """(P, J, 5, K) a force at the points of every step, if its channel is late by Chebyshev's points, ascending.

    Beyond the ends of the record it runs straight on, and stays from the last sample on where no delay counts.
    """
    samples, refine = grid
    signal = interpolated(0.0, record.rate, values)
    steps = np.arange(count * samples * refine).reshape(count, samples * refine)
    time = np.minimum((record.step / refine) * (steps.T[:, None, :] + POINTS[None, :, None]), signal.end)
    return at_delays(signal, time, -LARGEST / record.rate)
