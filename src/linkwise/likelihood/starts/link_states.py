"""States of links along a motion: measured where a channel shows them, else integrated with the laws as they are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from linkwise.arrays import Bools, Floats
from linkwise.model.law import Law
from linkwise.model.law_programs import rates_program
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.integrate import smoothed

_HIDDEN = 0.1  # of its own size: the scale of a defect of a state that no channel shows, at q = 1
_PERIODS = 4.0  # of the motion after which a state has forgotten where it started
_SHORTEST = 32  # samples of a piece
_NUDGE, _GROWN = 1e-6, 10.0  # change of a state at the start, and by which factor it may have grown


def link_states(
    record: Record, structure: Structure, sigma: Mapping[str, float], x: Floats, v: Floats
) -> tuple[Floats, Floats]:
    """States (S, N) of links, as in `System.states`, along displacements and velocities (n, N); their scales (S,)."""
    if not structure.topology.states:
        return np.empty((0, len(record))), np.empty(0)
    d, rate = link_motion(record, structure, x, v)
    values, sizes = [], []
    for law, numbers in structure.topology.by_law:
        if not law.states:
            continue
        inside = [
            follow_states(law, structure.links[k].values, d[:, k], rate[:, k], record.step)[:, 0]
            for k in numbers.tolist()
        ]
        for row, name in enumerate(law.states):
            for states, k in zip(inside, numbers.tolist(), strict=True):
                channel = f"state:{structure.links[k].name}.{name}"
                measured = channel in record.channels
                state = smoothed(record, channel, sigma[channel])[0] if measured else states[row]
                values.append(state)
                size = float(np.sqrt(np.mean(state**2))) or 1.0
                sizes.append(sigma[channel] if measured else _HIDDEN * size)
    return np.array(values).reshape(-1, len(record)), np.array(sizes)


def link_motion(record: Record, structure: Structure, x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Elongations in m and rates in m/s (N, L) of the links, from displacements and velocities (n, N)."""
    base = None
    if np.any(structure.base_incidence):  # without a channel, the motion is relative to the base
        base = record.channel("x:base") if "x:base" in record.channels else np.zeros(len(record))
    speed = None if base is None else np.gradient(base, record.step)
    return structure.elongations(x.T, base), structure.elongations(v.T, speed)


@np.errstate(all="ignore")  # states may run away where values are far off
def follow_states(
    law: Law,
    values: Mapping[str, float | Floats],
    d: Floats,
    v: Floats,
    step: float,
    batch: int = 1,
    start: float = 0.0,
) -> Floats:
    """States (r, B, N) of a link along its elongation and rate (N,), by the Runge-Kutta method of order 4.

    `values` are numbers, or (B, 1) for a `batch` of B links.

    The record is cut into pieces that run side by side; each begins at `start` some periods before the samples it gives.
    """
    if not law.states:
        return np.empty((0, batch, len(d)))
    size = np.sqrt(np.mean(v**2))
    period = 2.0 * np.pi * np.sqrt(np.mean((d - d.mean()) ** 2)) / (size * step) if size > 0.0 else 0.0
    piece = max(_SHORTEST, min(int(_PERIODS * period) + 1, len(d)))
    count = -(-len(d) // piece)
    lead = np.full(piece, d[0]), np.zeros(piece)
    tail = np.full(count * piece - len(d), d[-1]), np.zeros(count * piece - len(d))
    run_d = np.concatenate([lead[0], d, tail[0]])
    run_v = np.concatenate([lead[1], v, tail[1]])
    along_d, along_v = (sliding_window_view(run, 2 * piece)[::piece].T.copy() for run in (run_d, run_v))
    middle_d, middle_v = (0.5 * (along[:-1] + along[1:]) for along in (along_d, along_v))
    out = np.empty((len(law.states), batch, count, piece))
    states = np.full((len(law.states), batch, count), start)
    rates = _Rates(law, values, states)
    first, second, third, fourth = np.empty((4, *states.shape))
    for number in range(2 * piece - 1):
        if number >= piece:
            out[..., number - piece] = states
        rates.after(states, first, 0.0, along_d[number], along_v[number], first)
        rates.after(states, first, 0.5 * step, middle_d[number], middle_v[number], second)
        rates.after(states, second, 0.5 * step, middle_d[number], middle_v[number], third)
        rates.after(states, third, step, along_d[number + 1], along_v[number + 1], fourth)
        # states + step / 6 (first + 2 (second + third) + fourth), in place
        np.add(second, third, second)
        np.multiply(second, 2.0, second)
        np.add(first, second, first)
        np.add(first, fourth, first)
        np.multiply(first, step / 6.0, first)
        np.add(states, first, states)
    out[..., piece - 1] = states
    return out.reshape(len(law.states), batch, -1)[..., : len(d)]


@np.errstate(all="ignore")  # states may run away where values are far off
def forget_start(
    law: Law, values: Mapping[str, float | Floats], d: Floats, v: Floats, step: float, batch: int
) -> Bools:
    """Whether each of B links forgets where its states began (B,): a small change has not grown some periods later.

    Arguments are those of `follow_states`. A law that amplifies it, such as one that slips over a negative length, explains no
    motion beyond a few periods, however well it fits one.
    """
    if not law.states:
        return np.ones(batch, dtype=bool)
    nudged, plain = (follow_states(law, values, d, v, step, batch, start) for start in (_NUDGE, 0.0))
    return np.asarray(np.abs(nudged - plain).mean(axis=(0, 2)) <= _GROWN * _NUDGE)


class _Rates:
    """Rates (r, B, C) of states, like `like`, in arrays that all evaluations share: to be used where warnings are ignored."""

    def __init__(self, law: Law, values: Mapping[str, float | Floats], like: Floats) -> None:
        program = rates_program(
            tuple(rate.expression for rate in law.rates), (*law.states, *law.coefficients), law.variables
        )
        self._d, self._v = np.empty((2, *like.shape[1:]))
        self._inside, self._rates = np.empty_like(like), np.empty_like(like)
        numbers = (np.asarray(values[name], dtype=np.float64) for name in law.coefficients)
        self._operations = program.into([self._d, self._v, *self._inside, *numbers], list(self._rates))

    def after(self, states: Floats, slopes: Floats, step: float, d: Floats, v: Floats, out: Floats) -> None:
        """To `out`: the rates at elongations and rates (C,) of the link, a step in s from `states` along `slopes`."""
        self._d[:], self._v[:] = d, v
        if step:
            np.multiply(slopes, step, self._inside)
            np.add(states, self._inside, self._inside)
        else:
            self._inside[:] = states
        for operation in self._operations:
            operation()
        out[:] = self._rates
