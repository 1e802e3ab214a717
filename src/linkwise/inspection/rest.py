"""Where a channel is at rest: blocks at an end of it whose power is the same and small, without a resonance in them."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_BLOCKS = 40  # in which a record is looked at
_FEWEST = 6  # blocks of rest
_SHORTEST = 240  # samples of rest
QUIET = 0.2  # of the root mean square of the record
# ratio of the root mean squares of blocks at rest, greatest to least; correlated noise scatters more
_STEADY = 1.8
_ORDER = 8  # of the autoregression that tells resonances
_RESONANT = 0.97  # radius of a pole of it from which on something rings


def rest_period(values: Floats) -> slice | None:
    """The samples at rest of `values` (N,), at the end or else at the start; None where there are none."""
    for at_end in (True, False):
        run = _quiet_blocks(values[::-1] if at_end else values)
        if run:
            piece = slice(len(values) - run, len(values)) if at_end else slice(0, run)
            if not _rings(values[piece]):
                return piece
    return None


def _quiet_blocks(values: Floats) -> int:
    """Number of samples from the first on that are quiet and steady."""
    size = len(values) // _BLOCKS
    if size < 8:
        return 0
    blocks = values[: size * _BLOCKS].reshape(_BLOCKS, size)
    level = blocks.std(axis=1)
    least = greatest = level[0]
    count = 0
    for signal in level:
        least, greatest = min(least, signal), max(greatest, signal)
        if greatest > _STEADY * least or greatest > QUIET * values.std():
            break
        count += 1
    return count * size if count >= _FEWEST and count * size >= _SHORTEST else 0


def _rings(values: Floats) -> bool:
    """Whether an autoregression has a pole of a vibration, or there is nothing but rounding."""
    centred = values - values.mean()
    power = float(centred @ centred)
    if not power > 0.0:
        return False
    lags = np.array([centred[: len(centred) - lag] @ centred[lag:] for lag in range(_ORDER + 1)]) / power
    matrix = lags[np.abs(np.subtract.outer(np.arange(_ORDER), np.arange(_ORDER)))]
    weights = np.linalg.solve(matrix + 1e-9 * np.eye(_ORDER), lags[1:])
    poles = np.roots(np.concatenate([[1.0], -weights]))
    return bool(np.any((np.abs(poles) > _RESONANT) & (np.abs(poles.imag) > 1e-6)))
