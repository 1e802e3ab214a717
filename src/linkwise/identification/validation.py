"""How far an identified structure is from a record that it has not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.model.input_signal import Sampled
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.simulation.simulate import simulate

_STEP = 1e-5  # of the size of a state: for derivatives of a simulation that is right to rounding
_AFTER = 8  # samples of input beyond the settling: the spline through them then has no end there


@dataclass(frozen=True, eq=False)
class FreeRun:
    """What a structure does when it is left to itself, beside a record.

    `motion` has the responses of the record as the structure gives them, `residual` those of the record less these, both at
    the samples of the record; `rmse` per channel is the root mean square of the residual after the `settling` first samples,
    which told the initial state, in the channel's SI unit.
    """

    motion: Record
    residual: Record
    rmse: Mapping[str, float]
    settling: int

    @property
    def horizon(self) -> float | None:
        """Seconds from the start until rounding alone has grown to a part of the motion; None where it does not within the
        run. An error of the structure or of its initial state gets there sooner.
        """
        return None if self.motion.simulated is None else self.motion.simulated.horizon


def free_run(structure: Structure, record: Record, *, settling: int = 50) -> FreeRun:
    """Simulate an identified `structure` under the inputs of `record`, from the state that fits its first samples best.

    The state, displacement and velocity of every mass, is a least squares fit over the first `settling` samples through the
    simulation; forces and base motion come from the record, interpolated by a spline of the fifth order. Run it on a part of
    the record that the structure was not identified from:

        whole = lw.read_record("run.csv")
        fit = lw.identify(whole[:8000], structure)
        lw.free_run(fit.structure, whole[8000:]).rmse

    A chaotic structure parts from any record after a while, however well it is identified: the error of its initial state
    grows until nothing is left (the paper's chains within a second or so). There the run tells of the time before, and
    statistics of the force, such as `nmse`, tell the rest.

    Raises RecordError where the record has no response of the structure, has inputs with gaps or a base without displacement,
    or is not longer than the settling; SimulationError where the structure diverges.
    """
    channels = _responses(structure, record)
    if not 2 <= settling < len(record):
        raise RecordError(
            f"a run cannot settle on {settling} samples: the record has {len(record)}, and some must be left to compare"
        )
    for name in channels:
        seen = ~np.isnan(record.channel(name))
        if not (seen[:settling].any() and seen[settling:].any()):
            raise RecordError(
                f"has no sample among the first {settling}, which tell the state, or none after them",
                channel=name,
            )
    state = _initial_state(structure, record.select(channels), _inputs(record, settling + _AFTER), settling)
    run = _run(structure, channels, state, _inputs(record, len(record)), record.rate, len(record))
    motion = replace(run, start=record.start).select(channels)
    residual = record.select(channels).values - motion.values
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
            if f"x:{BASE}" not in record.channels:
                raise RecordError("a run needs the displacement of the base, x:base", channel=name)
            continue
        values = record.channel(name)
        if np.isnan(values).any():
            raise RecordError(
                "samples are missing, and an input drives the motion: fill them first", channel=name
            )
        inputs[name] = Sampled(0.0, record.rate, values[:samples])
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
    release |= {f"v:{name}": float(v) for name, v in zip(names, state[len(names) :], strict=True)}
    forces = {name.partition(":")[2]: each for name, each in inputs.items() if name.startswith("force:")}
    return simulate(
        structure,
        duration=(samples - 1) / rate,
        rate=rate,
        sensors=channels,
        release=release,
        forces=forces,
        base=inputs.get(f"x:{BASE}"),
    )


def _initial_state(
    structure: Structure, seen: Record, inputs: Mapping[str, Sampled], settling: int
) -> Floats:
    """(2 n,) displacements in m and velocities in m/s at the first sample."""
    first = seen.values[:settling]
    size = np.sqrt(np.nanmean(first**2, axis=0))
    weights = np.where(np.isfinite(first), 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    guess, scale = _first_look(structure, seen[:settling])

    def residual(relative: Floats) -> Floats:
        run = _run(structure, seen.channels, guess + scale * relative, inputs, seen.rate, settling)
        return np.asarray((weights * (run.select(seen.channels).values - np.nan_to_num(first))).ravel())

    def slope(relative: Floats) -> Floats:
        here = residual(relative)
        steps = _STEP * np.eye(len(guess))
        return np.stack([(residual(relative + step) - here) / _STEP for step in steps], axis=1)

    return np.asarray(
        guess + scale * scipy.optimize.least_squares(residual, np.zeros(len(guess)), jac=slope).x
    )


def _first_look(structure: Structure, seen: Record) -> tuple[Floats, Floats]:
    """A rough state (2 n,) at the first of a few samples, from a parabola through each displacement, and its size (2 n,)."""
    count = structure.size
    guess, size = np.zeros(2 * count), np.zeros(2 * count)
    for i, name in enumerate(structure.mass_names):
        for kind, place in (("x", i), ("v", count + i)):
            if f"{kind}:{name}" not in seen.channels:
                continue
            values = seen.channel(f"{kind}:{name}")
            at = np.flatnonzero(np.isfinite(values))[:8]
            if len(at) < 3:
                continue
            fitted = np.polynomial.polynomial.polyfit(at / seen.rate, values[at], 2)
            guess[place], size[place] = fitted[0], float(np.sqrt(np.nanmean(values**2)))
            if kind == "x" and f"v:{name}" not in seen.channels:
                guess[count + i] = fitted[1]
                size[count + i] = float(np.sqrt(np.nanmean(np.gradient(values, seen.step) ** 2)))
    for half in (slice(0, count), slice(count, None)):
        known = size[half][size[half] > 0.0]
        size[half] = np.where(size[half] > 0.0, size[half], known.mean() if len(known) else 1.0)
    return guess, size
