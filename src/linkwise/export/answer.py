"""Answers for other programs: what is exported of one, in the format of the suffix of the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import OutputError, expect
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Posterior
from linkwise.identification.validated_answer import answer_in_numbers
from linkwise.model.structure import Structure
from linkwise.output import atomic_file
from linkwise.templates import filled
from linkwise.verdict import UNGRADED, Basis


@dataclass(frozen=True)
class ExportedCoefficient:
    """A coefficient or a mass as other programs get it; `error` is None where it is known or has no interval."""

    owner: str
    name: str
    value: float
    unit: str
    error: float | None

    @property
    def full_name(self) -> str:
        """As `Name` writes it."""
        return f"{self.owner}.{self.name}"


@dataclass(frozen=True, eq=False)
class ExportedAnswer:
    """A structure of numbers, with the covariance (p, p) of those coefficients that were identified, by `names`.

    `note` is what there is to know of it, of which the remark of its `basis` says that it is not explained.
    """

    structure: Structure
    names: tuple[str, ...]
    covariance: Floats
    note: str
    version: str
    basis: Basis = UNGRADED

    @classmethod
    def of(cls, answer: Structure | Estimate | Posterior | str | Path) -> ExportedAnswer:
        """What an answer in any of its forms says; StructureError where a coefficient has no value."""
        given = answer_in_numbers(answer)
        names: tuple[str, ...] = ()
        covariance = np.zeros((0, 0))
        notes = [given.basis.remark] if given.basis.remark else []
        if given.posterior is not None:
            names, covariance = given.posterior.names, given.posterior.covariance
        else:
            notes.append("It has no standard errors, since the answer gives none.")
        if any(host.damping for host in given.structure.hosts):
            notes.append("An end HOST.-modeN moves as minus mode N of the host: damping between modes.")
        if turning := ", ".join(given.structure.rotations):
            what = "masses there are moments of inertia in kg m^2, and links moments in N m"
            notes.append(f"Rotations in rad: {turning}; {what}.")
        return cls(given.structure, names, covariance, " ".join(notes), version("linkwise"), given.basis)

    @property
    def quantities(self) -> dict[str, str]:
        """SI units of forces, elongations and rates of the links, both where some of them are moments."""
        angular = sorted({link.law.angular for link in self.structure.links}) or [False]
        units = {True: ("N m", "rad", "rad/s"), False: ("N", "m", "m/s")}
        joined = (" or ".join(names) for names in zip(*(units[turns] for turns in angular), strict=True))
        return dict(zip(("force", "d", "v"), joined, strict=True))

    @property
    def shapes(self) -> Floats:
        """(P, n) how the points of hosts move by the masses and modes of the structure, in 1/sqrt(kg), or rad/(m sqrt(kg))."""
        structure = self.structure
        rows = [structure.topology.row(point) for point in structure.points]
        return np.array(rows).reshape(len(rows), structure.size)

    @property
    def points(self) -> dict[str, dict[str, float]]:
        """For each point of a host the shapes of its modes there."""
        modes = self.structure.mass_names
        shapes = [dict(zip(modes, row, strict=True)) for row in self.shapes.tolist()]
        moving = [{mode: part for mode, part in shape.items() if part} for shape in shapes]
        return dict(zip(self.structure.points, moving, strict=True))

    @property
    def coefficients(self) -> tuple[ExportedCoefficient, ...]:
        """All coefficients and masses, link by link."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        errors = dict(zip(self.names, deviations.tolist(), strict=True))
        rows = [(mass.name, "mass", mass.mass.value, mass.mass_unit) for mass in self.structure.masses]
        for link in self.structure.links:
            rows += [(link.name, name, value, link.law.units[name]) for name, value in link.values.items()]
        return tuple(
            ExportedCoefficient(owner, name, value, unit, errors.get(f"{owner}.{name}"))
            for owner, name, value, unit in rows
            if value is not None
        )


