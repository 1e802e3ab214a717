"""Uncertainty of an identified structure: a normal distribution of its coefficients, in memory and in a result folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import from_csv_cell, listed, to_csv
from linkwise.errors import IdentificationError, RecordError, StructureError
from linkwise.estimates.causes import Cause, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.model.coefficient import MASS, Name
from linkwise.model.structure import Structure
from linkwise.model.structure_file import read_structure
from linkwise.output import RESULT, answer_folder
from linkwise.verdict import STATUSES, UNGRADED, Basis, Grade, Verdict

COVARIANCE = "covariance.csv"
_HEADER = ("first", "second", "covariance")
_FOR_DROPPED_TERMS = "for_dropped_terms"
_NAMED = 3  # edits that a message names
_TRIES = 200  # draws at most for each that is within the bounds


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """An identified structure with a normal distribution of its p unknown coefficients.

    A coefficient shared by several links is listed under each name, with full correlation.

    Attributes
    ----------
    structure : Structure
        The identified structure, all coefficients numbers.
    names : tuple of Name
        Full names of the p uncertain coefficients.
    covariance : array of shape (p, p)
        Their covariance.
    lower, upper : array of shape (p,)
        Their bounds.
    for_dropped_terms : array of shape (p, p) or None
        The part of the covariance that allows for terms that a discovery dropped or a diagnosis names.
    basis : Basis
        The grade of the answer.

    See Also
    --------
    read_posterior : Read one from a result folder.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> posterior = lw.estimates.Posterior.of(lw.identify(record, chain.unknown("nes"), method="weak"))
    >>> posterior.names
    ('nes1.alpha', 'nes1.beta', 'nes1.c')
    >>> posterior.draws(100, seed=1).shape
    (100, 3)
    """

    structure: Structure
    names: tuple[Name, ...]
    covariance: Floats
    lower: Floats
    upper: Floats
    for_dropped_terms: Floats | None = None
    basis: Basis = UNGRADED

    @classmethod
    def of(cls, estimate: Estimate) -> Posterior:
        """Distribution of the coefficients of an estimate.

        Parameters
        ----------
        estimate : Estimate
            A trusted estimate with intervals.

        Returns
        -------
        Posterior
            The distribution; parameters at a bound are taken as known.

        Raises
        ------
        IdentificationError
            If the estimate is not trusted or its method gives no intervals.
        """
        if estimate.without_intervals:
            raise IdentificationError(
                f"this estimate has no covariance to draw from ({estimate.without_intervals}); identify again until the "
                "estimate can be trusted, or use its structure without uncertainty"
            )
        free = np.flatnonzero(estimate.free).tolist()
        members = [(number, slot) for number in free for slot in estimate.parameters[number].members]
        which = np.array([number for number, _ in members], dtype=int)
        structure = estimate.structure
        owners = [*(link.name for link in structure.links), *structure.mass_names[::-1]]
        dropped = estimate.for_dropped_terms
        return cls(
            structure,
            tuple(Name(owners[index], key) for _, (index, key) in members),
            np.ascontiguousarray(estimate.covariance[np.ix_(which, which)]),
            np.array([estimate.parameters[number].lower for number in which]),
            np.array([estimate.parameters[number].upper for number in which]),
            None if dropped is None else dropped[np.ix_(which, which)],
            Basis(estimate.grade, estimate.status),
        )

    def __repr__(self) -> str:
        return f"<Posterior of {len(self.names)} coefficients: {listed(self.names)}>"

    @property
    def beside_terms_kept(self) -> Floats:
        """(p, p) the covariance for a prediction by the terms of the structure alone.

        The coefficients may be farther off than this, but only together with terms dropped or missing that make up for it
        in the motions of the record.
        """
        return self.covariance if self.for_dropped_terms is None else self.covariance - self.for_dropped_terms

    @property
    def values(self) -> Floats:
        """(p,) the identified values in SI units."""
        return np.array([self.structure.coefficient(name).value for name in self.names], dtype=float)

    def draws(self, count: int, seed: int) -> Floats:
        """Draw coefficients.

        Parameters
        ----------
        count : int
            Number of draws.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        array of shape (count, p)
            Normal draws within the bounds, in SI units.

        Raises
        ------
        IdentificationError
            If fewer than one draw in 200 is within the bounds, or `count` or `seed` is negative.
        """
        if count < 0 or seed < 0:
            raise IdentificationError(f"count and seed must not be negative, got {count} and {seed}")
        root = covariance_root(self.covariance)
        rng = np.random.default_rng(seed)
        accepted = np.empty((0, len(self.names)))
        for _ in range(_TRIES):
            proposed = self.values + rng.standard_normal((count, len(self.names))) @ root.T
            inside = np.all((proposed >= self.lower) & (proposed <= self.upper), axis=1)
            accepted = np.vstack([accepted, proposed[inside]])
            if len(accepted) >= count:
                return accepted[:count]
        raise IdentificationError(
            f"of {_TRIES * count} draws only {len(accepted)} lie within the bounds of the coefficients: the estimate is too "
            "uncertain for draws; use a longer record, or one with less noise"
        )

    def mirrored_draws(self, count: int, seed: int) -> Floats:
        """Draw coefficients in pairs on either side of the identified values, for bands.

        Where pairs are twice as many as coefficients, they have exactly the covariance, so that the deviation of whatever
        follows linearly from the coefficients has no error of sampling.

        Parameters
        ----------
        count : int
            Number of draws.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        array of shape (count, p)
            Normal draws, moved into the bounds, in SI units.
        """
        width = len(self.names)
        pairs = np.random.default_rng(seed).standard_normal(((count + 1) // 2, width))
        if len(pairs) >= 2 * width:
            pairs = np.linalg.solve(np.linalg.cholesky(pairs.T @ pairs / len(pairs)), pairs.T).T
        moved = pairs @ covariance_root(self.covariance).T
        drawn = self.values + np.stack([moved, -moved], axis=1).reshape(-1, width)[:count]
        return np.clip(drawn, self.lower, self.upper)

    def to_dict(self, draws: int = 1000, *, seed: int = 0) -> dict[str, Floats]:
        """Draws as packages for posteriors take them, as in ``arviz.from_dict({"posterior": posterior.to_dict()})``.

        Parameters
        ----------
        draws : int
            Number of draws.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        dict of str to array of shape (1, draws)
            A single chain of each coefficient, by its full name, in SI units.

        Raises
        ------
        IdentificationError
            As of `draws`.
        """
        drawn = self.draws(draws, seed)
        return {str(name): drawn[None, :, number] for number, name in enumerate(self.names)}


def covariance_root(covariance: Floats) -> Floats:
    """The root R (p, p) of a covariance R R', by that of the correlations; of one that is not positive the nearest."""
    unit = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit[unit == 0.0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def write_covariance(posterior: Posterior, path: Path) -> None:
    """Write the covariance as CSV: the upper triangle without zeros, two names and a number in each line.

    A fourth column has the part for terms dropped or missing, where there is one.

    Parameters
    ----------
    posterior : Posterior
        The distribution.
    path : Path
        The file.
    """
    first, second = np.nonzero(np.triu(posterior.covariance))
    parts = [part for part in (posterior.covariance, posterior.for_dropped_terms) if part is not None]
    entries = zip(
        first.tolist(), second.tolist(), *(part[first, second].tolist() for part in parts), strict=True
    )
    rows = ((posterior.names[i], posterior.names[j], *values) for i, j, *values in entries)
    to_csv(path, [(*_HEADER, _FOR_DROPPED_TERMS)[: 2 + len(parts)], *rows])


def read_posterior(folder: str | Path) -> Posterior:
    """Read the distribution of the coefficients from a result folder of `identify`.

    Parameters
    ----------
    folder : str or Path
        The folder, as written by `write_result`.

    Returns
    -------
    Posterior
        The distribution; folders store no bounds, so all but masses are unbounded.

    Raises
    ------
    StructureError
        If the structure cannot be read or lacks a coefficient.
    RecordError
        If there is no covariance, it is damaged, or the structure was edited since; the message names file and line.

    Examples
    --------
    >>> import tempfile
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = lw.report.write_result(estimate, f"{folder}/answer")
    ...     posterior = lw.estimates.read_posterior(f"{folder}/answer")
    >>> posterior.names
    ('nes1.alpha', 'nes1.beta', 'nes1.c')
    """
    folder = Path(folder)
    structure = read_structure(folder)
    path = folder / COVARIANCE
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file))
    except OSError:
        raise RecordError(_why_no_covariance(folder), path) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"is damaged ({error}); identify the record again", path) from None
    entries = [_covariance_entry(path, number, line) for number, line in enumerate(lines[1:], start=2)]
    names = tuple(dict.fromkeys(first for first, *_ in entries))
    index = {name: number for number, name in enumerate(names)}
    parts = np.zeros((2, len(names), len(names)))
    for number, (first, second, *values) in enumerate(entries, start=2):
        if second not in index:
            raise RecordError(f'"{second}" has no variance of its own', path, number)
        parts[:, index[first], index[second]] = parts[:, index[second], index[first]] = values
    for name in names:
        structure.coefficient(name)
    _require_unedited(folder, structure)
    dropped = parts[1] if _FOR_DROPPED_TERMS in (lines[0] if lines else ()) else None
    # folders store no bounds
    lower = np.array([np.finfo(float).tiny if name.key == MASS else -np.inf for name in names])
    upper = np.full(len(names), np.inf)
    return Posterior(structure, names, parts[0], lower, upper, dropped, Basis.stated_in(folder))


