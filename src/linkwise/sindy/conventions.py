"""Where the noise of a numerical study goes and where its derivatives come from: the paper does not say, and its Table 2
hangs on it.

Each convention turns the same clean record into the states that a regression reads. They differ by orders of magnitude:
noise in a displacement that is differentiated twice is multiplied by the square of the sampling rate, noise in the columns
of a library bends the coefficients by the square of its variance (errors in variables), and noise in the
derivatives alone averages out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from linkwise.errors import RecordError
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod, States, differentiate

Convention = Literal["displacement", "states", "differenced", "derivatives"]

CONVENTIONS: tuple[Convention, ...] = get_args(Convention)
"""Where `noisy_states` can put its noise, by name (METHODS section 3)."""
MEANING: dict[Convention, str] = {
    "displacement": "noise on every displacement, velocities and accelerations by differentiating it (the paper's steps 2 "
    "and 3)",
    "states": "noise on every displacement and velocity, accelerations exact",
    "differenced": "noise on every displacement and velocity, accelerations by central differences of fourth order of the "
    "noisy velocity",
    "derivatives": "displacements and velocities exact, noise on every acceleration (the paper's Eq. 2)",
}


def noisy_states(
    record: Record,
    convention: Convention,
    snr_db: float,
    *,
    seed: int,
    derivative: DifferentiationMethod = "spline",
) -> States:
    """States of a clean simulated record as a study of noise would see them.

    `record` must come from `simulate(..., sensors=("x", "v", "a"))`. White Gaussian noise is added at `snr_db` to
    each channel that the `convention` names, sigma^2 = mean(x^2) 10^(-dB/10) of that channel (METHODS section 2):

    - "displacement": noise on x; v and a are derived from it by the method `derivative` of `differentiate`;
    - "states": noise on x and v, a exact;
    - "differenced": noise on x and v; a by central differences of order 4 of the noisy v. Of the four it comes nearest to the
      paper's Table 2, with least squares and the reading "coefficients" of `monomial_force`;
    - "derivatives": noise on a; x and v exact. (The other derivative, x' = v, is a state at the same time and is exact.)

    A channel's noise depends on `seed` and its name alone, so conventions share it. Raises RecordError for a record
    that is measured, noisy or without one of the sensors, and for a convention that does not exist.
    """
    if convention not in CONVENTIONS:
        listed = "; ".join(f'"{name}": {meaning}' for name, meaning in MEANING.items())
        raise RecordError(f"{convention!r} is no convention for noise; there are {listed}")
    _require_clean(record)
    noisy = {"displacement": "x", "states": "xv", "differenced": "xv", "derivatives": "a"}[convention]
    seen = record.select([name for name in record.responses if name[0] in noisy]).with_noise(
        snr_db, seed=seed
    )
    if convention in ("displacement", "differenced"):
        inputs = [record.channel(name) for name in record.inputs]
        channels = (*seen.channels, *record.inputs)
        seen = replace(record, channels=channels, values=np.column_stack([seen.values, *inputs]))
        return differentiate(seen, derivative if convention == "displacement" else "differences", order=4)
    values = record.values.copy()
    values[:, [record.channels.index(name) for name in seen.channels]] = seen.values
    return differentiate(replace(record, values=values))


def _require_clean(record: Record) -> None:
    if record.simulated is None:
        raise RecordError(
            "a study of noise starts from a simulated record, whose truth is known; this one was measured"
        )
    added = [name for name, sigma in record.simulated.noise.items() if sigma > 0]
    if added:
        raise RecordError(
            "has noise already; give the record as it was simulated, and the noise is added here",
            channel=added[0],
        )
    for mass in record.simulated.structure.mass_names:
        for kind in "xva":
            if f"{kind}:{mass}" not in record.channels:
                raise RecordError(
                    "is not in the record, and a convention needs displacement, velocity and acceleration of every mass; "
                    'simulate with sensors=("x", "v", "a")',
                    channel=f"{kind}:{mass}",
                )
