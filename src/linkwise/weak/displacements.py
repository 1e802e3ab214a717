"""Displacements of a record as the weak form uses them, with the noise of their channels.

Masses have channels of their own. Modal coordinates of a host follow from the displacements of its points, y = S q, by least
squares with the variances of the channels as weights (METHODS section 11); what channels show beyond the modes is noise, or a
wrong shape. `with_displacements` integrates what was not measured, for searches that want no more than candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from linkwise.arrays import Bools, Floats, Indices, bridged
from linkwise.errors import IdentificationError
from linkwise.model.host import Host
from linkwise.model.link import Mass
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.gaps import denser, highest_frequency
from linkwise.signals.noise import bandwidth, channel_noise, noise_and_bandwidth
from linkwise.signals.states import drift_frequency, highpass, integral, smoothed

_INDEPENDENT = 1e-4  # of the largest singular value of shapes of unit length: sensors that tell less of a mode tell noise
_QUADRATURE_ERROR = 1e-5  # of the motion: error of the sums that approximate integrals of a smooth motion
_NOISE_FREE = 1e-3  # of the motion (60 dB): smaller noise is neglected when a window is chosen
_SHOWN = 4  # channels that a message lists


@dataclass(frozen=True, eq=False)
class MeasuredDisplacements:
    """Displacements of the nodes of a structure (its n masses and modes, base and ground), with their noise.

    Attributes
    ----------
    displacements : array of shape (n + 2, N)
        Displacements in m of the masses and modes, the base and the ground; 0 where not measured.
    source_variance, source_power : array of shape (C,)
        Variances of the noise of the channels in m^2, and their mean squares over the samples measured: of the masses and
        points of hosts, the base and the ground; 0 without a channel.
    has_channel : array of bool, shape (C,)
        Which of these the record has.
    source_weights : array of shape (n + 2, C)
        Weights of the channels in the displacements of the nodes.
    measured : array of bool, shape (n,)
        The masses and modes whose displacement the channels tell.
    missing : array of bool, shape (n, N)
        Samples that are missing.
    samples : int
        Number of displacement samples measured, of the base not counted.
    bandwidth : float
        Frequency in Hz up to which the motion is above the noise.
    surplus : float
        Mean square of what channels show beyond the modes of a host over that expected from noise, of the worst host; 1 where
        no host has more channels than modes.
    density : int
        How many samples there are for each that was measured: interpolated ones share the noise of their neighbours.
    """

    displacements: Floats
    source_variance: Floats
    source_power: Floats
    has_channel: Bools
    source_weights: Floats
    measured: Bools
    missing: Bools
    samples: int
    bandwidth: float
    surplus: float = 1.0
    density: int = 1

    @property
    def noise_free(self) -> bool:
        """Whether the noise of every channel is negligible."""
        small = self.source_variance < _NOISE_FREE**2 * self.source_power
        return bool(np.all(small[:-2][self.has_channel[:-2]]))

    @cached_property
    def floored_variance(self) -> Floats:
        """(C,) variances of the noise of the channels, at least those of the quadrature error of sums over samples.

        The floor keeps records without noise from being weighted by their rounding.
        """
        return np.maximum(self.source_variance, _QUADRATURE_ERROR**2 * self.source_power)

    def covariance(self, nodes: Indices, *, floored: bool = False) -> Floats:
        """(c, c) covariance in m^2 of the noise in the displacements of c nodes."""
        variance = self.floored_variance if floored else self.source_variance
        weights = self.source_weights[nodes]
        return np.asarray((weights * variance) @ weights.T)


def source_names(structure: Structure) -> list[str]:
    """The channels that tell the motion of nodes: of masses and points of hosts, of states of links, and of the base."""
    states = (f"state:{structure.links[link].name}.{name}" for link, name in structure.topology.states)
    return [*(f"x:{place}" for place in structure.places), *states, "x:base"]


def read_displacements(record: Record, structure: Structure) -> MeasuredDisplacements:
    """Displacements of the masses and modes of a structure in a record, and states; stated noise is used, the rest estimated.

    Raises IdentificationError if no mass has a displacement channel, those of a host do not determine its modes, or a state is
    not measured.
    """
    names = source_names(structure)
    has_channel = np.array([name in record.channels for name in names])
    measured = has_channel[:-1]
    if not measured[: len(structure.places)].any():
        raise IdentificationError(
            "the weak form needs the displacement of a mass and of all its neighbours, and the record has "
            f"{', '.join(record.channels)}: give {', '.join(names[: len(structure.places)][:_SHOWN])}, or map columns of the "
            "file to them (`channels`)",
            arguments=("channels",),
        )
    unmeasured = [name for name in names[len(structure.places) : -1] if name not in record.channels]
    if unmeasured:
        raise IdentificationError(
            f"the weak form needs the states of links with memory, and the record has no {', '.join(unmeasured)}: measure "
            'it, or use method "ml", which finds states',
            arguments=("channels",),
        )
    ends = np.zeros((len(names) + 1, len(record)))
    for row in np.flatnonzero(has_channel):
        ends[row] = record.channel(names[row])
    values = ends[: has_channel.sum()] if has_channel[: has_channel.sum()].all() else ends[:-1][has_channel]
    stated = [record.noise.get(name, np.nan) for name in names if name in record.channels]
    sigma, bands = noise_and_bandwidth(values.T, record.rate, stated)
    sigma = np.nan_to_num(sigma)
    highest = float(np.max(bands[: measured.sum()]))
    if np.isnan(highest):
        highest = _bridged_bandwidth(values[: measured.sum()], record.rate, sigma[: measured.sum()])
    missing = np.isnan(ends)
    ends[missing] = 0.0
    lacking = missing[:-2] | missing[-2]
    complete = np.maximum(len(record) - missing.sum(axis=1), 1)
    variance = np.zeros(len(names))
    variance[has_channel] = sigma**2
    shown = MeasuredDisplacements(
        displacements=ends,
        source_variance=np.append(variance, 0.0),
        source_power=np.einsum("ij,ij->i", ends, ends) / complete,
        has_channel=np.append(has_channel, False),
        source_weights=np.eye(len(ends)),
        measured=measured,
        missing=lacking,
        samples=int(np.sum(measured) * ends.shape[1] - np.sum(lacking[measured])),
        bandwidth=highest,
    )
    return _of_modes(shown, structure) if structure.hosts else shown


def read_densely(record: Record, structure: Structure) -> tuple[Record, MeasuredDisplacements]:
    """A record and its displacements, with samples in between where it has few in a period of the fastest motion.

    Raises IdentificationError as `read_displacements`.
    """
    dense, density = denser(record)
    motion = read_displacements(dense, structure)
    if density == 1:
        return record, motion
    return dense, replace(motion, bandwidth=highest_frequency(record), density=density)


def _bridged_bandwidth(values: Floats, rate: float, sigma: Floats) -> float:
    """Bandwidth in Hz of channels (C, N) without a long complete piece."""
    present = np.isfinite(values).any(axis=1)
    if not present.any():
        return 0.5 * rate
    whole = np.stack([bridged(row) for row in values[present]], axis=1)
    return float(np.max(bandwidth(whole, rate, sigma[present])))


def _of_modes(shown: MeasuredDisplacements, structure: Structure) -> MeasuredDisplacements:
    """Displacements of masses and modes from those `shown` of masses and points."""
    weights, surplus = _measured_modes(structure, shown.has_channel, shown.floored_variance)
    shows, whole = weights != 0.0, ~shown.missing.any(axis=0)
    beside = [np.mean((rows @ shown.displacements[:, whole]) ** 2) for rows in surplus]
    return replace(
        shown,
        displacements=weights @ shown.displacements,
        source_weights=weights,
        measured=shows[:-2].any(axis=1),
        missing=shows[:-2, :-2] @ shown.missing,
        surplus=float(np.nan_to_num(max(beside, default=1.0), nan=1.0)),
    )


def _measured_modes(
    structure: Structure, has_channel: Bools, variance: Floats
) -> tuple[Floats, list[Floats]]:
    """The weights (n + 2, C) of channels in the displacements of masses and modes, the base and the ground.

    With them, for each host with more channels than modes, the sums (k, C) of its channels in which no mode is seen, and that
    are white noise of unit variance. Channels have a `variance` (C,) in m^2; some are none by `has_channel` (C,).
    """
    _require_known_shapes(structure)
    topology, places = structure.topology, structure.places
    states = len(topology.states)
    weights, surplus = np.zeros((structure.size + states + 2, len(has_channel))), []
    weights[-2 - states :, -2 - states :] = np.eye(states + 2)
    for column, place in enumerate(places[len(structure.points) :], start=len(structure.points)):
        weights[topology.index[place], column] = float(has_channel[column])
    firsts = np.cumsum([0, *(len(host.points) for host in structure.hosts)]).tolist()
    for host, (first, last) in zip(structure.hosts, pairwise(firsts), strict=True):
        columns = first + np.flatnonzero(has_channel[first:last])
        modes = [topology.index[name] for name in host.coordinates]
        shapes = np.array([topology.row(places[column])[modes] for column in columns]).reshape(-1, len(modes))
        _require_determined(host, shapes, [places[column] for column in columns])
        deviation = np.sqrt(np.maximum(variance[columns], np.finfo(float).tiny))
        left, values, right = np.linalg.svd(shapes / deviation[:, None])
        own = left[:, : len(modes)]
        weights[np.ix_(modes, columns)] = (right.T / values) @ own.T / deviation
        if len(columns) > len(modes):
            rows = np.zeros((len(columns) - len(modes), len(has_channel)))
            rows[:, columns] = left[:, len(modes) :].T / deviation
            surplus.append(rows)
    return weights, surplus


def _require_determined(host: Host, shapes: Floats, places: list[str]) -> None:
    """IdentificationError where the shapes (c, r) of r modes at c measured places are not independent."""
    length = np.linalg.norm(shapes, axis=0)
    values = np.linalg.svd(shapes / np.where(length > 0.0, length, 1.0), compute_uv=False)
    independent = int(np.sum(values > _INDEPENDENT * values.max(initial=0.0)))
    lacking = shapes.shape[1] - independent
    if lacking:
        raise IdentificationError(
            f'the weak form needs the modal coordinates of host "{host.name}": its {shapes.shape[1]} modes take as many '
            f"displacements of points at which they differ, and the record has {independent} "
            f"({', '.join(f'x:{place}' for place in places) or 'no x:POINT'}), so {lacking} more "
            f'{"is" if lacking == 1 else "are"} needed; keep fewer modes, or use method "ml", which takes fewer sensors'
        )


def _require_known_shapes(structure: Structure) -> None:
    """IdentificationError where a shape is unknown, or known to within: the coordinates would depend on it."""
    for host in structure.hosts:
        for name, mode in zip(host.coordinates, host.modes, strict=True):
            if mode.shape_sigma:
                raise IdentificationError(
                    f"the shape of {name} is not known exactly at {', '.join(mode.shape_sigma)}, and the weak form takes "
                    'modal coordinates from shapes: use method "ml", or state shapes as numbers'
                )


def motion_without_drift(
    record: Record, channel: Channel, sigma: float, slowest: float | None = None
) -> tuple[Floats, Floats]:
    """Displacement in m and velocity in m/s (N,) from one channel of a motion with noise `sigma`, smoothed; integrals of an
    acceleration without what is slower than `slowest` in Hz, by default that of the channel, as its drift grows.
    """
    value, slope, _ = smoothed(record, channel, sigma)
    if channel.kind == "x":
        return value, slope
    if channel.kind == "v":
        return integral(value, record.step), value
    cutoff = drift_frequency(value, record.rate) if slowest is None else slowest
    velocity = highpass(integral(value, record.step), record.rate, cutoff)
    return highpass(integral(velocity, record.step), record.rate, cutoff), velocity


def with_displacements(record: Record, masses: Sequence[Mass]) -> Record:
    """`record` itself if it has the displacement of every mass, else with displacements integrated from what it has.

    Those of accelerations lack the same slow motion, and forces do as well where nothing else is shown: linear equations of
    motion hold between them then. The integration constant is lost, so that a spring away from d = 0 appears as other powers
    of d. The result therefore only suggests candidates; the likelihood, which uses the measured channels, decides.
    """
    missing = [mass.name for mass in masses if f"x:{mass.name}" not in record.channels]
    if not missing:
        return record
    sigma = channel_noise(record)
    sources = [record.motions_of(name)[0] for name in missing]
    accelerations = [channel for channel in sources if channel.kind == "a"]
    slowest = max(
        (drift_frequency(smoothed(record, c, sigma[c])[0], record.rate) for c in accelerations), default=None
    )
    values = record.values
    if slowest is not None and len(accelerations) == len(masses):
        values = values.copy()
        for column in (record.channels.index(name) for name in record.forces):
            twice = highpass(values[:, column], record.rate, slowest)
            values[:, column] = highpass(twice, record.rate, slowest)
    names, columns, noise = list(record.channels), [values], dict(record.noise)
    for name, channel in zip(missing, sources, strict=True):
        x, _ = motion_without_drift(record, channel, sigma[channel], slowest)
        names.append(Channel("x", name))
        columns.append(x[:, None])
        shown = float(np.sqrt(np.nanmean(record.channel(channel) ** 2)))
        relative = sigma[channel] / max(shown, float(np.finfo(float).tiny))
        noise[f"x:{name}"] = relative * float(np.sqrt(np.mean(x**2)))
    return replace(record, channels=tuple(names), values=np.hstack(columns), noise=noise, uncertainty={})