def _require_unedited(folder: Path, structure: Structure) -> None:
    """Raise RecordError where the structure is not that of the result beside it, to which the covariance belongs."""
    try:
        result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        links = {link["name"]: link for link in result["links"]}
        written = {f"the mass of {name}": mass["value"] for name, mass in result["masses"].items()}
        written |= {f"the law of {name}": str(link["law"]) for name, link in links.items()}
        written |= {f"between of {name}": tuple(link["between"]) for name, link in links.items()}
        for name, link in links.items():
            written |= {f"{name}.{key}": value["value"] for key, value in link["coefficients"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return  # a covariance that was written without a result
    stated: dict[str, object] = {f"the mass of {mass.name}": mass.mass.value for mass in structure.masses}
    stated |= {f"the law of {link.name}": link.law.text for link in structure.links}
    stated |= {f"between of {link.name}": link.between for link in structure.links}
    stated |= {f"{link.name}.{key}": value for link in structure.links for key, value in link.values.items()}
    edited = [name for name, value in stated.items() if written.get(name, value) != value]
    own = [link.name for link in structure.links]
    edited += [f"link {name}" for name in own if name not in (*links, *structure.modes)]
    edited += [f"link {name}" for name in links if name not in own]
    if edited:
        raise RecordError(
            f"was edited since it was written: {', '.join(edited[:_NAMED])} {'is' if len(edited) == 1 else 'are'} not as in "
            f"{RESULT} beside it, so the errors in {COVARIANCE} do not hold; give the structure file in place of the folder, "
            "to use it without errors, or identify again",
            folder / "structure.toml",
        )


def _covariance_entry(path: Path, number: int, line: list[str]) -> tuple[Name, Name, float, float]:
    """Two names, their covariance, and the part of it for dropped terms."""
    try:
        first, second, value, dropped = [*line, "0"] if len(line) == len(_HEADER) else line
        row, column = (Name.parse(from_csv_cell(cell)) for cell in (first, second))
        return row, column, float(value), float(dropped)
    except ValueError:
        message = f"{','.join(line)!r} is not two coefficients and a number ({','.join(_HEADER)})"
        raise RecordError(message, path, number) from None


def _why_no_covariance(folder: Path) -> str:
    """Why there is no covariance in a folder, and what to do."""
    try:
        result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        status = str(result["status"])
        without_intervals = Verdict.NO_INTERVALS.name in list(result.get("verdicts", ()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "there is no such file, and no result of identify either; give a structure file or a folder that identify wrote"
    if status != Verdict.CONVERGED.status:
        reason = f" ({status})" if status in STATUSES else ""
        why = f", since the estimate is not to be trusted{reason}; identify again"
    elif without_intervals:
        why = ', since the method gives none; identify with method "ml" or "weak"'
    else:
        why = " in this folder; identify again with this version"
    return f"there is no covariance{why}, or give its structure.toml"


_STRUCTURE = "structure.toml"
Answer = Structure | Estimate | Posterior | str | Path


@dataclass(frozen=True, eq=False)
class KnownAnswer:
    """The structure of an answer, and what is known of the errors of its coefficients, its laws and the sensors.

    `posterior` is that of the coefficients, or None, `without` then why the answer gives none; `ranges` in m are those that
    the elongations of its links visited in the record, `model_error` is a part of the forces, and `added` what was taken into
    the model.
    """

    structure: Structure
    posterior: Posterior | None = None
    basis: Basis = UNGRADED
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    model_error: float = 0.0
    sensor_errors: tuple[SensorErrorEstimate, ...] = ()
    added: tuple[Cause, ...] = ()
    without: str = ""

    @classmethod
    def of(cls, answer: Answer) -> KnownAnswer:
        """What an answer in any of its forms says. Raises the errors of reading."""
        match answer:
            case Structure():
                return cls(answer)
            case Posterior():
                return cls(answer.structure, answer, answer.basis)
            case Estimate():
                return cls(
                    answer.structure,
                    None if answer.without_intervals else Posterior.of(answer),
                    Basis(answer.grade, answer.status),
                    {link.link.name: link.d_range for link in answer.links},
                    0.0 if answer.grade is Grade.REFUSED else answer.model_error,
                    answer.sensor_errors,
                    answer.added,
                    answer.without_intervals,
                )
        path = answer_folder(Path(answer))
        if not path.is_dir():
            return cls(read_structure(path), basis=Basis.stated_in(path))
        structure, known = read_structure(path), (path / COVARIANCE).exists()
        stated = {"basis": Basis.stated_in(path), **_stated_in_result(path / RESULT)}
        return cls(structure, read_posterior(path) if known else None, **stated)

    def farthest(self, d: Floats) -> str:
        """The link whose elongation in `d` (M, L) m goes farthest beyond the range it visited; "" where none does."""
        worst, most = "", 1.0
        for number, link in enumerate(self.structure.links):
            low, high = self.ranges.get(link.name, (0.0, 0.0))
            if high > low:
                middle, half = 0.5 * (low + high), 0.5 * (high - low)
                beyond = float(np.abs(d[:, number] - middle).max() / half)
                worst, most = (link.name, beyond) if beyond > most else (worst, most)
        return worst


def _stated_in_result(path: Path) -> dict[str, Any]:
    """What a result file states of its answer, by the fields of `KnownAnswer`; of one that cannot be read, that alone.

    Raises StructureError for a status that linkwise does not write.
    """
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        status, grade = str(result["status"]), Grade(result.get("grade", "refused"))
        error = 0.0 if grade is Grade.REFUSED else float(result.get("model_error_percent") or 0.0) / 100.0
        moved = [link for link in result.get("links", ()) if (link.get("range") or {}).get("d")]
        visited = {str(link["name"]): link["range"]["d"] for link in moved}
        stated = {
            "basis": Basis(grade, status),
            "ranges": {name: (float(low), float(high)) for name, (low, high) in visited.items()},
            "model_error": error if isfinite(error) and error >= 0.0 else 0.0,
            "sensor_errors": tuple(map(SensorErrorEstimate.from_dict, result.get("sensor_errors", ()))),
            "added": tuple(map(_added, result.get("added", ()))),
            "without": status,
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {"without": f"no covariance is beside {_STRUCTURE}"}
    if status not in STATUSES:
        raise StructureError(
            f"states the status {status!r}, which linkwise does not write; identify again, or give the {_STRUCTURE} "
            "beside it",
            str(path),
        )
    return stated


def _added(document: Mapping[str, Any]) -> Cause:
    """A cause as result.json holds it, by what takes it out of a record."""
    size, source = float(document["size"]), str(document.get("source", ""))
    return Cause(str(document["cause"]), str(document["where"]), size, "1", 0.0, 0.0, source=source)
