"""The same record by every method, side by side: coefficients, grades, predictions and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from linkwise.display import JudgedView, align_columns, format_duration, format_error, format_value, paragraph
from linkwise.errors import LinkwiseError, expect
from linkwise.estimates.causes import Cause
from linkwise.estimates.estimate import Estimate, link_document
from linkwise.estimates.link_estimate import CoefficientEstimate
from linkwise.identification.identify import METHODS, identify
from linkwise.identification.validate import validate
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.record import Record
from linkwise.verdict import Grade, Verdict

_LONGEST = 400  # characters of a reason


@dataclass(frozen=True, eq=False)
class MethodAnswer:
    """What one method makes of a record.

    Attributes
    ----------
    name : str
        The method, "ml", "weak" or "sindy", or "ml with" a term that is missing.
    estimate : Estimate or None
        Its answer; None where the method does not apply.
    reason : str
        Why it does not apply, or why its answer does not predict the record; empty where it does.
    prediction : mapping of str to float
        Root mean square of the error of a free run, or of windows where the motion is chaotic, by channel, as a part of the
        deviation of the channel; empty where the answer does not follow the record.
    """

    name: str
    estimate: Estimate | None
    reason: str = ""
    prediction: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data."""
        estimate = self.estimate
        document: dict[str, Any] = {"name": self.name, "applies": estimate is not None, "reason": self.reason}
        if estimate is None:
            return document
        return {
            **document,
            "grade": estimate.grade.value,
            "status": estimate.status,
            "chi_square_per_sample": estimate.chi_square_per_sample,
            "seconds": estimate.seconds,
            "prediction_error_percent": {name: 100.0 * error for name, error in self.prediction.items()},
            "links": [link_document(link) for link in estimate.links if link.free],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(JudgedView):
    """The result of `compare`: answers of several methods, of which that of maximum likelihood gives the grade.

    Attributes
    ----------
    record : Record
        The record.
    answers : tuple of MethodAnswer
        The answers, that of "ml" first.
    missing : Cause or None
        The first cause in the diagnosis of "ml" that is a term of a law or a link.
    """

    record: Record
    answers: tuple[MethodAnswer, ...]
    missing: Cause | None = None

    @property
    def best(self) -> Estimate:
        """The answer of maximum likelihood."""
        estimate = self.answers[0].estimate
        assert estimate is not None
        return estimate

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Those of maximum likelihood."""
        return self.best.verdicts

    @cached_property
    def grade(self) -> Grade:
        """That of maximum likelihood."""
        return self.best.grade

    @property
    def head(self) -> tuple[str, str]:
        """The structure with the grade, and what is missing."""
        missing = "Nothing that it leaves points to a term that is missing."
        if self.missing is not None:
            missing = f"What is missing, by what it leaves: {self.missing.description}."
        return f"{self.best.structure.name or 'structure'}: maximum likelihood {self.grade.trust}", missing

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table: a column a method, a row a coefficient, grade, chi-square, channel and time."""
        answers = self.answers
        by_name = [{c.name: c for c in _unknown_coefficients(answer)} for answer in answers]
        units = {name: c.unit for coefficients in by_name for name, c in coefficients.items()}
        table: list[tuple[str, ...]] = [("", *(answer.name for answer in answers), "unit")]
        table += [(name, *(_cell(of.get(name)) for of in by_name), unit) for name, unit in units.items()]
        shown = [answer.estimate for answer in answers]
        table.append(("grade", *map(_grade_cell, shown), ""))
        squares = ["" if one is None else _number_cell(one.chi_square_per_sample) for one in shown]
        table.append(("chi-square", *squares, ""))
        for channel in self.record.responses:
            errors = [_number_cell(answer.prediction.get(channel), 100.0) for answer in answers]
            table.append((f"free run of {channel}", *errors, "%"))
        table.append(("time", *("" if one is None else format_duration(one.seconds) for one in shown), ""))
        return table

    @property
    def findings(self) -> tuple[str, ...]:
        """Why a method does not apply, or does not predict the record."""
        return tuple(f"{answer.name}: {answer.reason}" for answer in self.answers if answer.reason)

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain data for JSON."""
        return {
            "method": "compare",
            "status": self.best.status,
            **self._judgement(),
            "message": self.best.explanation,
            "missing": None if self.missing is None else self.missing.to_dict(),
            "answers": [answer.to_dict() for answer in self.answers],
        }

    def __str__(self) -> str:
        head, missing = self.head
        blocks = [f"{head}\n{paragraph(missing)}", "\n".join(align_columns(self.rows))]
        return "\n\n".join([*blocks, *map(paragraph, self.findings)])


def compare(record: Record, structure: Structure, *, progress: Progress = silent) -> Comparison:
    """Identify a structure by maximum likelihood, the weak form and the paper's SINDy, and by maximum likelihood with terms
    beside which it leaves only noise, if there are any, and predict the record by each.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure, with unknowns.
    progress : Progress
        Called with a `ProgressReport` now and then.

    Returns
    -------
    Comparison
        The answers; a method that does not take the record or the structure says why.

    Raises
    ------
    IdentificationError
        If maximum likelihood does not take them.
    TypeError
        If an argument has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> from linkwise.identification.compare import compare
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> comparison = compare(record, chain.unknown("nes"))
    >>> [answer.name for answer in comparison.answers]
    ['ml', 'weak', 'sindy']
    """
    expect("compare(record, structure): record", record, Record)
    expect("compare(record, structure): structure", structure, Structure)
    step = 0.2
    best = identify(record, structure, progress=part(progress, 0.0, 3.0 * step))
    tried = [_with_run("ml", best, record)]
    for number, name in enumerate((name for name in METHODS if name != "ml"), start=1):
        progress(ProgressReport(step * (2 + number), name))
        try:
            tried.append(_with_run(name, identify(record, structure, method=METHODS.lookup(name)()), record))
        except LinkwiseError as error:
            tried.append(MethodAnswer(name, None, _error_text(error)))
    missing, richer = (cause for cause in best.diagnosis if not cause.is_instrument), best.alternative
    if richer is not None:
        name = f"ml with {' and '.join(cause.label for cause in richer.added)}"
        tried.append(_with_run(name, richer, record))
    return Comparison(record, tuple(tried), next(missing, None))


def _with_run(name: str, estimate: Estimate, record: Record) -> MethodAnswer:
    """An answer with the error of its free run."""
    try:
        scores = validate(record, estimate.structure).channels
    except LinkwiseError as error:
        return MethodAnswer(name, estimate, f"its free run fails: {_error_text(error)}")
    return MethodAnswer(name, estimate, prediction={c: 1.0 - 0.01 * s.fit_percent for c, s in scores.items()})


def _error_text(error: LinkwiseError) -> str:
    return " ".join(str(error).split())[:_LONGEST]


def _unknown_coefficients(answer: MethodAnswer) -> Iterator[CoefficientEstimate]:
    """The unknown coefficients and masses of an answer."""
    if answer.estimate is not None:
        for link in answer.estimate.links:
            yield from (coefficient for coefficient in link.coefficients if not coefficient.known)
        yield from (mass for mass in answer.estimate.masses if not mass.known)


def _cell(coefficient: CoefficientEstimate | None) -> str:
    """A value with its standard error, where it has one."""
    if coefficient is None:
        return ""
    error = coefficient.standard_error
    text = format_value(coefficient.value, error)
    return text if error is None else f"{text} ± {format_error(error)}"


def _grade_cell(estimate: Estimate | None) -> str:
    """The grade; a method without chi-square does not test whether its laws explain the record."""
    if estimate is None:
        return "not applicable"
    untested = estimate.grade is Grade.EXPLAINED and estimate.chi_square_per_sample is None
    return "not tested" if untested else estimate.grade.value


def _number_cell(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:.3g}"
