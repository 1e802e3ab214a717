"""Errors of sensors and inputs that are estimated with the laws as long as one of them is diagnosed first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from linkwise.estimates.causes import CLOCK, Cause
from linkwise.likelihood.delays import Search, with_delays
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import (
    OF_FORCE,
    LikelihoodOptions,
    is_admissible,
    require_known_kinds,
    with_error,
)
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
    """The first error of a sensor or a force in a diagnosis that can be estimated; None where others explain as much, with
    which coefficients would change otherwise.
    """
    instruments = [cause for cause in diagnosis if cause.is_instrument and cause.kind != "input noise"]
    if not instruments or not is_admissible(instruments[0]):
        return None
    first = instruments[0]
    is_late = first.kind.endswith(("delay", CLOCK))
    return None if not is_late and any(rival.name in first.rivals for rival in diagnosis) else first
