"""How modes, response functions and distortion move with the level of a test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Indices
from linkwise.errors import IdentificationError, RecordError
from linkwise.inspection.levels.quantities import (
    ResponseFunction,
    acceleration_surfaces,
    bridged_gaps,
    decay_of,
    decaying_modes,
    distortion,
    forces_bridged,
    motions,
    ring_downs,
)
from linkwise.inspection.levels.result import OF_BANDWIDTH, OF_DAMPING, UNDAMPED, LevelComparison
from linkwise.inspection.result import labels as labels_of
from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.pursuit import RefinedModes, pursued_modes, refined_modes
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.joining import record_list
from linkwise.records.record import Record
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.signals.noise import channel_noise

_SHORTEST = 50  # samples of a decay
_MOST = 6  # modes that are followed, where their number is not given: those that respond most


def compare_levels(
    records: Sequence[Record], *, modes: int | None = None, progress: Progress = silent
) -> LevelComparison:
    """Compare records of one test at several levels: is the structure linear, and from which level on is it not?

    The linear modes that explain each record best are followed from the lowest level up. In a linear structure they stay.
    The level of a record is the peak of its forces, which does not depend on how long the record goes on after a tap.

    The level of records without forces is the peak of the motion, and their modes are those of the free decay after it. One
    record alone shows its modes as they ring down.

    Parameters
    ----------
    records : sequence of Record
        Records with the same channels. The peaks of the applied forces (N) are the levels; without any, those of the motion.
    modes : int, optional
        Number of modes that are followed; by default those that the lowest level shows, the 6 that respond most.
    progress : Progress
        Called with a `ProgressReport` for every record.

    Returns
    -------
    LevelComparison
        Frequencies, damping, response functions and distortion over the level, and modes as they ring down.

    Raises
    ------
    RecordError
        If there is no record, no mode stands above the noise at the lowest level, or a single record shows no decay.
    IdentificationError
        If the records lack a motion, or differ in their channels.
    TypeError
        If something else is given.

    See Also
    --------
    inspect : Look at each record by itself.

    Examples
    --------
    >>> import linkwise as lw
    >>> number = lw.Coefficient.number
    >>> law, values = lw.Law.parse("k*d + k3*d**3 + c*v"), {"k": number(4e3), "k3": number(4e9), "c": number(1.0)}
    >>> link = lw.Link("spring", ("m1", lw.model.GROUND), law, values)
    >>> oscillator = lw.Structure("hardening", (lw.Mass("m1", number(1.0)),), (link,))
    >>> taps = [
    ...     lw.simulate(
    ...         oscillator, forces={"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=4.0, rate=200.0, sensors=["a:m1"]
    ...     ).with_noise(40.0, seed=1)
    ...     for size in (0.1, 0.2, 2.0)
    ... ]
    >>> found = lw.inspection.compare_levels(taps)
    >>> found.first_nonlinear, found.moved(1), found.moved(2)
    (2, (), (1,))
    """
    given = record_list(records, "compare_levels(records): records")
    if not given:
        raise RecordError("levels are compared between two records or more, or one that rings down; got none")
    records = [forces_bridged(record) for record in given]
    _require_same_channels(records)
    forced = bool(records[0].forces)
    channel = None if forced else _loudest(records[0], records[0].motions)
    levels = np.array([_level(record, channel) for record in records])
    order = np.argsort(levels, kind="stable").tolist()
    ordered = [records[place] for place in order]
    complete = [short_gaps_bridged(record) or record for record in ordered]
    labels = labels_of(ordered, "level")
    measured = [_measurement(record, forced=forced) for record in ordered]
    of_highest = channel_noise(ordered[-1])
    rings = ring_downs(complete[-1], of_highest)
    gaps = tuple(name for name in ordered[-1].motions if name not in motions(complete[-1]))
    if len(records) == 1 and not rings:
        raise RecordError(_no_ring_down(gaps))
    if modes is not None or (forced and len(records) > 1):
        pursued = pursued_modes(measured[0], modes, part(progress, 0.0, 0.5))
        start = np.stack([pursued.frequencies, pursued.damping], axis=1)
    else:
        start = decaying_modes(decay_of(complete[0]), channel_noise(ordered[0]))
    if not len(start):
        message = "no mode stands above the noise at the lowest level; excite the structure more strongly"
        raise RecordError(message)
    every = refined_modes(measured[0], *start.T)
    selected = np.arange(len(every.damping)) if modes is not None else _followed(every)
    frequencies, damping = every.frequencies[selected], every.damping[selected]
    fits: list[RefinedModes] = []
    for number, at_level in enumerate(measured, start=1):
        progress(ProgressReport(0.5 + 0.5 * (number - 1) / len(records), f"level {number}"))
        fits.append(refined_modes(at_level, frequencies, damping))
        frequencies, damping = fits[-1].frequencies, fits[-1].damping
    response, force = _channels(ordered[0]) if forced else ("", "")
    return LevelComparison(
        labels=labels,
        levels=levels[order],
        channel=channel,
        unit=ordered[0].unit(channel or force),
        frequencies=np.array([fit.frequencies for fit in fits]),
        damping=np.array([fit.damping for fit in fits]),
        frequency_errors=np.array([fit.relative_errors[:, 0] * fit.frequencies for fit in fits]),
        damping_errors=np.array([fit.relative_errors[:, 1] * fit.damping for fit in fits]),
        left=np.array([fit.left for fit in fits]),
        noise=np.array([_noise_share(record, fit) for record, fit in zip(ordered, fits, strict=True)]),
        responses=tuple(ResponseFunction.of(record, response, force) for record in ordered if forced),
        distortions=tuple(distortion(record, response, force) if forced else None for record in complete),
        ring_downs=rings,
        with_gaps=gaps,
        bridged=bridged_gaps(labels, [given[place] for place in order], complete),
        surfaces=acceleration_surfaces(complete[-1], fits[0].frequencies, of_highest),
    )


def _no_ring_down(gaps: Sequence[str]) -> str:
    """Why a single record shows nothing."""
    if gaps:
        return (
            f"no mode can be followed as it rings down: {', '.join(gaps)} lack samples. Cut the record to a part without "
            "gaps of more than six samples, or give a second level to compare"
        )
    return (
        "levels are compared between two records or more, and this one alone does not ring down: it has no part without a "
        "force that is long enough to follow a mode as it decays"
    )


def _level(record: Record, channel: str | None) -> float:
    """The level of a record: the largest magnitude of all forces, or of a channel of the motion."""
    names = record.forces if channel is None else [channel]
    return max(float(np.nanmax(np.abs(record.channel(name)))) for name in names)


def _loudest(record: Record, motions: Sequence[str]) -> str:
    """The one of some motions that stands farthest above its noise."""
    noise = channel_noise(record)
    if not motions:
        listed = ", ".join(record.channels)
        raise IdentificationError(f"modes need a motion, such as a:beam.tip; the channels are {listed}")
    return max(motions, key=lambda name: float(np.nanstd(record.channel(name)) / noise[name]))


def _measurement(record: Record, *, forced: bool) -> ModalMeasurement:
    """The responses to forces, or the free decay where no force was recorded."""
    if forced:
        return ModalMeasurement.of([record], scaled=False)
    decay = decay_of(record)
    if len(decay) < _SHORTEST:
        raise IdentificationError(
            f"no applied force was recorded, and {record.source or 'a record'} does not decay freely for {_SHORTEST} samples "
            "or more: modes follow from an applied force (force:beam.tip) and the motion that it gives, or from a free decay"
        )
    return ModalMeasurement.of_decay(decay)


def _noise_share(record: Record, modes: RefinedModes) -> float:
    """Power of the noise as a part of that of the responses, as `RefinedModes.left` is one."""
    noise = channel_noise(record)
    variance = np.array([noise[name] ** 2 for name in record.motions])
    return float(np.mean(variance / np.maximum(modes.power, np.finfo(float).tiny)))


def _require_same_channels(records: Sequence[Record]) -> None:
    first = records[0].channels
    for number, record in enumerate(records[1:], start=2):
        differences = [f"{name} is missing" for name in first if name not in record.channels]
        differences += [f"{name} is not in the first" for name in record.channels if name not in first]
        if differences:
            raise IdentificationError(
                "levels are compared between records with the same channels; of "
                f"{record.source or f'record {number}'}, {', and '.join(differences)}"
            )


def _followed(refined: RefinedModes) -> Indices:
    """The numbers of the modes that are well determined, at most those that respond most, in the order of frequencies."""
    size = np.abs(refined.residues).max(axis=(1, 2)) if refined.residues.size else refined.free.max(axis=1)
    of_frequency, of_damping = refined.relative_errors.T
    firm = (of_frequency < OF_BANDWIDTH * refined.damping) & (of_damping < OF_DAMPING)
    firm &= refined.damping > UNDAMPED
    some = np.flatnonzero(firm) if firm.any() else np.arange(len(size))
    return np.sort(some[np.argsort(-(size / refined.damping)[some])][:_MOST])


def _channels(record: Record) -> tuple[str, str]:
    """The largest force, and a response where it acts, or else that which stands farthest above its noise."""
    force = max(record.forces, key=lambda name: float(np.mean(record.channel(name) ** 2)))
    at_force = [channel for channel in record.motions if channel.place == force.place]
    return _loudest(record, at_force or record.motions), force
