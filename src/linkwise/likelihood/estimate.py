"""Maximum likelihood as a method of identification: its options, the search from starting values, and the answer of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import process_time
from types import NoneType
from typing import ClassVar, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, expect
from linkwise.estimates.causes import NoiseEstimate, unseen_remark
from linkwise.estimates.estimate import Estimate, Estimator
from linkwise.likelihood.admitted import answer_with_sensors
from linkwise.likelihood.checks.horizons import over_horizons
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.checks.table import judge
from linkwise.likelihood.checks.unstated_forces import with_limits
from linkwise.likelihood.checks.usual_terms import unseen_terms
from linkwise.likelihood.explained import beside_exchange, explained_answer
from linkwise.likelihood.fit import (
    LikelihoodFit,
    likelihood_fit,
    motion_of_links,
    require_told,
    with_denoised,
)
from linkwise.likelihood.harmonics import (
    estimated_harmonics,
    harmonic_forces,
    not_shown_to_go_on,
    with_harmonics,
)
from linkwise.likelihood.optima.hidden_wells import fit_about_rest, other_places_of_rest
from linkwise.likelihood.optima.other_optima import lower_of_two, tightest_smooth_fit, with_faint_modes
from linkwise.likelihood.optima.profiles import profile_ends, with_profiles
from linkwise.likelihood.optima.restarts import (
    attempts,
    fit_from_starts,
    fit_of_growing_records,
    fit_with_restarts,
    is_settled,
    runs_away,
)
from linkwise.likelihood.options import (
    AskedFor,
    AskedKeywords,
    LikelihoodOptions,
    errors_to_find,
    require_known_kinds,
)
from linkwise.likelihood.problem import require_force_scale
from linkwise.likelihood.random_forces import (
    random_forces,
    refuse_beside_random_forces,
    with_noise_of_signals,
)
from linkwise.likelihood.remarks import disturbances, fit_remarks, inseparable, sensor_errors
from linkwise.likelihood.rigs.estimate import rig_estimate
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.shooting.residuals import LOSSES, Gaussian, Loss
from linkwise.likelihood.shooting.segmentation import require_same_channels, require_units_of_states
from linkwise.likelihood.shooting.system import held_where_unseen
from linkwise.likelihood.starts.drift import needs_integration
from linkwise.likelihood.starts.memory import (
    FindStarts,
    held_at_zero,
    host_memory_starts,
    memory_starts,
    memory_starts_by_links,
)
from linkwise.likelihood.starts.values import require_supported, starting_values
from linkwise.likelihood.terms import Offset, OfMotion, Term, frequencies_by_channel, of_kind, unknown_gains
from linkwise.model.link import refuse_signals
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.channel import MOTIONS
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed, framed_records
from linkwise.signals.noise import channel_noise

_ENDED_EARLY = (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK)
_QUIET = 1e-3  # of the motion: noise, at 60 dB, beside which a search creeps where laws leave more
_FAR = 1e3  # chi-square a sample beside such noise, which no model error explains though a search converged
_PART = 0.01  # of the motion, which stands for it until the residuals tell
_DENOISED = 2  # times that a fit beside errors that follow the motion is repeated: the noise in them is then that of a fit


class LikelihoodKeywords(AskedKeywords, total=False):
    """Options of `MaximumLikelihood` as keywords of `identify`; None stands for the default."""

    starts: Mapping[str, float] | None
    loss: Loss | None
    exact: bool
    profile: bool


@final
@dataclass(frozen=True, kw_only=True)
class MaximumLikelihood(AskedFor, Estimator):
    """Maximum likelihood on the raw samples, by annealed multiple shooting: the method "ml" of `identify`.

    It takes several records together, records with gaps, and sensors of any kind.

    Parameters
    ----------
    starts : mapping of str to float, optional
        Starting values in SI units by name of the unknown. By default those of the weak form, those from inverse dynamics
        where velocities or accelerations of all masses determine the forces of the links, or those stated in the structure.
    offsets : sequence of str, optional
        Channels with an unknown constant error, estimated with the rest.
    gains : sequence of str, optional
        Channels of sensors and of applied forces with an unknown constant factor, estimated with the rest.
    calibration : mapping of str to float, optional
        Relative standard deviations to which the gains of sensors and of applied forces are known, by channel: 0.01, or 1 %.
        ``"all"`` stands for every response channel that is not named, each with an error of its own, and for no force;
        ``"common"`` for a factor that all responses share. Gains are then found with the rest, with these priors, and every
        interval counts them.
    delays : sequence of str, optional
        Channels with an unknown delay, estimated with the rest; the only input is late as all sensors are early.
    drifts : sequence of str or mapping of str to float or None, optional
        Channels with a slow drift, which is estimated with the rest as a line of pieces of this length in s, from 0 at the
        start of each record; of 8 pieces without one.
    hums : mapping of str to float or sequence of float, optional
        Frequencies in Hz of hums, one or several, by channel; their amplitude and phase in each record are estimated with
        the rest.
    corners : sequence of str or mapping of str to float or None, optional
        Channels behind a high pass of first order, as AC coupling and charge amplifiers are, with its corner in Hz, which is
        estimated with the rest where none is given.
    clocks : sequence of str or mapping of str to float or None, optional
        Channels recorded by a device with a clock of its own, with the ppm by which that runs fast, which is estimated with
        the rest where none is given, as is the delay in the middle of the record. The only input stands for its device.
    harmonics : mapping of str to float or sequence of float, optional
        Frequencies in Hz of harmonic forces that no channel shows, as of a rotating machine, by the mass that they act on.
        Amplitude and phase in each record, and the frequency, are estimated with the rest.
    ambient : sequence of str or mapping of str to float or None, optional
        Masses on which a random force acts that no channel shows, such as wind or traffic: white, and independent of that on
        other masses. Its one-sided amplitude spectral density in N/sqrt(Hz) is found where none is given; ``"all"`` stands
        for every mass. The diagnosis names masses left out that it acts on, too.
    input_noise : sequence of str or mapping of str to float or None, optional
        Channels of inputs with white noise, such as ``"force:m1"``, ``"a:base"`` or ``"x:base"``, and its standard deviation
        in the SI unit of the channel, found where there is none; ``"all"`` stands for every input that acts. The diagnosis
        names a channel with more noise than is stated. For that of ``"signal:u"`` in a law intervals allow.
    admit : sequence of {"gain", "offset", "delay", "drift", "high pass", "clock", "crosstalk", ...}, optional
        Errors of sensors, also ``"gain drift"`` and ``"nonlinearity"``, that are taken into the model where they are
        significant: the fit is repeated with those that its diagnosis names, unless a term is as likely that would change
        coefficients.
    loss : Loss, optional
        Loss of a residual: `Gaussian()` or, against outliers, `Huber()` or `Student()`.
    exact : bool
        Take the laws for exact, with no model error: chi-square says how far a free run of them is from the record.
    profile : bool
        Also give intervals that follow the likelihood (`profile_interval`), of all unknowns but shapes of hosts.
    as_stated : bool
        Take no error of a sensor or an input into the model by itself where what was stated leaves more than noise, and
        look for no second answer with a missing term. So it is beside errors that are admitted by kind.

    Raises
    ------
    IdentificationError
        If the loss is not a `Loss`.

    References
    ----------
    H. G. Bock, in Modelling of Chemical Reaction Systems (1981), for multiple shooting.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method=lw.MaximumLikelihood(loss=lw.likelihood.Student()))
    >>> fit.method, fit.trusted
    ('ml', True)
    """

    method: ClassVar[str] = "ml"

    starts: Mapping[str, float] | None = None
    loss: Loss = field(default_factory=Gaussian, metadata={"typed": "LOSS", "choices": LOSSES})
    exact: bool = field(default=False, metadata={"typed": ""})
    profile: bool = field(default=False, metadata={"typed": ""})

    def __post_init__(self) -> None:
        for name in ("offsets", "gains", "delays"):
            expect(f"MaximumLikelihood: {name}", getattr(self, name), tuple, list)
        for name in ("starts", "calibration"):
            expect(f"MaximumLikelihood: {name}", getattr(self, name), Mapping, NoneType)
        if not isinstance(self.loss, Loss):
            raise IdentificationError(
                f"loss takes a Loss, one of Gaussian(), Huber() and Student(), got {self.loss!r}"
            )

    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """Estimate the unknowns of a structure by maximum likelihood.

        Parameters
        ----------
        records : sequence of Record
            One or more records with the same channels.
        structure : Structure
            The structure, with one unknown at least.
        progress : Progress
            Called at every step, with an `AnnealingStep` as detail.

        Returns
        -------
        Estimate
            The answer; an interrupt from the keyboard ends the search with the best so far.

        Raises
        ------
        IdentificationError
            If an unknown has no starting value, the records lack channels or differ in them, or nothing sets the scale of the
            forces.
        """
        with one_blas_thread():
            answer = (self._on_rig if structure.on_rig else self._in_motion)(records, structure, progress)
            return with_profiles(answer, progress) if self.profile else answer

    @property
    def _admitted(self) -> Sequence[str]:
        """The kinds of errors that may be added."""
        return (self.admit,) if isinstance(self.admit, str) else self.admit

    def _in_motion(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """The estimate of a structure whose masses move."""
        if structure.hosts:
            advice = "put its mean into the law as a coefficient"
            refuse_signals(structure.links, "structures with hosts", advice)
        for record in records:
            require_units_of_states(record, structure)
            _refuse_dead(record)
            if structure.hosts:
                require_supported(framed(record, structure, integrated=True).record, structure)
        if len({record.channels for record in records}) > 1:
            require_same_channels(framed_records(records, structure, integrated=True))
        structure = held_where_unseen(structure, records[0].channels)
        errors = errors_to_find(records, self)
        records, input_noise = with_noise_of_signals(records, self.input_noise or (), structure)
        if not self.ambient:
            require_force_scale(records, structure, unknown_gains(errors))
        options = LikelihoodOptions(
            errors,
            harmonics=harmonic_forces(frequencies_by_channel(self.harmonics), records[0], structure),
            random=random_forces(self.ambient or (), input_noise, records[0], structure),
            loss=self.loss,
            model_error=not self.exact,
            progress=progress,
        )
        admitted = self._admitted
        alone = self.as_stated or bool(admitted)
        if options.random:
            robust = not isinstance(self.loss, Gaussian)
            refuse_beside_random_forces(errors, admitted, robust=robust, records=records)

        def answer(structure: Structure, options: LikelihoodOptions, records: Sequence[Record]) -> Estimate:
            def report(fit: LikelihoodFit, records: Sequence[Record]) -> Estimate:
                return estimate_of(structure, search.smoothest(fit, records), records)

            search = _Search(structure, self.starts or {})
            driven, options = with_harmonics(search, records, options)
            return answer_with_sensors(search, driven, options, admitted, report)

        started = process_time()
        try:
            stated = answer(structure, options, records)
        except IdentificationError as refusal:
            if alone or refusal.arguments:  # of what was asked, no matter of the records
                raise
            return beside_exchange(answer, structure, options, records, refusal)
        seconds = process_time() - started
        return stated if alone else explained_answer(stated, answer, structure, options, records, seconds)

    def _on_rig(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """The estimate of links alone on a rig, of which errors of sensors other than offsets are not found."""
        errors, admitted = errors_to_find(records, self), self._admitted
        require_known_kinds(admitted)
        requests = {
            "harmonic forces": self.harmonics,
            "random forces": self.ambient,
            "noise of inputs": self.input_noise,
            "errors of sensors to be admitted": [kind for kind in admitted if kind != "offset"],
            "signals": structure.signals,
        }
        named = [f"{one.kind} ({one.channel})" for one in errors if not isinstance(one, Offset)]
        named += [f"{kind} ({', '.join(names)})" for kind, names in requests.items() if names]
        named += ["a robust loss"] * (not isinstance(self.loss, Gaussian)) + ["exact laws"] * self.exact
        if named:
            raise IdentificationError(
                f"{', '.join(named)}: not supported for links alone on a rig, where only offsets of sensors can be found"
            )
        offsets, given = [one.channel for one in errors], self.starts or {}
        more = "offset" in admitted
        return rig_estimate(records, structure, given, progress, offsets=offsets, finds_more=more)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the most likely values of a `structure`, from those that are `given` and starts that records show."""

    structure: Structure
    given: Mapping[str, float]

    def __call__(self, records: Sequence[Record], options: LikelihoodOptions) -> LikelihoodFit:
        """A fit; where it is lost again with noise of quiet channels, and with its motion for errors that follow it."""
        fit = self._from_starts(records, options)
        lost = fit.status in _ENDED_EARLY or fit.chi_square > _FAR or runs_away(fit)
        if lost and not fit.interrupted and (noisier := _with_noise_of_quiet(records)) is not None:
            fit = self._from_starts(noisier, options)
            noisier = [replace(record, noise={**record.noise, **fit.noise}) for record in records]
            fit = replace(self, given=fit.by_name)._from_starts(noisier, options)
        repeats = any(isinstance(one, OfMotion) for one in options.errors)
        for _ in range(_DENOISED * repeats):
            errors = with_denoised(fit, records, options.errors)
            fit = self._from_starts(records, replace(options, errors=errors))
        return fit

    def _from_starts(self, records: Sequence[Record], options: LikelihoodOptions) -> LikelihoodFit:
        if self._remembers:
            return self._with_memory(records, options)
        if self._integrates(records):
            return self._from_forces(records, options)
        theta, spread = starting_values(_about_rest(records, options.errors), self.structure, self.given)
        search = partial(likelihood_fit, records, self.structure, options=options)
        return lower_of_two(search(theta, spread=spread), search)

    @property
    def _remembers(self) -> bool:
        """Whether laws have states, or name signals."""
        return bool(self.structure.topology.states or self.structure.signals)

    def _integrates(self, records: Sequence[Record]) -> bool:
        """Whether the motion of masses follows from channels by inverse dynamics only, and so from starts of laws."""
        record = framed(records[0], self.structure, integrated=True).record
        return bool(self.structure.hosts) or needs_integration(record, self.structure)

    def _from_forces(self, records: Sequence[Record], options: LikelihoodOptions) -> LikelihoodFit:
        """A fit that starts with the laws that the forces of links give, and about the places where hidden masses rest.

        Beside noise of inputs it goes on from a fit without, whose motion is known better than that which is integrated.
        """
        search = partial(likelihood_fit, records, self.structure)
        if options.random and not any(force.ambient for force in options.random):
            exact = self._from_forces(records, replace(options, random=()))
            if is_settled(exact) or exact.interrupted:
                nodes = exact.optimum.point.nodes
                by_sample = nodes.shape[-1] == sum(map(len, records))
                beside = search(exact.values, options=replace(options, nodes=nodes if by_sample else None))
                if is_settled(beside) or beside.interrupted:
                    return beside
        theta, _ = starting_values(records, self.structure, self.given)
        about_rest = partial(fit_about_rest, records, self.structure, given=self.given)
        return fit_with_restarts(search, theta, options, another=about_rest)

    def _with_memory(self, records: Sequence[Record], options: LikelihoodOptions) -> LikelihoodFit:
        """A fit of a structure with memory or signals, from the starts that the records show of it."""
        structure, parameters = self.structure, self.structure.parameters
        known = {p.name: p.start for p in parameters if p.start is not None} | dict(self.given)
        framed_ones = framed_records(records, structure, integrated=True)
        shown = all(framed_ones[0].motions_of(name) for name in structure.mass_names)
        search = partial(likelihood_fit, structure=structure, options=options)
        knows_masses = all(link >= 0 for p in parameters for link, _ in p.members) and not structure.hosts

        def fit(kind: FindStarts) -> LikelihoodFit:
            starts = kind(framed_ones, structure, self.given)
            found = fit_from_starts(partial(search, records), starts)
            grown = partial(fit_of_growing_records, search, records, starts[0].values)
            done = found.interrupted or is_settled(found)
            return found if done else attempts([grown, lambda: found])[0]

        by_links = knows_masses and needs_integration(framed_ones[0], structure)
        whole = host_memory_starts if structure.hosts else memory_starts
        searches = [partial(fit, kind) for kind in (*[memory_starts_by_links] * by_links, whole)]
        beside_motion = records[0].motions and any(name.kind == "state" for name in records[0].channels)
        held = held_at_zero(structure) if beside_motion and knows_masses else None
        if held:
            searches.append(partial(self._from_motion, held, records, options))
        if all(p.name in known for p in parameters):
            values = np.array([known[p.name] for p in parameters])
            grown = partial(fit_of_growing_records, search, records, values)
            others = searches if shown and not structure.hosts and len(self.given) < len(known) else []
            searches = [partial(search, records, theta=values), grown, *others]
        return attempts(searches)[0]

    def _from_motion(
        self, held: Structure, records: Sequence[Record], options: LikelihoodOptions
    ) -> LikelihoodFit:
        """A fit from starts along the motion that laws `held` without states follow.

        A state that is recorded with hardly any noise, by an equation that is not quite right, leads the search for all
        of a law astray.
        """
        structure, moving = self.structure, [name for name in records[0].channels if name.kind != "state"]
        bare = [record.select(moving) for record in records]
        errors = tuple(one for one in options.errors if one.channel in moving)
        alone = replace(self, structure=held)._from_starts(bare, replace(options, errors=errors))
        followed = _along(alone, framed_records(records, structure, integrated=True), structure)
        best = memory_starts(followed, structure, self.given)[0].values
        steps = 1 if alone.interrupted else options.steps
        fit = likelihood_fit(records, structure, best, options=replace(options, steps=steps))
        return replace(fit, status=alone.status) if alone.interrupted else fit

    def smoothest(self, fit: LikelihoodFit, records: Sequence[Record]) -> LikelihoodFit:
        """The fit, or of motion that records show directly, the closest one to exact laws whose likelihood is quadratic."""
        if self._remembers or self._integrates(records):
            return fit

        def refit(values: Floats, nodes: Floats, q: float) -> LikelihoodFit:
            near = replace(fit.options, nodes=nodes, relaxation=q, tightest=q, model_error=False)
            return likelihood_fit(records, self.structure, values, options=near)

        return tightest_smooth_fit(fit, refit)


