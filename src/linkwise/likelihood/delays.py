"""Delays of any length, and clocks of their own: channels are shifted by whole samples, and what is left is fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf, isinf
from typing import TypeAlias

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.terms import PPM, Clock, Delay, Term, of_kind
from linkwise.records.joining import without_delays
from linkwise.records.record import Record

_WHOLE = 0.6  # samples of delay from which a channel is shifted by whole ones
_BESIDE = 1.0  # samples of delay beyond which the shift beside stands for it: where a fit ends there, it is no optimum
# samples by which a channel is shifted where noise does not explain what the laws leave
_BY = (1, -1, 2, -2, 4, -4)
_NO_RATIO = 0.1  # standard errors
_NO_SLIP = 0.02  # samples, over a record
_ON_TIME = (
    0.05  # samples of delay that are left: more misleads the tests of random forces beside an acceleration
)
# of a ratio that a fit finds, the most that the next one leaves: of right laws it is a few percent
_SHRINKING = 0.5
_SHIFTS = 8  # of channels, at most: beyond the delays wander


Search: TypeAlias = Callable[[Sequence[Record], LikelihoodOptions], LikelihoodFit]


def with_delays(
    search: Search, records: Sequence[Record], options: LikelihoodOptions
) -> tuple[LikelihoodFit, Sequence[Record]]:
    """The fit, and the records of it; channels that are late by more than a part of a sample are shifted by whole ones, and
    fitted again.

    Where the laws do not explain the records then, shifts further away are tried, since a delay has other optima about a part
    of a period away.
    """
    if not any(isinstance(one, Delay | Clock) for one in options.errors):
        return search(records, options), records
    best, alike = _on_one_clock(search, records, options), len({record.rate for record in records}) == 1
    for delay in of_kind(options.errors, Delay) if alike else ():
        if isinf(delay.deviation) and not delay.near:
            best = _at_best_shift(best, delay.channel)
    return best.fit, best.shown


def _on_one_clock(search: Search, records: Sequence[Record], options: LikelihoodOptions) -> _Shifted:
    """The fit at settled delays, in records out of which the ratios and delays of clocks are taken that it finds.

    What a fit finds of them is small then, as its first order takes it for.
    """
    members = {name for clock in of_kind(options.errors, Clock) for name in clock.members}
    late: Mapping[str, int] = {delay.channel: 0 for delay in of_kind(options.errors, Delay)}
    before: dict[str, float] = {}
    for _ in range(_SHIFTS):
        clocks = of_kind(options.errors, Clock)
        delays = of_kind(options.errors, Delay)
        slips = {name: ppm for clock in clocks for name, ppm in clock.late.items()}
        taken = {one.channel: one.taken_out for one in delays if one.taken_out}
        own = [without_delays(record, taken, clocks=slips) for record in records]
        best = _settled(_Shifted(search, own, options, late, {}))
        found = {clock: best.fit.size_of(clock) for clock in clocks if clock.ratio is None}
        left = best.fit.delays
        sizes: dict[Term, float] = {
            one: left[one.channel] for one in delays if one.channel in members & {*left}
        }
        is_on_time = all(abs(delay) < _ON_TIME * own[0].step for delay in sizes.values())
        if best.fit.interrupted or (is_on_time and all(_is_small(*pair, own[0]) for pair in found.values())):
            return best
        if any(
            abs(ratio) > max(_SHRINKING * before.get(clock.channel, inf), error)
            for clock, (ratio, error) in found.items()
        ):
            break
        late, before = best.late, {clock.channel: abs(ratio) for clock, (ratio, _) in found.items()}
        sizes |= {clock: ratio for clock, (ratio, _) in found.items()}
        errors = (
            one.taking_out(sizes[one]) if isinstance(one, Clock | Delay) and one in sizes else one
            for one in options.errors
        )
        options = replace(options, errors=tuple(errors))
    raise IdentificationError(
        f"the clock of {', '.join(clock.channel for clock in clocks)} does not settle: fits, in each of which the ratio of "
        "the last one was taken out, do not agree. State it (ppm), or take a shorter part of the record"
    )


@dataclass(frozen=True, eq=False)
class _Shifted:
    """Records of which channels that are `late` by whole samples are shifted, and the fits by `search` that are `known` by
    these.
    """

    search: Search
    records: Sequence[Record]
    options: LikelihoodOptions
    late: Mapping[str, int]
    known: dict[tuple[int, ...], LikelihoodFit]

    @property
    def step(self) -> float:
        return self.records[0].step

    @property
    def shown(self) -> list[Record]:
        """The records as they are fitted."""
        return [_shifted(record, self.late) for record in self.records]

    @property
    def fit(self) -> LikelihoodFit:
        shift = tuple(self.late.values())
        if shift not in self.known:
            errors = tuple(
                one.taking_out(self.late[one.channel] * self.step) if isinstance(one, Delay) else one
                for one in self.options.errors
            )
            self.known[shift] = self.search(self.shown, replace(self.options, errors=errors))
        return self.known[shift]

    @property
    def is_last(self) -> bool:
        """Whether no other shift is looked for: noise explains what the laws leave, or the search was interrupted."""
        return self.fit.interrupted or self.fit.leaves_noise

    @property
    def misfit(self) -> tuple[bool, float]:
        """By which fits at other shifts are ordered; a model error says little, as it depends on the noise beside it."""
        return not self.is_last, self.fit.chi_square

    def beside(self, more: Mapping[str, int]) -> _Shifted:
        """With channels that are late by some samples more."""
        return replace(self, late={**self.late, **{name: self.late[name] + more[name] for name in more}})


def _settled(shifted: _Shifted) -> _Shifted:
    """The shifts beside which delays are parts of a sample."""
    moved: dict[str, int] = {}
    for _ in range(_SHIFTS):
        moved = {
            name: round(delay / shifted.step)
            for name, delay in shifted.fit.delays.items()
            if abs(delay) > _WHOLE * shifted.step
        }
        if not moved or shifted.fit.interrupted:
            return shifted
        if len({record.rate for record in shifted.records}) > 1:
            raise IdentificationError(
                f"{next(iter(moved))} is late by more than a sample, which cannot be found from records of different "
                f"rates together: find it from one of them, and remove it from all (without_delays)"
            )
        shifted = shifted.beside(moved)
    raise IdentificationError(
        f"the delay of {', '.join(moved)} does not settle: {_SHIFTS} fits, each shifted by the last one's delay, do not "
        "agree. Estimate it from signals that move together (inspect), and take it out (without_delays)"
    )


def _at_best_shift(shifted: _Shifted, name: str) -> _Shifted:
    """The shift of a channel beside which no other explains the records better."""
    best = shifted
    for _ in range(_SHIFTS):
        nearest = best
        for samples in _BY:
            neighbour = best.beside({name: samples})
            with suppress(IdentificationError):  # the motion runs to infinity
                if not nearest.is_last and neighbour.misfit < nearest.misfit:
                    nearest = neighbour
        if nearest is best:
            break
        best = nearest
    # at the end of their range delays have no errors, and another shift stands for them
    is_optimum = all(abs(delay) <= _BESIDE * best.step for delay in best.fit.delays.values())
    return best if best.is_last or is_optimum else shifted


def _is_small(ratio: float, error: float, record: Record) -> bool:
    """Whether a ratio in ppm, known to an `error`, is hardly different from one, or no sample moves by it."""
    return abs(ratio) < max(_NO_RATIO * error, _NO_SLIP / (PPM * len(record)))


def _shifted(record: Record, late: Mapping[str, int]) -> Record:
    """The record with channels that are `late` by whole samples set beside the others, cut to what all have."""
    if not any(late.values()):
        return record
    first = max(0, *(-samples for samples in late.values()))
    count = len(record) - first - max(0, *late.values())
    rows: dict[str, slice] = {
        name: slice(first + late.get(name, 0), first + late.get(name, 0) + count) for name in record.channels
    }
    columns = [record.values[rows[name], column] for column, name in enumerate(record.channels)]
    return replace(
        record,
        start=record.start + first * record.step,
        values=np.stack(columns, axis=1),
        simulated=None,
        clipped={name: clipped.rows(rows[name]) for name, clipped in record.clipped.items()},
    )
