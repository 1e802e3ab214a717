"""Errors of sensors and inputs that are estimated with the laws as long as one of them is diagnosed first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from linkwise.estimates.causes import CLOCK, GAIN_DRIFT, Cause
from linkwise.likelihood.checks.judgement import LARGEST_SHIFT
from linkwise.likelihood.delays import Search, with_delays
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import (
    OF_FORCE,
    LikelihoodOptions,
    is_admissible,
    require_known_kinds,
    with_error,
)
from linkwise.likelihood.tests.diagnosis import DISTINCT
from linkwise.records.record import Record


class Diagnosed(Protocol):
    """An answer with a diagnosis of what it leaves."""

    @property
    def diagnosis(self) -> tuple[Cause, ...]: ...


Answer = TypeVar("Answer", bound=Diagnosed)


def answer_with_sensors(
    search: Search,
    records: Sequence[Record],
    options: LikelihoodOptions,
    admitted: Sequence[str],
    report: Callable[[LikelihoodFit, Sequence[Record]], Answer],
) -> Answer:
    """The `report` on the fit by `options`, at the delays and clocks which the search finds, with errors of the `admitted`
    kinds added as long as one of them is diagnosed first.

    An interrupt from the keyboard ends the search. Raises IdentificationError for a kind that cannot be admitted, and a delay
    that cannot be found.
    """
    require_known_kinds(admitted)
    while True:
        fit, taken = with_delays(search, records, options)
        answer = report(fit, taken)
        error = None if fit.interrupted else distinct_error(answer.diagnosis)
        if error is None or error.kind.removeprefix(OF_FORCE) not in admitted:
            return answer
        wider = with_error(options, error, records[0])  # no error is added twice, so that there is an end
        if wider is None:
            return answer
        options = wider


def distinct_error(diagnosis: Sequence[Cause]) -> Cause | None:
    """The first error of a sensor or a force in a diagnosis that can be estimated; None where others explain as much."""
    instruments = [cause for cause in diagnosis if cause.is_instrument and cause.kind != "input noise"]
    if not instruments or not is_admissible(instruments[0]):
        return None
    first = instruments[0]
    is_late = first.kind.endswith(("delay", CLOCK))
    rivals = (cause for cause in diagnosis if cause is not first)
    return None if not is_late and any(are_rivals(first, rival) for rival in rivals) else first


def are_rivals(first: Cause, second: Cause) -> bool:
    """Whether the records hardly distinguish an error from another: a gain of one channel from that of another, or a mass, or
    from a term that leaves other coefficients, as one that is even is like an offset of a displacement.
    """
    kinds = ("mass", GAIN_DRIFT, *(("gain", "force gain") if first.kind.endswith("gain") else (first.kind,)))
    of_laws = not second.is_instrument and max(first.shift, second.shift) > LARGEST_SHIFT
    return (of_laws or second.kind in kinds) and second.gain > first.gain - DISTINCT
