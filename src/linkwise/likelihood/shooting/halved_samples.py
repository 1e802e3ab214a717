"""Every second sample in place of all of them, for what follows a search: the same products with smooth columns.

What motion shows is often smooth over several samples. A column c that even samples determine has the values P c' at all
samples, with an interpolation P and its values c' at the even ones, so that its product with residuals r is c' times P' r: a
low pass of the residuals. Its products with other such columns are sums over even samples, with the weights P' 1. Residuals
remain those of white noise in all samples; nothing is left out of them but what no smooth column sees.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Scales, Segments, V, X

_HALF = 8  # even samples on either side that an odd one is interpolated from
_BETA = 5.0  # of the Kaiser window: 0.3 % up to 0.8 of the Nyquist frequency of the even samples
_NEAR = 6  # even samples that odd ones near an end are interpolated from
_FEWEST = 4 * _HALF  # even samples of a record, between whose ends odd ones are interpolated
_SMOOTH = 0.06  # of the root mean square of a column: the error of its interpolation
_LEAST = 0.2  # of a sample: the weight of an even one, below which samples around it are missing


def _midway(nodes: int) -> Floats:
    """(nodes - 1, nodes) the polynomials (Lagrange) midway between each two of some nodes."""
    places = np.arange(nodes)
    others = places[:, None] != places
    middles = places[:-1, None, None] + 0.5
    factors = np.where(others, middles - places, 1.0) / np.where(others, places[:, None] - places, 1)
    return np.asarray(factors.prod(axis=2))


def _weights() -> tuple[Floats, Floats]:
    """What an odd sample has of the even ones around it, (2 h,), and each of the first odd ones of the first even ones."""
    places = np.arange(2 * _HALF) - _HALF + 0.5
    inside = np.sinc(places) * np.kaiser(2 * _HALF, _BETA)
    polynomials = _midway(_NEAR)
    before, most = _NEAR // 2 - 1, _HALF - 1
    at_end = np.zeros((most, most + _NEAR - 1 - before))
    for number in range(most):
        first = max(number - before, 0)
        at_end[number, first : first + _NEAR] = polynomials[number - first]
    return inside / inside.sum(), at_end


_INSIDE, _AT_END = _weights()


def halved(
    segments: Segments, misfit: Misfit, scales: Scales, loss: Loss, rough: Floats
) -> tuple[Segments, Misfit] | None:
    """Segments with every second sample, and steps of flow and tangents as before.

    Their samples, residuals and `counts` give the products of smooth columns, with residuals and with each other, that all
    samples give. Of a record with an even number of samples the last one is left out.

    Parameters
    ----------
    segments : Segments
        The segments.
    misfit : Misfit
        The motion and its residuals.
    scales : Scales
        The noise.
    loss : Loss
        Loss of a residual; its weights become part of `counts`.
    rough : array of shape (M, C, K)
        The roughest of the columns of each channel, in any unit.

    Returns
    -------
    tuple of (Segments, Misfit) or None
        None where a column is not smooth over two samples, where samples are missing inside a record, where sensors show
        more than displacements and velocities at their time, and for short records.
    """
    sensors, known = segments.sensors, segments.observed[::2]
    plain = np.isin(sensors.kind, (X, V)).all() and not sensors.delays and segments.waveforms is None
    if not plain or segments.random is not None or segments.clipped is not None or len(segments.samples) % 2:
        return None
    chains = list(_chains(segments))
    if min(stop for _, stop in chains) < 2 * _FEWEST or not _is_smooth(chains, rough):
        return None
    weight = loss.weight(misfit.residuals) * segments.observed
    both = _low_pass(chains, np.concatenate([weight, weight * misfit.residuals], axis=1))
    counts, residuals = np.split(both, 2, axis=1)
    if np.any(counts[known] < _LEAST) or np.any(counts[~known] != 0.0):
        return None
    np.divide(residuals, counts, out=residuals, where=known)
    unit = scales.sigma[:, None] * (1.0 if segments.relative_noise is None else segments.relative_noise)
    by_transitions = _linear_in_masses(segments)
    return replace(
        segments,
        samples=segments.samples[::2] + (residuals - misfit.residuals[::2]) * unit,
        observed=known,
        counts=counts,
        refine=2 * segments.refine,
        tangent_refine=segments.tangent_refine if by_transitions else 2 * segments.tangent_refine,
        by_transitions=by_transitions,
        carried=None if segments.carried is None else segments.carried[:, ::2],
    ), replace(misfit, residuals=residuals)


def _linear_in_masses(segments: Segments) -> bool:
    """Whether displacements of few masses are all that sensors show, and their motion all that sensitivities consist of."""
    system, sensors = segments.system, segments.sensors
    others = system.states or system.shapes is not None or sensors.shapes is not None
    plain = not others and segments.inputs.uncertain is None
    return plain and len(system.incidence) < MANY and bool(np.all(sensors.kind == X))


def _chains(segments: Segments) -> Iterator[tuple[slice, int]]:
    """The segments of each record, and how many samples there are up to the last one that any channel has."""
    edges = [0, *(np.flatnonzero(~segments.linked) + 1).tolist(), segments.count]
    for first, last in pairwise(edges):
        own = slice(first, last)
        samples = np.flatnonzero(segments.observed[..., own].any(axis=1).T)
        yield own, int(samples[-1]) + 1 if len(samples) else 0


def _series(values: Floats, own: slice) -> Floats:
    """(N, C) of values (M, C, K) in some segments that follow each other."""
    return values[..., own].transpose(2, 0, 1).reshape(-1, values.shape[1])


def _is_smooth(chains: list[tuple[slice, int]], values: Floats) -> bool:
    """Whether the even samples of values (M, C, K) determine the odd ones."""
    errors, power = np.zeros((2, values.shape[1]))
    for own, stop in chains:
        series = _series(values, own)[:stop]
        even, odd = series[::2], series[1::2][: (stop - 1) // 2]
        inside = _between(even)
        at_ends = (_AT_END @ part[: _AT_END.shape[1]] for part in (even, even[::-1]))
        left = odd - np.concatenate([next(at_ends), inside, next(at_ends)[::-1]])
        errors += np.sum(left**2, axis=0)
        power += np.sum(odd**2, axis=0)
    return bool(np.all(errors <= _SMOOTH**2 * power))


def _between(even: Floats) -> Floats:
    """(N - 2 h + 1, C) midway between each two of even samples (N, C) that are inside."""
    last, count = 2 * _HALF - 1, len(even) - 2 * _HALF + 1
    out = np.zeros((count, even.shape[1]))
    for first, tap in enumerate(_INSIDE[:_HALF]):  # which are symmetric
        out += tap * (even[first : first + count] + even[last - first : last - first + count])
    return out


def _low_pass(chains: list[tuple[slice, int]], values: Floats) -> Floats:
    """(M / 2, C, K) the sums of values (M, C, K), each given to the even samples that it is interpolated from."""
    M, C, K = values.shape
    out = np.zeros((K, M // 2, C))
    edge = len(_AT_END)
    for own, stop in chains:
        series = _series(values, own)[:stop]
        even = series[::2].copy()
        odd = series[1::2][: len(even) - 1]
        inner = odd[edge : len(odd) - edge]
        for first, tap in enumerate(_INSIDE[:_HALF]):
            weighed, last = tap * inner, 2 * _HALF - 1 - first
            even[first : first + len(inner)] += weighed
            even[last : last + len(inner)] += weighed
        even[: _AT_END.shape[1]] += _AT_END.T @ odd[:edge]
        even[::-1][: _AT_END.shape[1]] += _AT_END.T @ odd[::-1][:edge]
        out[own].reshape(-1, C)[: len(even)] = even
    return np.ascontiguousarray(out.transpose(1, 2, 0))