def _along(fit: LikelihoodFit, framed_ones: Sequence[Record], structure: Structure) -> list[Record]:
    """The first of records in the coordinates of the equations, with the motion of a fit, which has no drift, for sensors."""
    record, states = framed_ones[0], fit.misfit.trajectories.states[fit.segments.at_samples]
    x = fit.segments.in_records(states[:, 0], framed_ones)[0]
    kept = record.select([name for name in record.channels if name.is_input or name.kind not in MOTIONS])
    channels = (*kept.channels, *(f"x:{name}" for name in structure.mass_names))
    return [Record(record.start, record.rate, channels, np.column_stack([kept.values, x]))]


def _with_noise_of_quiet(records: Sequence[Record]) -> list[Record] | None:
    """The records with the same part of the motion of each channel as its noise, if any shows hardly any; else None.

    Beside a channel that is taken for exact, what laws leave of it goes into the motion of the others.
    """
    first = records[0]
    found, unstated = channel_noise(first), [name for name in first.responses if name not in first.noise]
    sizes = {name: float(np.nanstd(first.channel(name))) for name in unstated}
    if not any(found[name] < _QUIET * size for name, size in sizes.items()):
        return None
    alike = {str(name): max(_PART * size, found[name]) for name, size in sizes.items()}
    return [replace(record, noise={**record.noise, **alike}) for record in records]


