"""Segments of records in which channels of applied forces have unknown gains or delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.late_base import places_of_delays, powers_through
from linkwise.likelihood.shooting.late_sensors import LARGEST
from linkwise.likelihood.shooting.segmentation import value_at_points
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.tableau import POINTS
from linkwise.likelihood.shooting.uncertain_forces import UncertainForces
from linkwise.model.excitation import Sampled
from linkwise.model.structure import Structure
from linkwise.model.topology import FIRST_POINT
from linkwise.records.channel import BAND_LIMITED, FORCE, Channel, interpolated
from linkwise.records.record import Record
from linkwise.signals.base_frame import frame_acceleration


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
        dict.fromkeys(Channel.parse(name) for name in (*gains, *delays) if name.startswith(FORCE))
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
    assert segments.inputs.force is not None
    uncertain = UncertainForces(
        channels=channels,
        ends=np.where(points >= 0, FIRST_POINT - points, masses),
        rows=np.array([structure.topology.row(name) for name in places]),
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
    return replace(
        segments,
        inputs=replace(segments.inputs, uncertain=uncertain),
        sensors=replace(segments.sensors, late_inputs=1 + int(uncertain.delays.max())),
    )


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
    """(J, 5, K) what a channel shows, less forces of inertia, at the points of every step; where late, powers of the delay."""
    samples = len(segments.samples)
    pieces = []
    for record in records:
        values, acceleration = record.channel(name), frame_acceleration(record)
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


def _at_delays(record: Record, values: Floats, count: int, grid: tuple[int, int]) -> Floats:
    """(P, J, 5, K) a force at the points of every step, if its channel is late by Chebyshev's points, ascending.

    Beyond the ends of the record it runs straight on, and stays from the last sample on where no delay counts.
    """
    samples, refine = grid
    signal: Sampled = interpolated(0.0, record.rate, values)
    steps = np.arange(count * samples * refine).reshape(count, samples * refine)
    time = (record.step / refine) * (steps.T[:, None, :] + POINTS[None, :, None])
    rows = []
    for place in places_of_delays():
        late = np.minimum(time, signal.end) + place * LARGEST / record.rate
        inside = np.clip(late, 0.0, signal.end)
        row = signal.value(inside)
        beyond = late != inside
        row[beyond] += signal.derivative(inside[beyond]) * (late[beyond] - inside[beyond])
        rows.append(row)
    return np.stack(rows)
