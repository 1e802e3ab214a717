"""Free runs: an identified structure under the inputs of a record that it was not identified from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.likelihood.shooting.system import System
from linkwise.model.host_support import refuse_hosts
from linkwise.model.input_signal import Sampled
from linkwise.model.memory_support import refuse_memory
from linkwise.model.rig_support import refuse_rig
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel
from linkwise.records.interpolation import BAND_LIMITED, ORDER_OF
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed
from linkwise.simulation.simulate import simulate

_STEP = 1e-5  # of the size of a state: for derivatives of a simulation that is right to rounding
_AFTER = 8  # samples of input beyond the settling: the spline through them then has no end there


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A simulation of a structure under the inputs of a record, compared with that record.

    Attributes
    ----------
    motion : Record
        The responses of the record as the structure gives them.
    residual : Record
        The responses of the record less these.
    rmse : mapping of str to float
        Root mean square of the residual after the first `settling` samples, by channel, in its SI unit.
    settling : int
        The number of samples that the initial state was fitted to.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.4, rate=1000.0).with_noise(40.0, seed=1)
    >>> run = lw.free_run(chain, record)
    >>> run.motion.channels, run.settling
    (('x:m1', 'x:m2'), 50)
    """

    motion: Record
    residual: Record
    rmse: Mapping[str, float]
    settling: int

    @property
    def horizon(self) -> float | None:
        """Time in s past which a chaotic motion cannot be predicted; None if it can throughout.

        Rounding alone has then grown to a part of the motion; an error of the structure or of its initial state gets there
        sooner.
        """
        return None if self.motion.simulated is None else self.motion.simulated.horizon


@checked
def free_run(structure: Structure, record: Record, *, settling: int = 50) -> FreeRun:
    """Simulate an identified structure under the inputs of a record, from the state that fits its first samples best.

    Use a part of the record that the structure was not identified from. A chaotic structure departs from any record after a
    while, however well it is identified, since the error of its initial state grows (that of the paper's chains within about a
    second): the run then validates the time before, and `nmse` compares forces over the whole record.

    Parameters
    ----------
    structure : Structure
        The structure, every coefficient a number.
    record : Record
        The record. Its forces and base motion drive the structure, interpolated by a spline of the fifth order.
    settling : int
        The number of samples to which the displacements and velocities at the start are fitted, by least squares.

    Returns
    -------
    FreeRun
        The motion, and its difference from the record.

    Raises
    ------
    RecordError
        If the record has no response of the structure, has inputs with gaps, or is not longer than the settling.
    IdentificationError
        If the motion of the base is not known well enough for a link or a channel.
    SimulationError
        If the structure diverges.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record[:500], chain.unknown("nes"))
    >>> run = lw.free_run(fit.structure, record[500:700])
    >>> sorted(run.rmse)
    ['x:m1', 'x:m2']
    """
    refuse_rig(structure, "validation")
    refuse_memory(structure.links, "free runs")
    refuse_hosts(structure, "free runs")
    given = record.select([*record.inputs, *_responses(structure, record)])
    frame = framed(given, structure)
    record, channels = frame.record, frame.record.responses
    if not 2 <= settling < len(record):
        raise RecordError(
            f"settling must be at least 2 and leave samples to compare, got {settling} of {len(record)} samples"
        )
    for name in channels:
        present = ~np.isnan(record.channel(name))
        if not (present[:settling].any() and present[settling:].any()):
            raise RecordError(
                f"has no sample among the first {settling}, which determine the state, or none after them",
                channel=name,
            )
    state = _initial_state(structure, record.select(channels), _inputs(record, settling + _AFTER), settling)
    run = _run(structure, channels, state, _inputs(record, len(record)), record.rate, len(record))
    motion = replace(run, start=record.start).select(channels)
    residual = record.select(channels).values - motion.values
    channels = given.responses
    motion = replace(motion, channels=channels, values=motion.values + frame.shown)
    rmse = np.sqrt(np.nanmean(residual[settling:] ** 2, axis=0))
    return FreeRun(
        motion=motion,
        residual=Record(
            record.start, record.rate, channels, residual, source=f"{record.source} less a free run"
        ),
        rmse=dict(zip(channels, map(float, rmse), strict=True)),
        settling=settling,
    )


def _responses(structure: Structure, record: Record) -> tuple[str, ...]:
    channels = tuple(name for name in record.responses if Channel.parse(name).mass in structure.mass_names)
    if not channels:
        raise RecordError(
            f"no response of {', '.join(structure.mass_names)} is in the record, which holds {', '.join(record.channels)}; "
            "there is nothing to compare a run with"
        )
    return channels


