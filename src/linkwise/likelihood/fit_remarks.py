"""Sentences on what a fit found beside the coefficients: random forces, errors of sensors, other optima."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.low_signal import is_loosened
from linkwise.records.channel import Channel

_LOOSENED = (
    "If the motion had to follow the laws exactly, noise would leave the likelihood many optima, of which a search finds one. "
    "The motion was let depart from the laws by a small part of the noise, and the intervals are wider for that."
)


def fit_remarks(
    fit: LikelihoodFit, delays: Mapping[str, float], faint: Sequence[str] = ()
) -> tuple[str, ...]:
    """What was found beside the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    delays : mapping of str to float
        Delays in s that were found by channel.
    faint : sequence of str, optional
        Frequencies of modes that the record hardly shows.

    Returns
    -------
    tuple of str
        Sentences on random forces, on sensors, with standard errors, and on other values that are as likely.
    """
    texts = [
        *(
            f"{name} is off by {value:.4g} throughout (estimated with the other unknowns"
            for name, value in fit.offsets.items()
        ),
        *(
            f"{name} shows {value:.6g} of its motion (estimated with the other unknowns"
            for name, value in fit.gains.items()
        ),
        *(
            f"{name} is late by {1e3 * value:.4g} ms (estimated with the other unknowns"
            for name, value in delays.items()
        ),
    ]
    units = [""] * (len(fit.offsets) + len(fit.gains)) + [" ms"] * len(delays)
    deviations = fit.sensor_deviations * np.where([bool(unit) for unit in units], 1e3, 1.0)
    of_sensors = [
        f"{text}, standard error {deviation:.2g}{unit})."
        for text, deviation, unit in zip(texts, deviations, units, strict=True)
    ]
    names = fit.segments.system.parameters.names
    tied = [
        "Another set of values explains the records as well: "
        f"{', '.join(f'{name} = {value:.4g}' for name, value in zip(names, values, strict=True))}."
        for values in fit.others
    ]
    loosened = [_LOOSENED] if is_loosened(fit) else []
    return (
        *(force.description for force in fit.random_forces),
        *of_sensors,
        *_disturbances(fit),
        *loosened,
        *tied,
        *map(_of_faint_mode, faint),
    )


def _disturbances(fit: LikelihoodFit) -> Iterator[str]:
    """What was found of drifts and hums."""
    first = 0
    for disturbance in fit.disturbances:
        sizes, deviations = fit.waveforms[:, first : first + disturbance.count]
        yield disturbance.describe(sizes, deviations, Channel.parse(disturbance.channel).unit)
        first += disturbance.count


def _of_faint_mode(name: str) -> str:
    return f"{name} is hardly determined by the record, whose noise hides the mode: its interval is what was known beforehand."
