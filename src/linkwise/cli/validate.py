"""`linkwise validate`: a record and an identified structure, to how well the one predicts the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, note, progress
from linkwise.cli.options import ANSWER, POSITIVE, grouped, typed
from linkwise.cli.reading_options import RecordOptions, record_options
from linkwise.identification.validated_answer import answer_in_numbers
from linkwise.output import VALIDATION


@dataclass(frozen=True)
class ScoringOptions:
    """What of a record is scored, and what is estimated again.

    Parameters
    ----------
    burn : float | None
        Time at the start of the record from which the initial state is estimated; it is not scored (default 5 % of
        the record, 50 to 300 samples).
    refit : bool
        Also estimate the coefficients of the answer again, from RECORD alone, and compare; it takes as long as
        identify.
    """

    burn: float | None = typed("S", type=POSITIVE)
    refit: bool = typed(is_flag=True)


@click.command()
@record_options
@click.argument("answer", type=ANSWER)
@grouped(ScoringOptions, "scoring")
@answer_options(VALIDATION)
def validate(source: RecordOptions, answer: Path, scoring: ScoringOptions, delivery: Delivery) -> int:
    """Predict RECORD with an identified structure, and report where and by how much the prediction is wrong.

    ANSWER is the folder that identify or discover wrote, or a structure file in which every coefficient is a number. Use a
    record, or a part of one, that was not used in the identification. The initial state is estimated from the start of the
    record; from there the structure moves freely under the recorded inputs, or in windows if the motion is chaotic.
    Nothing is estimated again, but with --refit each coefficient of an answer with intervals, from RECORD alone.

    Errors of sensors that the answer found are taken out of RECORD. A gain, offset or delay that --sensor states with
    a size, as force:m1:gain=1 of a load cell that was repaired, counts in place of what the answer found of it.

    Exit code 3 means that the prediction disagrees with the record: in some channel its RMSE is larger than noise, the error
    of the initial state, the intervals of the coefficients and the model error of the answer explain in 999 of 1000 records.
    So it does where the record tests nothing, as any motion as large as the recorded one would agree, and with --refit where
    the laws of a trusted answer leave more than noise of the record with any coefficients.

    \b
    Examples:
      linkwise validate second.csv answer -o validation
      linkwise validate run.csv answer --from 4 --burn 0.2
      linkwise validate second.csv answer --refit
      linkwise validate second.csv answer --sensor force:m1:gain=1
      linkwise validate second.csv answer/structure.toml --json
    """
    source.refuse_unknown_errors()
    subject = answer_in_numbers(answer)
    if subject.basis.remark and not answer.is_dir():  # that of a folder is a finding
        note(f"{answer}: {subject.basis.remark}")
    note(*source.masses_beside(subject.structure))
    with progress("reading") as step:
        record = source.read_motion_of(subject.structure)
        corrected = source.removed_errors(record)
        validation = lw.validate(record, answer, corrected=corrected, progress=step, **vars(scoring))
    return delivery.of(validation)
