"""What a study shows, each claim a sentence with its figures and whether it holds: the verdict of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.paper.published import DECIBELS, INFORMED_NMSE
from linkwise.paper.subset import PaperStudy
from linkwise.paper.table_2 import NEAR, Table2, near
from linkwise.study.cells import Cell, StudyTable
from linkwise.verdict import Verdict

BELOW = 500.0  # times below the paper's physics-informed error: what maximum likelihood is held to at 20 dB
MOST = 0.8  # of the cells of Table 2 that the best convention is to reproduce: 12 of 15


@dataclass(frozen=True)
class Claim:
    """A sentence; `met` is None if the study has too few rows to decide."""

    text: str
    met: bool | None

    @property
    def mark(self) -> str:
        """A sign for a list."""
        return {True: "✓", False: "✗", None: "–"}[self.met]


def claims(table: StudyTable, paper: PaperStudy, comparison: Table2) -> tuple[Claim, ...]:
    """The claims that a study tests, what it was made for first."""
    listed = [_complete(table)]
    if comparison.cells:
        listed = [
            *(_far_below(table, paper, method) for method in paper.likelihood),
            *([_reproduced(comparison)] if comparison.classical else []),
            *(_informed(table, paper, method) for method in paper.informed),
            *listed,
        ]
    return (*listed, *_trusted(table, paper))


def _complete(table: StudyTable) -> Claim:
    done = table.expected - table.missing
    text = f"All {table.expected} cases were run"
    if table.missing:
        empty = sum(not cell.done for cell in table.cells)
        text = (
            f"{done} of {table.expected} cases were run; {empty} of {len(table.cells)} cells are empty, "
            "and medians are of what there is"
        )
    failed = f"; {table.failed} gave no answer" if table.failed else "; every one gave an answer"
    return Claim(f"{text}{failed if done else ''}.", not table.missing and not table.failed)


def _far_below(table: StudyTable, paper: PaperStudy, method: str) -> Claim:
    level = DECIBELS[-1]
    cells = [table.cell(name, level, method) for name in paper.masses]
    errors = {cell.masses: cell.nmse for cell in cells if cell is not None and cell.nmse is not None}
    required = (
        f"{BELOW:g} times below the {INFORMED_NMSE:g} % that the paper's physics-informed SINDy keeps there"
    )
    if not errors:
        return Claim(f"{method} at {level:g} dB: no results yet. It should stay {required}.", None)
    least = min(INFORMED_NMSE / value for value in errors.values())
    worst = max(errors, key=lambda masses: errors[masses])
    text = (
        f"{method} at {level:g} dB: at most {errors[worst]:.2g} % ({worst} masses), {_rounded_down(least)} times below "
        f"the paper's physics-informed {INFORMED_NMSE:g} %"
    )
    missed = [
        f"{masses} masses ({INFORMED_NMSE / value:.3g} times)"
        for masses, value in errors.items()
        if INFORMED_NMSE / value < BELOW
    ]
    if missed:
        return Claim(f"{text}; it misses {BELOW:g} times in the cells of {', '.join(missed)}.", False)
    absent = _absent(paper, errors)
    if absent:
        return Claim(f"{text}; there are no results yet for {absent}. It should stay {required}.", None)
    return Claim(f"{text} in every cell; {BELOW:g} times was asked for.", True)


def _reproduced(comparison: Table2) -> Claim:
    best = comparison.best
    if best is None:
        return Claim("Table 2: no convention of the classical method has a number for any cell.", None)
    within, counted, count = comparison.within(best), comparison.counted(best), len(comparison.cells)
    factor = comparison.typical_factor(best)
    text = (
        f'Table 2 is reproduced best by "{best}" (of {len(comparison.classical)} ways to run SINDy): '
        f"{within} of {count} cells within a factor {NEAR:g}, the median factor is {factor:.2g}"
    )
    enough = within >= MOST * count
    if counted < count and not enough:
        return Claim(
            f"{text}; {count - counted} cells have no number yet.",
            None if within + count - counted >= MOST * count else False,
        )
    return Claim(f"{text}{'' if enough else f'; {np.ceil(MOST * count):.0f} were asked for'}.", enough)


def _informed(table: StudyTable, paper: PaperStudy, method: str) -> Claim:
    level = DECIBELS[-1]
    cells = [table.cell(name, level, method) for name in paper.masses]
    errors = {cell.masses: cell.nmse for cell in cells if cell is not None and cell.nmse is not None}
    if not errors:
        return Claim(
            f"{method} at {level:g} dB: no results yet; the paper has around {INFORMED_NMSE:g} %.", None
        )
    text = (
        f"{method} at {level:g} dB: {min(errors.values()):.2g} to {max(errors.values()):.2g} %; "
        f"the paper has around {INFORMED_NMSE:g} %"
    )
    off = [f"{masses} masses" for masses, value in errors.items() if not near(value, INFORMED_NMSE)]
    if off:
        return Claim(f"{text}, which {', '.join(off)} miss by more than a factor {NEAR:g}.", False)
    absent = _absent(paper, errors)
    return Claim(f"{text}{f'; no results yet for {absent}' if absent else ''}.", None if absent else True)


def _trusted(table: StudyTable, paper: PaperStudy) -> list[Claim]:
    """Whether linkwise's own estimators stand by their answers."""
    claims_of_trust = []
    for method in (*paper.weak, *paper.likelihood):
        answers = [row for cell in _of(table, method) for row in cell.answers]
        doubtful = [row for row in answers if row.status != Verdict.CONVERGED.status]
        if answers:
            text = f"{method} stands by {len(answers) - len(doubtful)} of its {len(answers)} answers"
            claims_of_trust.append(
                Claim(
                    f"{text}{'; the others say that they are not to be trusted' if doubtful else ''}.",
                    not doubtful,
                )
            )
    return claims_of_trust


def _of(table: StudyTable, method: str) -> Sequence[Cell]:
    return [cell for cell in table.cells if cell.method == method]


def _absent(paper: PaperStudy, errors: dict[int, float]) -> str:
    return ", ".join(f"{masses} masses" for masses in paper.masses.values() if masses not in errors)


def _rounded_down(value: float) -> str:
    """Two digits, never more than there is."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / unit * (1 + 1e-12)) * unit:.0f}"
