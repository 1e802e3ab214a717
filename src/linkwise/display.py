"""Results as text and in notebooks: formatted numbers, aligned columns, and how results describe themselves."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from html import escape
from math import floor, isfinite, log10
from pathlib import Path
from pkgutil import resolve_name
from textwrap import fill
from typing import TYPE_CHECKING, Any

from linkwise.verdict import UNGRADED, Basis, Grade, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKED = (*"=+-@＝＋－＠\t\r\n'",)  # with which a formula may begin, and the apostrophe itself
_FAR_FROM_NOISE = 1e4  # chi-square from which its decimals say nothing
_WIDTH = 100  # at which sentences are wrapped
_LONGEST_NAME = 50  # characters: MATLAB takes 63, and prefixes are added
LONGEST = 2000  # characters of a message: what a screen shows beside what was typed


def shortened(message: str) -> str:
    """`message` with its middle left out where it is longer than `LONGEST`: what quotes a file may quote all of it."""
    if len(message) <= LONGEST:
        return message
    half = LONGEST // 2
    left_out = len(message) - 2 * half
    return f"{message[:half]} [... {left_out} characters ...] {message[-half:]}"


def paragraph(text: str, indent: str = "") -> str:
    """A text in lines that a terminal shows whole; a path or a name is never broken.

    >>> paragraph("written to " + 99 * "a").split()[-1] == 99 * "a"
    True
    """
    return fill(text, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def remark_lines(remark: str) -> str:
    """What a reader must not miss, as a paragraph with a mark in front."""
    return paragraph(f"! {remark}", indent="  ")


def on_one_line(text: str) -> str:
    """`text` with a space for every character that ends a line somewhere, or that nobody sees.

    >>> on_one_line("κ 1\\n\\u2028\\0")
    'κ 1   '
    """
    return "".join(letter if letter.isprintable() else " " for letter in text)


def csv_cell(value: object) -> object:
    """`value` for a cell of a CSV file: a text that a spreadsheet would run as a formula gets an apostrophe in front.

    >>> [csv_cell(value) for value in ("nes1", "=1+1", "'quoted", -2.5)]
    ['nes1', "'=1+1", "''quoted", -2.5]
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(_MARKED) else value


