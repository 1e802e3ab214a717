"""Links that supply energy to the motion by more than their uncertainty, which no spring or damper does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.structure import Link

_SIGNIFICANT = 3.0  # standard errors of the mean power: by chance once in 740 links that dissipate nothing


def supplied_power(link: Link, free: Sequence[str], covariance: Floats, d: Floats, v: Floats) -> float | None:
    """Mean power that a link supplies to the motion, where that is significant.

    The force at v = 0 is left out, since a spring returns the energy it stores.

    Parameters
    ----------
    link : Link
        The link, all coefficients numbers.
    free : sequence of str
        Names of its q unknown coefficients.
    covariance : array of shape (q, q)
        Their covariance.
    d, v : array of shape (R,)
        Elongations in m and rates in m/s.

    Returns
    -------
    float or None
        Mean power in W; None unless it is above three standard errors.
    """
    moving, resting = (link.law.partials(d, rate, link.values) for rate in (v, np.zeros_like(v)))
    power = float(np.nanmean((moving.force - resting.force) * v))
    slopes = np.array(
        [np.nanmean((moving.by_coefficient[name] - resting.by_coefficient[name]) * v) for name in free]
    )
    deviation = float(np.sqrt(max(float(slopes @ covariance @ slopes), 0.0)))
    return -power if deviation > 0.0 and power < -_SIGNIFICANT * deviation else None
