"""The definition of a study, structures, noise levels, methods and seeds, and its file (TOML; a folder keeps the same
tables as JSON).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any

import msgspec

from linkwise.display import near_miss
from linkwise.errors import IdentificationError, LawError, LinkwiseError, StudyError, expect, require_known
from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Impulse
from linkwise.model.structure import Structure
from linkwise.model.structure_file import parse_structure, read_structure
from linkwise.model.toml import decode, parse_toml, read_toml_text
from linkwise.study.methods import (
    DiscoveryMethod,
    LinkByLink,
    MonomialMethod,
    PhysicsInformedMethod,
    PySindyMethod,
    SindyMethod,
    StudyMethod,
)
from linkwise.study.subject import Case, Subject, study_errors_at

_LEAST = {"first_seed": 0, "cycles": 1, "quick": 1}  # of whole numbers


@dataclass(frozen=True, eq=False)
class Study:
    """A Monte Carlo study: every subject at every noise level by every method, once for each seed.

    Parameters
    ----------
    name : str
        The name of the study.
    subjects : tuple of Subject
        The structures, with their excitation, sensors and unknowns.
    snr_db : tuple of float
        Signal-to-noise ratios in dB (METHODS section 2).
    methods : tuple of StudyMethod
        The methods.
    first_seed, cycles : int
        The first seed, and the number of seeds.
    quick : int
        The number of seeds of a quick run.

    Raises
    ------
    StudyError
        If a list is empty or has an entry twice, or a number is out of range; the error names the key.

    Examples
    --------
    >>> import linkwise as lw
    >>> study = lw.study.read_study("paper")
    >>> len(study), len(study.quickly())
    (10500, 525)
    """

    name: str
    subjects: tuple[Subject, ...]
    snr_db: tuple[float, ...]
    methods: tuple[StudyMethod, ...]
    first_seed: int = 1000
    cycles: int = 100
    quick: int = 5

    def __repr__(self) -> str:
        parts = f"{len(self.subjects)} structures, {len(self.methods)} methods"
        return f"<Study {self.name}: {parts}, {len(self.snr_db)} noise levels, {self.cycles} seeds>"

    def __post_init__(self) -> None:
        _check_distinct("structure", [subject.name for subject in self.subjects])
        _check_distinct("snr_db", list(self.snr_db))
        _check_distinct("method", [method.name for method in self.methods])
        for level in self.snr_db:
            if not isfinite(level):
                wanted = "a signal-to-noise ratio must be a finite number of dB"
                raise StudyError(f"{wanted}, got {level!r}", "snr_db")
        for key, least in _LEAST.items():
            if getattr(self, key) < least:
                raise StudyError(f"must be at least {least}, got {getattr(self, key)}", key)

    def quickly(self) -> Study:
        """The same study with its quick number of cycles at most.

        Returns
        -------
        Study
            The study.
        """
        return replace(self, cycles=min(self.cycles, self.quick))

    def cases(self) -> Iterator[Case]:
        """All cases, cycle by cycle, so that a study that is stopped has rows of every cell.

        Returns
        -------
        iterator of Case
            The cases.
        """
        seeds = range(self.first_seed, self.first_seed + self.cycles)
        for seed, subject, level, method in product(seeds, self.subjects, self.snr_db, self.methods):
            yield Case(subject.name, level, method.name, seed)

    def __len__(self) -> int:
        return self.count

    @property
    def count(self) -> int:
        """The number of cases, however large."""
        return len(self.subjects) * len(self.snr_db) * len(self.methods) * self.cycles

    def subject(self, name: str) -> Subject:
        """One of the subjects.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Subject
            The subject.

        Raises
        ------
        StudyError
            If there is none.
        """
        require_known("structure", name, self._subjects, StudyError)
        return self._subjects[name]

    def method(self, name: str) -> StudyMethod:
        """One of the methods.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        StudyMethod
            The method.

        Raises
        ------
        StudyError
            If there is none.
        """
        require_known("method", name, self._methods, StudyError)
        return self._methods[name]

    def cycle(self, case: Case) -> int:
        """The number of the cycle of a case, 0 for the first.

        Parameters
        ----------
        case : Case
            A case of this study.

        Returns
        -------
        int
            The number of the cycle.
        """
        return case.seed - self.first_seed

    def sort_key(self, case: Case) -> tuple[int, int, int, int]:
        """The position of a case in tables: by structure, noise level, method and seed, in the order of the study.

        Parameters
        ----------
        case : Case
            A case of this study.

        Returns
        -------
        tuple of int
            What sorts the case.
        """
        structure, method = list(self._subjects).index(case.structure), list(self._methods).index(case.method)
        return structure, self.snr_db.index(case.snr_db), method, case.seed

    def document(self) -> dict[str, Any]:
        """The tables of a study file that defines this study, with all defaults and structures.

        Returns
        -------
        dict
            Plain data, for TOML or JSON.
        """
        return {
            "name": self.name,
            "snr_db": list(self.snr_db),
            **{key: getattr(self, key) for key in _LEAST},
            "structure": [subject.document() for subject in self.subjects],
            "method": [method.document() for method in self.methods],
        }

    def text(self) -> str:
        """The document as JSON, which is equal for equal studies.

        Returns
        -------
        str
            JSON.
        """
        return json.dumps(self.document(), indent=1, ensure_ascii=False)

    @cached_property
    def _subjects(self) -> dict[str, Subject]:
        return {subject.name: subject for subject in self.subjects}

    @cached_property
    def _methods(self) -> dict[str, StudyMethod]:
        return {method.name: method for method in self.methods}


def _check_distinct(key: str, values: Sequence[object]) -> None:
    if not values:
        raise StudyError("a study needs at least one", key)
    value, count = Counter(values).most_common(1)[0]
    if count > 1:
        raise StudyError(f"{value!r} is listed {count} times; entries must be distinct", key)


_SOURCES = ("bnes", "file", "toml")
_AS_GIVEN = ("release", "forces", "base", "sensors", "unknown", "judge", "scatter", "frequency")


class _Impulse(msgspec.Struct, forbid_unknown_fields=True):
    mass: str
    momentum: float
    time: float = 0.0


class _Structure(msgspec.Struct, forbid_unknown_fields=True):
    duration: float | list[float]
    rate: float | list[float]
    name: str = ""
    bnes: int | None = None
    file: str | None = None
    toml: str | None = None
    values: dict[str, float] = {}
    release: dict[str, float] = {}
    impulse: list[_Impulse] = []
    forces: dict[str, str] = {}
    base: str | None = None
    sensors: tuple[str, ...] = ("x",)
    unknown: tuple[str, ...] = ("all",)
    judge: tuple[str, ...] = ()
    scatter: float = 0.0
    frequency: float | None = None
    variant: list[dict[str, Any]] = []


METHOD_KINDS: dict[str, type[StudyMethod]] = {
    "ml": LinkByLink,
    "weak": LinkByLink,
    "physics-informed": PhysicsInformedMethod,
    "discover": DiscoveryMethod,
    "sindy": SindyMethod,
    "pysindy": PySindyMethod,
    "monomial": MonomialMethod,
}
"""The class of each kind of method in a study file."""


class _Document(msgspec.Struct, forbid_unknown_fields=True):
    snr_db: list[float]
    structure: list[_Structure]
    method: list[dict[str, Any]]
    name: str = ""
    first_seed: int = 1000
    cycles: int = 100
    quick: int = 5


def read_study(study: str | Path) -> Study:
    """Read the definition of a study.

    Parameters
    ----------
    study : str or path
        The name of a study that ships with linkwise ("paper", "reach"), or a TOML file. Relative paths of structure files are
        from the folder of that file.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    StudyError
        If there is no such study or file, or something is wrong in it; the error names the file and the key.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.study.read_study("paper").snr_db
    (40.0, 30.0, 20.0)
    """
    expect("read_study(study): study", study, str, Path)
    path = Path(study)
    shipped = {entry.name: entry for entry in files("linkwise.study").iterdir()}
    names = sorted(name.removesuffix(".toml") for name in shipped if name.endswith(".toml"))
    if str(study) in names:
        name = f"{study}.toml"
        return parse_study(shipped[name].read_text(encoding="utf-8"), name, Path())
    if not path.is_file():
        raise StudyError(
            f"there is no such study{near_miss(str(study), names)}; give a TOML file, or a study that ships with linkwise: "
            f"{', '.join(names)}",
            str(study),
        )
    text = read_toml_text(path, StudyError)
    return parse_study(text, str(study), path.parent)


def parse_study(text: str, source: str, folder: Path) -> Study:
    """The study in a TOML text; errors call it `source`, and relative paths are from `folder`."""
    return build_study(parse_toml(text, source, StudyError), source, folder)


def build_study(data: dict[str, Any], source: str, folder: Path) -> Study:
    """The study that the tables of a study file define; relative paths are from `folder`."""
    document: _Document = decode(data, _Document, source, "", StudyError)
    subjects = tuple(
        _subject(entry, length, path, source, folder)
        for i, listed in enumerate(document.structure)
        for entry, path in _with_variants(listed, data["structure"][i], f"structure[{i}]", source)
        for length in _durations_and_rates(entry, f"{source}, {path}")
    )
    methods = tuple(_method(entry, f"method[{i}]", source) for i, entry in enumerate(document.method))
    counts = {key: getattr(document, key) for key in _LEAST}
    try:
        return Study(document.name or Path(source).stem, subjects, tuple(document.snr_db), methods, **counts)
    except StudyError as error:
        raise StudyError(error.message, f"{source}, {error.where}") from None


def _with_variants(
    entry: _Structure, table: dict[str, Any], path: str, source: str
) -> Iterator[tuple[_Structure, str]]:
    """A structure as it stands, and each of its variants: the keys of the variant in place of its own; with their paths."""
    yield entry, path
    for i, variant in enumerate(entry.variant):
        place = f"{path}.variant[{i}]"
        own: _Structure = decode({**table, **variant, "variant": []}, _Structure, source, place, StudyError)
        if not variant.get("name"):
            wanted = "give the variant a name, which is added to that of the structure"
            raise StudyError(wanted, f"{source}, {place}.name")
        name = f"{_structure_name(entry)}, {own.name}" if _structure_name(entry) else own.name
        yield msgspec.structs.replace(own, name=name, values={**entry.values, **own.values}), place


def _durations_and_rates(entry: _Structure, where: str) -> Iterator[tuple[float, float, tuple[str, ...]]]:
    """Each duration of a structure in s at each of its rates in Hz; where it lists several, what of these its name says."""
    listed: list[list[tuple[float, tuple[str, ...]]]] = []
    for key, unit in (("duration", "s"), ("rate", "Hz")):
        given = getattr(entry, key)
        if given == []:
            raise StudyError("must be a number, or a list of at least one", f"{where}.{key}")
        several = isinstance(given, list)
        listed.append([(value, (f"{value:.6g} {unit}",)) for value in given] if several else [(given, ())])
    for (duration, first), (rate, second) in product(*listed):
        yield duration, rate, (*first, *second)


def _structure_name(entry: _Structure) -> str:
    return entry.name or (f"bnes{entry.bnes}" if entry.bnes else "")


def _subject(
    entry: _Structure, length: tuple[float, float, tuple[str, ...]], path: str, source: str, folder: Path
) -> Subject:
    structure, (duration, rate, named) = _structure(entry, path, source, folder), length
    try:
        return Subject(
            name=", ".join((_structure_name(entry) or structure.name or path, *named)),
            structure=structure,
            duration=duration,
            rate=rate,
            impulses=tuple(Impulse(**msgspec.structs.asdict(impulse)) for impulse in entry.impulse),
            **{key: getattr(entry, key) for key in _AS_GIVEN},
        )
    except StudyError as error:
        raise StudyError(error.message, f"{source}, {path}.{error.where}") from None
    except LinkwiseError as error:
        raise StudyError(str(error), f"{source}, {path}") from None


def _structure(entry: _Structure, path: str, source: str, folder: Path) -> Structure:
    given = [key for key in _SOURCES if getattr(entry, key) is not None]
    if len(given) != 1:
        raise StudyError(
            "give one of the keys bnes (number of masses), file (a structure file) and toml (its text), got "
            f"{' and '.join(given) or 'none of them'}",
            f"{source}, {path}",
        )
    with study_errors_at(f"{source}, {path}.{given[0]}"):
        if entry.bnes is not None:
            structure = bnes_chain(entry.bnes)
        elif entry.file is not None:
            structure = read_structure(folder / entry.file)
        else:
            structure = parse_structure(entry.toml or "", f"{source}, {path}.toml")
    with study_errors_at(f"{source}, {path}.values"):
        structure = structure.with_values(entry.values)
    unknown = [p.name for p in structure.parameters if p.start is None or not isfinite(p.sigma)]
    if unknown:
        raise StudyError(
            f"{unknown[0]} is unknown, but the structure must be simulated before it is identified; give it a number here or "
            "in `values`, and name in `unknown` what is to be identified",
            f"{source}, {path}.{given[0]}",
        )
    return structure


def _method(entry: dict[str, Any], path: str, source: str) -> StudyMethod:
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in METHOD_KINDS:
        hint = near_miss(kind, METHOD_KINDS) if isinstance(kind, str) else ""
        got = f"got {'nothing' if kind is None else repr(kind)}{hint}"
        raise StudyError(f"expected one of {', '.join(METHOD_KINDS)}; {got}", f"{source}, {path}.kind")
    try:
        return decode(entry, METHOD_KINDS[kind], source, path, StudyError)
    except (IdentificationError, LawError) as error:
        raise StudyError(str(error), f"{source}, {path}") from None
