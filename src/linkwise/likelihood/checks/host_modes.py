"""Hosts that lack a mode in the band.

The modes of a host move alone under the forces on its points: those that are applied, and those of the links along the fitted
motion. A sensor on the host shows a sum of these motions and of free decays, in which a host that is stated as it should be
has only its own frequencies. A mode that is not stated leaves a peak, and one more mode explains it. Amplitudes are free at
every sensor, as where the modes of a test are looked for, so that no shape has to be known, nor any to be right.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.fit import motion_of_links
from linkwise.modal.measurement import ModalMeasurement
from linkwise.modal.pursuit import Projection, best_addition
from linkwise.model.host import Host
from linkwise.records.channel import BASE, Channel
from linkwise.records.record import Record
from linkwise.verdict import Verdict

_MORE = 20.0  # times what any other cause explains: a mode that is lacking is no small error, as these are
_SAMPLES = 20_000  # of the first record, that are looked at
_MODES = 60  # of a host, that can be told apart
_SHORTEST = 6  # samples for each of the columns of the modes
_NYQUIST = 0.45  # of the rate: frequencies up to which a mode is in the band
_STILL = 1e-3  # periods in a record of a motion that stands for a rigid one
_DAMPING = (1e-6, 0.99)  # damping that stands for none, and for more than critical
_APART = 0.08  # relative distance from a stated frequency, below which that is rather off
_JUDGED = 0.5  # of what is left in the sensors of the host: one more mode beside other causes explains less
_GAIN = 50.0  # of -2 log likelihood for each column that is added
_SEEN = 100.0  # of the noise in power: a mode that should be seen in the sensors
_NEEDED = 0.05  # of what a mode that should be seen takes off: less, and it is elsewhere


def modes_of_hosts(of: Examined, before: Judgement) -> Judgement | None:
    """Whether hosts lack modes, before all other causes: errors of sensors look a little like them."""
    settled = before.verdict is not Verdict.NOT_CONVERGED  # else the forces of links are wrong
    if of.fit.random_forces or not (settled and of.is_unexplained(before.verdict)):
        return None
    most = max((cause.gain for cause in before.diagnosis), default=0.0)
    causes = tuple(cause for cause in _lacking_modes(of) if cause.gain > _MORE * most)
    if not causes:
        return None
    parts = [
        f"with {cause.description}, the forces on it explain {100.0 * cause.share:.3g} % of what its stated modes leave in "
        "its sensors: state that mode, or keep it of the matrices"
        for cause in causes
    ]
    message = f"The structure does not explain the record: {'; '.join(parts)}."
    return before.overruled(Verdict.UNEXPLAINED_FORCES, message, *causes, is_final=True)


def _lacking_modes(of: Examined) -> Iterator[Cause]:
    """For each host at most one; none on a moving base, and where a model error stands for what the laws lack."""
    record = of.records[0]
    if not of.fit.chi_square_off or any(channel.place == BASE for channel in record.channels):
        return
    start = record[: min(len(record), _SAMPLES)]
    forces = _forces_on_points(of, len(start)) if of.identified.hosts else {}
    for host in of.identified.hosts:
        measured = _measured(host, start, forces, of.fit.noise)
        cause = None if measured is None else _lacking_mode(host, measured)
        if cause is not None:
            yield cause


def _forces_on_points(of: Examined, samples: int) -> dict[str, Floats]:
    """(N,) the force on each point of a host along the fitted motion, from the start of the first record."""
    identified, record = of.identified, of.records[0]
    motion = motion_of_links(of.fit, identified, of.records)
    points = {point for host in identified.hosts for point in host.points}
    totals: dict[str, Floats] = {}
    for number, link in enumerate(identified.links):
        if link.name in identified.modes or not points.intersection(link.between):
            continue
        force = None if motion.identified_force is None else motion.identified_force[:samples, number]
        if force is None or np.isnan(force).any():
            force = link.force(motion.d[:samples, number], motion.v[:samples, number], {})
        for point, sign in zip(link.between, (-1.0, 1.0), strict=True):
            if point in points:
                totals[point] = totals.get(point, 0.0) + sign * np.nan_to_num(force)
    for channel in record.forces:
        if (point := channel.place) in points:
            totals[point] = totals.get(point, 0.0) + np.nan_to_num(record.channel(channel)[:samples])
    return totals


def _measured(
    host: Host, record: Record, forces: Mapping[str, Floats], noise: Mapping[str, float]
) -> ModalMeasurement | None:
    """What the sensors of a host show of it under the forces on its points.

    None where no sensor is on the host, no force acts, or there are too many modes for the samples.
    """
    sensors = [channel for channel in record.motions if channel.place in host.points]
    acting = {point: force for point, force in forces.items() if point in host.points and force.any()}
    values = [mode.frequency.value for mode in host.modes]
    if not sensors or not acting or None in values or len(values) > _MODES:
        return None
    shown = np.column_stack([record.select(sensors).values, *acting.values()])
    complete = int(np.isfinite(shown).all(axis=1).sum())
    if complete < _SHORTEST * (len(values) + 1) * (len(acting) + 2):
        return None
    channels = (*sensors, *(Channel("force", point) for point in acting))
    deviations = {name: noise.get(name) or 1.0 for name in sensors}
    test = Record(0.0, record.rate, channels, shown, noise=deviations)
    return ModalMeasurement.of([test], host.name, scaled=False)


def _lacking_mode(host: Host, measured: ModalMeasurement) -> Cause | None:
    """The mode that explains most of what the stated ones leave, if it explains what no other cause does."""
    [run] = measured.runs
    slowest, highest = _STILL / (run.step * run.count), _NYQUIST / run.step
    stated = {
        name: np.log([max(frequency, slowest), np.clip(mode.damping.value or 0.0, *_DAMPING)])
        for name, mode in zip(host.coordinates, host.modes, strict=True)
        if (frequency := mode.frequency.value or 0.0) <= highest
    }
    modes = Projection(measured, np.array([*stated.values()]))
    near = [((1.0 - _APART) * own, (1.0 + _APART) * own) for own in np.exp(modes.logs[:, 0]).tolist()]
    added = best_addition(modes, near)
    if added is None:
        return None
    frequency = float(np.exp(added[0, 0]))
    wider = Projection(measured, np.concatenate([modes.logs, added]))
    before, after = modes.cost(run.noise), wider.cost(run.noise)
    gain = run.responses.size * float(np.log(before / max(after, 1.0)))
    share, columns = (before - after) / before, len(run.responses) * (len(run.forces) + 2)
    if frequency > highest or any(low < frequency < high for low, high in near):
        return None
    if share < _JUDGED or gain < _GAIN * columns or _lacks_a_stated_one(host, list(stated), wider):
        return None
    return Cause("mode", host.name, frequency, "Hz", gain, standard_error=0.0, share=share)


def _lacks_a_stated_one(host: Host, stated: Sequence[str], modes: Projection) -> bool:
    """Whether the sensors do not show a stated mode that they should: then it is another one, and none is lacking."""
    measured = modes.measured
    [run] = measured.runs
    for number, name in enumerate(stated):
        shape = np.array([host.shape(f"{host.name}.{point}")[name] for point in measured.points])
        driven = np.tensordot(
            shape[measured.forced], run.motions(*np.exp(modes.logs[number]))[: len(run.forces)], axes=1
        )
        expected = replace(run, responses=shape[measured.sensed, None] * driven[measured.kinds])
        others = replace(modes, logs=np.delete(modes.logs, number, axis=0))
        alone = replace(others, measured=replace(measured, runs=(expected,))).cost(run.noise)
        needed = others.cost(run.noise) - modes.cost(run.noise)
        if alone > _SEEN * len(run.responses) and needed < _NEEDED * alone:
            return True
    return False
