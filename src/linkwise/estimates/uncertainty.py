"""An identified structure and how well it is known: what draws of it are made from, in memory and in a result folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkwise.arrays import Floats
from linkwise.atomic import RESULT
from linkwise.errors import IdentificationError, RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.model.toml_file import read_structure
from linkwise.text import csv_cell, from_csv_cell

COVARIANCE = "covariance.csv"
_HEADER = ("first", "second", "covariance")
_TRIES = 200  # draws for one that bounds allow


@dataclass(frozen=True, eq=False)
class Posterior:
    """A `structure` of numbers, of which those named `names` (p,) are uncertain with `covariance` (p, p).

    Coefficients that are one unknown are named each, and vary together. `lower`, `upper` (p,) bound them.
    """

    structure: Structure
    names: tuple[str, ...]
    covariance: Floats
    lower: Floats
    upper: Floats

    @classmethod
    def of(cls, estimate: Estimate) -> Posterior:
        """What an estimate knows. Raises IdentificationError for one whose intervals are not to be trusted."""
        if not (estimate.trusted and estimate.intervals):
            why = estimate.status if not estimate.trusted else f"{estimate.method} tells no intervals"
            raise IdentificationError(
                f"this answer has no covariance to draw from ({why}); identify again until the answer can be trusted, or take "
                "its structure as it is"
            )
        dense = estimate.covariance
        covariance = dense if isinstance(dense, np.ndarray) else dense.toarray()
        members = [
            (number, _name(estimate.structure, place))
            for number, (parameter, free) in enumerate(zip(estimate.parameters, estimate.free, strict=True))
            if free
            for place in parameter.members
        ]
        which = np.array([number for number, _ in members], dtype=int)
        return cls(
            estimate.structure,
            tuple(name for _, name in members),
            np.ascontiguousarray(covariance[np.ix_(which, which)]),
            np.array([estimate.parameters[number].lower for number in which]),
            np.array([estimate.parameters[number].upper for number in which]),
        )

    @property
    def values(self) -> Floats:
        """(p,) the identified numbers."""
        return np.array([self.structure.coefficient(name).value for name in self.names], dtype=float)

    def draws(self, count: int, seed: int) -> Floats:
        """(count, p) normal draws within the bounds. Raises IdentificationError where bounds leave hardly any."""
        scale = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        unit = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self.covariance / np.outer(unit, unit))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        rng = np.random.default_rng(seed)
        drawn, kept = np.empty((0, len(self.names))), 0
        for _ in range(_TRIES):
            tried = self.values + (rng.standard_normal((count, len(self.names))) @ root.T) * unit
            drawn = np.vstack([drawn, tried[np.all((tried >= self.lower) & (tried <= self.upper), axis=1)]])
            kept = len(drawn)
            if kept >= count:
                return drawn[:count]
        raise IdentificationError(
            f"of {_TRIES * count} draws only {kept} lie within the bounds of the coefficients: the answer is too uncertain to "
            "tell what follows from it; measure longer, or with less noise"
        )


def write_covariance(knowledge: Posterior, path: Path) -> None:
    """The covariance as a CSV file of its upper triangle, zeros left out: two names and a number in each line."""
    first, second = np.nonzero(np.triu(knowledge.covariance))
    with path.open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(_HEADER)
        for i, j in zip(first.tolist(), second.tolist(), strict=True):
            names = (csv_cell(knowledge.names[k]) for k in (i, j))
            lines.writerow((*names, repr(float(knowledge.covariance[i, j]))))


def read_posterior(folder: str | Path) -> Posterior:
    """What a result folder of `identify` knows.

    Raises StructureError for a structure that cannot be read, RecordError for a folder without a covariance or with one that
    does not fit, naming file and line.
    """
    folder = Path(folder)
    structure = read_structure(folder / "structure.toml")
    path = folder / COVARIANCE
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file))
    except OSError:
        raise RecordError(_missing(folder), path) from None
    entries = [_entry(path, number, line) for number, line in enumerate(lines[1:], start=2)]
    names = tuple(dict.fromkeys(first for first, _, _ in entries))
    index = {name: number for number, name in enumerate(names)}
    covariance = np.zeros((len(names), len(names)))
    for number, (first, second, value) in enumerate(entries, start=2):
        if second not in index:
            raise RecordError(f'"{second}" has no variance of its own', path, number)
        covariance[index[first], index[second]] = covariance[index[second], index[first]] = value
    for name in names:
        structure.coefficient(name)
    return Posterior(structure, names, covariance, *_bounds(names))


def _bounds(names: Sequence[str]) -> tuple[Floats, Floats]:
    """A folder tells no bounds but those of nature: masses are positive."""
    lower = np.array([np.finfo(float).tiny if name.endswith(".mass") else -np.inf for name in names])
    return lower, np.full(len(names), np.inf)


def _entry(path: Path, number: int, line: list[str]) -> tuple[str, str, float]:
    try:
        first, second, value = line
        return from_csv_cell(first), from_csv_cell(second), float(value)
    except ValueError:
        text = ",".join(line)
        raise RecordError(
            f"{text!r} is not two coefficients and a number ({','.join(_HEADER)})", path, number
        ) from None


def _missing(folder: Path) -> str:
    """Why there is no covariance in a folder, and what to do."""
    status = ""
    try:
        result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        status = str(result["status"])
    except (OSError, ValueError, KeyError, TypeError):
        return "there is no such file, and no answer of identify either; give a structure file or a folder that identify wrote"
    if status != "converged":
        return (
            f"there is no covariance, since the answer is not to be trusted ({status}); identify again, or give its "
            "structure.toml"
        )
    return (
        "there is no covariance in this answer; identify again with this version, or give its structure.toml"
    )


def _name(structure: Structure, place: tuple[int, str]) -> str:
    index, key = place
    owner = structure.links[index] if index >= 0 else structure.masses[-1 - index]
    return f"{owner.name}.{key}"