def export_answer(answer: Structure | Estimate | Posterior | str | Path, path: str | Path) -> Path:
    """Write an answer for another program: the forces of its links, and its coefficients with errors and covariance.

    Parameters
    ----------
    answer : Structure, Estimate, Posterior, str or Path
        What `identify` or the `estimate` of what `discover` returned, the folder that was written of it, or a structure of
        numbers or its file.
    path : str or Path
        The file, in the format of its suffix: ``.py``, a module for NumPy with a function for the force of each link;
        ``.m``, a function for MATLAB and Octave; ``.mat``, the numbers for MATLAB; ``.csv`` or ``.xlsx``, a table for
        spreadsheets.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StructureError
        If a coefficient has no value.
    OutputError
        If the suffix is another one, the name of the file is not one that its language takes, or the file cannot be written.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = lw.export_answer(lw.bnes_chain(2), f"{folder}/chain.py")
    ...     [line for line in path.read_text().splitlines() if line.startswith("def ")]
    ['def force_spring1(d, v, *, k=30000.0, c=1.0):', 'def force_nes1(d, v, *, alpha=-100.0, beta=1000000.0, c=0.02):']
    """
    return written(answer, path, EXPORTS, "answer", lambda content: content)


def written(
    answer: Structure | Estimate | Posterior | str | Path,
    path: str | Path,
    formats: Mapping[str, ExportFormat],
    what: Literal["answer", "equations"],
    content: Callable[[ExportedAnswer], object],
) -> Path:
    """Write what `content` makes of an answer to a file, in the format of its suffix, for the function ``export_WHAT``."""
    expect(f"export_{what}(answer, path): answer", answer, Structure, Estimate, Posterior, str, Path)
    expect(f"export_{what}(answer, path): path", path, str, Path)
    path = Path(path)
    write = format_writer(path, formats, "answers" if what == "answer" else what)
    exported = content(ExportedAnswer.of(answer))
    with atomic_file(path) as partial:
        write(exported, partial, path.stem)
    return path


def format_writer(path: Path, formats: Mapping[str, ExportFormat], what: str) -> Callable[..., None]:
    """The function that writes files of this suffix, given the content, a path and a name; OutputError if there is none."""
    suffix = path.suffix.lower()
    if suffix not in formats:
        kind, choices = path.suffix or "a file without suffix", ", ".join(formats)
        raise OutputError(f"{path}: {what} cannot be exported to {kind}; choose from {choices}")
    write: Callable[..., None] = resolve_name(formats[suffix].writer)
    return write


@dataclass(frozen=True)
class ExportFormat:
    """What a file of this format is, and `writer`, "module:function", which writes it.

    That function takes an `ExportedAnswer`, a path, and the name that the file will have, without its suffix.
    """

    title: str
    writer: str


EXPORTS = {
    ".py": ExportFormat(
        "a Python module: the force of each link as a function of arrays, with coefficients, errors and covariance",
        "linkwise.export.python:write",
    ),
    ".m": ExportFormat("the same as a function for MATLAB and Octave", "linkwise.export.matlab:write_m"),
    ".mat": ExportFormat("the numbers and laws as variables for MATLAB", "linkwise.export.matlab:write_mat"),
    ".csv": ExportFormat(
        "a table of the coefficients with units, errors and intervals",
        "linkwise.export.spreadsheet:write_csv",
    ),
    ".xlsx": ExportFormat("the same table, and the covariance", "linkwise.export.spreadsheet:write_xlsx"),
}


def listed_formats(formats: Mapping[str, ExportFormat]) -> list[str]:
    """A line for each format: its suffix, and what a file of it is."""
    width = max(map(len, formats))
    return [f"{suffix:{width}}  {entry.title}" for suffix, entry in formats.items()]


def rendered(template: str, **parts: Any) -> str:
    """The file in another language that a template makes of its parts."""
    text = filled("export", template, **parts)
    return text if text.endswith("\n") else f"{text}\n"
