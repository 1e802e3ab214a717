"""The displacements that a weak form reads off a record, and what is known of their noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth, noise_and_bandwidth

_RESOLVED = 1e-5  # of the motion: what the sums that stand for integrals tell of a smooth motion
_QUIET = 1e-3  # noise below this part of the motion (60 dB) counts as none when a window is chosen


@dataclass(frozen=True, eq=False)
class MeasuredDisplacements:
    """Displacements `displacements` (n + 2, N) in m of what links hold on to: masses, the base and the ground, 0 where not
    seen.

    `variance` (n,) and `base_variance` are those of their noise in m^2, `power` (n + 2,) their mean squares where seen;
    `measured` (n,) says which masses have a displacement channel, `missing` (n, N) which samples are lost (None: no sample
    is), `base` (N,) is None where it has no channel. `bandwidth` is the frequency in Hz up to which motion stands above
    noise.
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
        """Displacement samples that were seen."""
        lost = 0 if self.missing is None else int(np.sum(self.missing[self.measured]))
        return int(np.sum(self.measured) * self.displacements.shape[1]) - lost

    @property
    def noise_free(self) -> bool:
        """Whether there is no noise to speak of."""
        return bool(np.all(self.variance[self.measured] < _QUIET**2 * self.power[:-2][self.measured]))

    @cached_property
    def noise_variance(self) -> Floats:
        """(n + 2,) variances of the noise in `displacements`."""
        return np.append(self.variance, [self.base_variance, 0.0])

    @cached_property
    def floored_variance(self) -> Floats:
        """(n + 2,) variances in `displacements` of noise and of what sums over samples do not resolve of integrals.

        So a record without noise is not held to its rounding.
        """
        return np.maximum(self.noise_variance, _RESOLVED**2 * self.power)


def differences(values: Floats, ends: Indices) -> Floats:
    """(m, N) rows of `values` at the first less those at the second of `ends` (m, 2)."""
    found = np.empty((len(ends), values.shape[1]))
    for row, (first, second) in zip(found, ends.tolist(), strict=True):
        np.subtract(values[first], values[second], out=row)
    return found


def read_displacements(record: Record, structure: Structure) -> MeasuredDisplacements:
    """The motion of the masses of `structure` in `record`; its noise as the record states it, else as found in it.

    Raises IdentificationError for a record without displacements.
    """
    names = [*(f"x:{name}" for name in structure.mass_names), "x:base"]
    there = np.array([name in record.channels for name in names])
    seen = there[:-1]
    if not seen.any():
        raise IdentificationError(
            f"the weak form needs displacements, and the record holds {', '.join(record.channels)}: give a channel x:MASS, "
            "or map a column of the file to one (`channels`)",
            arguments=("channels",),
        )
    ends = np.zeros((len(names) + 1, len(record)))
    for row in np.flatnonzero(there):
        ends[row] = record.channel(names[row])
    values = ends[: there.sum()] if there[: there.sum()].all() else ends[:-1][there]
    stated = [record.noise.get(name, np.nan) for name, each in zip(names, there, strict=True) if each]
    sigma, bands = noise_and_bandwidth(values.T, record.rate, stated)
    sigma = np.nan_to_num(sigma)
    highest = float(np.max(bands[: seen.sum()]))
    if np.isnan(highest):
        highest = _bridged(values[: seen.sum()], record.rate, sigma[: seen.sum()])
    missing = np.isnan(ends)
    gaps = bool(missing.any())
    if gaps:
        ends[missing] = 0.0
    whole = np.maximum(len(record) - missing.sum(axis=1), 1) if gaps else len(record)
    variance = np.zeros(len(names))
    variance[there] = sigma**2
    return MeasuredDisplacements(
        displacements=ends,
        base=ends[-2] if there[-1] else None,
        variance=variance[:-1],
        base_variance=float(variance[-1]),
        power=np.einsum("ij,ij->i", ends, ends) / whole,
        measured=seen,
        missing=missing[:-2] | missing[-2] if gaps else None,
        bandwidth=highest,
    )


def _bridged(values: Floats, rate: float, sigma: Floats) -> float:
    """The frequency in Hz up to which some channel (C, N) stands above its noise where no long piece is whole: over bridged
    gaps.
    """
    at = np.arange(values.shape[1])
    seen = np.isfinite(values)
    whole = [np.interp(at, at[here], row[here]) for row, here in zip(values, seen, strict=True) if here.any()]
    if not whole:
        return 0.5 * rate
    return float(np.max(bandwidth(np.stack(whole, axis=1), rate, sigma[seen.any(axis=1)])))
