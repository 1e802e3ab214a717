"""A study beside the paper's Table 2: what the paper prints, which convention reproduces it, and what the study shows,
claim by claim.

Liu, Li and Jiang, "On efficiency and accuracy of sparse identification of bistable nonlinear energy sink chains" (2024).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from linkwise.model.chains import bnes_chain
from linkwise.study.definition import Study
from linkwise.study.subject import Row, Subject
from linkwise.study.summary import Cell, StudySummary
from linkwise.verdict import Verdict

MASSES = (2, 4, 6, 8, 10)
DECIBELS = (40.0, 30.0, 20.0)  # signal to noise, as the paper lists them

_ROWS = (
    (0.0018, 0.0027, 0.0039, 0.0358, 0.6450),
    (0.0331, 0.1128, 0.4716, 2.3555, 9.7115),
    (2.1564, 5.8351, 9.0256, 30.3485, 63.0856),
)

_CELLS = ((masses, level) for level, masses in product(DECIBELS, MASSES))
TABLE_2 = dict(zip(_CELLS, sum(_ROWS, ()), strict=True))
"""NMSE in % of the sink's force (Eq. 8) by number of masses and dB: SINDy with all monomials up to the third order."""

INFORMED_NMSE = 0.5
"""NMSE in % that physics-informed SINDy keeps "around" at 20 dB for every number of masses (section 5, Fig. 9a)."""

INFORMED_SECONDS = dict(zip(MASSES, (0.9, 1.7, 2.9, 5.1, 12.3), strict=True))
"""Computing time in s of physics-informed SINDy by number of masses (section 5, Fig. 9b)."""

DURATION, RATE = 6.0, 1000.0
"""Length in s and samples per second of every record (section 4)."""


def start(masses: int) -> dict[str, float]:
    """The release of the first mass in m/s (section 4; what it writes for eight masses serves from four on)."""
    return {"v:m1": 1.0 if masses == 2 else 3.0}


@dataclass(frozen=True)
class PaperStudy:
    """`masses` counts those of each structure of a study that is a chain of the paper, by its name, fewest first.

    The paper's numbers may stand beside these alone. `classical` are the methods with a library of all monomials, `informed`
    those with the links' own columns, `weak` and `likelihood` linkwise's estimators; each by name in the study's order.
    """

    masses: Mapping[str, int]
    classical: tuple[str, ...]
    informed: tuple[str, ...]
    weak: tuple[str, ...]
    likelihood: tuple[str, ...]

    @classmethod
    def of(cls, study: Study) -> PaperStudy:
        """What `study` has of it: a chain counts with the masses, links, release, length and rate of the paper."""
        masses = {subject.name: subject.structure.size for subject in study.subjects if _is_paper(subject)}

        def named(kind: str) -> tuple[str, ...]:
            return tuple(method.name for method in study.methods if method.document()["kind"] == kind)

        ordered = dict(sorted(masses.items(), key=lambda item: item[1]))
        return cls(ordered, named("monomial"), named("physics-informed"), named("weak"), named("ml"))

    def named(self, masses: int) -> str | None:
        """The name of the chain of so many masses, None where the study has none."""
        return next((name for name, count in self.masses.items() if count == masses), None)


def _is_paper(subject: Subject) -> bool:
    count = subject.structure.size
    if count not in MASSES:
        return False
    chain = bnes_chain(count)
    return (
        (subject.structure.masses, subject.structure.links) == (chain.masses, chain.links)
        and dict(subject.release) == start(count)
        and (subject.duration, subject.rate) == (DURATION, RATE)
        and not (subject.impulses or subject.forces or subject.base)
    )


NEAR = 3.0  # a cell is reproduced within this factor


@dataclass(frozen=True)
class Table2Cell:
    """One cell of Table 2: the paper's NMSE in %, and by method the cell of the study."""

    masses: int
    snr_db: float
    paper: float
    cells: Mapping[str, Cell]

    @property
    def where(self) -> str:
        """The cell in words."""
        return f"{self.masses} masses, {self.snr_db:g} dB"

    def nmse(self, method: str) -> float | None:
        """The median NMSE in % of a method, None where there is none."""
        return self.cells[method].nmse if method in self.cells else None

    def ratio(self, method: str) -> float | None:
        """The median NMSE of a method over that of the paper; None where there is none."""
        nmse = self.nmse(method)
        return None if nmse is None else nmse / self.paper

    def near(self, method: str) -> bool:
        """Whether a method's median is within the factor `NEAR` of the paper."""
        return near(self.nmse(method), self.paper)


