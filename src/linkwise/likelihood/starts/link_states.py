"""States of links along a motion: measured where a channel shows them, else integrated with the laws as they are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from linkwise.arrays import Bools, Floats
from linkwise.expression.program import cached_program
from linkwise.model.law import Law
from linkwise.model.named_laws import slider_parts
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import smoothed

_HIDDEN = 0.1  # of its own size: the scale of a defect of a state that no channel shows, at q = 1
_PERIODS = 4.0  # of the motion after which a state has forgotten where it started
_SHORTEST = 32  # samples of a piece
# steps a sample where states ran away, and by which factor beyond their reach they have
_FINER, _AWAY = 8, 100.0
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
        inside = {}
        for k in numbers.tolist():
            motion = np.stack([d[:, k], rate[:, k], *signals_of(record, law)])
            inside[k] = LinkRuns(law, structure.links[k].values, motion, record.step).states()[:, 0]
        for row, name in enumerate(law.states):
            for k in numbers.tolist():
                channel = f"state:{structure.links[k].name}.{name}"
                measured = channel in record.channels
                state = smoothed(record, channel, sigma[channel])[0] if measured else inside[k][row]
                values.append(state)
                size = float(np.sqrt(np.mean(state**2))) or 1.0
                sizes.append(sigma[channel] if measured else _HIDDEN * size)
    return np.array(values).reshape(-1, len(record)), np.array(sizes)


def signals_of(record: Record, law: Law) -> list[Floats]:
    """The signals (N,) that a law names, in its order."""
    return [record.channel(f"signal:{name}") for name in law.signals]


def link_motion(record: Record, structure: Structure, x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Elongations in m and rates in m/s (N, L) of the links, from displacements and velocities (n, N)."""
    base = None
    if np.any(structure.base_incidence):  # without a channel, the motion is relative to the base
        base = record.channel("x:base") if "x:base" in record.channels else np.zeros(len(record))
    speed = None if base is None else np.gradient(base, record.step)
    return structure.elongations(x.T, base), structure.elongations(v.T, speed)


