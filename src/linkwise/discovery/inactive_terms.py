"""Terms that never acted: a stop that no motion reached is zero all along, and no record tells anything of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.model.link import BASE, GROUND
from linkwise.weak.displacements import MeasuredDisplacements

_FEWEST = 8  # samples at which a term has to act: noise alone carries a few beyond the reach of the motion
_NAMED = 6


def inactive_terms(
    motions: Sequence[MeasuredDisplacements], rates: Sequence[float], candidates: Candidates
) -> tuple[str, ...]:
    """The names of the candidates that were zero in all `motions`, sampled at `rates` in Hz, but for a few samples."""
    row = {
        name: number for number, name in enumerate((*(mass.name for mass in candidates.masses), BASE, GROUND))
    }
    found = []
    for entry in candidates.entries:
        if not entry.term.law.kinks:  # a smooth term is zero nowhere but at points
            continue
        first, second = (row[end] for end in candidates.pairs[entry.pair].between)
        acted = 0
        for motion, rate in zip(motions, rates, strict=True):
            d = motion.ends[first] - motion.ends[second]
            there = np.ones(len(d), dtype=bool)
            if motion.missing is not None:
                for end in {first, second} & set(range(len(motion.missing))):
                    there &= ~motion.missing[end]
            force = entry.term.law.force(d, np.gradient(d) * rate, {})
            acted += int(np.count_nonzero(np.broadcast_to(force, d.shape)[there]))
        if acted < _FEWEST:
            found.append(entry.name)
    return tuple(found)


def inactive_remark(names: Sequence[str]) -> tuple[str, ...]:
    """What to say of them, if there are any."""
    if not names:
        return ()
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (
        f"{', '.join(names[:_NAMED])}{more} never acted in this record, so nothing is said of them; record a motion that "
        "reaches them.",
    )