def to_csv(
    path: Path, rows: Iterable[Iterable[object]], *, numbers: str = "", encoding: str = "utf-8"
) -> None:
    """Write rows of cells as a CSV file, each as `csv_cell` has it, none for None; numbers in the format of that name."""

    def written(value: object) -> object:
        return f"{value:{numbers}}" if numbers and isinstance(value, float) else csv_cell(value)

    with path.open("w", encoding=encoding, newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(map(written, row) for row in rows)


def from_csv_cell(cell: str) -> str:
    """The text that `csv_cell` has written."""
    return cell[1:] if cell.startswith("'") else cell


def format_value(value: float, error: float | None = None) -> str:
    """`value` rounded to two significant digits of its standard `error`, or to six digits without one."""
    if not isfinite(value):
        return str(value)
    if error is None or not error > 0.0 or not isfinite(error):
        return f"{value:.6g}"
    last = floor(log10(error)) - 1
    if last >= 0 and abs(value) < 1e7:
        return f"{value:.0f}"
    if -7 <= last < 0 and (abs(value) >= 1e-3 or value == 0.0):
        return f"{value:.{-last}f}"
    digits = floor(log10(abs(value))) - last if value else 0
    return f"{value:.{max(digits, 1)}e}"


def format_error(value: float) -> str:
    """A standard error rounded to two significant digits."""
    if not 1e-4 <= value < 1e7:
        return f"{value:.1e}"
    last = floor(log10(value)) - 1
    return f"{value:.{-last}f}" if last < 0 else f"{round(value / 10.0**last) * 10.0**last:.0f}"


def format_both(value: float, error: float) -> tuple[str, str]:
    """A value to the digits that its standard error gives, and the error."""
    return format_value(value, error), format_error(error)


def format_percent(part: float) -> str:
    """A part of a whole in per cent: two digits, or whole per cents where it has more.

    >>> [format_percent(part) for part in (0.00123, 0.0456, 1.07, -2.0)]
    ['0.12 %', '4.6 %', '107 %', '-200 %']
    """
    return f"{100.0 * part:.0f} %" if abs(part) >= 0.1 else f"{100.0 * part:.2g} %"


def format_chi_square(value: float) -> str:
    """Chi-square per degree of freedom with three decimals, or with three digits where laws leave far more than noise."""
    return f"{value:.3f}" if value < _FAR_FROM_NOISE else f"{value:.3g}"


def format_duration(seconds: float) -> str:
    """A time that something took, or takes, as people say it.

    >>> [format_duration(seconds) for seconds in (0.0123, 9.96, 75.4, 110.0, 4000.0)]
    ['0.012 s', '10 s', '75 s', '1 min 50 s', '1 h 7 min']
    """
    if seconds < 9.95:
        return f"{seconds:.2g} s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if seconds < 3599.5:
        minutes, rest = divmod(round(seconds), 60)
        return f"{minutes} min {rest} s"
    hours, rest = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {rest} min"


def align_columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """One line per row, cells padded to columns: the first and last flush left, the others flush right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        cells[0], cells[-1] = row[0].ljust(widths[0]), row[-1]
        lines.append(("  " + "  ".join(cells)).rstrip())
    return lines


def table(
    rows: Sequence[tuple[str, ...]], title: str = "", *, most: int | None = None, more: str = "more"
) -> list[str]:
    """The lines of a head and `rows` below it, at most so many, under a title; none where there are no rows."""
    if len(rows) < 2:
        return []
    shown = rows if most is None else rows[: 1 + most]
    hidden = [f"  ... and {len(rows) - len(shown)} {more}"] if len(shown) < len(rows) else []
    return [*filter(None, [title]), *align_columns(shown), *hidden]


def text_of(*blocks: Iterable[str]) -> str:
    """Blocks of lines, an empty line between them; blocks without lines are left out."""
    return "\n\n".join(filter(None, map("\n".join, blocks)))


def listed(names: Sequence[str]) -> str:
    """Names in a line; of more than six the first four and the last."""
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])}, ..., {names[-1]}"


def enumerated(names: Sequence[str]) -> str:
    """Names in a sentence, the last after "and"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def near_miss(typed: str, names: Iterable[str]) -> str:
    """'; did you mean "x"?' for the first name of the owner `typed`, as "m2.mass" of m2, or the closest one; else empty."""
    known = list(names)
    near = [name for name in known if name.startswith(f"{typed}.")] or get_close_matches(typed, known, n=1)
    return f'; did you mean "{near[0]}"?' if near and near[0] != typed else ""


def identifiers(names: Iterable[str], reserved: Iterable[str]) -> dict[str, str]:
    """A name of ASCII letters, digits and underscores for each, no two alike and none of those `reserved`."""
    used, chosen = set(reserved), {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name).lstrip("_")[:_LONGEST_NAME] or "unnamed"
        plain = f"n{plain}" if plain[0].isdigit() else plain
        unique, number = plain, 1
        while unique in used:
            number += 1
            unique = f"{plain}_{number}"
        used.add(unique)
        chosen[name] = unique
    return chosen


_GOOD, _BAD, _NEUTRAL = "#1a7f37", "#b42318", "#57606a"


class NotebookView:
    """A result that a notebook shows as HTML rather than as its `repr`.

    >>> import linkwise as lw
    >>> "2 masses, 2 links" in lw.bnes_chain(2)._repr_html_()
    True
    """

    def _repr_html_(self) -> str:
        return text_html(str(self))

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"


FIGURES = {
    "Absorption": "linkwise.plot.absorptions:decay_figure",
    "AbsorptionIntervals": "linkwise.plot.absorptions:decay_figure",
    "AbsorptionMap": "linkwise.plot.absorptions:map_figure",
    "Backbone": "linkwise.plot.responses:backbone_figure",
    "Basins": "linkwise.plot.responses:basins_figure",
    "Comparison": "linkwise.plot.links:comparison_figure",
    "Design": "linkwise.plot.absorptions:designs_figure",
    "Discovery": "linkwise.plot.discoveries:evidence_figure",
    "Estimate": "linkwise.plot.links:forces_figure",
    "Inspection": "linkwise.plot.records:spectra_figure",
    "LevelComparison": "linkwise.plot.levels:levels_figure",
    "Response": "linkwise.plot.responses:response_figure",
    "Validation": "linkwise.plot.validations:prediction_figure",
}
"""What draws a result by its type, loaded when it is drawn: results do not know figures."""


class JudgedView(NotebookView):
    """The same for an answer: a result with `verdicts`, which say whether it can be trusted, as far as its `basis` can."""

    basis: Basis = UNGRADED

    if TYPE_CHECKING:  # a field or a property of the answer

        @property
        def verdicts(self) -> tuple[Verdict, ...]:
            """What can be said of the answer, the most important first."""

    def _repr_html_(self) -> str:
        return text_html(str(self), self.trusted)

    @property
    def trusted(self) -> bool:
        """Whether only noise is left, and nothing speaks against the answer."""
        return self.grade is Grade.EXPLAINED

    @property
    def grade(self) -> Grade:
        """How far the answer goes, on which exit codes depend."""
        return Grade.worst((self.basis.grade, *(verdict.grade for verdict in self.verdicts)))

    def plot(self) -> Figure:
        """Draw the figure that says most of the result; `linkwise.plot` has further ones, and axes of one's own.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, which a notebook shows and `savefig` writes.

        Raises
        ------
        TypeError
            If the result is a table alone.

        Examples
        --------
        >>> import linkwise as lw
        >>> curve = lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3)
        >>> len(curve.plot().axes)
        3
        """
        kind = type(self).__name__
        if kind not in FIGURES:
            raise TypeError(f"{kind} has no figure of its own: print it, or see linkwise.plot")
        figure: Figure = resolve_name(FIGURES[kind])(self)
        return figure

    def _judgement(self) -> dict[str, Any]:
        """The part of `to_dict` that all answers share."""
        verdicts = [verdict.name for verdict in self.verdicts]
        of_basis = {"basis": self.basis.remark} if self.basis.remark else {}
        return {"verdicts": verdicts, "trusted": self.trusted, "grade": self.grade.value, **of_basis}


def text_html(text: str, trusted: bool | None = None) -> str:
    """`text` as a self-contained `div` of HTML, which needs neither scripts nor style sheets and escapes every character, with
    its first line as the heading: green where it can be trusted, red where not, grey without a claim.
    """
    colour = _NEUTRAL if trusted is None else _GOOD if trusted else _BAD
    first, _, rest = text.partition("\n")
    body = f'<pre style="margin: 0.4em 0 0 0">{escape(rest)}</pre>' if rest else ""
    return (
        f'<div style="border-left: 4px solid {colour}; padding: 0.3em 0.8em; overflow-x: auto">'
        f"<strong>{escape(first)}</strong>{body}</div>"
    )
