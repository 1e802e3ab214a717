"""Displacements of a record as the weak form uses them, with their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.gaps import denser, highest_frequency
from linkwise.signals.noise import bandwidth, noise_and_bandwidth
from linkwise.weak.elements import Elimination, elimination_of
from linkwise.weak.measured_modes import measured_modes

_QUADRATURE_ERROR = 1e-5  # of the motion: error of the sums that approximate integrals of a smooth motion
_NOISE_FREE = 1e-3  # of the motion (60 dB): smaller noise is neglected when a window is chosen


@dataclass(frozen=True, eq=False)
class MeasuredDisplacements:
    """Displacements of the nodes of a structure (its n masses and modes, base and ground), with their noise.

    Attributes
    ----------
    displacements : array of shape (n + 2, N)
        Displacements in m of the masses and modes, the base and the ground; 0 where not measured.
    base : array of shape (N,) or None
        Displacement of the base in m; None without a channel.
    source_variance, source_power : array of shape (C,)
        Variances of the noise of the channels in m^2, and their mean squares over the samples measured: of the masses and
        points of hosts, the base and the ground; 0 without a channel.
    has_channel : array of bool, shape (C,)
        Which of these the record has.
    source_weights : array of shape (n + 2, C) or None
        Weights of the channels in the displacements of the nodes; None where each node has its own.
    measured : array of bool, shape (n,)
        The masses and modes whose displacement the channels tell.
    missing : array of bool, shape (n, N), or None
        Samples that are missing; None without any.
    samples : int
        Number of displacement samples measured, of the base not counted.
    bandwidth : float
        Frequency in Hz up to which the motion is above the noise.
    surplus : float
        Mean square of what channels show beyond the modes of a host over that expected from noise, of the worst host; 1 where
        no host has more channels than modes.
    elimination : Elimination or None
        The state of a link that is not measured and is eliminated.
    density : int
        How many samples there are for each that was measured: interpolated ones share the noise of their neighbours.
    """

    displacements: Floats
    base: Floats | None
    source_variance: Floats
    source_power: Floats
    has_channel: Bools
    source_weights: Floats | None
    measured: Bools
    missing: Bools | None
    samples: int
    bandwidth: float
    surplus: float = 1.0
    elimination: Elimination | None = None
    density: int = 1

    @property
    def x_or_nan(self) -> Floats:
        """(n, N) displacements of the masses and modes, NaN where a sample is missing."""
        x = self.displacements[:-2]
        return x if self.missing is None else np.where(self.missing, np.nan, x)

    @property
    def noise_free(self) -> bool:
        """Whether the noise of every channel is negligible."""
        small = self.source_variance < _NOISE_FREE**2 * self.source_power
        return bool(np.all(small[:-2][self.has_channel[:-2]]))

    def of_piece(self, piece: Record, structure: Structure) -> MeasuredDisplacements:
        """Displacements of a piece of the record, with the noise that was found in the whole of it.

        Parameters
        ----------
        piece : Record
            The piece.
        structure : Structure
            The structure.

        Returns
        -------
        MeasuredDisplacements
            The displacements.
        """
        deviations = np.sqrt(self.source_variance[:-1]).tolist()
        stated = {
            name: sigma
            for name, sigma in zip(source_names(structure), deviations, strict=True)
            if sigma > 0.0 and name in piece.channels
        }
        eliminate = self.elimination is not None
        return read_displacements(
            replace(piece, noise={**piece.noise, **stated}), structure, eliminate=eliminate
        )

    @cached_property
    def floored_variance(self) -> Floats:
        """(C,) variances of the noise of the channels, at least those of the quadrature error of sums over samples.

        The floor keeps records without noise from being weighted by their rounding.
        """
        return np.maximum(self.source_variance, _QUADRATURE_ERROR**2 * self.source_power)

    def covariance(self, nodes: Indices, *, floored: bool = False) -> Floats:
        """(c, c) covariance of the noise in the displacements of c nodes."""
        variance = self.floored_variance if floored else self.source_variance
        if self.source_weights is None:
            return np.diag(variance[nodes])
        weights = self.source_weights[nodes]
        return np.asarray((weights * variance) @ weights.T)


def source_names(structure: Structure) -> list[str]:
    """The channels that tell the motion of nodes: of masses and points of hosts, of states of links, and of the base."""
    states = (f"state:{structure.links[link].name}.{name}" for link, name in structure.topology.states)
    return [*(f"x:{place}" for place in structure.places), *states, "x:base"]


def read_displacements(
    record: Record, structure: Structure, *, eliminate: bool = False
) -> MeasuredDisplacements:
    """Displacements of the masses of a structure in a record.

    Parameters
    ----------
    record : Record
        The record. Noise that it states is used; the rest is estimated.
    structure : Structure
        The structure.
    eliminate : bool, optional
        Whether a state that the record does not show is eliminated.

    Returns
    -------
    MeasuredDisplacements
        The displacements and their noise.

    Raises
    ------
    IdentificationError
        If no mass has a displacement channel, those of a host do not tell its modes, or a state that is not measured cannot
        be eliminated.
    """
    names = source_names(structure)
    has_channel = np.array([name in record.channels for name in names])
    measured = has_channel[:-1]
    if not measured[: len(structure.places)].any():
        raise IdentificationError(
            f"the weak form needs displacements, and the record has {', '.join(record.channels)}: give a channel x:MASS, "
            "or map a column of the file to one (`channels`)",
            arguments=("channels",),
        )
    unmeasured = [name for name in names[len(structure.places) : -1] if name not in record.channels]
    elimination = elimination_of(structure, unmeasured) if eliminate else None
    if unmeasured and elimination is None:
        raise IdentificationError(
            f"the weak form needs the states of links with memory, and the record has no {', '.join(unmeasured)}: measure "
            'it, or use method "ml", which finds states',
            arguments=("channels",),
        )
    ends = np.zeros((len(names) + 1, len(record)))
    for row in np.flatnonzero(has_channel):
        ends[row] = record.channel(names[row])
    values = ends[: has_channel.sum()] if has_channel[: has_channel.sum()].all() else ends[:-1][has_channel]
    stated = [
        record.noise.get(name, np.nan) for name, present in zip(names, has_channel, strict=True) if present
    ]
    sigma, bands = noise_and_bandwidth(values.T, record.rate, stated)
    sigma = np.nan_to_num(sigma)
    highest = float(np.max(bands[: measured.sum()]))
    if np.isnan(highest):
        highest = _bridged_bandwidth(values[: measured.sum()], record.rate, sigma[: measured.sum()])
    missing = np.isnan(ends)
    gaps = bool(missing.any())
    if gaps:
        ends[missing] = 0.0
    lacking = missing[:-2] | missing[-2]
    complete = np.maximum(len(record) - missing.sum(axis=1), 1) if gaps else len(record)
    variance = np.zeros(len(names))
    variance[has_channel] = sigma**2
    shown = MeasuredDisplacements(
        displacements=ends,
        base=ends[-2] if has_channel[-1] else None,
        source_variance=np.append(variance, 0.0),
        source_power=np.einsum("ij,ij->i", ends, ends) / complete,
        has_channel=np.append(has_channel, False),
        source_weights=None,
        measured=measured,
        missing=lacking if gaps else None,
        samples=int(np.sum(measured) * ends.shape[1] - np.sum(lacking[measured])),
        bandwidth=highest,
        elimination=elimination,
    )
    return _of_modes(shown, structure) if structure.hosts else shown


def read_densely(record: Record, structure: Structure) -> tuple[Record, MeasuredDisplacements]:
    """Displacements of masses, with samples between those of a record that has few in a period of the fastest motion.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.

    Returns
    -------
    record : Record
        The record, made denser where it must be.
    motion : MeasuredDisplacements
        Its displacements and their noise.

    Raises
    ------
    IdentificationError
        As `read_displacements`.
    """
    dense, density = denser(record)
    motion = read_displacements(dense, structure)
    if density == 1:
        return record, motion
    return dense, replace(motion, bandwidth=highest_frequency(record), density=density)


def _of_modes(shown: MeasuredDisplacements, structure: Structure) -> MeasuredDisplacements:
    """Displacements of masses and modes from those `shown` of masses and points."""
    modes = measured_modes(structure, shown.has_channel, shown.floored_variance)
    shows = modes.weights != 0.0
    missing = None if shown.missing is None else np.any(shows[:-2, :-2, None] & shown.missing, axis=1)
    return replace(
        shown,
        displacements=modes.weights @ shown.displacements,
        source_weights=modes.weights,
        measured=shows[:-2].any(axis=1),
        missing=missing,
        surplus=modes.surplus(shown.displacements, shown.missing),
    )


def _bridged_bandwidth(values: Floats, rate: float, sigma: Floats) -> float:
    """Bandwidth in Hz of channels (C, N) without a long complete piece: gaps are bridged by linear interpolation."""
    index = np.arange(values.shape[1])
    finite = np.isfinite(values)
    bridged = [
        np.interp(index, index[present], row[present])
        for row, present in zip(values, finite, strict=True)
        if present.any()
    ]
    if not bridged:
        return 0.5 * rate
    return float(np.max(bandwidth(np.stack(bridged, axis=1), rate, sigma[finite.any(axis=1)])))
