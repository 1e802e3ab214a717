"""The prediction of a record: one free run, or windows where the motion is chaotic, with what limits its accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError, RecordError, SimulationError, expect
from linkwise.estimates.uncertainty import Posterior
from linkwise.identification.validation.answer import uncertain
from linkwise.identification.validation.windows import WindowPredictor
from linkwise.likelihood.rigs.estimate import motion_deviations
from linkwise.likelihood.rigs.problem import (
    BASE_CHANNEL,
    Minimum,
    RigProblem,
    cell_name,
    cell_noise,
    minimise,
    rig_forces,
)
from linkwise.likelihood.shooting.system import System
from linkwise.model.excitation import Sampled
from linkwise.model.link import refuse_memory
from linkwise.model.structure import BASE, Structure, refuse_hosts, refuse_rig
from linkwise.progress import Progress, ProgressReport
from linkwise.records.channel import BAND_LIMITED, LARGEST, ORDER_OF, Channel, require_complete
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed
from linkwise.simulation.simulate import simulate

_RELATIVE_STEP = 1e-5  # of the size of a state: for derivatives of a simulation that is right to rounding
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
    >>> run = lw.analysis.free_run(chain, record)
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
    >>> run = lw.analysis.free_run(fit.structure, record[500:700])
    >>> sorted(run.rmse)
    ['x:m1', 'x:m2']
    """
    expect("free_run(structure, record): structure", structure, Structure)
    expect("free_run(structure, record): record", record, Record)
    refuse_rig(structure, "validation")
    refuse_memory(structure.links, "free runs")
    refuse_hosts(structure, "free runs")
    given = record.select([*record.inputs, *_responses(structure, record)])
    frame = framed(given, structure)
    record, channels = frame.record, frame.record.responses
    if not 2 <= settling < len(record):
        message = f"settling must be at least 2 and leave samples to compare, got {settling} of {len(record)} samples"
        raise RecordError(message)
    for name in channels:
        present = ~np.isnan(record.channel(name))
        if not (present[:settling].any() and present[settling:].any()):
            message = (
                f"has no sample among the first {settling}, which determine the state, or none after them"
            )
            raise RecordError(message, channel=name)
    state = _initial_state(structure, record.select(channels), _inputs(record, settling + _AFTER), settling)
    run = _run(structure, channels, state, _inputs(record, len(record)), record.rate, len(record))
    motion = replace(run, start=record.start).select(channels)
    residual = record.select(channels).values - motion.values
    channels = given.responses
    motion = replace(motion, channels=channels, values=motion.values + frame.shown)
    rmse = np.sqrt(np.nanmean(residual[settling:] ** 2, axis=0))
    left = Record(record.start, record.rate, channels, residual, source=f"{record.source} less a free run")
    errors: dict[str, float] = dict(zip(channels, map(float, rmse), strict=True))
    return FreeRun(motion=motion, residual=left, rmse=errors, settling=settling)


def _responses(structure: Structure, record: Record) -> tuple[Channel, ...]:
    channels = tuple(channel for channel in record.responses if channel.place in structure.mass_names)
    if not channels:
        raise RecordError(
            f"no response of {', '.join(structure.mass_names)} is in the record, which holds {', '.join(record.channels)}; "
            "there is nothing to compare a run with"
        )
    return channels


def _inputs(record: Record, samples: int) -> dict[Channel, Sampled]:
    """The inputs of the first so many samples by channel, on a clock that starts at 0."""
    inputs = {}
    for name in record.inputs:
        if name.place == BASE and name.kind != "x":
            continue
        values = record.channel(name)
        require_complete(name, values, record.start, record.rate)
        order = ORDER_OF[record.interpolation.get(name, BAND_LIMITED)]
        inputs[name] = Sampled(0.0, record.rate, values[:samples], order=order)
    return inputs


def _run(
    structure: Structure,
    channels: tuple[str, ...],
    state: Floats,
    inputs: Mapping[Channel, Sampled],
    rate: float,
    samples: int,
) -> Record:
    released = [f"{kind}:{name}" for kind in "xv" for name in structure.mass_names]
    released += [f"state:{structure.links[index].name}.{name}" for index, name in System.of(structure).states]
    return simulate(
        structure,
        duration=(samples - 1) / rate,
        rate=rate,
        sensors=channels,
        release=dict(zip(released, state.tolist(), strict=True)),
        forces={channel.place: signal for channel, signal in inputs.items() if channel.is_force},
        signals={name: inputs[Channel("signal", name)] for name in structure.signals},
        base=inputs.get(Channel("x", BASE)),
    )