def _refuse_dead(record: Record) -> None:
    """Refuse a record with a sensor that shows zero throughout, which sets no scale of the motion."""
    shown = {name: record.channel(name) for name in record.responses}
    dead = [
        name for name, values in shown.items() if (values == 0.0).any() and not np.nan_to_num(values).any()
    ]
    if dead:
        raise IdentificationError(
            f"every sample of {', '.join(dead)} is 0: a dead channel; check sensor and cable, or leave the channel out",
            arguments=("channels",),
        )


def _about_rest(records: Sequence[Record], errors: Sequence[Term]) -> list[Record]:
    """The records with what channels of unknown offset show on average taken off, which may dwarf the motion."""
    unknown = [one.channel for one in of_kind(errors, Offset) if np.isinf(one.deviation)]
    moved = [record.values.copy() for record in records]
    for record, values in zip(records, moved, strict=True):
        columns = [name in unknown for name in record.channels]
        values[:, columns] -= np.nanmean(values[:, columns], axis=0)
    return [replace(record, values=values) for record, values in zip(records, moved, strict=True)]


def _approximated(fit: LikelihoodFit, judgement: Judgement) -> tuple[LikelihoodFit | None, Judgement]:
    """The approximate answer of laws that leave more than noise, and the judgement, which says why there is none; of laws
    that are only tried there is none.
    """
    if not judgement.may_be_approximate or fit.options.is_trial:
        return None, judgement
    found = over_horizons(fit)
    if not isinstance(found, str):
        return found, replace(judgement, added={})  # the scatter of blocks and the path hold all that
    message = f"{judgement.message} {found}" if found and judgement.verdict.forbids else judgement.message
    return None, replace(judgement, message=message)


