"""What can be foreseen of a discovery before any time is spent: masses at rest, records too short, motion that is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.errors import IdentificationError
from linkwise.likelihood.start import channel_noise
from linkwise.record import Record

_REST = 0.1  # of the noise's power: less motion than this is not seen (-10 dB)
_FAINT = 3.0  # (5 dB): less tells little
_FEWEST = 4  # samples a candidate, over all masses: below it a regression on all of them fits noise
_FEW = 20


def outlook(records: Sequence[Record], candidates: Candidates) -> tuple[str, ...]:
    """Sentences on what these records will not tell.

    Raises IdentificationError where they can tell nothing: a mass without a sensor, no motion above the noise, fewer samples
    than a regression on all candidates needs.
    """
    _require_sensors(records, candidates)
    names = [mass.name for mass in candidates.masses]
    ratio = np.max([_motion(record, names) for record in records], axis=0)
    resting = [name for name, each in zip(names, ratio, strict=True) if each < _REST]
    if len(resting) == len(names):
        raise IdentificationError(
            "there is no motion above the noise in any channel, so no structure to be found: hit the structure harder, "
            "or check the sensors' range and units"
        )
    samples = sum(len(record) for record in records) * len(names)
    needed = len(candidates.entries)
    if samples < _FEWEST * needed:
        raise IdentificationError(
            f"the record is too short: {samples} samples over {len(names)} masses for {needed} candidates, and {_FEWEST} a "
            f"candidate are the least; record {-(-_FEWEST * needed // len(names))} samples or more, or allow fewer terms"
        )
    told = []
    if resting:
        told.append(
            f"{_listed(resting)} did not move above the noise: no link to {_them(resting)} can be told; hit nearer to "
            f"{_them(resting)}."
        )
    faint = [name for name, each in zip(names, ratio, strict=True) if _REST <= each < _FAINT]
    if faint:
        told.append(f"{_listed(faint)} hardly moved above the noise: weak terms of links there will be missed.")
    if samples < _FEW * needed:
        told.append(
            f"{samples} samples for {needed} candidates are few: weak terms will be missed; record for longer."
        )
    return tuple(told)


def _require_sensors(records: Sequence[Record], candidates: Candidates) -> None:
    for record in records:
        blind = [
            mass.name
            for mass in candidates.masses
            if not any(f"{kind}:{mass.name}" in record.channels for kind in "xva")
        ]
        if blind:
            raise IdentificationError(
                f"no sensor shows {_listed(blind)}: links cannot be discovered around a motion that nobody saw. Add a channel "
                f"x:{blind[0]}, map a column to it with --channel, or identify a structure that you write down"
            )


def _motion(record: Record, names: Sequence[str]) -> list[float]:
    """The power of the motion of every mass over that of its noise, in its best channel."""
    noise = channel_noise(record)
    found = []
    for name in names:
        ratios = [
            float(np.nanmean((record.channel(channel) - np.nanmean(record.channel(channel))) ** 2)) / noise[channel] ** 2 - 1.0
            for channel in (f"{kind}:{name}" for kind in "xva")
            if channel in record.channels and noise[channel] > 0.0
        ]
        found.append(max(ratios, default=0.0))
    return found


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _them(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"
