"""What the paper prints, to stand beside what is found here.

Liu, Li and Jiang, "On efficiency and accuracy of sparse identification of bistable nonlinear energy sink chains" (2024).
"""

from __future__ import annotations

from itertools import product

MASSES = (2, 4, 6, 8, 10)
DECIBELS = (40.0, 30.0, 20.0)  # signal to noise, as the paper lists them

_ROWS = (
    (0.0018, 0.0027, 0.0039, 0.0358, 0.6450),
    (0.0331, 0.1128, 0.4716, 2.3555, 9.7115),
    (2.1564, 5.8351, 9.0256, 30.3485, 63.0856),
)

TABLE_2 = {
    (masses, decibel): value
    for (decibel, masses), value in zip(product(DECIBELS, MASSES), sum(_ROWS, ()), strict=True)
}
"""NMSE in % of the sink's force (Eq. 8) by number of masses and dB: SINDy with all monomials up to the third order."""

INFORMED_NMSE = 0.5
"""NMSE in % that physics-informed SINDy keeps "around" at 20 dB for every number of masses (section 5, Fig. 9a)."""

INFORMED_SECONDS = dict(zip(MASSES, (0.9, 1.7, 2.9, 5.1, 12.3), strict=True))
"""Computing time in s of physics-informed SINDy by number of masses (section 5, Fig. 9b)."""

DURATION, RATE = 6.0, 1000.0
"""Length in s and samples per second of every record (section 4)."""


def start(masses: int) -> dict[str, float]:
    """The release of the first mass in m/s (section 4; what it writes for eight masses serves from four on)."""
    return {"v:m1": 1.0 if masses == 2 else 3.0}
