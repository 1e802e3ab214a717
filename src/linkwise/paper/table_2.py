"""A study beside the paper's Table 2, cell by cell: which convention reproduces it, and what would explain the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.paper.published import DECIBELS, TABLE_2
from linkwise.paper.subset import PaperStudy
from linkwise.study.cells import Cell, StudyTable
from linkwise.study.row import Row

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
    def of(cls, table: StudyTable, paper: PaperStudy) -> Table2:
        """The cells of Table 2 that the study asks for."""
        cells = []
        for decibel in DECIBELS:
            for name, masses in paper.masses.items():
                study_cells = {
                    method: cell
                    for method in table.methods
                    if (cell := table.cell(name, decibel, method)) is not None
                }
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
        return min(
            methods,
            key=lambda method: (-self.within(method), self.typical_factor(method) or np.inf),
            default=None,
        )


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
    deviation = (
        f"{1.0 / ratio:.3g} times below the paper" if ratio < 1.0 else f"{ratio:.3g} times above the paper"
    )
    readings = {name: count(study_cell.answers) for name, count in _COUNTED.items()}
    readings |= {candidate: cell.nmse(candidate) for candidate in classical if candidate != method}
    fitting = [f"{name} ({_percent(value)})" for name, value in readings.items() if near(value, cell.paper)]
    share = study_cell.share_above(cell.paper)
    single = f"{100.0 * share:.0f} % of single cycles lie above the paper's value"
    if fitting:
        return f"{deviation}; {single}; within a factor {NEAR:g} would be {', '.join(fitting)}"
    known = {name: value for name, value in readings.items() if value}
    closest = min(known, key=lambda name: abs(np.log(known[name] / cell.paper)), default=None)
    closest_text = "" if closest is None else f", the closest being {closest} ({_percent(known[closest])})"
    return (
        f"{deviation}; {single}; no mean, no other choice of sink and no other convention comes within a factor {NEAR:g}"
        f"{closest_text}"
    )


def _median_of(pick: Callable[[Row], float | None]) -> Callable[[Sequence[Row]], float | None]:
    """The median over rows of what `pick` takes from one."""

    def count(rows: Sequence[Row]) -> float | None:
        picked = [value for row in rows if (value := pick(row)) is not None]
        return float(np.median(picked)) if picked else None

    return count


def _mean(rows: Sequence[Row]) -> float | None:
    return float(np.mean([row.nmse for row in rows if row.nmse is not None])) if rows else None


_COUNTED: Mapping[str, Callable[[Sequence[Row]], float | None]] = {
    "the mean over cycles": _mean,
    "the first sink alone": _median_of(lambda row: next(iter(row.links.values()), None)),
    "the last sink alone": _median_of(lambda row: next(reversed(list(row.links.values())), None)),
    "the worst sink": _median_of(lambda row: row.worst),
    "the best sink": _median_of(lambda row: min(row.links.values(), default=None)),
}


def _percent(value: float | None) -> str:
    return "no number" if value is None else f"{value:.3g} %"
