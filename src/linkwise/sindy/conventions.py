"""Noise conventions of a numerical study: which quantities carry noise and how the derivatives are formed.

The paper does not state either, and its Table 2 depends on both. Each convention turns the same noise-free record into the
states that a regression uses. They differ by orders of magnitude: differentiating a noisy displacement twice multiplies the
noise by the square of the sampling rate, noise in the columns of a library biases the coefficients in proportion to its
variance (errors in variables), and noise in the derivatives alone averages out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from linkwise.errors import RecordError
from linkwise.records.record import Record
from linkwise.signals.states import States, differentiate

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
) -> States:
    """States of a noise-free simulated record with synthetic noise under a convention.

    White Gaussian noise is added to each channel that the convention names. Its variance is mean(x^2) 10^(-snr_db / 10) of
    that channel, and its samples depend on the seed and the name of the channel alone, so that conventions share them.

    Parameters
    ----------
    record : Record
        A record of ``simulate(..., sensors=("x", "v", "a"))`` without noise.
    convention : {"displacement", "states", "differenced", "derivatives"}
        "displacement" adds noise to x and derives v and a from it; "states" adds noise to x and v and leaves a exact;
        "differenced" adds noise to x and v and forms a by central differences of order 4 of the noisy v; "derivatives" adds
        noise to a and leaves x and v exact. With least squares and the reading "coefficients" of `monomial_force`,
        "differenced" comes nearest to the paper's Table 2.
    snr_db : float
        Signal-to-noise ratio in dB.
    seed : int
        Seed of the noise.

    Returns
    -------
    States
        Displacements in m, velocities in m/s and accelerations in m/s^2, each of shape (N, n).

    Raises
    ------
    RecordError
        If the record was measured, has noise or lacks a sensor, or the convention is unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> lw.sindy.noisy_states(record, "differenced", 30.0, seed=1).a.shape
    (1001, 2)
    """
    if convention not in CONVENTIONS:
        listed = "; ".join(f'"{name}": {meaning}' for name, meaning in MEANING.items())
        raise RecordError(f"unknown noise convention {convention!r}; choose from {listed}")
    _require_clean(record)
    noisy = {"displacement": "x", "states": "xv", "differenced": "xv", "derivatives": "a"}[convention]
    named = [name for name in record.responses if name[0] in noisy]
    noisy_record = record.select(named).with_noise(snr_db, seed=seed)
    if convention in ("displacement", "differenced"):
        channels = (*noisy_record.channels, *record.inputs)
        values = np.column_stack([noisy_record.values, *map(record.channel, record.inputs)])
        noisy_record = replace(record, channels=channels, values=values, uncertainty={})
        return differentiate(noisy_record, "spline" if convention == "displacement" else "differences")
    values = record.values.copy()
    values[:, [record.channels.index(name) for name in noisy_record.channels]] = noisy_record.values
    return differentiate(replace(record, values=values))


def _require_clean(record: Record) -> None:
    if record.simulated is None:
        message = "a study of noise needs a simulated record, whose noise-free motion is known; this one was measured"
        raise RecordError(message)
    added = [name for name, sigma in record.simulated.noise.items() if sigma > 0]
    if added:
        message = (
            "has noise already; give the record as it was simulated, since `noisy_states` adds the noise"
        )
        raise RecordError(message, channel=added[0])
    for mass in record.simulated.structure.mass_names:
        for kind in "xva":
            if f"{kind}:{mass}" not in record.channels:
                raise RecordError(
                    "is not in the record; displacement, velocity and acceleration of every mass are needed: "
                    'simulate with sensors=("x", "v", "a")',
                    channel=f"{kind}:{mass}",
                )
