"""What records of a rig must hold: the displacement of the base, and the force in each link that has unknowns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.prescribed.motion import PrescribedMotion
from linkwise.likelihood.prescribed.problem import Forces
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel, require_complete
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise, noise_sigma
from linkwise.signals.smooth import smoothing_spline

BASE_CHANNEL = Channel("x", BASE)
_FEWEST = 32  # samples
_FLOOR = 1e-12  # of the largest displacement: smaller noise is below rounding
_SUBSTEPS = 2  # between samples, at first


def cell_name(structure: Structure, link: int) -> Channel:
    """The channel of the load cell of a link, by its number."""
    return Channel("f", structure.links[link].name)


def rig_forces(record: Record, structure: Structure) -> Forces:
    """Motion and forces of a record; IdentificationError where it does not hold them."""
    name = BASE_CHANNEL
    if name not in record.channels:
        raise IdentificationError(
            f"a link alone on a rig is identified from the displacement of its base, {name}, but the record holds "
            f"{', '.join(record.channels)}; where one end is fixed, call the other end the base"
        )
    values = record.channel(name)
    require_complete(name, values, record.start, record.rate)
    if len(values) < _FEWEST:
        raise IdentificationError(
            f"{len(values)} samples are too few for links on a rig, which need {_FEWEST}"
        )
    if not np.ptp(values) > 0.0:
        raise IdentificationError(
            f"{name} does not change: the force in a link that does not move says nothing about its law"
        )
    cells = {
        number: record.channel(cell_name(structure, number))
        for number in range(len(structure.links))
        if cell_name(structure, number) in record.channels
    }
    for number, force in cells.items():
        if not np.isfinite(force).any():
            raise IdentificationError(
                f"channel {cell_name(structure, number)} has no sample that is a number"
            )
    for parameter in structure.parameters:
        unseen = [index for index, _ in parameter.members if index not in cells]
        if len(unseen) == len(parameter.members):
            raise IdentificationError(
                f"{parameter.name} is unknown, but the record has no load cell of its link: give channel "
                f"{cell_name(structure, unseen[0])}, the force in it"
            )
    return Forces(prescribed_motion(record), cells)


def require_same_cells(records: Sequence[Forces], structure: Structure) -> None:
    """Raise IdentificationError where a load cell is in one record and not in another."""
    for number in range(len(structure.links)):
        lacking = [index for index, forces in enumerate(records, start=1) if number not in forces.cells]
        if 0 < len(lacking) < len(records):
            raise IdentificationError(
                f"records that are taken together must hold the same channels, and {cell_name(structure, number)} is not in "
                f"record {lacking[0]} of {len(records)}"
            )


def prescribed_motion(record: Record) -> PrescribedMotion:
    """The motion of the base of a record, smoothed at the level of its noise."""
    values = record.channel(BASE_CHANNEL)
    spline = smoothing_spline(values, record.rate)
    return PrescribedMotion.of(spline, _SUBSTEPS, _sensor_noise(record, values, spline.value()[:, 0]))


def _sensor_noise(record: Record, values: Floats, smooth: Floats) -> float:
    """Standard deviation in m of the noise of the displacement; that of a coarse resolution is what smoothing takes out."""
    stated = record.noise.get(BASE_CHANNEL)
    if stated is not None:
        return float(stated)
    estimated = float(np.nan_to_num(noise_sigma(values)[0]))
    return max(estimated, float(np.std(values - smooth)), _FLOOR * float(np.abs(values).max()))


def cell_noise(records: Sequence[Record], structure: Structure) -> dict[int, float]:
    """Noise of load cells in N by the number of their link: of several records the largest."""
    noise_by_record = [channel_noise(record) for record in records]
    names = {number: cell_name(structure, number) for number in range(len(structure.links))}
    return {
        number: max(noise[name] for noise in noise_by_record)
        for number, name in names.items()
        if name in noise_by_record[0]
    }