@dataclass(frozen=True, eq=False)
class LinkRuns:
    """A `batch` of B links of a law along one motion, from which their states follow by the Runge-Kutta method of order 4.

    `values` of the coefficients are numbers, or (B, 1), and `motion` (2 + U, N) has the elongation, its rate, and the signals
    that the law names, in a `step` in s.

    The record is cut into pieces that run side by side; each begins some periods before the samples it gives. States of
    sliders follow the elongation within their bounds. States that run away from sample to sample, as those of a link that
    moves by many times the length at which it yields, are followed again in steps of an eighth.
    """

    law: Law
    values: Mapping[str, float | Floats]
    motion: Floats
    step: float
    batch: int = 1

    @np.errstate(all="ignore")  # states may run away where values are far off
    def states(self, start: float = 0.0) -> Floats:
        """States (r, B, N), each of which begins at `start`."""
        if not self.law.states:
            return np.empty((0, self.batch, self.motion.shape[1]))
        states = self._followed(start)
        if slider_parts(self.law) is not None:
            return states
        away = np.flatnonzero(self._run_away(states, start))
        if len(away):
            own = {name: np.asarray(v)[away] if np.size(v) > 1 else v for name, v in self.values.items()}
            motion, step = _between(self.motion, self.step), self.step / _FINER
            finer = replace(self, values=own, motion=motion, step=step, batch=len(away))
            states[:, away] = finer._followed(start)[..., ::_FINER]
        return states

    @np.errstate(all="ignore")
    def forget_start(self) -> Bools:
        """Whether each link forgets where its states began (B,): a small change has not grown some periods later.

        A law that amplifies it, such as one that slips over a negative length, explains no motion beyond a few periods,
        however well it fits one.
        """
        if not self.law.states:
            return np.ones(self.batch, dtype=bool)
        change = self.states(_NUDGE) - self.states()
        return np.asarray(np.abs(change).mean(axis=(0, 2)) <= _GROWN * _NUDGE)

    def _run_away(self, states: Floats, start: float) -> Bools:
        """Whether states (r, B, N) of each link leave what their rates at zero add up to, by far."""
        d, v, *signals = self.motion
        at_zero = {**dict.fromkeys(self.law.states, 0.0), **dict(zip(self.law.signals, signals, strict=True))}
        rates = self.law.state_rates(d, v, {**self.values, **at_zero})
        sums = np.cumsum(np.stack([np.broadcast_to(rate, states.shape[1:]) for rate in rates]), axis=-1)
        reach = self.step * np.abs(sums).max(axis=-1) + abs(start)
        return np.asarray(~(np.abs(states).max(axis=-1) <= _AWAY * reach).all(axis=0))

    def _followed(self, start: float) -> Floats:
        """As `states`, in the steps of the samples."""
        (d, v), step = self.motion[:2], self.step
        size = np.sqrt(np.mean(v**2))
        period = 2.0 * np.pi * np.sqrt(np.mean((d - d.mean()) ** 2)) / (size * step) if size > 0.0 else 0.0
        piece = max(_SHORTEST, min(int(_PERIODS * period) + 1, len(d)))
        count = -(-len(d) // piece)
        run = np.pad(self.motion, ((0, 0), (piece, count * piece - len(d))), mode="edge")
        run[1, :piece] = run[1, piece + len(d) :] = 0.0
        along = sliding_window_view(run, 2 * piece, axis=1)[:, ::piece].swapaxes(1, 2).copy()  # (2 + U, M, C)
        if slider_parts(self.law) is not None:
            return self._slid(along[0], start)[..., : len(d)]
        middle = 0.5 * (along[:, :-1] + along[:, 1:])
        out = np.empty((len(self.law.states), self.batch, count, piece))
        states = np.full((len(self.law.states), self.batch, count), start)
        rates = self._rates(states)
        for number in range(2 * piece - 1):
            if number >= piece:
                out[..., number - piece] = states
            first = rates(states, along[:, number])
            second = rates(states + 0.5 * step * first, middle[:, number])
            third = rates(states + 0.5 * step * second, middle[:, number])
            fourth = rates(states + step * third, along[:, number + 1])
            states = states + (first + 2.0 * (second + third) + fourth) * (step / 6.0)
        out[..., piece - 1] = states
        return out.reshape(len(self.law.states), self.batch, -1)[..., : len(d)]

    def _slid(self, along: Floats, start: float) -> Floats:
        """States (r, B, C M) of sliders from elongations (2 M, C) of pieces, the first half of which leads to what is given.

        A step from one sample to the next, in which d goes one way, has no error, and the largest size of a state enters it.
        """
        parts = slider_parts(self.law)
        assert parts is not None
        numbers = parts(*(np.asarray(self.values[name], dtype=np.float64) for name in self.law.coefficients))
        count, piece = len(self.law.states), len(along) // 2
        shape = (2 * count, self.batch, along.shape[1])
        stiffness, largest = np.split(np.stack([np.broadcast_to(number, shape[1:]) for number in numbers]), 2)
        out, states = np.empty((count, *shape[1:], piece)), np.full((count, *shape[1:]), start)
        lowest, moved = -largest, np.empty_like(states)
        for number, change in enumerate(np.diff(along, axis=0)):
            if number >= piece:
                out[..., number - piece] = states
            np.multiply(stiffness, change, moved)
            np.add(states, moved, states)
            np.minimum(states, largest, out=states)
            np.maximum(states, lowest, out=states)
        out[..., piece - 1] = states
        return out.reshape(count, self.batch, -1)

    def _rates(self, like: Floats) -> Callable[[Floats, Floats], Floats]:
        """What gives the rates (r, B, C) of states, like `like`, along the motion (2 + U, C) of the link, in arrays that all
        evaluations share: to be used where warnings are ignored.
        """
        law = self.law
        names = (*law.variables, *law.coefficients)
        program = cached_program(tuple(rate.expression for rate in law.rates), names, wide=law.variables)
        along = np.empty((2 + len(law.signals), *like.shape[1:]))
        inside, rates = np.empty_like(like), np.empty_like(like)
        numbers = (np.asarray(self.values[name], dtype=np.float64) for name in law.coefficients)
        operations = program.into([*along[:2], *inside, *along[2:], *numbers], list(rates))

        def evaluated(states: Floats, motion: Floats) -> Floats:
            inside[:], along[:] = states, motion[:, None]
            for operation in operations:
                operation()
            return rates.copy()

        return evaluated


def _between(motion: Floats, step: float) -> Floats:
    """(2 + U, M) elongations and rates in finer steps, by cubics that have both of the samples, and signals, by lines."""
    d, v, *signals = motion
    part = (np.arange(_FINER) / _FINER)[None, :]
    change, first, last = (part_of[:, None] for part_of in (np.diff(d), step * v[:-1], step * v[1:]))
    square, cube = 3.0 * change - 2.0 * first - last, first + last - 2.0 * change
    elongation = d[:-1, None] + part * (first + part * (square + part * cube))
    rate = (first + part * (2.0 * square + 3.0 * part * cube)) / step
    fine = np.arange(_FINER * (len(d) - 1) + 1) / _FINER
    lines = [np.interp(fine, np.arange(len(d)), signal) for signal in signals]
    return np.stack([np.append(elongation, d[-1]), np.append(rate, v[-1]), *lines])
