"""Columns of the normal equations of errors that sensors and inputs have: offsets, gains, delays, and shown random forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.flow import at_ends_and_middles
from linkwise.likelihood.shooting.late_sensors import late_motion
from linkwise.likelihood.shooting.local_rows import as_slice
from linkwise.likelihood.shooting.random_states import RandomStates
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, Iterate, Scales, Segments, Sensors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces, Single


def columns_of_forces(segments: Segments) -> Indices:
    """The columns of gains, then of delays, of uncertain forces among those of the errors of sensors."""
    uncertain, sensors = segments.inputs.uncertain, segments.sensors
    if uncertain is None:
        return np.empty(0, dtype=int)
    gains, delays = (numbers[numbers >= 0] for numbers in (uncertain.gains, uncertain.delays))
    return np.concatenate([sensors.offsets + gains, sensors.offsets + sensors.gains + delays])


def changes_of_forces(
    segments: Segments, point: Iterate, scales: Scales, part: slice
) -> CandidateForces | None:
    """The forces on masses, in some segments, per unit of each error of `columns_of_forces`; None without any."""
    if segments.inputs.uncertain is None:
        return None
    uncertain = segments.inputs.uncertain.part(part)
    force, rate = uncertain.acting(point.gains, point.delays)
    scaled, late = np.flatnonzero(uncertain.gains >= 0), np.flatnonzero(uncertain.delays >= 0)
    gains, delays = uncertain.gains[scaled], uncertain.delays[late]
    units = scales.theta[len(point.theta) + len(point.offsets) :]
    per_gain = -force[:, :, scaled] * (units[gains] / point.gains[gains])[:, None]
    per_delay = rate[:, :, late] * units[len(point.gains) + delays][:, None]
    changes = np.concatenate([per_gain, per_delay], axis=2)
    starts, middles = at_ends_and_middles(changes, segments.flow_steps_per_tangent)
    ends = uncertain.ends[np.concatenate([scaled, late])]
    return CandidateForces(np.full(len(ends), -1), ends, starts, middles)


def add_offsets(columns: Floats, segments: Segments, scales: Scales, whiten: Single, part: slice) -> None:
    """The columns of constant offsets, and of waveforms behind them, among those of the errors of sensors."""
    sensors = segments.sensors
    units = scales.theta[segments.system.parameters.size :]
    for channel in np.flatnonzero(sensors.offset >= 0):
        number = sensors.offset[channel]
        columns[:, :, channel, number] = whiten[:, channel].T * units[number]
    if segments.waveforms is not None:
        for number, channel in enumerate(segments.waveforms.channel.tolist(), start=sensors.constants):
            values = segments.waveforms.values[:, number - sensors.constants, part]
            columns[:, :, channel, number] = (whiten[:, channel] * values).T * units[number]


def tangents_of_channels(
    motions: Sequence[Single],
    kind: int,
    channels: Indices,
    sensors: Sensors,
    point: Iterate,
    rate: float | Floats,
) -> Single:
    """(c, P, k) tangents of what the `channels` of one `kind` show; those that are late to first order in the delay."""
    rows = motions[kind][as_slice(sensors.mass[channels])]
    late = sensors.delay[channels] >= 0 if kind < A and len(sensors.delay) else np.zeros(0, dtype=bool)
    if late.any():
        rows = rows.copy()
    for number in np.flatnonzero(late).tolist():
        delay, mass = point.delays[sensors.delay[channels[number]]], sensors.mass[channels[number]]
        rows[number] -= (delay * rate * motions[kind + 1][mass]).astype(rows.dtype)
    return rows


def add_delays(
    jacobian: Floats, segments: Segments, misfit: Misfit, scales: Scales, whiten: Single, part: slice
) -> None:
    """The columns of delays: the rate of the motion that the sensor shows, sign reversed."""
    sensors, point = segments.sensors.at(segments.system.at(misfit.point.theta)), misfit.point
    first = jacobian.shape[-1] - 1 - sensors.delays
    units, factors = scales.theta[len(scales.theta) - sensors.delays :], sensors.factors(point.gains)
    for channel in sensors.late:
        number = sensors.delay[channel]
        _, rate = late_motion(
            sensors.orbit_with_points(misfit.trajectories.part(part)),
            segments.step[part] * segments.refine,
            segments.refine,
            mass=int(sensors.mass[channel]),
            kind=int(sensors.kind[channel]),
            delay=float(point.delays[number]),
        )
        if segments.late_base is not None:
            rate = rate + segments.late_base.at(channel, float(point.delays[number]), part)[1]
        column = -whiten[:, channel] * rate * (units[number] * factors[channel])
        jacobian[:, :, channel, first + number] = column.T


def calibrate_gains(
    jacobian: Floats, segments: Segments, misfit: Misfit, scales: Scales, root: Floats, part: slice
) -> None:
    """Sensors with an unknown gain: their rows are scaled by it, and its own column is the motion, whitened alike.

    `root` (M, C, k) is the square root of the samples' weights, 0 where one is missing. The columns of uncertain forces,
    which move the masses, are in place.
    """
    sensors, point = segments.sensors, misfit.point
    motion_columns = jacobian.shape[-1] - 1 - sensors.unknowns
    first = len(point.theta) + len(point.offsets)
    factors, moving = sensors.factors(point.gains), motion_columns + columns_of_forces(segments)
    for channel in sensors.scaled:
        relative = 1.0 if segments.relative_noise is None else segments.relative_noise[channel, part]
        sigma = scales.sigma[channel] * relative
        predicted = segments.samples[:, channel, part] / sigma - misfit.residuals[:, channel, part]
        if misfit.clipped is not None:
            predicted = predicted + misfit.clipped.shown[:, channel, part]
        if segments.carried is not None:
            predicted = predicted + segments.carried[0, :, channel, part] / sigma
        if sensors.offset[channel] >= 0:
            predicted = predicted - point.offsets[sensors.offset[channel]] / sigma
        if segments.waveforms is not None:
            added = segments.waveforms.added(int(channel), point.offsets[sensors.constants :])
            predicted = predicted - added[:, part] / sigma
        jacobian[:, :, channel, :motion_columns] *= np.float32(factors[channel])
        jacobian[:, :, channel, moving] *= np.float32(factors[channel])
        for number in np.flatnonzero(sensors.gain[channel]):
            unit = scales.theta[first + number] / factors[channel]
            column = motion_columns + len(point.offsets) + number
            jacobian[:, :, channel, column] = (root[:, channel] * predicted * unit).T


def add_shown_forces(jacobian: Floats, random: RandomStates, scales: Scales, whiten: Single) -> None:
    """What sensors show of random forces directly, in segments of one sample."""
    assert random.shown is not None
    for channel, number in np.argwhere(random.shown):
        row = random.rows[number]
        jacobian[:, 0, channel, row] += whiten[0, channel] * np.float32(
            random.shown[channel, number] * scales.state[row]
        )
