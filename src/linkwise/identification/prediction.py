"""The prediction of a record: one free run, or windows where the motion is chaotic, with what limits its accuracy.

`predict` chooses between the two, `one_step` predicts every sample from those just before it, and `free_run` is the run alone.
All take states from a `WindowPredictor`. Its windows are segments of the likelihood that are not linked: in each the state is
fitted to the first samples, and the structure predicts the samples after, all windows at once. A weak prior of the size of
the motion holds what the first samples do not determine, such as the state of a mass without a sensor; its uncertainty is then
part of that of the prediction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import RecordError, SimulationError, expect
from linkwise.likelihood.shooting.flow import POINTS
from linkwise.likelihood.shooting.residuals import Gaussian, Misfit, Orbit, evaluate
from linkwise.likelihood.shooting.segmentation import inputs_along, sensor_arrays
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangents import whitened_jacobian
from linkwise.likelihood.starts.states import start_states
from linkwise.model.excitation import Sampled
from linkwise.model.link import refuse_memory
from linkwise.model.structure import BASE, Structure, refuse_hosts, refuse_rig
from linkwise.progress import Progress, ProgressReport
from linkwise.records.channel import BAND_LIMITED, HELD, ORDER_OF, Channel, interpolated
from linkwise.records.channel_units import places_of
from linkwise.records.record import Record
from linkwise.records.sample_checks import LARGEST, require_complete
from linkwise.signals.base_frame import framed
from linkwise.simulation.simulate import simulate

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

    `variances` (N, 3, C) of it are from the state at the start, the coefficients and the stated error of the laws; `d` in m
    and `v` in m/s (N, L) the motion of the links. It runs from `starts` independent states, each for a `window` in s, or None
    for one free run, which the growth of the error of its state hides a `horizon` in s after the burn, or never.
    """

    predicted: Floats
    variances: Floats
    d: Floats
    v: Floats
    starts: int = 1
    window: float | None = None
    horizon: float | None = None


def predict(predictor: WindowPredictor, burn: int, progress: Progress) -> Prediction:
    """Predict a record from the state in its first `burn` samples, as far as chaos lets it, else in windows."""
    progress(ProgressReport(0.0, "state at the start"))
    record = predictor.record
    size = np.nanstd(record.select(record.responses).values, axis=0)
    for samples in dict.fromkeys((min(burn + _BEGINNING, len(record)), len(record))):
        run = _one_run(predictor, burn, samples, progress)
        horizon = _horizon(run, burn, size)
        is_certain = samples == len(record) or (horizon or 0) < samples - 2 * max(burn, _FEWEST)
        if horizon is not None and is_certain:  # that it stays lost shows only before the end of a beginning
            progress(ProgressReport(0.6, "windows"))
            return _in_windows(predictor, burn, horizon, size)
    return run


def _horizon(run: Prediction, burn: int, size: Floats) -> int | None:
    """Samples after the burn from which a run has lost the state, beside channels of that `size` (C,); None for none."""
    deviation = np.sqrt(run.variances[:, 0])
    span = max(burn, _FEWEST)
    early = np.sqrt(np.mean(run.variances[:span, 0], axis=0))
    lost = (deviation > _LOST * size) & (deviation > _GROWN * early)
    lost = (lost & (_means_ahead(lost, span) > _STAYS)).any(axis=1)
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
    variance[targets] = prediction.variances[-1].sum(axis=0).T
    return predicted, variance


def _one_run(predictor: WindowPredictor, burn: int, samples: int, progress: Progress) -> Prediction:
    """One run of so many samples, and what errors of its start, coefficients and laws change of it."""
    record, structure = predictor.record[:samples], predictor.structure
    channels = record.responses
    start = predictor(np.zeros(1, dtype=int), burn, burn)
    state, root = start.state[:, 0], start.state_root[..., 0]
    if not (np.isfinite(state).all() and np.isfinite(root).all()):
        raise no_state(burn)
    progress(ProgressReport(0.2, "free run"))
    run = _simulated(predictor.valued, record, state)
    truth = run.simulated
    assert truth is not None
    progress(ProgressReport(0.5, "what errors change of it"))
    states = [*truth.displacement.T, *truth.velocity.T, *truth.states.values()]
    predicted = run.select(channels).values.copy()
    predicted[:burn] = np.nan
    of_record = replace(predictor, record=record)
    variances = of_record.variances_along(np.array(states), root, start.state_by_coefficients[..., 0])
    return Prediction(
        predicted, variances, *_link_motion(record, structure, truth.displacement, truth.velocity)
    )