def estimate_of(
    structure: Structure, fit: LikelihoodFit, records: Sequence[Record], *, offered: Structure | None = None
) -> Estimate:
    """The estimate that a fit of `structure` to `records` gives, with its verdicts.

    The laws were searched in the records among those `offered`, or stated. Raises IdentificationError where the records do
    not tell a gain.
    """
    require_told(fit)
    fit = with_limits(fit)
    structures = (structure,) if offered is None else (offered, structure)
    examined = Examined(fit, structures, records, searched=offered is not None)
    judgement, identified = judge(examined), examined.identified
    residuals = fit.misfit.residuals
    approximate, judgement = _approximated(fit, judgement) if offered is None else (None, judgement)
    if approximate is not None:
        fit, identified = approximate, structure.with_values(approximate.by_name)
    covariance, faint = with_faint_modes(fit, identified)
    of_harmonics, frequencies, amplitudes = estimated_harmonics(fit, records)
    covariance = sum(judgement.added.values(), covariance) + of_harmonics
    units: dict[str, str] = {name: unit_in(structure, name) for name in records[0].channels}
    of_sensors = (*sensor_errors(fit, units), *frequencies)
    of_terms = offered is None and judgement.leaves_noise  # a search says what else it would find
    tested = None if approximate or judgement.verdict.forbids else examined.diagnosis.tested
    unseen = unseen_terms(fit, tested, covariance, terms=of_terms)
    return Estimate(
        method="ml",
        fit_verdicts=(judgement.verdict,),
        message=judgement.message,
        seconds=0.0,
        given_structure=structure,
        parameters=structure.parameters,
        values=fit.values,
        covariance=covariance,
        free=fit.free,
        noise={
            name: NoiseEstimate.of(records[0], name, sigma, units[name]) for name, sigma in fit.noise.items()
        },
        chi_square_per_sample=fit.chi_square,
        samples=fit.samples,
        compute_motion=partial(motion_of_links, fit, identified, records, judged=residuals),
        record=records[0],
        more_records=tuple(records[1:]),
        remarks=(
            *fit_remarks(fit, records, of_sensors, faint),
            *amplitudes,
            *other_places_of_rest(fit, identified, records[0].channels),
            *unseen_remark(unseen),
            *(inseparable(fit) if judgement.verdict.forbids else ()),
        ),
        profile=None if approximate or judgement.lacks_more else partial(profile_ends, fit.optimum),
        model_error=judgement.model_error,
        diagnosis=judgement.diagnosis,
        random_forces=fit.random_forces,
        sensor_errors=of_sensors,
        disturbances=disturbances(fit),
        may_fade=not_shown_to_go_on(fit, records),
        unseen_terms=unseen,
        for_dropped_terms=judgement.added_for_terms,
        approximate=approximate is not None,
    )