@dataclass(frozen=True)
class Table2:
    """Table 2 in the paper's order, noise level by noise level, for the chains that the study has."""

    cells: tuple[Table2Cell, ...]
    classical: tuple[str, ...]

    @classmethod
    def of(cls, table: StudySummary, paper: PaperStudy) -> Table2:
        """The cells of Table 2 that the study asks for."""
        cells = []
        for decibel in DECIBELS:
            for name, masses in paper.masses.items():
                of_methods = ((method, table.cell(name, decibel, method)) for method in table.methods)
                study_cells = {method: cell for method, cell in of_methods if cell is not None}
                if study_cells:
                    cells.append(Table2Cell(masses, decibel, TABLE_2[masses, decibel], study_cells))
        return cls(tuple(cells), paper.classical)

    def within(self, method: str) -> int:
        """Cells that a method reproduces within the factor `NEAR`."""
        return sum(cell.near(method) for cell in self.cells)

    def counted(self, method: str) -> int:
        """Cells in which a method has a median."""
        return sum(cell.nmse(method) is not None for cell in self.cells)

    def typical_factor(self, method: str) -> float | None:
        """The median factor, above 1, between a method and the paper; None where it has no median."""
        ratios = [ratio for cell in self.cells if (ratio := cell.ratio(method))]
        return float(np.exp(np.median(np.abs(np.log(ratios))))) if ratios else None

    @cached_property
    def best(self) -> str | None:
        """The classical method that reproduces most cells, of equals the one with the smallest typical factor."""
        methods = [method for method in self.classical if self.counted(method)]
        ranked = [(-self.within(method), self.typical_factor(method) or np.inf) for method in methods]
        return methods[ranked.index(min(ranked))] if methods else None


def near(value: float | None, paper: float) -> bool:
    """Whether a value is within the factor `NEAR` of the paper's."""
    return value is not None and paper / NEAR <= value <= paper * NEAR


def explanation(cell: Table2Cell, method: str, classical: Sequence[str]) -> str:
    """Why a cell is off: what else the paper may have counted that comes near its value, worked out from the rows.

    Empty where the cell is near, or where nothing was run.
    """
    study_cell = cell.cells.get(method)
    if study_cell is None or not study_cell.done or cell.near(method):
        return ""
    if study_cell.nmse is None:
        return f"{len(study_cell.failures)} of {study_cell.done} cycles gave no answer"
    ratio = study_cell.nmse / cell.paper
    times, side = (1.0 / ratio, "below") if ratio < 1.0 else (ratio, "above")
    deviation = f"{times:.3g} times {side} the paper"
    rows = study_cell.answers
    readings = {name: _counted(statistic, map(pick, rows)) for name, (statistic, pick) in _COUNTED.items()}
    readings |= {candidate: cell.nmse(candidate) for candidate in classical if candidate != method}
    fitting = [f"{name} ({_percent(value)})" for name, value in readings.items() if near(value, cell.paper)]
    share = study_cell.share_above(cell.paper)
    single = f"{100.0 * share:.0f} % of single cycles lie above the paper's value"
    if fitting:
        return f"{deviation}; {single}; within a factor {NEAR:g} would be {', '.join(fitting)}"
    known = {name: value for name, value in readings.items() if value}
    closest = min(known, key=lambda name: abs(np.log(known[name] / cell.paper)), default=None)
    closest_text = "" if closest is None else f", the closest being {closest} ({_percent(known[closest])})"
    none = f"no mean, no other choice of sink and no other convention comes within a factor {NEAR:g}"
    return f"{deviation}; {single}; {none}{closest_text}"


def _counted(statistic: Callable[..., Any], numbers: Iterable[float | None]) -> float | None:
    """A statistic of the numbers that there are."""
    present = [number for number in numbers if number is not None]
    return float(statistic(present)) if present else None


_COUNTED: Mapping[str, tuple[Callable[..., Any], Callable[[Row], float | None]]] = {
    "the mean over cycles": (np.mean, lambda row: row.nmse),
    "the first sink alone": (np.median, lambda row: next(iter(row.links.values()), None)),
    "the last sink alone": (np.median, lambda row: next(reversed(list(row.links.values())), None)),
    "the worst sink": (np.median, lambda row: row.worst),
    "the best sink": (np.median, lambda row: min(row.links.values(), default=None)),
}


def _percent(value: float | None) -> str:
    return "no number" if value is None else f"{value:.3g} %"


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


