"""Starting values of coefficients from forces, where elongations are known up to drift.

A law is fitted to the forces of all windows together, while a line may be added to the elongation in each window. A first
guess comes from high-pass filtered elongations, for which the law is linear in its coefficients. Then each window finds its
best line under the law by grid search, and the law is corrected with the lines eliminated (variable projection).

References
----------
G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.drift_windows import DriftWindows, drift_candidates
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals, link_signals, window_half
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import highpass

_PERIODS = 1.5  # length of a window: long enough to separate the coefficients
_CUTOFFS = (2.0, 5.0, 10.0)  # Hz, below which a first guess treats motion as drift
_ROUNDS = 12
_TOLERANCE = 1e-3  # of the cost


def link_start(
    signals: LinkSignals,
    number: int,
    link: Link,
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> dict[str, float]:
    """Starting values of coefficients in which the law of a link is jointly linear.

    Parameters
    ----------
    signals : LinkSignals
        Signals of all links.
    number : int
        Index of the link.
    link : Link
        The link.
    values : mapping of str to float
        Values of the other coefficients.
    free : tuple of str
        Names of the coefficients.

    Returns
    -------
    dict of str to float
        Starting values by name.
    """
    half = window_half(signals, number, _PERIODS)
    windows = DriftWindows.of(signals, number, half=half, stride=half)
    trials = []
    for cutoff in _CUTOFFS:
        d, v = (highpass(signal[number], 1.0 / signals.step, cutoff) for signal in (signals.d, signals.v))
        start = dict(values) | _regressed(link, d, v, signals.force[number], values, free)
        trials.append(_improved(windows, link, start, free))
    return min(trials, key=lambda trial: trial[0])[1]


def _regressed(
    link: Link,
    d: Floats,
    v: Floats,
    force: Floats,
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> dict[str, float]:
    """The free coefficients in which the law is linear, by least squares on the forces (N,); others keep their values."""
    linear = [name for name in free if name in link.law.linear]
    if not linear:
        return {}
    partials = link.law.partials(d, v, dict(values) | dict.fromkeys(linear, 0.0))
    columns = np.stack([np.broadcast_to(partials.by_coefficient[name], d.shape) for name in linear], axis=1)
    solved = _least_squares(columns, force - partials.force)
    return dict(zip(linear, map(float, solved), strict=True))


def _least_squares(columns: Floats, right: Floats) -> Floats:
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), np.finfo(float).tiny)
    return np.asarray(np.linalg.lstsq(columns / size, right, rcond=None)[0] / size)


def _improved(
    windows: DriftWindows, link: Link, values: dict[str, float], free: tuple[str, ...]
) -> tuple[float, dict[str, float]]:
    """Squared force error and free coefficients after alternating between lines and coefficients."""
    best, best_values = np.inf, values
    for _ in range(_ROUNDS):
        candidates = drift_candidates(windows, link, values)
        cost = float(candidates.cost.min(axis=0).sum())
        if cost >= best:
            break
        converged = cost > (1.0 - _TOLERANCE) * best
        best, best_values = cost, values
        if converged:
            break
        lowest = candidates.cost.argmin(axis=0)
        lines = candidates.lines[:, lowest, np.arange(len(lowest))]
        step = _projected_step(windows, link, values, free, lines)
        values = values | {name: values[name] + change for name, change in zip(free, step, strict=True)}
    return best, {name: best_values[name] for name in free}


def _projected_step(
    windows: DriftWindows,
    link: Link,
    values: dict[str, float],
    free: tuple[str, ...],
    lines: Floats,
) -> Floats:
    """The Gauss-Newton step (p,) of the coefficients with the lines (2, K) of all windows eliminated."""
    d, v = windows.motion(lines)
    partials = link.law.partials(d, v, values)
    error = windows.force - partials.force
    columns = np.stack([np.broadcast_to(partials.by_coefficient[name], d.shape) for name in free], axis=2)
    by_line = [np.broadcast_to(partials.by_d, d.shape)]
    if windows.integration_order > 1:
        by_line.append(by_line[0] * windows.time + partials.by_v)
    if windows.integration_order:
        q, _ = np.linalg.qr(np.stack(by_line, axis=2))
        columns = columns - q @ (q.transpose(0, 2, 1) @ columns)
        error = error - (q @ (q.transpose(0, 2, 1) @ error[..., None]))[..., 0]
    return _least_squares(columns.reshape(-1, len(free)), error.ravel())


def law_start(
    record: Record, structure: Structure, sigma: dict[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Starting values of all parameters of a structure whose links the record determines.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : dict of str to float
        Standard deviations of the noise by channel.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    dict of str to float
        Starting values by name of the parameter.

    Raises
    ------
    IdentificationError
        If a coefficient that enters its law nonlinearly has no starting value.
    """
    signals = link_signals(record, structure, sigma)
    return start_of_links(signals, structure, given, range(len(structure.links)))


def start_of_links(
    signals: LinkSignals, structure: Structure, given: Mapping[str, float], numbers: Iterable[int]
) -> dict[str, float]:
    """Starting values of the parameters of some links of a structure, from their signals.

    Parameters
    ----------
    signals : LinkSignals
        Signals of the links.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.
    numbers : iterable of int
        The links.

    Returns
    -------
    dict of str to float
        Starting values by name of the parameter.

    Raises
    ------
    IdentificationError
        If a coefficient that enters its law nonlinearly has no starting value.
    """
    by_parameter: dict[str, list[float]] = {}
    names = {member: parameter.name for parameter in structure.parameters for member in parameter.members}
    for number in numbers:
        link = structure.links[number]
        free = tuple(name for name in link.law.coefficients if (number, name) in names)
        if not free:
            continue
        values = {
            name: float(coefficient.value)
            for name, coefficient in link.coefficients.items()
            if coefficient.value is not None
        }
        values |= {name: given[names[number, name]] for name in free if names[number, name] in given}
        missing = [name for name in free if name not in values and name not in link.law.linear]
        if missing:
            raise IdentificationError(
                f'link "{link.name}": the law {link.law} is not linear in {", ".join(missing)}, which needs a start: write '
                f"{missing[0]} = {{ start = ... }} among its coefficients"
            )
        for name, value in link_start(signals, number, link, values, free).items():
            by_parameter.setdefault(names[number, name], []).append(value)
    return {name: float(np.mean(values)) for name, values in by_parameter.items()}
