"""What can be foreseen of a discovery before any time is spent: masses at rest or alike, short records, no motion at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.errors import IdentificationError
from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise

_REST = 0.1  # of the noise's power: less motion than this is not seen (-10 dB)
_FAINT = 3.0  # (5 dB): less tells little
_APART = 30.0  # times the noise's power (15 dB) that the difference of two motions should have
_ALIKE = 0.05  # of the smaller motion's power: a difference below it is what a stiff link leaves
_FEWEST = 4  # samples a candidate, over all masses: below it a regression on all of them fits noise
_FEW = 20


@dataclass(frozen=True)
class DataChecks:
    """`told` in sentences; `resting` masses did not move, `alike` ones so much like another that links may be exchanged."""

    told: tuple[str, ...]
    resting: tuple[str, ...]
    alike: tuple[str, ...]


def check_data(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What these records will not tell.

    Raises IdentificationError where they can tell nothing: a mass without a sensor, no motion above the noise, fewer samples
    than a regression on all candidates needs.
    """
    names = [mass.name for mass in candidates.masses]
    _require_sensors(records, names)
    _require_base(records)
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
            f"{_listed(resting)} did not move above the noise and {'is' if len(resting) == 1 else 'are'} left out: a link to "
            f"{_them(resting)} looks like one to the ground. Hit nearer to {_them(resting)}."
        )
    faint = [name for name, each in zip(names, ratio, strict=True) if _REST <= each < _FAINT]
    if faint:
        told.append(
            f"{_listed(faint)} hardly moved above the noise: weak terms of links there will be missed."
        )
    if samples < _FEW * needed:
        told.append(
            f"{samples} samples for {needed} candidates are few: weak terms will be missed; record for longer."
        )
    moving = [name for name in names if name not in resting]
    apart = _apart_all(records, moving)
    alike: list[str] = []
    for group, least in _groups(moving, apart):
        apart_by = (
            f"down to {10.0 * np.log10(least):.0f} dB above the noise" if least > 1.0 else "lost in the noise"
        )
        told.append(
            f"{_listed(group)} moved alike, with differences {apart_by}: a link to one of them may be told as a link to "
            "another. Hit them one by one."
        )
        alike += group
    return DataChecks(tuple(told), tuple(resting), tuple(alike))


def _require_sensors(records: Sequence[Record], names: Sequence[str]) -> None:
    for record in records:
        blind = [name for name in names if not any(f"{kind}:{name}" in record.channels for kind in "xva")]
        if blind:
            raise IdentificationError(
                f"no sensor shows {_listed(blind)}: links cannot be discovered around a motion that nobody saw. Add a channel "
                f"x:{blind[0]}, map a column to it with --channel, or identify a structure that you write down"
            )


def _require_base(records: Sequence[Record]) -> None:
    """What moves the base is no input without its displacement, and links to a base that is left out are found elsewhere."""
    for record in records:
        moving = [name for name in ("v:base", "a:base") if name in record.channels]
        if moving and "x:base" not in record.channels:
            raise IdentificationError(
                f"the record has {' and '.join(moving)} but not the displacement of the base, which links to it need: give a "
                "channel x:base, or leave the base out where nothing hangs on it"
            )


def _motion(record: Record, names: Sequence[str]) -> list[float]:
    """The power of the motion of every mass over that of its noise, in its best channel."""
    noise = channel_noise(record)
    found = []
    for name in names:
        channels = [f"{kind}:{name}" for kind in "xva" if f"{kind}:{name}" in record.channels]
        ratios = [
            _power(record.channel(channel)) / noise[channel] ** 2 - 1.0 if noise[channel] > 0.0 else 0.0
            for channel in channels
        ]
        found.append(max(ratios, default=0.0))
    return found


def _apart_all(records: Sequence[Record], names: Sequence[str]) -> Floats:
    """(n, n) below the diagonal: the most that two masses' difference stands above its noise in any record, in power."""
    apart = np.full((len(names), len(names)), np.inf)
    for number, one in enumerate(names):
        for place, other in enumerate(names[:number]):
            apart[number, place] = max(_apart(record, f"x:{one}", f"x:{other}") for record in records)
    return apart


def _groups(names: Sequence[str], apart: Floats) -> list[tuple[list[str], float]]:
    """Groups of masses whose displacements differ by little more than noise in all records, and the least ratio of powers."""
    count, group = scipy.sparse.csgraph.connected_components(apart < _APART, directed=False)
    members = [np.flatnonzero(group == each).tolist() for each in range(count)]
    return [
        ([names[place] for place in each], float(apart[np.ix_(each, each)].min()))
        for each in members
        if len(each) > 1
    ]


def _apart(record: Record, one: str, other: str) -> float:
    """Power of the difference over that of its noise; infinite where the motions are not alike."""
    if one not in record.channels or other not in record.channels:
        return np.inf
    noise = channel_noise(record.select((one, other)))
    variance = noise[one] ** 2 + noise[other] ** 2
    difference = _power(record.channel(one) - record.channel(other)) - variance
    least = min(_power(record.channel(name)) - noise[name] ** 2 for name in (one, other))
    return float(difference / variance) if difference < _ALIKE * least and variance > 0.0 else np.inf


def _power(values: Floats) -> float:
    return float(np.nanmean((values - np.nanmean(values)) ** 2))


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _them(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"
