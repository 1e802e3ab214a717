"""Lengths and velocities of tables and texts of a page in the units that its figures have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.plot import style
else:  # who wants the numbers alone does not wait for it
    style = lazy_module("linkwise.plot.style")


def in_units_of_figures(
    rows: Sequence[Sequence[str]], columns: slice, *, alike: bool = False
) -> list[tuple[str, ...]]:
    """`rows` that end in an SI unit, with the numbers of `columns` in the unit that a figure of them has, as mm: that of the
    row, or, where they are `alike`, of all with its unit.
    """
    sizes = [max((abs(float(cell)) for cell in row[columns] if cell), default=0.0) for row in rows]
    largest: dict[str, float] = {}
    for row, size in zip(rows, sizes, strict=True):
        largest[row[-1]] = max(size, largest.get(row[-1], 0.0))
    scaled = []
    for (*cells, unit), size in zip(rows, sizes, strict=True):
        factor, shown = style.scale(largest[unit] if alike else size, unit)
        cells[columns] = [f"{factor * float(cell):.4g}" if cell else "" for cell in cells[columns]]
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


def table_as_in_figures(rows: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
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
