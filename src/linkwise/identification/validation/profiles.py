"""Where in the motion a prediction fails: over time, over the elongation and velocity of every link, and over frequency."""

from __future__ import annotations

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.identification.validation.prediction import Prediction
from linkwise.identification.validation.result import ErrorProfile, ErrorSpectrum
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_BINS = 24
_SEGMENTS = 8  # of a spectrum, at half overlap


def error_profiles(record: Record, structure: Structure, prediction: Prediction) -> tuple[ErrorProfile, ...]:
    """The error over time, then over d and v of every link along the predicted motion; modes of hosts are no links."""
    measured = record.select(record.responses).values
    size = np.nanstd(measured, axis=0)
    relative = (measured - prediction.predicted) / np.where(size > 0.0, size, 1.0)
    with np.errstate(invalid="ignore"):
        counted = np.isfinite(relative).sum(axis=1)
        square = np.nansum(relative**2, axis=1) / np.maximum(counted, 1)
    scored = counted > 0
    quantities = [("time", "s", record.time)]
    for number, link in enumerate(structure.links):
        if link.name in structure.modes:
            continue
        of_d, of_v = link.law.motion_units
        quantities.append((f"d of {link.name}", of_d, prediction.d[:, number]))
        quantities.append((f"v of {link.name}", of_v, prediction.v[:, number]))
    return tuple(
        _profile(quantity, unit, values[scored], square[scored]) for quantity, unit, values in quantities
    )


def _profile(quantity: str, unit: str, values: Floats, square: Floats) -> ErrorProfile:
    low, high = float(values.min()), float(values.max())
    if not high > low:
        high = low + max(abs(low), 1e-12)
    edges = np.linspace(low, high, _BINS + 1)
    samples, _ = np.histogram(values, edges)
    total, _ = np.histogram(values, edges, weights=square)
    error = np.where(samples > 0, 100.0 * np.sqrt(total / np.maximum(samples, 1)), np.nan)
    return ErrorProfile(quantity, unit, edges, error, samples)


def error_spectra(record: Record, predicted: Floats) -> dict[str, ErrorSpectrum]:
    """Spectra of the channels over their longest stretch without gaps; none where it is too short."""
    spectra = {}
    for column, name in enumerate(record.responses):
        measured = record.channel(name)
        error = measured - predicted[:, column]
        stretch = _longest(np.isfinite(error))
        length = 2 * (stretch.stop - stretch.start) // (_SEGMENTS + 1)
        if length < 16:
            continue
        settings = {"fs": record.rate, "nperseg": length}
        frequency, density = scipy.signal.welch(measured[stretch], **settings)
        _, left = scipy.signal.welch(error[stretch], **settings)
        spectra[name] = ErrorSpectrum(frequency[1:], density[1:], left[1:])
    return spectra


def _longest(present: Floats) -> slice:
    """The longest run of True."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(int)))
    starts, stops = ends[::2], ends[1::2]
    longest = int(np.argmax(stops - starts))
    return slice(int(starts[longest]), int(stops[longest]))
