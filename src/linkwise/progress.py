"""How long work says how far it is: one protocol for all of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time
from typing import Protocol, final

from linkwise.errors import IdentificationError


@final
@dataclass(frozen=True)
class ProgressReport:
    """How far a piece of work is.

    Parameters
    ----------
    fraction : float
        The part that is done, from 0 to 1. It does not fall while one piece of work goes on, except where a search has to
        take back what it thought to be done.
    activity : str
        What is being done, in a few words, for a person who waits.
    detail : object, optional
        What the work itself notes at this point: an `AnnealingStep` of a maximum-likelihood fit, a `StudyProgress` of a
        study, else None.

    Examples
    --------
    >>> import linkwise as lw
    >>> report = lw.estimates.ProgressReport(0.25, "step 3")
    >>> f"{report.activity}: {report.fraction:.0%}"
    'step 3: 25%'
    """

    fraction: float
    activity: str
    detail: object = None


class Progress(Protocol):
    """What the keyword `progress` of all long work takes: a callable that is given a `ProgressReport`.

    What it returns is ignored. An exception that it raises ends the work; at a KeyboardInterrupt `identify` and `discover`
    return the best so far.

    Examples
    --------
    >>> import linkwise as lw
    >>> reports = []
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=100.0, progress=reports.append
    ... )
    >>> reports[-1]
    ProgressReport(fraction=1.0, activity='simulating', detail=None)
    """

    def __call__(self, report: ProgressReport, /) -> object:
        """Take note of a report."""


def silent(report: ProgressReport, /) -> None:
    """Take no note of a report: what long work does where nobody waits."""


def rising(progress: Progress) -> Progress:
    """The same progress with fractions that do not fall, where work starts again within what was taken for done."""
    highest = 0.0

    def risen(report: ProgressReport, /) -> None:
        nonlocal highest
        highest = max(highest, report.fraction)
        progress(replace(report, fraction=highest))

    return risen


def part(progress: Progress, start: float, stop: float) -> Progress:
    """The progress of a part of the work, whose own fractions from 0 to 1 are those from `start` to `stop` of the whole."""

    def within(report: ProgressReport, /) -> None:
        progress(replace(report, fraction=start + (stop - start) * report.fraction))

    return within


def until(end: float, progress: Progress, message: str) -> Progress:
    """The same progress, which ends a search by an IdentificationError where the processor time is beyond an `end`."""

    def within(report: ProgressReport, /) -> None:
        if process_time() > end:
            raise IdentificationError(message)
        progress(report)

    return within