def _initial_state(
    structure: Structure, measured: Record, inputs: Mapping[Channel, Sampled], settling: int
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
        steps = _RELATIVE_STEP * np.eye(len(guess))
        return np.stack([(residual(relative + step) - unmoved) / _RELATIVE_STEP for step in steps], axis=1)

    found = scipy.optimize.least_squares(residual, np.zeros(len(guess)), jac=slope).x
    return np.asarray(guess + scale * found)


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


_LOST = 0.1  # of the RMS of a channel: an uncertainty of the state that has grown to it ends a prediction
_GROWN = 10.0  # times that over the burn: what is as uncertain from the start has not grown
_STAYS = 0.5  # of the time that follows, as long as the burn: an uncertainty that passes is not the end
# samples: chaos loses the state in fewer, and the runs through a long record need not be made
_BEGINNING = 5_000
_FEWEST = 50  # samples of that time at least: after a shorter burn the uncertainty grows for as long without any chaos
_SHORTEST = 4  # samples that a window predicts at least
_LONGEST = 8  # windows at least
_SETTLE = 100  # samples at most that determine the state of a window
# of the samples must come before the prediction of their window is lost; the others are left out
_WITHIN = 0.9
_HISTORY = 20  # samples before the one that is predicted one step ahead
_MOST_STEPS = 4000  # predictions one step ahead


@dataclass(frozen=True, eq=False)
class Prediction:
    """N samples of C responses as a structure predicts them, (N, C) in SI units, NaN where nothing is predicted.

    `by_state`, `by_coefficients` and `by_laws` (N, C) are variances of it from the state at the start, the coefficients
    and the stated error of the laws; `d` in m and `v` in m/s (N, L) the motion of the links. It runs from `starts`
    independent states, each for a `window` in s, or None for one free run, which the growth of the error of its state
    hides a `horizon` in s after the burn, or never.
    """

    predicted: Floats
    by_state: Floats
    by_coefficients: Floats
    by_laws: Floats
    d: Floats
    v: Floats
    starts: int = 1
    window: float | None = None
    horizon: float | None = None

    @property
    def variance(self) -> Floats:
        """The variance (N, C) of the prediction, of all that is not exact."""
        return self.by_state + self.by_coefficients + self.by_laws


def predict(predictor: WindowPredictor, burn: int, progress: Progress) -> Prediction:
    """Predict a record from the state in its first `burn` samples, as far as chaos lets it, else in windows."""
    progress(ProgressReport(0.0, "state at the start"))
    record = predictor.record
    size = np.nanstd(record.select(record.responses).values, axis=0)
    for samples in dict.fromkeys((min(burn + _BEGINNING, len(record)), len(record))):
        run = _free_run(predictor, burn, samples, progress)
        horizon = _horizon(run, burn, size)
        told = samples == len(record) or (horizon or 0) < samples - 2 * max(burn, _FEWEST)
        if horizon is not None and told:  # that it stays lost shows only before the end of a beginning
            progress(ProgressReport(0.6, "windows"))
            return _windows(predictor, burn, horizon, size)
    return run


def _horizon(run: Prediction, burn: int, size: Floats) -> int | None:
    """Samples after the burn from which a run has lost the state, beside channels of that `size` (C,); None for none."""
    deviation = np.sqrt(run.by_state)
    span = max(burn, _FEWEST)
    early = np.sqrt(np.mean(run.by_state[:span], axis=0))
    lost = (deviation > _LOST * size) & (deviation > _GROWN * early)
    lost = (lost & (_ahead(lost, span) > _STAYS)).any(axis=1)
    lost[:burn] = False
    return max(int(np.argmax(lost)) - burn, 2 * _SHORTEST) if lost.any() else None


def one_step(predictor: WindowPredictor, burn: int) -> tuple[Floats, Floats]:
    """Predictions (N, C) of samples after the burn, each from the samples just before it, and their variance.

    NaN where a sample is not predicted, which is so of most in a long record.
    """
    record = predictor.record
    history = min(_HISTORY, burn)
    count = len(record) - burn
    targets = burn + np.arange(0, count, -(-count // _MOST_STEPS))
    prediction = predictor(targets - history, history, history + 1)
    shape = (len(record), len(record.responses))
    predicted, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    predicted[targets] = prediction.predicted[-1].T
    variance[targets] = (prediction.by_state + prediction.by_coefficients + prediction.by_laws)[-1].T
    return predicted, variance


def _free_run(predictor: WindowPredictor, burn: int, samples: int, progress: Progress) -> Prediction:
    """One run of so many samples, and what errors of its start, coefficients and laws change of it."""
    record, structure = predictor.record[:samples], predictor.structure
    channels = record.responses
    start = predictor(np.zeros(1, dtype=int), burn, burn)
    state, root = start.state[:, 0], start.state_root[0]
    if not (np.isfinite(state).all() and np.isfinite(root).all()):
        raise SimulationError(
            f"no state is found from which the answer follows the first {burn} samples of the record: its laws run away along "
            "that motion; check its coefficients and their units, or identify again"
        )
    names = [parameter.name for parameter in structure.parameters]
    valued = structure.with_values(dict(zip(names, map(float, predictor.values), strict=True)))
    progress(ProgressReport(0.2, "free run"))
    run = _run(valued, channels, state, _inputs(record, samples), record.rate, samples)
    truth = run.simulated
    assert truth is not None
    progress(ProgressReport(0.5, "what errors change of it"))
    states = [*truth.displacement.T, *truth.velocity.T, *truth.states.values()]
    predicted = run.select(channels).values.copy()
    predicted[:burn] = np.nan
    return Prediction(
        predicted,
        *predictor.variances_along(np.array(states), root, start.state_by_coefficients[0]),
        *_along(record, structure, truth.displacement, truth.velocity),
    )


def _along(record: Record, structure: Structure, x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """(N, L) elongations in m and rates in m/s of the links, from displacements and velocities (N, n) of the masses."""
    if f"x:{BASE}" not in record.channels:
        return structure.elongations(x, None), structure.elongations(v, None)
    base = record.channel(f"x:{BASE}")
    return structure.elongations(x, base), structure.elongations(v, np.gradient(base, record.step))


def _windows(predictor: WindowPredictor, burn: int, horizon: int, size: Floats) -> Prediction:
    """The longest windows, by factors of two, of which nearly all samples come before the state is lost."""
    record, structure = predictor.record, predictor.structure
    samples = max(min((len(record) - burn) // _LONGEST, horizon), _SHORTEST)
    while True:
        settle = min(burn, max(_HISTORY, samples), _SETTLE)
        firsts = np.arange(burn, len(record), samples) - settle
        prediction = predictor(firsts, settle, settle + samples)
        deviation = np.sqrt(prediction.by_state[settle:])  # (M, C, K)
        early = np.sqrt(np.mean(prediction.by_state[:settle], axis=0))
        lost = ((deviation > _LOST * size[:, None]) & (deviation > _GROWN * early)).any(axis=1)
        lost = np.maximum.accumulate(lost, axis=0)  # (M, K)
        if 1.0 - np.mean(lost) >= _WITHIN or samples == _SHORTEST:
            break
        samples = max(samples // 2, _SHORTEST)
    ahead = prediction.predicted[settle:].transpose(0, 2, 1)
    running_away = int(np.any(~(np.abs(ahead) <= LARGEST) & ~lost[..., None], axis=(0, 2)).sum())
    if running_away:
        raise SimulationError(
            f"from {running_away} of {len(firsts)} states along the record the motion of the answer runs to infinity; check "
            "its coefficients, and the units of the channels of the record and of its time"
        )
    ahead[lost] = np.nan

    def joined(parts: Floats) -> Floats:
        """(N, ...) from (M, ..., K): what follows the state of each window, one after the other."""
        tail = np.moveaxis(parts[settle:], -1, 0)
        tail = tail.reshape(-1, *tail.shape[2:])[: len(record) - burn]
        return np.concatenate([np.full((burn, *tail.shape[1:]), np.nan), tail])

    motion = joined(prediction.motion)
    d, v = _along(record, structure, motion[:, 0], motion[:, 1])
    return Prediction(
        predicted=joined(prediction.predicted),
        by_state=joined(prediction.by_state),
        by_coefficients=joined(prediction.by_coefficients),
        by_laws=joined(prediction.by_laws),
        d=d,
        v=v,
        starts=len(firsts),
        window=samples * record.step,
        horizon=horizon * record.step,
    )


def _ahead(values: Floats | Bools, samples: int) -> Floats:
    """Means (N, C) of `values` over the samples that follow each."""
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0, dtype=float)
    ends = np.minimum(np.arange(len(values)) + samples, len(values))
    return np.asarray((total[ends] - total[:-1]) / (ends - np.arange(len(values)))[:, None])


_SUBSTEPS = 8  # between samples
_PRIOR = 1e-6  # of the normal matrix, for combinations of states that the start does not determine


def rig_channels(record: Record, structure: Structure) -> Record:
    """The motion of the base and the forces of the links; RecordError where the record does not hold them."""
    cells = [cell_name(structure, link) for link in range(len(structure.links))]
    shown = [name for name in cells if name in record.channels]
    if not shown or BASE_CHANNEL not in record.channels:
        raise RecordError(
            f"links alone on a rig are compared along {BASE_CHANNEL} with {', '.join(cells)}, and the record holds "
            f"{', '.join(record.channels)}"
        )
    return record.select([BASE_CHANNEL, *shown])


def rig_prediction(
    record: Record, structure: Structure, posterior: Posterior | None, burn: int, law_error: float
) -> tuple[Prediction, dict[str, float]]:
    """The forces by the laws, with states at the start from the first `burn` samples, and the noise by channel.

    That noise is of the load cell and of the motion, along which the forces are computed.
    """
    try:
        forces = rig_forces(record, structure)
    except IdentificationError as error:
        raise RecordError(str(error)) from None
    noise = cell_noise([record], structure)
    free = structure if posterior is None or not posterior.names else uncertain(posterior)
    problem = RigProblem(free, (forces,)).with_substeps(_SUBSTEPS)
    theta = np.array([structure.coefficient(p.name).value or 0.0 for p in free.parameters])
    minimum, covariance = _started(RigProblem(structure, (forces,)).with_substeps(_SUBSTEPS), noise, burn)
    minimum = Minimum(np.append(theta, minimum.unknowns), minimum.cost, minimum.paths, minimum.converged)
    count, cells = len(record), len(problem.links)
    slopes = problem.jacobian(minimum.paths).reshape(cells, count, -1)
    of_states, of_coefficients = slopes[..., len(theta) :], slopes[..., : len(theta)]
    moved = motion_deviations(problem, minimum).reshape(cells, count)
    every = problem.records[0].motion.substeps
    predicted = np.stack([path.force()[::every] for path in minimum.paths], axis=1)
    predicted[:burn] = np.nan
    spread = np.zeros((count, cells)) + law_error * np.nanstd(predicted, axis=0)
    order = [] if posterior is None else [posterior.names.index(p.name) for p in free.parameters]
    known = np.zeros((0, 0)) if posterior is None else posterior.beside_terms_kept[np.ix_(order, order)]
    motion = problem.records[0].motion
    prediction = Prediction(
        predicted=predicted,
        by_state=_variance(of_states, covariance),
        by_coefficients=_variance(of_coefficients, known),
        by_laws=spread**2,
        d=np.outer(motion.d[::every], structure.base_incidence),
        v=np.outer(motion.v[::every], structure.base_incidence),
    )
    levels: dict[str, float] = {
        cell_name(structure, link): float(np.hypot(noise[link], np.sqrt(np.mean(moved[number] ** 2))))
        for number, link in enumerate(problem.links)
    }
    return prediction, levels


def _started(problem: RigProblem, noise: dict[int, float], burn: int) -> tuple[Minimum, Floats]:
    """The states at the start that explain the forces of the first `burn` samples best, and their covariance."""
    cells = [(len(cell.measured), cell.link) for cell in problem.cells]
    weights = np.concatenate([np.where(np.arange(n) < burn, 1.0 / noise[link], 0.0) for n, link in cells])
    start = np.zeros(problem.size)
    paths = problem.paths(start)
    if not all(path.converged for path in paths):
        raise RecordError("the states of a link run away along the recorded motion")
    minimum = minimise(problem, start, weights) if problem.size else Minimum(start, 0.0, paths, True)
    slopes = weights[:, None] * problem.jacobian(minimum.paths)
    normal = slopes.T @ slopes
    powers = np.concatenate([np.mean(path.states**2, axis=0) for path in minimum.paths])
    # a state that the start does not show, as behind backlash, is as uncertain as it is large later on
    normal += _PRIOR * np.diag(normal.diagonal()) + np.diag(1.0 / np.where(powers > 0.0, powers, 1.0))
    return minimum, np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _variance(slopes: Floats, covariance: Floats) -> Floats:
    """Variances (N, C) of forces with derivatives (C, N, q) by what has this covariance."""
    return np.asarray(np.einsum("cnq,qr,cnr->nc", slopes, covariance, slopes))