def _link_motion(record: Record, structure: Structure, x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """(N, L) elongations in m and rates in m/s of the links, from displacements and velocities (N, n) of the masses."""
    if f"x:{BASE}" not in record.channels:
        return structure.elongations(x, None), structure.elongations(v, None)
    base = record.channel(f"x:{BASE}")
    return structure.elongations(x, base), structure.elongations(v, np.gradient(base, record.step))


def _in_windows(predictor: WindowPredictor, burn: int, horizon: int, size: Floats) -> Prediction:
    """The longest windows, by factors of two, of which nearly all samples come before the state is lost."""
    record, structure = predictor.record, predictor.structure
    samples = max(min((len(record) - burn) // _LONGEST, horizon), _SHORTEST)
    while True:
        settle = min(burn, max(_HISTORY, samples), _SETTLE)
        firsts = np.arange(burn, len(record), samples) - settle
        prediction = predictor(firsts, settle, settle + samples)
        by_state = prediction.variances[:, 0]  # (M, C, K)
        deviation, early = np.sqrt(by_state[settle:]), np.sqrt(np.mean(by_state[:settle], axis=0))
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
    d, v = _link_motion(record, structure, motion[:, 0], motion[:, 1])
    return Prediction(
        predicted=joined(prediction.predicted),
        variances=joined(prediction.variances),
        d=d,
        v=v,
        starts=len(firsts),
        window=samples * record.step,
        horizon=horizon * record.step,
    )


def _means_ahead(values: Floats | Bools, samples: int) -> Floats:
    """Means (N, C) of `values` over the samples that follow each."""
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0, dtype=float)
    ends = np.minimum(np.arange(len(values)) + samples, len(values))
    return np.asarray((total[ends] - total[:-1]) / (ends - np.arange(len(values)))[:, None])


_RELATIVE_ERROR = 1e-6  # of the size of a channel, to which a state is fitted
_EXACT = np.zeros(0), np.zeros((0, 0))  # values and covariance of a structure without uncertain coefficients


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
    given = usable(record, structure)
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
    size = np.sqrt(np.nanmean(record.select(channels).values[:settling] ** 2, axis=0))
    predictor = WindowPredictor(record, structure, *_EXACT, _RELATIVE_ERROR * np.where(size > 0.0, size, 1.0))
    state = predictor(np.zeros(1, dtype=int), settling, settling).state[:, 0]
    run = _simulated(structure, record, state)
    motion = replace(run, start=record.start).select(channels)
    residual = record.select(channels).values - motion.values
    channels = given.responses
    motion = replace(motion, channels=channels, values=motion.values + frame.shown)
    rmse = np.sqrt(np.nanmean(residual[settling:] ** 2, axis=0))
    left = Record(record.start, record.rate, channels, residual, source=f"{record.source} less a free run")
    errors: dict[str, float] = dict(zip(channels, map(float, rmse), strict=True))
    return FreeRun(motion=motion, residual=left, rmse=errors, settling=settling)


def usable(record: Record, structure: Structure) -> Record:
    """The responses of the structure, and all inputs; RecordError where there is nothing to compare."""
    masses = structure.places
    responses = [c for c in record.responses if c.place in places_of(c.kind, structure)]
    if not responses:
        raise RecordError(
            f"no response of {', '.join(masses)} is in the record, which holds {', '.join(record.channels)}; "
            "there is nothing to compare a prediction with"
        )
    for name in record.inputs:
        if name.is_force and name.place not in masses:
            raise RecordError(
                f"this force acts on no mass of the structure, whose {'masses and points' if structure.hosts else 'masses'} "
                f"are {', '.join(masses)}",
                channel=name,
            )
        require_complete(name, record.channel(name), record.start, record.rate)
    return record.select([*record.inputs, *responses])


def _simulated(structure: Structure, record: Record, state: Floats) -> Record:
    """The responses of a record by a structure that starts from a state (2n + S,), on a clock that starts at 0."""
    inputs: dict[Channel, Sampled] = {}
    for name in record.inputs:
        if name.place != BASE or name.kind == "x":
            order = ORDER_OF[record.interpolation.get(name, BAND_LIMITED)]
            inputs[name] = Sampled(0.0, record.rate, record.channel(name), order=order)
    released = [f"{kind}:{name}" for kind in "xv" for name in structure.mass_names]
    released += [f"state:{structure.links[index].name}.{name}" for index, name in System.of(structure).states]
    return simulate(
        structure,
        duration=(len(record) - 1) / record.rate,
        rate=record.rate,
        sensors=record.responses,
        release=dict(zip(released, state.tolist(), strict=True)),
        forces={channel.place: signal for channel, signal in inputs.items() if channel.is_force},
        signals={name: inputs[Channel("signal", name)] for name in structure.signals},
        base=inputs.get(Channel("x", BASE)),
    )


_PRIOR = 3.0  # deviation of the prior over the RMS of the motion: held only where samples say nothing
_FIRST = 16  # samples of the first fit; each next one takes more, so that chaos does not hide the minimum
_GROWTH = 3  # times as many
_ITERATIONS, _ROUGH_ITERATIONS = 12, 4  # at most, for all samples and before
_SETTLED = 0.01  # squared steps smaller than this part of a variance end a fit
_FLOW_ERROR = 0.01  # of the noise: by how much steps half as long may change a prediction
_MAX_REFINEMENT = 8  # steps per sample
_TESTED = 50  # windows whose predictions decide how fine the steps must be
_NUMBERS = 8_000_000  # in the sensitivities of one batch of windows
_FEWEST_IN_WINDOW = 64  # samples of a window of a long run
_FARTHEST = 1e100  # times its unit: how far a departure that grows without end is followed


@dataclass(frozen=True, eq=False)
class WindowPrediction:
    """K windows of M samples and C channels: what the sensors would show (M, C, K) in SI units, and `variances` (M, 3, C, K)
    of it from the fitted state, the coefficients and the stated error of the laws. `motion` (M, 2, n, K) are displacements in
    m and velocities in m/s, `state` (2 n + S, K) is that at the first sample, the states of links last, `state_root` (2 n + S,
    2 n + S, K) the root R of its covariance R R', and `state_by_coefficients` (2 n + S, p, K) how it follows the coefficients.
    """

    predicted: Floats
    variances: Floats
    motion: Floats
    state: Floats
    state_root: Floats
    state_by_coefficients: Floats


@dataclass(frozen=True, eq=False)
class WindowPredictor:
    """Predicts windows of one record by a structure whose p uncertain coefficients are unknowns with `values` (p,) and a
    `root` (p, r) of their covariance. `sigma` (C,) is the noise of the responses, `law_error` the part of the forces of
    the links that the laws leave, by root mean squares.
    """

    record: Record
    structure: Structure
    values: Floats
    root: Floats
    sigma: Floats
    law_error: float = 0.0

    @np.errstate(over="ignore", invalid="ignore")  # a motion that runs away leaves states that are not finite
    def __call__(self, firsts: Indices, burn: int, samples: int) -> WindowPrediction:
        """The windows that begin at samples `firsts` (K,), with states from their first `burn` samples."""
        count = self._system.dimension
        size = max(1, _NUMBERS // (samples * count * (count + len(self.values) + 1)))
        parts = [firsts[first : first + size] for first in range(0, len(firsts), size)]
        refine = self._refinement(self._guess, firsts, samples)
        try:
            pieces = [self._predicted(part, burn, samples, refine) for part in parts]
        except np.linalg.LinAlgError as error:  # of sensitivities so large that their squares hide all else
            raise no_state(burn) from error
        return WindowPrediction(*(np.concatenate(fields, axis=-1) for fields in zip(*pieces, strict=True)))

    @np.errstate(over="ignore", invalid="ignore")
    def variances_along(self, states: Floats, root: Floats, follow: Floats) -> Floats:
        """Variances (N, 3, C) of what a run with these `states` (2 n + S, N) of the whole record shows, by its start, the
        coefficients and the laws.

        `root` (2 n + S, 2 n + S) is that of the covariance of the first state, which follows the coefficients by `follow` (2 n
        + S, p). Departures of the run are carried from window to window, and the windows are integrated side by side.
        """
        count = states.shape[1]
        samples = max(_FEWEST_IN_WINDOW, round(np.sqrt(count)))
        firsts = np.arange(0, count, samples)
        refine = self._refinement(states, firsts, samples)
        masses = len(self.structure.mass_names) if self.law_error else 0
        prior, unit = self._prior[:, None], self._unit[:, None]
        moved = np.hstack([root, follow @ self.root]) / prior
        fixed = np.hstack([np.zeros((len(unit), len(root))), self.root / unit])
        by_laws = np.zeros((len(root), masses))  # departures of the state
        size = max(1, _NUMBERS // (samples * refine * len(root) * (len(root) + len(unit) + 1)))
        parts = []
        for first in range(0, len(firsts), size):
            batch = firsts[first : first + size]
            run = self._run(self._segments(batch, samples, refine), states[:, batch])
            slopes, ends = _slopes(run)
            changes = list(self._changed_by_laws(run))
            for k in range(len(batch)):
                of_laws = [shown[..., k].ravel() for shown, _ in changes]
                total = np.vstack([moved, fixed])
                by_both = slopes[k] @ total
                by_forces = slopes[k, :, : len(prior)] @ by_laws
                by_forces += np.transpose(of_laws or np.zeros((0, len(slopes[k]))))
                shown = by_both[:, : len(root)], by_both[:, len(root) :], by_forces
                parts.append([np.sum(part**2, axis=1).reshape(samples, -1) for part in shown])
                by_laws = ends[k, :, : len(prior)] @ by_laws
                for number, (_, end) in enumerate(changes):
                    by_laws[:, number] += end[:, k] / self._prior
                moved = np.clip(ends[k] @ total, -_FARTHEST, _FARTHEST)
        return self.sigma**2 * np.concatenate(parts, axis=1)[:, :count].transpose(1, 0, 2)

    @cached_property
    def valued(self) -> Structure:
        """The structure with its values."""
        names = [parameter.name for parameter in self.structure.parameters]
        return self.structure.with_values(dict(zip(names, map(float, self.values), strict=True)))

    @cached_property
    def _system(self) -> System:
        return System.of(self.structure)

    @cached_property
    def _unit(self) -> Floats:
        """(p,) units of parameters, their size."""
        return np.where(self.values != 0.0, np.abs(self.values), 1.0)

    @cached_property
    def _guess(self) -> Floats:
        """(2 n + S, N) rough states at all samples."""
        noise: dict[str, float] = dict(zip(self.record.responses, map(float, self.sigma), strict=True))
        rough = start_states(self.record, self.valued, noise, samples=5)
        return np.concatenate([rough.x, rough.v, rough.memory])

    @cached_property
    def _prior(self) -> Floats:
        """(2 n + S,) deviations of the prior of a state."""
        size, masses = np.sqrt(np.mean(self._guess**2, axis=1)), self.structure.size
        kinds = np.split(size, [masses, 2 * masses])
        unmeasured = np.concatenate([np.full(len(kind), kind.max(initial=0.0)) for kind in kinds])
        return _PRIOR * np.where(size > 0.0, size, np.where(unmeasured > 0.0, unmeasured, 1.0))

    def _segments(self, firsts: Indices, samples: int, refine: int) -> Segments:
        """Windows as segments of their own with readings of 0: what a run leaves of these is, negative, what it shows."""
        steps = np.arange(samples * refine)[:, None, None]
        index = firsts + (steps + POINTS[None, :, None]) / refine  # (J, 5, K)
        shape = samples, len(self.sigma), len(firsts)
        along = partial(_input_at, self.record, index)
        return Segments(
            system=self._system,
            sensors=sensor_arrays(self.record.responses, self.structure),
            samples=np.zeros(shape),
            observed=np.ones(shape, dtype=bool),
            step=np.full(len(firsts), self.record.step / refine),
            linked=np.zeros(len(firsts) - 1, dtype=bool),
            inputs=inputs_along(self.record, self.structure, (len(steps), len(firsts)), along),
            refine=refine,
            tangent_refine=refine,
        )

    def _run(self, segments: Segments, states: Floats) -> Misfit:
        """The motion from states (2 n + S, K), and what it leaves of the readings over the noise."""
        scales = Scales(self.sigma, self._prior, self._unit)
        return evaluate(segments, Iterate(states, self.values, np.zeros(0)), scales, Gaussian())

    def _refinement(self, states: Floats, firsts: Indices, samples: int) -> int:
        """Steps per sample that keep the error of the flow from `states` (2 n + S, N) well below the noise."""
        tested = firsts[:: max(1, len(firsts) // _TESTED)]
        most = min(samples, 64)

        def shown(refine: int) -> Floats:
            return self._run(self._segments(tested, most, refine), states[..., tested]).residuals

        refine, coarse = 1, shown(1)
        while refine < _MAX_REFINEMENT:
            fine = shown(2 * refine)
            change = fine - coarse
            if np.isfinite(change).all() and np.sqrt(np.mean(change**2)) < _FLOW_ERROR:
                break
            refine, coarse = 2 * refine, fine
        return refine

    def _predicted(self, firsts: Indices, burn: int, samples: int, refine: int) -> tuple[Floats, ...]:
        """The fields of `WindowPrediction` for some windows."""
        K, C, m = len(firsts), len(self.sigma), len(self._prior)
        segments = self._segments(firsts, samples, refine)
        nodes = self._guess[..., firsts].copy()
        values = self.record.select(self.record.responses).values
        readings = values[firsts + np.arange(burn)[:, None]].transpose(0, 2, 1)  # (burn, C, K)
        present = np.isfinite(readings)
        fitted = min(_FIRST, burn)
        while True:
            part = replace(
                segments,
                samples=np.where(present, readings, 0.0)[:fitted],
                observed=present[:fitted],
                inputs=segments.inputs.first(fitted * refine),
            )
            most = _ITERATIONS if fitted == burn else _ROUGH_ITERATIONS
            nodes = self._fitted_states(nodes, part, most)
            if fitted == burn:
                break
            fitted = min(_GROWTH * fitted, burn)
        run = self._run(segments, nodes)
        slopes, _ = _slopes(run)
        head = slopes[:, : burn * C] * present.transpose(2, 0, 1).reshape(K, burn * C, 1)
        information = head[..., :m].transpose(0, 2, 1) @ head[..., :m] + np.eye(m)
        follow = -np.linalg.solve(information, head[..., :m].transpose(0, 2, 1) @ head[..., m:])
        state_root = np.linalg.inv(np.linalg.cholesky(information)).transpose(0, 2, 1)
        by_state = np.sum((slopes[..., :m] @ state_root) ** 2, axis=2)
        total = slopes[..., m:] + slopes[..., :m] @ follow
        by_theta = np.sum((total @ (self.root / self._unit[:, None])) ** 2, axis=2)
        variances = np.zeros((samples, 3, C, K))
        variances[:, 0], variances[:, 1] = (
            variance.reshape(K, samples, C).transpose(1, 2, 0) for variance in (by_state, by_theta)
        )
        for change, _ in self._changed_by_laws(run):
            variances[:, 2] += change**2
        motion = run.trajectories.states[: samples * refine : refine].copy()
        motion[:, 1] *= refine * self.record.rate
        root, follow = self._prior[:, None] * state_root, self._prior[:, None] * follow / self._unit
        sigma = self.sigma[:, None]
        return (
            -sigma * run.residuals, sigma**2 * variances, motion, nodes, root.transpose(1, 2, 0),
            follow.transpose(1, 2, 0),
        )  # fmt: skip

    def _changed_by_laws(self, run: Misfit) -> Iterator[tuple[Floats, Floats]]:
        """What forces of the links that are off by a part of themselves change, mass after mass: (M, C, K) of what is shown,
        over the noise, and (2 n + S, K) of the state at the end.
        """
        if self.law_error == 0.0:
            return
        segments, orbit, states = run.segments, run.trajectories, run.point.nodes
        ends, middles = orbit.accelerations, orbit.half_accelerations[1::2]
        at = POINTS[None, :, None, None]
        first, last, middle = ends[:-1, None], ends[1:, None], middles[:, None]
        acceleration = first * (1 - at) * (1 - 2 * at) + middle * 4 * at * (1 - at) + last * at * (2 * at - 1)
        applied = np.zeros_like(acceleration) if segments.inputs.force is None else segments.inputs.force
        for mass, size in enumerate(run.mechanics.masses):
            force = applied.copy()
            force[:, :, mass] += self.law_error * (size * acceleration[:, :, mass] - applied[:, :, mass])
            inputs = replace(segments.inputs, force=force)
            changed = self._run(replace(segments, inputs=inputs), states)
            both = (own.trajectories.ends(segments.step)[: len(states)] for own in (run, changed))
            end, changed_end = both
            yield run.residuals - changed.residuals, changed_end - end

    def _fitted_states(self, nodes: Floats, segments: Segments, most: int) -> Floats:
        """(2 n + S, K) states from which segments fit their readings best, from given ones, by damped Gauss-Newton steps in
        each.
        """
        m, prior, K = len(self._prior), self._prior, segments.count
        damping = np.full(K, 1e-3)

        def tried(states: Floats) -> tuple[Misfit, Floats]:
            run = self._run(segments, states)
            away = (states - nodes) / prior[:, None]
            cost = np.sum(run.residuals**2, axis=(0, 1)) + np.sum(away**2, axis=0)
            return run, np.where(np.isfinite(cost), cost, np.inf)

        states = nodes.copy()
        run, cost = tried(states)
        better = np.ones(K, dtype=bool)
        for _ in range(most):
            if better.any():
                rows = _slopes(run)[0][..., :m]
                normal = rows.transpose(0, 2, 1) @ rows + np.eye(m)
                right = np.einsum("kri,kr->ki", rows, run.residuals.transpose(2, 0, 1).reshape(K, -1))
                right -= ((states - nodes) / prior[:, None]).T
                valid = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
                normal[~valid], right[~valid] = np.eye(m), 0.0
            diagonal = np.einsum("kii->ki", normal)
            damped = normal.copy()
            damped[:, range(m), range(m)] += damping[:, None] * diagonal
            step = np.linalg.solve(damped, right[..., None])[..., 0]
            trial = states + (prior * step).T
            changed, new_cost = tried(trial)
            better = new_cost < cost
            states = np.where(better, trial, states)
            damping = np.where(better, damping / 10.0, damping * 10.0)
            size = np.einsum("ki,kij,kj->k", step, normal, step)  # squared, in standard errors
            if np.all((size < _SETTLED) | ~valid):
                break
            run = replace(
                run,
                orbit=Orbit.of(run.trajectories.replaced(changed.trajectories, better)),
                residuals=np.where(better, changed.residuals, run.residuals),
            )
            cost = np.where(better, new_cost, cost)
        return states


def _slopes(run: Misfit) -> tuple[Floats, Floats]:
    """(K, M C, 2 n + S + p) sensitivities of what is shown over the noise to states in units of the prior, and to theta in
    its unit, and (K, 2 n + S, 2 n + S + p) those of the state at the end, in units of the prior.
    """
    jacobian, ends = whitened_jacobian(run, slice(None))
    return jacobian[..., :-1].astype(float), ends


def no_state(samples: int) -> SimulationError:
    """The error of an answer whose laws run away before so many samples are over."""
    return SimulationError(
        f"no state is found from which the answer follows {samples} samples of the record: its laws run away along that "
        "motion; check its coefficients and their units, or identify again"
    )


def _input_at(record: Record, index: Floats, name: str, *, derivative: bool = False) -> Floats:
    """Value or rate of an input at fractional samples (J, 5, K), the points of steps; held behind the last one."""
    values, kind = record.channel(name), record.interpolation.get(name, BAND_LIMITED)
    if kind == HELD:  # to the end of the last step in a sample, where the signal jumps
        sample = np.minimum(np.floor(index[:, len(POINTS) // 2]).astype(int), len(values) - 1)
        return np.zeros(index.shape) + (0.0 if derivative else values[sample][:, None])
    signal = interpolated(0.0, record.rate, values, kind)
    time = index / record.rate
    inside = np.minimum(time, signal.end)
    return (
        np.where(time <= signal.end, signal.derivative(inside), 0.0) if derivative else signal.value(inside)
    )
