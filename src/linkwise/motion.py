"""The displacements that a weak form reads off a record, and what is known of their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import IdentificationError, RecordError
from linkwise.noise import bandwidth, noise_sigma
from linkwise.record import Record
from linkwise.structure import Structure

Floats = NDArray[np.float64]

_QUIET = 1e-3  # noise below this part of the motion (60 dB) counts as none when a window is chosen


@dataclass(frozen=True, eq=False)
class SeenMotion:
    """Displacements `x` (n, N) in m with 0 where a sample is missing, and of the base (N,), or None without one.

    `variance` (n,) and `base_variance` are those of their noise in m^2; `seen` (n,) says which masses have a displacement
    channel, `missing` (n, N) which samples are lost (None: no sample is). `highest` is the frequency in Hz up to which
    motion stands above noise, `quiet` says that there is no noise to speak of.
    """

    x: Floats
    base: Floats | None
    variance: Floats
    base_variance: float
    seen: NDArray[np.bool_]
    missing: NDArray[np.bool_] | None
    highest: float
    quiet: bool

    @property
    def samples(self) -> int:
        """Displacement samples that were seen."""
        lost = 0 if self.missing is None else int(self.missing[self.seen].sum())
        return int(self.seen.sum()) * self.x.shape[1] - lost


def read_motion(record: Record, structure: Structure) -> SeenMotion:
    """The motion of the masses of `structure` in `record`; its noise as the record states it, else as found in it.

    Raises IdentificationError for a record without displacements.
    """
    names = [f"x:{name}" for name in structure.mass_names]
    present = [name for name in names if name in record.channels]
    if not present:
        raise IdentificationError(
            f"the weak form needs displacements, and the record holds {', '.join(record.channels)}: give a channel x:MASS, "
            "or map a column to one with --channel x:MASS=COLUMN"
        )
    base = "x:base" in record.channels
    values = np.stack([record.channel(name) for name in [*present, *(["x:base"] if base else [])]])
    count = len(present)
    missing = np.isnan(values)
    gaps = bool(missing.any())
    variance = noise_variance(record, [*present, *(["x:base"] if base else [])], values)
    highest = _highest(values[:count], record.rate, np.sqrt(variance[:count]))
    if gaps:
        values = np.where(missing, 0.0, values)
    seen = np.array([name in record.channels for name in names])
    x, spread, lost = np.zeros((structure.size, len(record))), np.zeros(structure.size), None
    x[seen], spread[seen] = values[:count], variance[:count]
    if gaps:
        lost = np.zeros(x.shape, dtype=bool)
        lost[seen] = missing[:count]
        lost |= missing[-1] if base else False
    power = np.mean(values[:count] ** 2, axis=1)
    return SeenMotion(
        x=x,
        base=values[-1] if base else None,
        variance=spread,
        base_variance=float(variance[-1]) if base else 0.0,
        seen=seen,
        missing=lost,
        highest=highest,
        quiet=bool(np.all(variance[:count] < _QUIET**2 * power)),
    )


def _highest(values: Floats, rate: float, sigma: Floats) -> float:
    """The frequency in Hz up to which some channel (C, N) stands above its noise; gaps are bridged where no long piece is
    whole.
    """
    try:
        return float(np.max(bandwidth(values.T, rate, sigma)))
    except RecordError:
        at = np.arange(values.shape[1])
        seen = np.isfinite(values)
        whole = [np.interp(at, at[here], row[here]) for row, here in zip(values, seen, strict=True) if here.any()]
        if not whole:
            return 0.5 * rate
        return float(np.max(bandwidth(np.stack(whole, axis=1), rate, sigma[seen.any(axis=1)])))


def noise_variance(record: Record, names: list[str], values: Floats) -> Floats:
    """(C,) variance of the noise in `values` (C, N) of the channels `names`: stated by the record, else found.

    A channel too broken by gaps to tell counts as free of noise.
    """
    stated = np.array([record.noise.get(name, np.nan) for name in names])
    if np.isfinite(stated).all():
        return stated**2
    found = np.nan_to_num(noise_sigma(values.T))
    return np.where(np.isfinite(stated), stated, found) ** 2
