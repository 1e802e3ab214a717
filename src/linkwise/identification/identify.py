"""From a record and a structure with unknowns to the force law of every link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal, Unpack

import numpy as np

from linkwise.display import near_miss
from linkwise.errors import ArgumentTypeError, IdentificationError, expect
from linkwise.estimates.estimate import Estimate, Estimator
from linkwise.identification.weak_answer import judged_by_likelihood
from linkwise.likelihood.estimate import LikelihoodKeywords, MaximumLikelihood
from linkwise.likelihood.options import uncounted
from linkwise.model.structure import Structure
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
