"""Records of a structure on a moving base, in coordinates that the estimators can use.

Where a velocity or an acceleration is all that is known of the base, its displacement is known up to a line or a constant
only. If no link ends at the ground, the equations in coordinates relative to the base need none of it:

    M z'' = -B f(B'z, B'z') + w - M 1 x_base''

so that the base rests and every mass carries a force of inertia (Chopra, Dynamics of Structures, section 1.7). That of a mass
that is not known follows the estimate of it: the record has the force by the value that the structure states, and the
acceleration of the coordinates for the rest of it.

A sensor that is not relative to the base shows its displacement or velocity as well, which integration gives up to a line or a
constant, and up to what an offset and the noise of the acceleration add. The polynomial that fits the sensor best is taken
out, a parabola for two integrations; what is left of it has to be estimated with the laws, as a drift of the sensor from an
unknown start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import combinations

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.model.structure import BASE, GROUND, Structure
from linkwise.records.channel import BAND_LIMITED, MOTIONS, Channel, interpolated
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_complete

_SPLINE = 7  # order of the spline that is integrated


class RelativeRecord(Record):
    """A record in coordinates relative to a base, whose acceleration is a:base; x:base rests."""


@dataclass(frozen=True, eq=False)
class FramedRecord:
    """A record with responses in the coordinates of the equations, named as those of masses, in the order of the original;
    `names` are theirs in `record`. Where the coordinates are relative to the base, it has forces of inertia of masses that
    have a value, x:base at rest, and the acceleration of the coordinates in m/s^2 (N,), else None, as a:base. `carried`
    (2, N) is what a sensor shows beside the motion in these coordinates, and its rate, without an entry where that is
    nothing. From responses that are `drifting` an integral was taken.
    """

    record: Record
    names: Mapping[str, Channel]
    carried: Mapping[Channel, Floats] = field(default_factory=dict)
    acceleration: Floats | None = None
    drifting: tuple[Channel, ...] = ()

    @property
    def shown(self) -> Floats:
        """(N, C) what the sensors show beside the motion in these coordinates."""
        nothing = np.zeros((2, len(self.record)))
        return np.stack([self.carried.get(name, nothing)[0] for name in self.names.values()], axis=1)


def framed(record: Record, structure: Structure, *, integrated: bool = False) -> FramedRecord:
    """A record in coordinates at rest, or relative to a base of which only a velocity or an acceleration is known; the
    record itself where no channel is relative to the base and its displacement is known or not needed. Where `integrated`,
    sensors may be left with a drift, by integrals of the motion of the base. IdentificationError if that motion is not
    known well enough for a channel or a link.
    """
    relative = [channel for channel in record.responses if channel.relative]
    displaced = f"x:{BASE}" in record.channels
    known = bool(record.motions_of(BASE))
    based = [link.name for link in structure.links if BASE in link.between]
    grounded = [link.name for link in structure.links if GROUND in link.between]
    if based and not known and not relative and not structure.hosts:
        raise IdentificationError(
            f'the link "{based[0]}" ends at the base, and the record has no motion of it; add a channel x:base, v:base or '
            "a:base, or let the link end at the ground if the base did not move",
            arguments=("channels",),
        )
    moves = known and not displaced and (bool(based) or bool(relative and not grounded))
    if not relative and not moves:
        return FramedRecord(record, {channel: channel for channel in record.responses})
    if not known:
        raise IdentificationError(
            f"{relative[0]} is relative to the base, whose motion the record lacks: give a channel x:{BASE}, v:{BASE} or "
            f"a:{BASE}"
        )
    if moves and grounded:
        raise IdentificationError(
            f'link "{grounded[0]}" ends at the ground and another at the base, so the displacement of the base is needed, '
            f"which {record.motions_of(BASE)[0]} determines only up to drift: give a channel x:{BASE}, or let every link end "
            "at the base"
        )
    if not moves and not displaced:
        raise IdentificationError(
            f"{relative[0]} is relative to the base, whose displacement the record lacks: with links to the ground alone, "
            f"give a channel x:{BASE}"
        )
    names: dict[str, Channel] = {name: Channel(name.kind, name.place) for name in record.responses}
    for first, second in combinations(names, 2):
        if names[first] == names[second]:
            same = f"{first} and {second} show the same motion"
            raise IdentificationError(f"{same}, relative to the base or not: select one of them")
    motion = _BaseMotion(record, integrated and moves)
    carried, drifting = {}, []
    for channel, plain in zip(record.responses, names.values(), strict=True):
        if channel.is_motion and channel.relative != moves:  # shown in the one frame, needed in the other
            sign = 1.0 if moves else -1.0
            carried[plain] = sign * motion.value_and_rate(channel.order, channel)
            if motion.integrations(channel.order) > 0:
                carried[plain] += motion.best_polynomial(channel)
                drifting.append(plain)
    acceleration = motion.value_and_rate(2, f"a:{BASE}")[0] if moves else None
    changed = _changed(record, names, carried, structure, acceleration)
    return FramedRecord(changed, names, carried, acceleration, tuple(drifting))


def _changed(
    record: Record,
    names: Mapping[str, Channel],
    carried: Mapping[Channel, Floats],
    structure: Structure,
    acceleration: Floats | None,
) -> Record:
    """The record with responses less what they carry, and the forces of inertia of all masses."""
    inputs = [name for name in record.inputs if acceleration is None or name.place != BASE]
    kept: dict[str, Channel] = {**names, **{name: name for name in inputs}}
    columns = {plain: record.channel(name) for name, plain in kept.items()}
    columns |= {plain: columns[plain] - motion[0] for plain, motion in carried.items()}
    noise: dict[str, float] = {kept[name]: sigma for name, sigma in record.noise.items() if name in kept}
    if acceleration is not None:
        for name in record.inputs:  # with inertia, which joins them
            if (kind := record.interpolation.get(name, BAND_LIMITED)) != BAND_LIMITED:
                raise IdentificationError(
                    f"{name} is stated to be {kind} between its samples, which is not supported beside a base of which the "
                    "acceleration or velocity alone is known: leave that out, or record the displacement of the base"
                )
        for mass in structure.masses:
            channel = Channel("force", mass.name)
            columns[channel] = columns.get(channel, 0.0) - (mass.mass.value or 0.0) * acceleration
        columns |= {Channel("x", BASE): np.zeros(len(record)), Channel("a", BASE): acceleration}
        noise[f"x:{BASE}"] = 0.0
    changed = replace(
        record,
        channels=tuple(columns),
        values=np.stack(list(columns.values()), axis=1),
        noise=noise,
        simulated=None,
        clipped={plain: record.clipped[name] for name, plain in names.items() if name in record.clipped},
        interpolation={name: kind for name, kind in record.interpolation.items() if name in columns},
        uncertainty={},  # of channels by their own names, which the estimators take from the record itself
    )
    if acceleration is None:
        return changed
    return RelativeRecord(**{member.name: getattr(changed, member.name) for member in fields(changed)})


def frame_acceleration(record: Record) -> Floats | None:
    """Acceleration (N,) in m/s^2 of the coordinates of a record that `framed` gave; None where they are at rest, and not
    in those of a base that accelerates.
    """
    return record.channel(f"a:{BASE}") if isinstance(record, RelativeRecord) else None


@dataclass(frozen=True, eq=False)
class _BaseMotion:
    """The motion of the base in a record, with derivatives of band-limited signals, and integrals where these are allowed."""

    record: Record
    integrated: bool = False

    def value_and_rate(self, order: int, wanted_by: str) -> Floats:
        """(2, N) a derivative of the motion and its rate; IdentificationError where only an integral would give it."""
        return np.stack([self._derivative(order, wanted_by), self._derivative(order + 1, wanted_by)])

    @property
    def _known(self) -> list[int]:
        """Which derivatives the record has."""
        return [channel.order for channel in self.record.motions_of(BASE)]

    def integrations(self, order: int) -> int:
        """How many integrations give a derivative of the motion; 0 or less where derivatives do."""
        return self._known[0] - order

    def best_polynomial(self, sensor: Channel) -> Floats:
        """(2, N) what integration leaves open of the motion that a sensor shows, and its rate, by its samples.

        With an offset of what is integrated. Raises IdentificationError for a sensor without enough samples.
        """
        shown = self.record.channel(sensor)
        time, present = np.arange(len(shown)) * self.record.step, np.isfinite(shown)
        degree = self.integrations(sensor.order)
        if np.count_nonzero(present) <= degree:
            raise IdentificationError(f"{sensor} has no more than {degree} samples: leave the channel out")
        left = (shown - self._derivative(sensor.order, sensor))[present]
        open_part = np.polynomial.Polynomial.fit(time[present], left, degree)
        return np.stack([open_part(time), open_part.deriv()(time)])

    def _integral(self, order: int) -> Floats:
        """The motion of an `order` of derivative, 0 at the first sample."""
        count = self.integrations(order)
        values = self.record.channel(f"{MOTIONS[order + count]}:{BASE}")
        require_complete(f"{MOTIONS[order + count]}:{BASE}", values, self.record.start, self.record.rate)
        time, most = np.arange(len(values)) * self.record.step, max(1, (len(values) - 1) // 2 * 2 - 1)
        spline = scipy.interpolate.make_interp_spline(time, values, k=min(_SPLINE, most))
        return np.asarray(spline.antiderivative(count)(time))

    def _derivative(self, order: int, wanted_by: str) -> Floats:
        known = [number for number in self._known if number <= order]
        if not known and self.integrated:
            return self._integral(order)
        if not known:
            has = self.record.motions_of(BASE)[0]
            raise IdentificationError(
                f"{wanted_by} is not relative to the base, and {has} gives the {'displacement' if order == 0 else 'velocity'} "
                f"of the base only up to drift: measure the motion relative to the base (rel:{wanted_by}), or the acceleration"
            )
        name = f"{MOTIONS[known[-1]]}:{BASE}"
        values = self.record.channel(name)
        require_complete(name, values, self.record.start, self.record.rate)
        for _ in range(order - known[-1]):
            signal = interpolated(0.0, self.record.rate, values)
            values = signal.derivative(np.arange(len(values)) / self.record.rate)
        return values


def framed_records(
    records: Sequence[Record], structure: Structure, *, integrated: bool = False
) -> list[Record]:
    """The records in the coordinates of `framed`."""
    return [framed(record, structure, integrated=integrated).record for record in records]
