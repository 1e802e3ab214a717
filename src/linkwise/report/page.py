"""The page of a result: its head, sections in order, and lengths in the units that figures have.

Templates escape what they print and miss nothing silently.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from linkwise import __version__
from linkwise.export.templates import filled
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.registry import lazy_module
from linkwise.report.folder import R, Reported, ResultFolder, Section, write_graded
from linkwise.verdict import Basis

if TYPE_CHECKING:
    from linkwise.plot import style
else:  # who wants the numbers alone does not wait for it
    style = lazy_module("linkwise.plot.style")


def rendered(template: str, **parts: Any) -> str:
    """The page that a template makes of its parts, with the version."""
    return filled("report", template, version=__version__, **parts)


@dataclass(frozen=True)
class Head:
    """What stands above the sections of a page.

    The first line of `verdict` is its headline, `findings` is what the result does not determine. The title is the name of
    the structure unless it is given.
    """

    verdict: Sequence[str]
    structure: Structure | None = None
    findings: Sequence[str] = ()
    title: str = ""
    basis: Basis | None = None


def in_units_of_figures(
    rows: Sequence[Sequence[str]], columns: slice, *, alike: bool = False
) -> list[tuple[str, ...]]:
    """`rows` that end in an SI unit, with the numbers of `columns` in the unit that a figure of them has, as mm: that of the
    row, or, where they are `alike`, of all with its unit.
    """
    numbers = [[float(cell) if cell else None for cell in row[columns]] for row in rows]
    own = [max((abs(number) for number in some if number), default=0.0) for some in numbers]
    scaled = []
    for (*cells, unit), some, largest in zip(rows, numbers, own, strict=True):
        if alike:
            largest = max(size for size, row in zip(own, rows, strict=True) if row[-1] == unit)
        factor, shown = style.scale(largest, unit)
        cells[columns] = ["" if number is None else f"{factor * number:.4g}" for number in some]
        scaled.append((*cells, shown or unit))
    return scaled


_NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_SMALL = 0.01  # of the largest length of a column: what is smaller would begin with zeros in its unit
_LENGTHS = re.compile(rf"(?<![\w.=^])({_NUMBER}(?:(?:, | to | and | ± | … ){_NUMBER})*) (m/s|m)(?![\w/^])")


def lengths_as_in_figures(texts: Sequence[str], *, alike: bool = False) -> list[str]:
    """Texts with the lengths and velocities in them in the unit that figures of them have: 2.98 mm for 0.00298 m. What is far
    smaller than others has a unit of its own, unless all units must be `alike`.
    """
    sizes: dict[str, float] = {}
    for match in (match for text in texts for match in _LENGTHS.finditer(text)):
        sizes[match[2]] = max(sizes.get(match[2], 0.0), _largest(match))

    def shown(match: re.Match[str]) -> str:
        largest = _largest(match)
        small = not alike and 0.0 < largest < _SMALL * sizes[match[2]]
        factor, unit = style.scale(largest if small else sizes[match[2]], match[2])
        return f"{re.sub(_NUMBER, lambda number: _times(factor, number[0]), match[1])} {unit}"

    return [_LENGTHS.sub(shown, text) for text in texts]


def _largest(match: re.Match[str]) -> float:
    """The largest modulus of the numbers of a match of `_LENGTHS`."""
    return max(abs(float(number)) for number in re.findall(_NUMBER, match[1]))


def _times(factor: float, number: str) -> str:
    """A number by a factor, with its digits."""
    digits = len(number.partition("e")[0].replace(".", "").lstrip("-0")) or 1
    return f"{factor * float(number):.{max(digits, 3)}g}"


def _table_as_in_figures(rows: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """A table with its lengths and velocities, by column, in the unit that figures of them have."""
    columns = []
    for title, *cells in zip(*rows, strict=True):
        name, comma, unit = title.rpartition(", ")
        if comma and unit in ("m", "m/s"):
            scaled = lengths_as_in_figures([f"{cell} {unit}" for cell in cells], alike=True)
            cells = [cell.rpartition(" ")[0] for cell in scaled]
            units = (one.rpartition(" ")[2] for one in scaled if any(map(str.isdigit, one)))
            title = f"{name}, {next(units, unit)}"
        columns.append([title, *lengths_as_in_figures(cells)])
    return list(zip(*columns, strict=True))


def sectioned(
    mark: str,
    head: Callable[[R], Head],
    sections: Callable[[R], Mapping[str, Section]],
    following: Sequence[str],
    data: Callable[[R, Path], None] = lambda result, folder: None,
) -> ResultFolder[R]:
    """The folder of a result whose page is its head and its sections, HTML that carries everything in itself; `following` is
    what to do next, the last for a result that is not trusted.
    """

    def page(reported: Reported[R], sections: Mapping[str, Section], pictures: Mapping[str, Markup]) -> str:
        result: Any = reported.result
        shown = head(result)
        verdict, findings = map(lengths_as_in_figures, (shown.verdict, shown.findings))
        shown = replace(shown, verdict=verdict, findings=findings)
        tables = {name: _table_as_in_figures(section.rows) for name, section in sections.items()}
        return rendered(
            "section_page.html.jinja",
            title=shown.title or (shown.structure and shown.structure.name) or "structure",
            head=shown,
            grade=result.grade.value,
            basis=result.basis.remark,
            following=following[0 if result.trusted else -1],
            sections={name: replace(section, rows=tables[name]) for name, section in sections.items()},
            pictures=pictures,
            structure="" if shown.structure is None else format_structure(shown.structure),
        )

    def written(reported: Reported[R], folder: Path) -> None:
        result: Any = reported.result
        shown = head(result)
        if shown.structure is not None:
            write_graded(shown.structure, shown.basis or result.basis, folder)
        data(result, folder)

    return ResultFolder(data=written, sections=lambda one: sections(one.result), page=page, mark=mark)
