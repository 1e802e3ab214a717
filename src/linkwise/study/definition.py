"""The definition of a study: structures, noise levels, methods and seeds."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

from linkwise.argument_types import checked_class
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.display import near_miss
from linkwise.errors import StudyError
from linkwise.study.method import StudyMethod
from linkwise.study.row import Case
from linkwise.study.subject import Subject

_Entry = TypeVar("_Entry", Subject, StudyMethod)


@checked_class
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
    >>> study = lw.read_study("paper")
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

    place = DeprecatedAttribute(Deprecated("sort_key", since="0.2.0", until="0.4.0"))

    def __post_init__(self) -> None:
        named: dict[str, list[object]] = {
            "structure": [subject.name for subject in self.subjects],
            "snr_db": list(self.snr_db),
            "method": [method.name for method in self.methods],
        }
        for key, values in named.items():
            _check_distinct(key, values)
        for level in self.snr_db:
            if not math.isfinite(level):
                raise StudyError(
                    f"a signal-to-noise ratio must be a finite number of dB, got {level!r}", "snr_db"
                )
        for key, value, least in (
            ("first_seed", self.first_seed, 0),
            ("cycles", self.cycles, 1),
            ("quick", self.quick, 1),
        ):
            if value < least:
                raise StudyError(f"must be at least {least}, got {value}", key)

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
        for seed in range(self.first_seed, self.first_seed + self.cycles):
            for subject in self.subjects:
                for level in self.snr_db:
                    for method in self.methods:
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
        return _lookup(name, "structure", self._subjects)

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
        return _lookup(name, "method", self._methods)

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
        return (*self._positions[case.structure, case.snr_db, case.method], case.seed)

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
            "first_seed": self.first_seed,
            "cycles": self.cycles,
            "quick": self.quick,
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

    @cached_property
    def _positions(self) -> dict[tuple[str, float, str], tuple[int, int, int]]:
        return {
            (subject.name, level, method.name): (i, j, k)
            for i, subject in enumerate(self.subjects)
            for j, level in enumerate(self.snr_db)
            for k, method in enumerate(self.methods)
        }


def _check_distinct(key: str, values: Sequence[object]) -> None:
    if not values:
        raise StudyError("a study needs at least one", key)
    value, count = Counter(values).most_common(1)[0]
    if count > 1:
        raise StudyError(f"{value!r} is listed {count} times; entries must be distinct", key)


def _lookup(name: str, kind: str, by_name: dict[str, _Entry]) -> _Entry:
    """The entry called `name`; StudyError with all names if there is none."""
    if name not in by_name:
        raise StudyError(
            f'unknown {kind} "{name}"{near_miss(name, by_name)}; choose from {", ".join(by_name)}'
        )
    return by_name[name]
