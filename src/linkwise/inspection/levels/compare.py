"""How modes, response functions and distortion move with the level of a test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.argument_types import checked
from linkwise.errors import IdentificationError, RecordError
from linkwise.inspection.levels.distortion import distortion
from linkwise.inspection.levels.response_function import ResponseFunction
from linkwise.inspection.levels.result import OF_BANDWIDTH, OF_DAMPING, UNDAMPED, LevelComparison
from linkwise.inspection.levels.ring_down import ring_down
from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.pursuit import RefinedModes, pursued_modes, refined_modes
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.record import Record
from linkwise.records.sequence import record_list
from linkwise.signals.channel_noise import channel_noise

_MOST = 6  # modes that are followed, where their number is not given: those that respond most


@checked
def compare_levels(
    records: Sequence[Record], *, modes: int | None = None, progress: Progress = silent
) -> LevelComparison:
    """Compare records of one test at several levels: is the structure linear, and from which level on is it not?

    The linear modes that explain each record best are followed from the lowest level up. In a linear structure they stay.
    The level of a record is the peak of its forces, which does not depend on how long the record goes on after a tap.

    Parameters
    ----------
    records : sequence of Record
        Two records or more with the same channels, applied forces (N) among them, whose peaks are the levels.
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
        If there are fewer than two records, or no mode stands above the noise at the lowest level.
    IdentificationError
        If the records lack a force or a motion, or differ in their channels.
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
    >>> link = lw.Link("spring", ("m1", lw.GROUND), law, values)
    >>> oscillator = lw.Structure("hardening", (lw.Mass("m1", number(1.0)),), (link,))
    >>> taps = [
    ...     lw.simulate(
    ...         oscillator, forces={"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=4.0, rate=200.0, sensors=["a:m1"]
    ...     ).with_noise(40.0, seed=1)
    ...     for size in (0.1, 0.2, 2.0)
    ... ]
    >>> found = lw.compare_levels(taps)
    >>> found.first_nonlinear, found.moved(1), found.moved(2)
    (2, (), (1,))
    """
    records = record_list(records, "records")
    if len(records) < 2:
        raise RecordError(f"levels are compared between two records or more, got {len(records)}")
    _require_same_channels(records)
    measured = [ModalMeasurement.of([record], scaled=False) for record in records]
    levels = np.array([_level(record) for record in records])
    order = np.argsort(levels, kind="stable")
    lowest = measured[order[0]]
    pursued = pursued_modes(lowest, modes, part(progress, 0.0, 0.5))
    if not len(pursued.frequencies):
        raise RecordError(
            "no mode stands above the noise at the lowest level; excite the structure more strongly"
        )
    every = refined_modes(lowest, pursued.frequencies, pursued.damping)
    selected = list(range(len(every.damping))) if modes is not None else _followed(every)
    frequencies, damping = every.frequencies[selected], every.damping[selected]
    by_level: list[RefinedModes] = []
    for number, place in enumerate(order.tolist()):
        progress(ProgressReport(0.5 + 0.5 * number / len(records), f"level {number + 1}"))
        by_level.append(refined_modes(measured[place], frequencies, damping))
        frequencies, damping = by_level[-1].frequencies, by_level[-1].damping
    ordered = [records[place] for place in order.tolist()]
    response, force = _channels(records[order[0]])
    highest, last = ordered[-1], by_level[-1]
    noise = channel_noise(highest)
    shown = _shown(highest)
    rings = []
    for mode in range(len(selected)):
        sizes = np.abs(last.residues[mode]).max(axis=1)
        relative = [size / noise[name] for size, name in zip(sizes, shown, strict=True)]
        best = shown[int(np.argmax(relative))]
        rings.append(ring_down(highest, best, last.frequencies, mode, noise[best]))
    return LevelComparison(
        labels=_labels(ordered),
        levels=levels[order],
        frequencies=np.array([refined.frequencies for refined in by_level]),
        damping=np.array([refined.damping for refined in by_level]),
        frequency_errors=np.array(
            [refined.relative_errors[:, 0] * refined.frequencies for refined in by_level]
        ),
        damping_errors=np.array([refined.relative_errors[:, 1] * refined.damping for refined in by_level]),
        left=np.array([refined.left for refined in by_level]),
        noise=np.array(
            [_noise_share(record, refined) for record, refined in zip(ordered, by_level, strict=True)]
        ),
        responses=tuple(ResponseFunction.of(record, response, force) for record in ordered),
        distortions=tuple(distortion(record, response, force) for record in ordered),
        ring_downs=tuple(ring for ring in rings if ring is not None),
    )


def _level(record: Record) -> float:
    """The largest magnitude of all forces."""
    forces = [record.channel(name) for name in record.inputs if name.startswith("force:")]
    return max(float(np.abs(force).max()) for force in forces)


def _noise_share(record: Record, modes: RefinedModes) -> float:
    """Power of the noise as a part of that of the responses, as `RefinedModes.left` is one."""
    noise = channel_noise(record)
    variance = np.array([noise[name] ** 2 for name in _shown(record)])
    return float(np.mean(variance / np.maximum(modes.power, np.finfo(float).tiny)))


def _shown(record: Record) -> list[str]:
    """The responses that are motions."""
    return [name for name in record.responses if name.partition(":")[0] in ("x", "v", "a")]


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


def _followed(refined: RefinedModes) -> list[int]:
    """The numbers of the modes that are well determined, at most those that respond most, in the order of frequencies."""
    peaks = np.abs(refined.residues).max(axis=(1, 2)) / refined.damping
    errors = refined.relative_errors
    firm = (
        (refined.damping > UNDAMPED)
        & (errors[:, 0] < OF_BANDWIDTH * refined.damping)
        & (errors[:, 1] < OF_DAMPING)
    )
    some = np.flatnonzero(firm) if firm.any() else np.arange(len(peaks))
    return sorted(some[np.argsort(-peaks[some])][:_MOST].tolist())


def _channels(record: Record) -> tuple[str, str]:
    """The largest force, and a response where it acts, or else that which stands farthest above its noise."""
    forces = [name for name in record.inputs if name.startswith("force:")]
    force = max(forces, key=lambda name: float(np.mean(record.channel(name) ** 2)))
    place = force.partition(":")[2]
    shown = _shown(record)
    at_force = [name for name in shown if name.partition(":")[2] == place]
    noise = channel_noise(record)
    return max(
        at_force or shown, key=lambda name: float(np.nanstd(record.channel(name)) / noise[name])
    ), force


def _labels(records: Sequence[Record]) -> tuple[str, ...]:
    sources = [record.source for record in records]
    return tuple(
        source if source and sources.count(source) == 1 else f"level {number}"
        for number, source in enumerate(sources, start=1)
    )
