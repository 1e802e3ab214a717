"""What is known beforehand of the errors of sensors: what the records state, and what the user asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, isinf
from typing import Any

import numpy as np

from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.likelihood.sensor_unknowns import ALL, by_channel, late_channels
from linkwise.records.channel import FORCE
from linkwise.records.record import Record
from linkwise.records.sensor_uncertainty import COMMON, SensorUncertainty


def errors_to_find(
    records: Sequence[Record],
    *,
    offsets: Sequence[str] = (),
    gains: Sequence[str] = (),
    calibration: Mapping[str, float] | None = None,
    delays: Sequence[str] = (),
) -> dict[str, Any]:
    """The fields of `LikelihoodOptions` for the errors of sensors.

    Parameters
    ----------
    records : sequence of Record
        The records, and what they state (`Record.uncertainty`) of their responses and applied forces.
    offsets, gains, delays : sequence of str, optional
        Channels with an unknown error, whatever the records state of it; gains and delays also those of applied forces.
    calibration : mapping of str to float, optional
        Relative standard deviations of gains, as of `MaximumLikelihood`; they go before what the records state.

    Returns
    -------
    dict
        `offsets`, `gains`, `calibration`, `delays` and the standard deviations of offsets and delays.

    Raises
    ------
    IdentificationError
        If records state different things of a channel, a gain, delay or calibration is that of none in them, or a gain or
        delay that of a force that is 0 throughout.
    """
    stated = _stated(records)
    requested = dict(calibration or {})
    inputs, forces = records[0].inputs, records[0].forces
    _require_recorded((*gains, *delays), forces)
    _require_acting((*gains, *delays), records)
    delays = [
        channel
        for name in delays
        for channel in ((name in inputs and late_channels(records[0], name)) or (name,))
    ]
    named = {
        name: known.gain
        for name, known in stated.items()
        if known.gain and not isinf(known.gain) and name not in (*requested, *gains)
    }
    free = {name: known for name, known in stated.items() if isinf(known.gain) and name not in requested}
    if ALL in requested:
        named = (
            dict.fromkeys((name for name in records[0].responses if name not in free), requested[ALL]) | named
        )
    named |= {name: sigma for name, sigma in requested.items() if name != ALL}
    by_channel(requested, records[0].responses, forces)
    deviations = {
        kind: _deviations(stated, kind, own) for kind, own in (("offset", offsets), ("delay", delays))
    }
    return {
        "offsets": _with(offsets, stated, "offset"),
        "gains": (*gains, *(name for name in free if name not in gains)),
        "calibration": by_channel(named, records[0].responses, forces),
        "delays": _with(delays, stated, "delay"),
        "offset_deviations": deviations["offset"],
        "delay_deviations": deviations["delay"],
    }


def unknown_gains(errors: Mapping[str, Any]) -> tuple[str, ...]:
    """The channels of whose gains nothing is known, among `errors_to_find`."""
    return tuple(name for name in errors["gains"] if name not in errors["calibration"])


def _with(requested: Sequence[str], stated: Mapping[str, SensorUncertainty], kind: str) -> Sequence[str]:
    """The channels that are asked for, and those of which such an error is stated."""
    more = [name for name, known in stated.items() if getattr(known, kind) and name not in requested]
    return (*requested, *more) if more else requested


def _deviations(
    stated: Mapping[str, SensorUncertainty], kind: str, requested: Sequence[str]
) -> dict[str, float]:
    sigmas = {name: float(getattr(known, kind)) for name, known in stated.items() if name not in requested}
    return {name: sigma for name, sigma in sigmas.items() if sigma and not isinf(sigma)}


def _require_recorded(named: Sequence[str], forces: Sequence[str]) -> None:
    """Raise IdentificationError for an error of a force that no channel shows."""
    for name in named:
        if name.startswith(FORCE) and name not in forces:
            raise IdentificationError(
                f"no gain or delay of {name} can be estimated{near_miss(name, forces)}: the record "
                f"{'has the forces ' + ', '.join(forces) if forces else 'shows no applied force'}"
            )


def _require_acting(named: Sequence[str], records: Sequence[Record]) -> None:
    """Raise IdentificationError for an error of a force that its channel shows nowhere."""
    for name in dict.fromkeys(named):
        if name.startswith(FORCE) and not any(np.any(record.channel(name)) for record in records):
            raise IdentificationError(
                f"no gain or delay of {name} can be estimated: it is 0 throughout the {_records(len(records))}. If no force "
                "acts there, leave its gain and delay out; if one does, its channel is dead, and the motion cannot be "
                "explained without it"
            )


def _records(count: int) -> str:
    return "record" if count == 1 else "records"


def _stated(records: Sequence[Record]) -> dict[str, SensorUncertainty]:
    """What the records state of their responses and forces; IdentificationError where they disagree."""
    stated: dict[str, SensorUncertainty] = {}
    for record in records:
        for name, known in _counted(record).items():
            if stated.setdefault(name, known) != known:
                first, second = (
                    uncertainty.described(name).rstrip(".").partition(": ")[2]
                    for uncertainty in (stated[name], known)
                )
                raise IdentificationError(
                    f"records that are taken together state different errors of {name}: {first}, and {second}; state the same "
                    "of all, for instance in a mapping file"
                )
    return stated


def _counted(record: Record) -> dict[str, SensorUncertainty]:
    """What a record states and the likelihood counts, with the delay of the only input as one of each response.

    Of forces that is the gain and, beside other inputs, the delay.
    """
    stated = {
        name: known for name, known in record.uncertainty.items() if name in (COMMON, *record.responses)
    }
    for name, known in record.uncertainty.items():
        if name not in record.inputs:
            continue
        if name.startswith(FORCE) and known.gain:
            stated[name] = SensorUncertainty(gain=known.gain)
        for channel in late_channels(record, name) if known.delay else ():
            own = stated.get(channel, SensorUncertainty())
            stated[channel] = replace(own, delay=hypot(own.delay, known.delay))
    return stated


def uncounted(records: Sequence[Record], method: str) -> tuple[str, ...]:
    """Sentences on what records state of sensors that `method` does not count."""
    every = method == "ml"
    names = [
        name
        for record in records
        for name in record.uncertainty
        if not every or (name not in (COMMON, *record.responses) and not _is_counted(record, name))
    ]
    if not names:
        return ()
    listed = ", ".join(dict.fromkeys(names))
    of_inputs = "offsets of forces and errors of a base are not estimated"
    why = of_inputs if every else 'method "ml" alone counts errors of sensors'
    return (f"What is stated of the errors of {listed} is not counted: {why}.",)


def _is_counted(record: Record, name: str) -> bool:
    """Whether all that is stated of an input is its gain, if it is a force, and a delay that can be estimated."""
    known, is_force = record.uncertainty[name], name.startswith(FORCE)
    late = not known.delay or bool(late_channels(record, name))
    return (is_force or not known.gain) and not known.offset and late
