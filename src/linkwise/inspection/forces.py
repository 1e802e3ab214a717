"""Which mass a recorded force acts on, by Newton's law over times in which links cannot answer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.records.record import Record

_NEAR, _FAR = 0.3, 0.3  # of the mass: how far the one is from it, and the others from none
_ERROR = 0.1  # of the mass
_LONGEST = 64  # samples on either side
_HARD = 0.3  # of the largest force: where it outweighs that of the links


def driven_mass(record: Record, force: str, masses: Mapping[str, float]) -> str | None:
    """The mass on which a force acts.

    Over twice the time T, x(t + T) - 2 x(t) + x(t - T) is the acceleration of a mass in a triangular window, and so are the
    differences of its velocity; under the same window the force is that acceleration times the mass on which it acts, and
    not of the others, while T is short against the periods of the links.

    Parameters
    ----------
    record : Record
        A record with the force and a motion of each mass.
    force : str
        The channel of the force.
    masses : mapping of str to float
        Masses in kg by name.

    Returns
    -------
    str or None
        The mass; None where the record does not tell, as with a slow force.
    """
    responses = {name: record.motions_of(name) for name in masses}
    if not all(responses.values()) or np.isnan(record.channel(force)).any():
        return None
    half = 1
    while half <= min(_LONGEST, len(record) // 8):
        found = {name: _share(record, force, responses[name][0], masses[name], half) for name in masses}
        if all(error < _ERROR for _, error in found.values()):
            driven = [name for name, (share, _) in found.items() if abs(share - 1.0) < _NEAR]
            idle = [name for name, (share, _) in found.items() if abs(share) < _FAR]
            return driven[0] if len(driven) == 1 and len(driven) + len(idle) == len(found) else None
        half *= 2
    return None


def _share(record: Record, force: str, motion: str, mass: float, half: int) -> tuple[float, float]:
    """Mass times acceleration over the force, where it is large, and the standard error of that."""
    kind, values = motion.partition(":")[0], record.channel(motion)
    triangle = np.concatenate([np.arange(1.0, half + 1.0), np.arange(half - 1.0, 0.0, -1.0)]) * record.step**2
    inner = slice(1, len(values) - 2 * half + 1)
    pushed = np.convolve(record.channel(force), triangle, "valid")[inner]
    if kind == "x":
        moved = values[2 * half :] - 2.0 * values[half:-half] + values[: -2 * half]
    elif kind == "v":
        moved = np.convolve(values[half:] - values[:-half], np.full(half, record.step), "valid")[inner]
    else:
        moved = np.convolve(values, triangle, "valid")[inner]
    pushed, moved = pushed[: len(moved)] - np.median(pushed), mass * (moved - np.nanmedian(moved))
    hard = (np.abs(pushed) > _HARD * np.max(np.abs(pushed))) & ~np.isnan(moved)
    power = float(np.sum(pushed[hard] ** 2))
    if not power > 0.0:
        return 0.0, np.inf
    share = float(pushed[hard] @ moved[hard]) / power
    rest = float(np.mean((moved[hard] - share * pushed[hard]) ** 2))
    alike = {"x": 2.0, "v": 1.0 * half, "a": 2.0 * half}[kind]  # neighbours with the same noise
    return share, float(np.sqrt(alike * rest / power))
