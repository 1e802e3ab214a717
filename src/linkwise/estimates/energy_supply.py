"""Links that give energy to the motion beyond doubt, as no spring or damper does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.structure import Link

_SIGNIFICANT = 3.0  # standard errors of the mean power: by chance once in 740 links that dissipate nothing


def supplied_power(link: Link, free: Sequence[str], covariance: Floats, d: Floats, v: Floats) -> float | None:
    """Mean power in W that `link` gives to its ends on the way d (R,) m, v (R,) m/s; None where it may give none.

    `covariance` (q, q) is that of the coefficients named `free` (q,). The force at rest counts for nothing: a spring gives
    back what it took.
    """
    moving, resting = (link.law.partials(d, rate, link.values) for rate in (v, np.zeros_like(v)))
    power = float(np.nanmean((moving.force - resting.force) * v))
    slopes = np.array(
        [np.nanmean((moving.by_coefficient[name] - resting.by_coefficient[name]) * v) for name in free]
    )
    deviation = float(np.sqrt(max(float(slopes @ covariance @ slopes), 0.0)))
    return -power if deviation > 0.0 and power < -_SIGNIFICANT * deviation else None
