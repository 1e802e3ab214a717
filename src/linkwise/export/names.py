"""Names in other languages for what has names of its own here."""

from __future__ import annotations

import re
from collections.abc import Iterable

_LONGEST = 50  # characters: MATLAB takes 63, and prefixes are added


def identifiers(names: Iterable[str], reserved: Iterable[str]) -> dict[str, str]:
    """A name of ASCII letters, digits and underscores for each, no two alike and none of those `reserved`."""
    used, chosen = set(reserved), {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name).lstrip("_")[:_LONGEST] or "unnamed"
        plain = f"n{plain}" if plain[0].isdigit() else plain
        unique, number = plain, 1
        while unique in used:
            number += 1
            unique = f"{plain}_{number}"
        used.add(unique)
        chosen[name] = unique
    return chosen