def claims(table: StudySummary, paper: PaperStudy, comparison: Table2) -> tuple[Claim, ...]:
    """The claims that a study tests, what it was made for first."""
    listed: list[Claim] = []
    if comparison.cells:
        listed += [_far_below(table, paper, method) for method in paper.likelihood]
        listed += [_reproduced(comparison)] if comparison.classical else []
        listed += [_informed(table, paper, method) for method in paper.informed]
    return (*listed, _complete(table), *_trusted(table, paper))


def _complete(table: StudySummary) -> Claim:
    done = table.expected - table.missing
    text = f"All {table.expected} cases were run"
    if table.missing:
        empty = sum(not cell.done for cell in table.cells)
        text = f"{done} of {table.expected} cases were run; {empty} of {len(table.cells)} cells are empty"
        text = f"{text}, and medians are of what there is"
    failed = f"; {table.failed} gave no answer" if table.failed else "; every one gave an answer"
    return Claim(f"{text}{failed if done else ''}.", not table.missing and not table.failed)


def _errors(table: StudySummary, paper: PaperStudy, method: str, level: float) -> dict[int, float]:
    """The errors of a method in % by number of masses."""
    cells = [table.cell(name, level, method) for name in paper.masses]
    return {cell.masses: cell.nmse for cell in cells if cell is not None and cell.nmse is not None}


def _far_below(table: StudySummary, paper: PaperStudy, method: str) -> Claim:
    level = DECIBELS[-1]
    errors = _errors(table, paper, method, level)
    kept = f"the {INFORMED_NMSE:g} % that the paper's physics-informed SINDy keeps there"
    required = f"{BELOW:g} times below {kept}"
    if not errors:
        return Claim(f"{method} at {level:g} dB: no results yet. It should stay {required}.", None)
    least = min(INFORMED_NMSE / value for value in errors.values())
    worst = max(errors, key=lambda masses: errors[masses])
    text = (
        f"{method} at {level:g} dB: at most {errors[worst]:.2g} % ({worst} masses), {_rounded_down(least)} times below "
        f"the paper's physics-informed {INFORMED_NMSE:g} %"
    )
    times = {masses: INFORMED_NMSE / value for masses, value in errors.items()}
    missed = [f"{masses} masses ({ratio:.3g} times)" for masses, ratio in times.items() if ratio < BELOW]
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
        met = None if within + count - counted >= MOST * count else False
        return Claim(f"{text}; {count - counted} cells have no number yet.", met)
    return Claim(f"{text}{'' if enough else f'; {np.ceil(MOST * count):.0f} were asked for'}.", enough)


def _informed(table: StudySummary, paper: PaperStudy, method: str) -> Claim:
    level, published = DECIBELS[-1], f"the paper has around {INFORMED_NMSE:g} %"
    errors = _errors(table, paper, method, level)
    if not errors:
        return Claim(f"{method} at {level:g} dB: no results yet; {published}.", None)
    span = f"{min(errors.values()):.2g} to {max(errors.values()):.2g} %"
    text = f"{method} at {level:g} dB: {span}; {published}"
    off = [f"{masses} masses" for masses, value in errors.items() if not near(value, INFORMED_NMSE)]
    if off:
        return Claim(f"{text}, which {', '.join(off)} miss by more than a factor {NEAR:g}.", False)
    absent = _absent(paper, errors)
    return Claim(f"{text}{f'; no results yet for {absent}' if absent else ''}.", None if absent else True)


def _trusted(table: StudySummary, paper: PaperStudy) -> list[Claim]:
    """Whether linkwise's own estimators trust their answers."""
    claims_of_trust = []
    for method in (*paper.weak, *paper.likelihood):
        answers = [row for cell in table.cells if cell.method == method for row in cell.answers]
        doubtful = [row for row in answers if row.status != Verdict.CONVERGED.status]
        if answers:
            text = f"{method} trusts {len(answers) - len(doubtful)} of its {len(answers)} answers"
            others = "; of the others it says that they are not to be trusted" if doubtful else ""
            claims_of_trust.append(Claim(f"{text}{others}.", not doubtful))
    return claims_of_trust


def _absent(paper: PaperStudy, errors: dict[int, float]) -> str:
    return ", ".join(f"{masses} masses" for masses in paper.masses.values() if masses not in errors)


def _rounded_down(value: float) -> str:
    """Two digits, never more than there is."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / unit * (1 + 1e-12)) * unit:.0f}"
