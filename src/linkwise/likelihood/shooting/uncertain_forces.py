"""Applied forces whose channels have an unknown gain or delay: what acts where a channel shows gain * force(t - delay).

Over the delay a force is the polynomial through its values at Chebyshev's points, as what late sensors show of a base is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices


@dataclass(frozen=True, eq=False)
class UncertainForces:
    """f applied forces with unknown errors.

    Attributes
    ----------
    channels : tuple of str
        Their channels.
    ends : array of int, shape (f,)
        The masses that they act on; points of hosts from -3 down.
    rows : array of shape (f, n)
        How each acts on the masses, with the shapes that the structure states.
    points : array of int, shape (f,)
        Numbers of their points among those of the system, -1 for masses.
    gains, delays : array of int, shape (f,)
        Numbers of their unknown gains and delays, -1 for none.
    certain : array of shape (J, 5, n, K)
        What acts on the masses beside them at the points of every step, in N.
    coefficients : tuple of array of shape (J, 5, f, K)
        What the channels show there, in N; with delays, the coefficients of powers of the delay over its `unit`.
    unit : array of shape (K,)
        The largest delay in s for which these hold.
    """

    channels: tuple[str, ...]
    ends: Indices
    rows: Floats
    points: Indices
    gains: Indices
    delays: Indices
    certain: Floats
    coefficients: tuple[Floats, ...]
    unit: Floats

    def mapped(self, change: Callable[[Floats], Floats], unit: Floats) -> UncertainForces:
        """With each array over steps changed, and the `unit` (K',) of the segments then."""
        return replace(
            self,
            certain=change(self.certain),
            coefficients=tuple(map(change, self.coefficients)),
            unit=unit,
        )

    def part(self, segments: slice | Indices) -> UncertainForces:
        """The forces in some segments."""
        return self.mapped(lambda values: values[..., segments], self.unit[segments])

    def acting(self, gains: Floats, delays: Floats) -> tuple[Floats, Floats]:
        """(J, 5, f, K) the forces in N at gains (g,) and delays (l,) in s, and their rates; straight on beyond `unit`."""
        late = np.append(delays, 0.0)[self.delays, None] / self.unit
        factors = np.append(gains, 1.0)[self.gains, None]
        place = np.clip(late, -1.0, 1.0)
        value, slope = np.zeros_like(self.coefficients[0]), np.zeros_like(self.coefficients[0])
        for row in self.coefficients[::-1]:
            slope = slope * place + value
            value = value * place + row
        value += slope * (late - place)
        return value / factors, slope / (self.unit * factors)

    def on_masses(self, acting: Floats) -> Floats:
        """(J, 5, n, K) all forces on the masses, with those (J, 5, f, K) of the uncertain ones."""
        force = self.certain.copy()
        for number, row in enumerate(self.rows):
            for mass in np.flatnonzero(row).tolist():
                force[:, :, mass] += row[mass] * acting[:, :, number]
        return force
