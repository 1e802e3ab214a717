"""Displacements of a record as the weak form uses them, with their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth, noise_and_bandwidth

_QUADRATURE_ERROR = 1e-5  # of the motion: error of the sums that approximate integrals of a smooth motion
_NOISE_FREE = 1e-3  # of the motion (60 dB): smaller noise is neglected when a window is chosen


@dataclass(frozen=True, eq=False)
class MeasuredDisplacements:
    """Displacements of the nodes of a structure (masses, base and ground), with their noise.

    Attributes
    ----------
    displacements : array of shape (n + 2, N)
        Displacements in m of the masses, the base and the ground; 0 where not measured.
    base : array of shape (N,) or None
        Displacement of the base in m; None without a channel.
    variance : array of shape (n,)
        Variances of the noise of the masses in m^2.
    base_variance : float
        Variance of the noise of the base in m^2.
    power : array of shape (n + 2,)
        Mean squares in m^2 over the samples measured.
    measured : array of bool, shape (n,)
        The masses with a displacement channel.
    missing : array of bool, shape (n, N), or None
        Samples that are missing; None without any.
    bandwidth : float
        Frequency in Hz up to which the motion is above the noise.
    """

    displacements: Floats
    base: Floats | None
    variance: Floats
    base_variance: float
    power: Floats
    measured: Bools
    missing: Bools | None
    bandwidth: float

    @property
    def x(self) -> Floats:
        """(n, N) displacements of the masses."""
        return self.displacements[:-2]

    @property
    def x_or_nan(self) -> Floats:
        """(n, N) displacements of the masses, NaN where a sample is missing."""
        return self.x if self.missing is None else np.where(self.missing, np.nan, self.x)

    @property
    def samples(self) -> int:
        """Number of displacement samples measured."""
        missing = 0 if self.missing is None else int(np.sum(self.missing[self.measured]))
        return int(np.sum(self.measured) * self.displacements.shape[1]) - missing

    @property
    def noise_free(self) -> bool:
        """Whether the noise of every channel is negligible."""
        return bool(np.all(self.variance[self.measured] < _NOISE_FREE**2 * self.power[:-2][self.measured]))

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
        names = [*(f"x:{name}" for name in structure.mass_names), "x:base"]
        deviations = np.sqrt(self.noise_variance[:-1]).tolist()
        stated = {
            name: sigma
            for name, sigma in zip(names, deviations, strict=True)
            if sigma > 0.0 and name in piece.channels
        }
        return read_displacements(replace(piece, noise={**piece.noise, **stated}), structure)

    @cached_property
    def noise_variance(self) -> Floats:
        """(n + 2,) variances of the noise in `displacements`."""
        return np.append(self.variance, [self.base_variance, 0.0])

    @cached_property
    def floored_variance(self) -> Floats:
        """(n + 2,) variances of the noise, at least those of the quadrature error of sums over samples.

        The floor keeps records without noise from being weighted by their rounding.
        """
        return np.maximum(self.noise_variance, _QUADRATURE_ERROR**2 * self.power)


def differences(values: Floats, ends: Indices) -> Floats:
    """Elongations between pairs of rows.

    Parameters
    ----------
    values : array of shape (k, N)
        Displacements.
    ends : array of int, shape (m, 2)
        Indices of the two rows of each pair.

    Returns
    -------
    array of shape (m, N)
        The first row less the second.
    """
    result = np.empty((len(ends), values.shape[1]))
    for row, (first, second) in zip(result, ends.tolist(), strict=True):
        np.subtract(values[first], values[second], out=row)
    return result


def read_displacements(record: Record, structure: Structure) -> MeasuredDisplacements:
    """Displacements of the masses of a structure in a record.

    Parameters
    ----------
    record : Record
        The record. Noise that it states is used; the rest is estimated.
    structure : Structure
        The structure.

    Returns
    -------
    MeasuredDisplacements
        The displacements and their noise.

    Raises
    ------
    IdentificationError
        If no mass has a displacement channel.
    """
    names = [*(f"x:{name}" for name in structure.mass_names), "x:base"]
    has_channel = np.array([name in record.channels for name in names])
    measured = has_channel[:-1]
    if not measured.any():
        raise IdentificationError(
            f"the weak form needs displacements, and the record has {', '.join(record.channels)}: give a channel x:MASS, "
            "or map a column of the file to one (`channels`)",
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
    complete = np.maximum(len(record) - missing.sum(axis=1), 1) if gaps else len(record)
    variance = np.zeros(len(names))
    variance[has_channel] = sigma**2
    return MeasuredDisplacements(
        displacements=ends,
        base=ends[-2] if has_channel[-1] else None,
        variance=variance[:-1],
        base_variance=float(variance[-1]),
        power=np.einsum("ij,ij->i", ends, ends) / complete,
        measured=measured,
        missing=missing[:-2] | missing[-2] if gaps else None,
        bandwidth=highest,
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
