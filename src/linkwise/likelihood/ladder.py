"""The ladder: errors of inputs and sensors that are taken into the model where laws as stated leave more than noise.

Noise of inputs comes first, at the level that their channels show; then what the diagnosis names first, an error at a time,
as long as it is one of a sensor or an input. The answer is that beside all of it where it leaves nothing but noise, else the
one as stated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from linkwise.errors import IdentificationError
from linkwise.estimates.causes import CLOCK, HARMONIC, Cause, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.harmonics import harmonic_forces
from linkwise.likelihood.options import LikelihoodOptions, beside_clocks, distinct_error, with_error
from linkwise.likelihood.random_forces import noise_of_channels, random_forces
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.verdict import Grade, Verdict

_RUNGS = 4  # errors that are added at most: with more, a term is missing rather


def with_errors_added(
    stated: Estimate,
    answer: Callable[[LikelihoodOptions], Estimate],
    options: LikelihoodOptions,
    records: Sequence[Record],
) -> Estimate:
    """The answer as `stated`, or that beside errors of inputs and sensors if they leave nothing but noise.

    `answer` gives the one by other options.
    """
    if stated.grade is Grade.EXPLAINED or stated.fit_verdicts[0] is Verdict.NOT_CONVERGED:
        return stated
    current: Estimate = stated
    added: tuple[Cause, ...] = ()
    for _ in range(_RUNGS):
        clock = any(
            cause.kind == CLOCK for cause in current.diagnosis[:1]
        )  # which noise of inputs would hide
        rung = (
            (clock and _first_error(options, records, current))
            or _noise(options, records, stated)
            or _first_error(options, records, current)
        )
        if rung is None:
            return stated
        options, cause = rung
        added = (*added, *cause)
        try:
            current = answer(options)
        except IdentificationError:
            return stated
        if current.grade is Grade.EXPLAINED:
            return replace(current, added=_as_found(added, current))
    return stated


_Rung = tuple[LikelihoodOptions, tuple[Cause, ...]]


def _noise(options: LikelihoodOptions, records: Sequence[Record], stated: Estimate) -> _Rung | None:
    """Noise of the inputs at the level of their channels; None beside what excludes it, or where there is none."""
    robust = not isinstance(options.loss, Gaussian)
    of_clocks = beside_clocks((), options.clocks, records[0])
    late = set(options.delays) - set(of_clocks)
    beside = (*late, *options.drifts, *options.hums, *options.random)
    of_links = any(channel.of_link for channel in records[0].channels)
    structure = stated.given_structure
    levels = noise_of_channels(records, structure)
    levels = {name: level for name, level in levels.items() if not name.startswith("signal:")}
    if not levels or robust or beside or of_links or structure.hosts:
        return None
    try:
        random = random_forces((), levels, records[0], structure)
    except IdentificationError:
        return None
    return replace(options, random=random), tuple(_of_input(name, levels, stated) for name in levels)


def _of_input(name: str, levels: Mapping[str, float], stated: Estimate) -> Cause:
    gain = next((c.gain for c in stated.diagnosis if c.kind == "input noise" and c.where == name), 0.0)
    return Cause("input noise", name, levels[name], unit_in(stated.given_structure, name), gain, 0.0)


def _first_error(options: LikelihoodOptions, records: Sequence[Record], current: Estimate) -> _Rung | None:
    """The error of a sensor or a force that the diagnosis names first; None where that is something else, or has rivals."""
    if current.diagnosis and current.diagnosis[0].kind == HARMONIC:
        line = current.diagnosis[0]
        more = harmonic_forces({line.where: line.size}, records[0], current.given_structure)
        known = tuple(replace(force, amplitudes=()) for force in options.harmonics)
        return replace(options, harmonics=(*known, *more)), (line,)
    first = distinct_error(current.diagnosis)
    if first is None or first is not current.diagnosis[0]:
        return None
    if options.random and first.kind.endswith(("delay", "gain")):
        return None  # delays are not estimated then, and masses, which look like a gain, not tested
    wider = with_error(options, first, records[0])
    return None if wider is None else (wider, (first,))


def _as_found(added: Sequence[Cause], answer: Estimate) -> tuple[Cause, ...]:
    """What was added, with the sizes and standard errors of the answer beside it."""
    found: dict[tuple[str, str], SensorErrorEstimate] = {
        (error.kind, error.channel): error for error in answer.sensor_errors
    }
    sizes = []
    for cause in added:
        error = found.get((cause.kind.removeprefix("force "), cause.where))
        of_gain = cause.kind.endswith("gain")
        if error is not None:
            size = error.value - 1.0 if of_gain else error.value
            cause = replace(cause, size=size, standard_error=error.standard_error)
        sizes.append(cause)
    return tuple(sizes)
