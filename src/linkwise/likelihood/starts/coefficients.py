"""Coefficients from forces on motions that are known up to a line in every window.

A law is fitted to the forces of all windows together, while each window is free to shift and tilt its elongation. The first
guess takes what is slow out of the elongation, for there a law is linear in its coefficients; then every window looks for its
best line under the law, anew on a grid, and the law is corrected with the lines eliminated (variable projection, Golub and
Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.drift_windows import DriftWindows, drift_candidates
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals, highpassed, link_signals, window_half
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_PERIODS = 1.5  # that a window spans: long enough to tell the coefficients apart
_CUTS = (2.0, 5.0, 10.0)  # Hz, below which a first guess takes motion for drift
_ROUNDS = 12
_SETTLED = 1e-3  # of the cost


def link_start(
    seen: LinkSignals,
    number: int,
    link: Link,
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> dict[str, float]:
    """The coefficients `free` (the law is jointly linear in them) of a link whose others are `values`."""
    half = window_half(seen, number, _PERIODS)
    windows = DriftWindows.of(seen, number, half=half, stride=half)
    tried = []
    for cut in _CUTS:
        d, v = (highpassed(each[number], 1.0 / seen.step, cut) for each in (seen.d, seen.v))
        guess = dict(
            zip(
                free,
                _regressed(link, d, v, seen.force[number], values, free),
                strict=True,
            )
        )
        tried.append(_improved(windows, link, dict(values) | guess, free))
    return min(tried, key=lambda each: each[0])[1]


def _regressed(
    link: Link,
    d: Floats,
    v: Floats,
    force: Floats,
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> Floats:
    found = link.law.partials(d, v, dict(values) | dict.fromkeys(free, 0.0))
    columns = np.stack([np.broadcast_to(found.by_coefficient[name], d.shape) for name in free], axis=1)
    return _least_squares(columns, force - found.force)


def _least_squares(columns: Floats, right: Floats) -> Floats:
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), np.finfo(float).tiny)
    return np.asarray(np.linalg.lstsq(columns / size, right, rcond=None)[0] / size)


def _improved(
    windows: DriftWindows, link: Link, values: dict[str, float], free: tuple[str, ...]
) -> tuple[float, dict[str, float]]:
    """Squared force error and coefficients after the rounds."""
    best, best_values = np.inf, values
    for _ in range(_ROUNDS):
        lines = drift_candidates(windows, link, values)
        pick = lines.cost.argmin(axis=0)
        line = lines.lines[:, pick, np.arange(len(pick))]
        cost = float(lines.cost.min(axis=0).sum())
        if cost < best:
            settled = cost > (1.0 - _SETTLED) * best
            best, best_values = cost, values
            if settled:
                break
        else:
            break
        step = _projected_step(windows, link, values, free, line)
        values = values | {name: values[name] + change for name, change in zip(free, step, strict=True)}
    return best, {name: best_values[name] for name in free}


def _projected_step(
    windows: DriftWindows,
    link: Link,
    values: dict[str, float],
    free: tuple[str, ...],
    line: Floats,
) -> Floats:
    """The Gauss-Newton step of the coefficients with the lines of all windows eliminated."""
    d, v = windows.motion(line)
    found = link.law.partials(d, v, values)
    error = windows.force - found.force
    columns = np.stack([np.broadcast_to(found.by_coefficient[name], d.shape) for name in free], axis=2)
    own = [np.broadcast_to(found.by_d, d.shape)]
    if windows.integration_order > 1:
        own.append(own[0] * windows.time + found.by_v)
    if windows.integration_order:
        q, _ = np.linalg.qr(np.stack(own, axis=2))
        columns = columns - q @ (q.transpose(0, 2, 1) @ columns)
        error = error - (q @ (q.transpose(0, 2, 1) @ error[..., None]))[..., 0]
    return _least_squares(columns.reshape(-1, len(free)), error.ravel())


def law_start(
    record: Record, structure: Structure, sigma: dict[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Every parameter of a `structure` whose links the record tells; `given` are starts, needed for what is not linear."""
    seen = link_signals(record, structure, sigma)
    found: dict[str, list[float]] = {parameter.name: [] for parameter in structure.parameters}
    names = {member: parameter.name for parameter in structure.parameters for member in parameter.members}
    for number, link in enumerate(structure.links):
        free = tuple(name for name in link.law.coefficients if (number, name) in names)
        if not free:
            continue
        values = {
            name: float(each.value) for name, each in link.coefficients.items() if each.value is not None
        }
        values |= {name: given[names[number, name]] for name in free if names[number, name] in given}
        lost = [name for name in free if name not in values and name not in link.law.linear]
        if lost:
            raise IdentificationError(
                f'the law "{link.law}" of {link.name} is not linear in {", ".join(lost)}, which therefore needs a start'
            )
        for name, value in link_start(seen, number, link, values, free).items():
            found[names[number, name]].append(value)
    return {name: float(np.mean(each)) for name, each in found.items()}