def _inputs(record: Record, samples: int) -> dict[str, Sampled]:
    """The inputs of the first so many samples by channel, on a clock that starts at 0."""
    inputs = {}
    for name in record.inputs:
        kind, _, where = name.partition(":")
        if where == BASE and kind != "x":
            continue
        values = record.channel(name)
        if np.isnan(values).any():
            raise RecordError(
                "samples are missing, and an input drives the motion: fill them first", channel=name
            )
        order = ORDER_OF[record.interpolation.get(name, BAND_LIMITED)]
        inputs[name] = Sampled(0.0, record.rate, values[:samples], order=order)
    return inputs


def _run(
    structure: Structure,
    channels: tuple[str, ...],
    state: Floats,
    inputs: Mapping[str, Sampled],
    rate: float,
    samples: int,
) -> Record:
    names = structure.mass_names
    release = {f"x:{name}": float(x) for name, x in zip(names, state[: len(names)], strict=True)}
    release |= {
        f"v:{name}": float(v) for name, v in zip(names, state[len(names) : 2 * len(names)], strict=True)
    }
    inside = [f"state:{structure.links[index].name}.{name}" for index, name in System.of(structure).states]
    release |= {name: float(value) for name, value in zip(inside, state[2 * len(names) :], strict=True)}
    forces = {name.partition(":")[2]: signal for name, signal in inputs.items() if name.startswith("force:")}
    return simulate(
        structure,
        duration=(samples - 1) / rate,
        rate=rate,
        sensors=channels,
        release=release,
        forces=forces,
        base=inputs.get(f"x:{BASE}"),
    )


def run_from(
    structure: Structure,
    record: Record,
    channels: tuple[str, ...],
    state: Floats,
    extra: Mapping[str, Floats] | None = None,
) -> Record:
    """The channels of a structure that runs from a state (2 n + S,) under the inputs of a record, by the record's clock.

    `extra` forces in N (N,) by channel are added to those of the record.
    """
    inputs = _inputs(record, len(record))
    for name, force in (extra or {}).items():
        given = record.channel(name) if name in inputs else 0.0
        inputs[name] = Sampled(
            0.0, record.rate, given + force, order=inputs[name].order if name in inputs else 5
        )
    run = _run(structure, channels, state, inputs, record.rate, len(record))
    return replace(run, start=record.start)


def _initial_state(
    structure: Structure, measured: Record, inputs: Mapping[str, Sampled], settling: int
) -> Floats:
    """(2 n,) displacements in m and velocities in m/s at the first sample."""
    first = measured.values[:settling]
    size = np.sqrt(np.nanmean(first**2, axis=0))
    weights = np.where(np.isfinite(first), 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    guess, scale = _rough_state(structure, measured[:settling])

    def residual(relative: Floats) -> Floats:
        run = _run(structure, measured.channels, guess + scale * relative, inputs, measured.rate, settling)
        return np.asarray((weights * (run.select(measured.channels).values - np.nan_to_num(first))).ravel())

    def slope(relative: Floats) -> Floats:
        unmoved = residual(relative)
        steps = _STEP * np.eye(len(guess))
        return np.stack([(residual(relative + step) - unmoved) / _STEP for step in steps], axis=1)

    return np.asarray(
        guess + scale * scipy.optimize.least_squares(residual, np.zeros(len(guess)), jac=slope).x
    )


def _rough_state(structure: Structure, measured: Record) -> tuple[Floats, Floats]:
    """A rough state (2 n,) at the first of a few samples, from a parabola through each displacement, and its size (2 n,)."""
    count = structure.size
    guess, size = np.zeros(2 * count), np.zeros(2 * count)
    for i, name in enumerate(structure.mass_names):
        for kind, place in (("x", i), ("v", count + i)):
            if f"{kind}:{name}" not in measured.channels:
                continue
            values = measured.channel(f"{kind}:{name}")
            at = np.flatnonzero(np.isfinite(values))[:8]
            if len(at) < 3:
                continue
            fitted = np.polynomial.polynomial.polyfit(at / measured.rate, values[at], 2)
            guess[place], size[place] = fitted[0], float(np.sqrt(np.nanmean(values**2)))
            if kind == "x" and f"v:{name}" not in measured.channels:
                guess[count + i] = fitted[1]
                size[count + i] = float(np.sqrt(np.nanmean(np.gradient(values, measured.step) ** 2)))
    for half in (slice(0, count), slice(count, None)):
        known = size[half][size[half] > 0.0]
        size[half] = np.where(size[half] > 0.0, size[half], known.mean() if len(known) else 1.0)
    return guess, size
