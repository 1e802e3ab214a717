"""How inputs run between their samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.model.input_signal import Sampled

HELD, LINEAR, BAND_LIMITED = INTERPOLATIONS = ("held", "linear", "band-limited")
ORDER_OF = {HELD: 0, LINEAR: 1, BAND_LIMITED: 5}
_ENOUGH = 64  # samples from which a windowed sinc interpolates accurately


def check_interpolation(inputs: Sequence[str], interpolation: Mapping[str, str]) -> None:
    """Raise RecordError for an interpolation that is unknown, or of a channel that is no input."""
    for name, kind in interpolation.items():
        if name not in inputs:
            listed = ", ".join(inputs) or "there are none"
            raise RecordError(
                f"an interpolation is given for a channel that is not an input of the record; inputs: {listed}",
                channel=name,
            )
        if kind not in INTERPOLATIONS:
            raise RecordError(
                f"unknown interpolation {kind!r}; choose from {', '.join(INTERPOLATIONS)}", channel=name
            )
        if kind == HELD and name.endswith(":base"):
            raise RecordError(
                "a base does not jump from sample to sample; choose linear or band-limited", channel=name
            )


def interpolated(start: float, rate: float, values: Floats, kind: str = BAND_LIMITED) -> Sampled:
    """The input with samples `values` (N,) and what runs between them."""
    band_limited = kind == BAND_LIMITED and len(values) > _ENOUGH
    return Sampled(start, rate, values, order=ORDER_OF[kind], band_limited=band_limited)


def at_samples(values: Floats, kind: str = BAND_LIMITED) -> Floats:
    """Samples (N,) of an input for sums that stand for integrals: a held one jumps at each, and has its mean there."""
    return values if kind != HELD else 0.5 * (values + np.append(values[:1], values[:-1]))
