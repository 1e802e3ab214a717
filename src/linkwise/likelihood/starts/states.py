"""Where annealing starts: states at the nodes from the sensors, and the scale on which a defect is natural.

What a mass shows decides: a displacement is smoothed and differentiated, a velocity smoothed and integrated once, an
acceleration twice, with the drift of the sums taken out. A mass without a sensor starts at rest; annealing moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.drift_tracking import elongations_from_forces
from linkwise.likelihood.starts.inverse_dynamics import (
    DRIFT,
    determines_links,
    highpassed,
    link_signals,
    masses_from_links,
    smoothed,
    summed,
)
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_UNSEEN = 0.1  # of the motion of the seen masses: how far a node of a hidden mass is free to move at q = 1


@dataclass(frozen=True, eq=False)
class StartStates:
    """Displacements and velocities (n, N) of all masses, `sigma` (n,) of what their sensor makes of both, (2n,)."""

    x: Floats
    v: Floats
    scale: Floats


def start_states(record: Record, structure: Structure, sigma: dict[str, float], samples: int) -> StartStates:
    """The motion as the sensors tell it. `samples` is the length of a segment, over which a velocity defect builds up.

    Where `structure` has all its numbers and every mass a sensor, what velocities and accelerations do not tell of the place
    is read from the forces (`inversion`).
    """
    kinds = {
        name: [kind for kind in "xva" if f"{kind}:{name}" in record.channels] for name in structure.mass_names
    }
    x, v = _told(record, structure, sigma, kinds)
    scale = np.full((2, structure.size), np.nan)
    reach = np.sqrt(samples) / 4.0
    for i, name in enumerate(structure.mass_names):
        if not kinds[name]:
            continue
        channel = f"{kinds[name][0]}:{name}"
        ratio = max(sigma[channel] / np.sqrt(np.nanmean(record.channel(channel) ** 2)), 1e-12)
        seen = kinds[name][0] == "x"
        scale[0, i] = sigma[channel] if seen else ratio * _rms(x[i])
        scale[1, i] = sigma[channel] * record.rate * reach if seen else ratio * _rms(v[i])
    hidden = np.isnan(scale[0])
    for order, motion in enumerate((x, v)):
        scale[order, hidden] = _UNSEEN * np.sqrt(np.mean(motion[~hidden] ** 2))
    return StartStates(x, v, scale.ravel())


def _told(
    record: Record,
    structure: Structure,
    sigma: dict[str, float],
    kinds: dict[str, list[str]],
) -> tuple[Floats, Floats]:
    """Displacements and velocities (n, N), zero for masses without a sensor."""
    lost = any(kinds[name][:1] in (["v"], ["a"]) for name in structure.mass_names)
    if lost and determines_links(record, structure) and _numbered(structure):
        seen = link_signals(record, structure, sigma)
        return masses_from_links(record, structure, *elongations_from_forces(seen, structure.links))
    x, v = (
        np.zeros((structure.size, len(record))),
        np.zeros((structure.size, len(record))),
    )
    for i, name in enumerate(structure.mass_names):
        if not kinds[name]:
            continue
        seen_by = {kind: smoothed(record, f"{kind}:{name}", sigma) for kind in kinds[name]}
        if "v" in seen_by:
            v[i] = seen_by["v"][0]
        elif "x" in seen_by:
            v[i] = seen_by["x"][1]
        else:
            v[i] = highpassed(summed(seen_by["a"][0], record.step), record.rate, DRIFT)
        if "x" in seen_by:
            x[i] = seen_by["x"][0]
        else:
            total = summed(v[i], record.step)
            x[i] = total if "v" in seen_by else highpassed(total, record.rate, DRIFT)
    return x, v


def _numbered(structure: Structure) -> bool:
    return all(
        structure.coefficient(f"{link.name}.{name}").value is not None
        for link in structure.links
        for name in link.coefficients
    )


def segment_nodes(states: Sequence[StartStates], samples: int) -> Floats:
    """(2, n, K) the states at the first sample of every segment, record after record."""
    return np.concatenate(
        [np.stack([each.x[:, ::samples], each.v[:, ::samples]]) for each in states],
        axis=2,
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
