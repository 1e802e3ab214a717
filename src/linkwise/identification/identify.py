"""From a record and a structure with unknowns to the force law of every link, and how far an identified force is from the true
one, where there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal, Unpack

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import ArgumentTypeError, IdentificationError, RecordError, expect
from linkwise.estimates.curves import force_error
from linkwise.estimates.estimate import Estimate, Estimator
from linkwise.identification.weak_answer import judged_by_likelihood
from linkwise.likelihood.estimate import LikelihoodKeywords, MaximumLikelihood
from linkwise.likelihood.options import uncounted
from linkwise.likelihood.rigs.link_path import LinkPath
from linkwise.model.excitation import Sampled
from linkwise.model.structure import BASE, GROUND, Link, Structure
from linkwise.progress import Progress, silent
from linkwise.records.channel_units import in_units_of
from linkwise.records.joining import check_distinct, check_stated_noise, joined_notes, record_list
from linkwise.records.record import Record
from linkwise.registry import Registry
from linkwise.signals.force_window import with_force_windows
from linkwise.weak.estimate import WeakForm

METHODS: Registry[type[Estimator]] = Registry(
    "method",
    {
        "ml": "linkwise.likelihood.estimate:MaximumLikelihood",
        "weak": "linkwise.weak.estimate:WeakForm",
        "sindy": "linkwise.sindy.estimate:PhysicsInformedSindy",
    },
    IdentificationError,
)


IdentificationMethod = Literal["ml", "weak", "sindy"]


@np.errstate(over="ignore", invalid="ignore")  # what overflows is found not to be finite, and refused
def identify(
    record: Record | Sequence[Record],
    structure: Structure,
    *,
    method: IdentificationMethod | Estimator = "ml",
    progress: Progress = silent,
    **options: Unpack[LikelihoodKeywords],
) -> Estimate:
    """Identify the unknown coefficients and masses of a structure.

    Parameters
    ----------
    record : Record or sequence of Record
        The record, or several records of the same structure, which "ml" fits together.
    structure : Structure
        The structure; what is unknown in it is identified.
    method : {"ml", "weak", "sindy"} or Estimator
        Maximum likelihood on the raw samples (METHODS section 5); the weak form (section 4: no signal is differentiated,
        noise bias removed; milliseconds, and judged by the likelihood for up to six masses); or the paper's physics-informed
        SINDy. `MaximumLikelihood(...)`, `WeakForm()` or `PhysicsInformedSindy(...)` in place of the name says how.
    progress : Progress
        Called with a `ProgressReport` at every step of "ml"; the others are done at once.
    **options
        Options of "ml": `starts`, `offsets`, `gains`, `calibration`, `delays`, `drifts`, `hums`, `ambient`, `input_noise`,
        `admit`, `loss`, `exact` and `profile`, as in `MaximumLikelihood`.

    Returns
    -------
    Estimate
        The identified structure with intervals, and verdicts on what limits the trust in it.

    Raises
    ------
    IdentificationError
        If the records do not determine an unknown at all, nothing is unknown, or options are given that the method does not
        have.
    RecordError
        If two records hold the same samples, or the noise stated of a channel is far more than its samples.
    TypeError
        If an argument has another type, or a keyword is unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"))
    >>> low, high = fit.coefficient("nes1.alpha").interval
    >>> low < -100.0 < high
    True
    """
    for name in options.keys() - LikelihoodKeywords.__annotations__:
        known = near_miss(name, LikelihoodKeywords.__annotations__)
        raise ArgumentTypeError(f"identify() got an unexpected keyword argument {name!r}{known}")
    estimator = _estimator(method, {name: value for name, value in options.items() if value})
    records = record_list(record, "identify(record, structure): record")
    expect("identify(record, structure): structure", structure, Structure)
    if not records:
        raise IdentificationError("there is no record to identify from")
    check_distinct(records)
    check_stated_noise(records)
    recorded = records[0]
    records = [with_force_windows(in_units_of(given, structure)) for given in records]
    if not structure.parameters:
        message = 'there is nothing to identify, every coefficient is a number: write "unknown" for those to be found'
        raise IdentificationError(message)
    started = perf_counter()
    estimate = estimator.estimate(records, structure, progress)
    if isinstance(estimator, WeakForm):
        estimate = judged_by_likelihood(estimate)
    seconds, notes = perf_counter() - started, joined_notes(records)
    remarks = (*uncounted(records, estimate.method), *_unused(recorded, structure, estimate.method))
    return replace(estimate, seconds=seconds, notes=notes, remarks=(*estimate.remarks, *remarks))


def _unused(record: Record, structure: Structure, method: str) -> tuple[str, ...]:
    """A remark on the channels of signals that no law names, or of links that a method does not use.

    The weak form uses measured states.
    """
    channels = record.channels
    signals = [name for name in channels if name.kind == "signal" and name.place not in structure.signals]
    if signals:
        return (f"{', '.join(signals)} were not used: no law names such a signal.",)
    if method == MaximumLikelihood.method:
        return ()
    states = method == WeakForm.method
    unused = [name for name in channels if name.of_link and not (states and name.kind == "state")]
    takes = "forces of links" if states else "forces and states of links"
    return (f'{", ".join(unused)} were not used: method "ml" alone takes {takes}.',) if unused else ()


def _estimator(method: str | Estimator, options: dict[str, Any]) -> Estimator:
    """The estimator that a user names or gives; `options` are those of "ml" that were given beside it."""
    if isinstance(method, Estimator):
        if options:
            message = f"{', '.join(options)} were given beside {type(method).__name__}(...); give options to that object"
            raise IdentificationError(message)
        return method
    expect("identify(record, structure): method", method, str, Estimator)
    kind = METHODS.lookup(method)
    if not options:
        return kind()
    if kind is not MaximumLikelihood:
        raise IdentificationError(f'{", ".join(options)} are for method "ml", not for "{method}"')
    return MaximumLikelihood(**options)


_SUBSTEPS = 10  # between samples, of links with memory: right to 1e-4 at 20 samples a period


def nmse(true: Link, estimated: Link, record: Record) -> float:
    """Compute the normalised mean square error of an identified force.

    It is the mean square of the difference of both stiffness forces (v = 0) over the variance of the true one, at the
    elongations of a record: the true ones of a simulated record, those of the displacements of a measured one. If one of the
    links has memory, the whole forces are compared: both are driven by the elongations, from the true states at the start of
    a simulated record, and from states of 0 otherwise.

    Parameters
    ----------
    true : Link
        The link with its true law.
    estimated : Link
        The link with the identified law.
    record : Record
        The motion over which both are compared.

    Returns
    -------
    float
        The error in %.

    Raises
    ------
    RecordError
        If an end of the link has no displacement in the record, the true force does not vary, or a state of a link with memory
        runs away.
    SimulationError
        If the elongation of a link with memory has gaps.

    References
    ----------
    The paper, Eq. 8.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> weaker = lw.bnes_chain(2, alpha=-99.0)
    >>> bool(0.0 < lw.nmse(chain.link("nes1"), weaker.link("nes1"), record) < 0.1)
    True
    """
    expect("nmse(true, estimated, record): true", true, Link)
    expect("nmse(true, estimated, record): estimated", estimated, Link)
    expect("nmse(true, estimated, record): record", record, Record)
    forces = _forces_with_memory if true.law.states or estimated.law.states else _stiffness_forces
    return force_error(*forces(true, estimated, record), true.name)


def _stiffness_forces(true: Link, estimated: Link, record: Record) -> tuple[Floats, Floats]:
    """(N',) N of both links at rest, at the elongations and signals of the samples where both ends were seen."""
    d = _elongation(true, record)
    seen = np.isfinite(d)
    named = {*true.law.signals, *estimated.law.signals}
    signals = {name: record.channel(f"signal:{name}")[seen] for name in named}
    return true.force(d[seen], states=signals), estimated.force(d[seen], states=signals)


def _forces_with_memory(true: Link, estimated: Link, record: Record) -> tuple[Floats, Floats]:
    """(N,) N of both links along the motion of one, their states by the trapezoidal rule between samples."""
    motion = Sampled(0.0, record.rate, _elongation(true, record))
    step = record.step / _SUBSTEPS
    nodes = np.minimum(step * np.arange(_SUBSTEPS * (len(record) - 1) + 1), motion.end)
    d, v = motion.value(nodes), motion.derivative(nodes)
    states = {} if record.simulated is None else record.simulated.states
    forces: list[Floats] = []
    for link in (true, estimated):
        start = [float(states.get(f"{true.name}.{name}", [0.0])[0]) for name in link.law.states]
        path = LinkPath.of(link.law, link.values, d, v, step, np.array(start))
        if not path.converged:
            message = f'a state of link "{link.name}" runs away along the motion of the record, so that its force has no error'
            raise RecordError(message)
        forces.append(path.force()[::_SUBSTEPS])
    return forces[0], forces[1]


def _elongation(link: Link, record: Record) -> Floats:
    """(N,) elongations of one link."""
    return np.asarray(_displacement(link.between[0], record) - _displacement(link.between[1], record))


def _displacement(end: str, record: Record) -> Floats:
    truth = record.simulated
    if end == GROUND:
        return np.zeros(len(record))
    if truth is not None and end == BASE and truth.base is not None:
        return truth.base
    if truth is not None and end in truth.structure.topology.index and end != BASE:
        return np.asarray(truth.displacement @ truth.structure.topology.row(end))
    return record.channel(f"x:{end}")
