"""Colours and number scales that all figures share, still and interactive."""

from __future__ import annotations

import math

# Okabe and Ito: told apart with any kind of colour vision, and in grey.
IDENTIFIED = "#0072B2"
TRUE = "#000000"
MEASURED = "#8C8C8C"
WELL = "#D55E00"
VISITED = "#E8EEF4"
CHAOS = "#F3EDE4"  # behind a motion that is one of many
SERIES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")

_PREFIXES = {3: "G", 2: "M", 1: "k", 0: "", -1: "m", -2: "µ", -3: "n"}


def scale(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit that bring numbers up to `largest` (in `unit`) between 1 and 1000: (1000.0, "mm") for 0.02 m.

    Units that begin with a power or a quotient take the prefix on their first symbol, as in mm/s. Numbers without a unit, or
    whose unit is open ("?"), stay as they are.
    """
    if unit in ("", "?"):
        return 1.0, ""
    if not (largest > 0.0 and math.isfinite(largest)):
        return 1.0, unit
    thousands = min(3, max(-3, math.floor(math.log10(largest * (1 + 1e-12)) / 3)))
    return 1000.0**-thousands, _PREFIXES[thousands] + unit
