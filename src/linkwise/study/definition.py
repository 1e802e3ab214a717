"""A study as it stands on paper: which structures, how much noise, which methods, which seeds."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from linkwise.errors import StudyError
from linkwise.study.method import StudyMethod
from linkwise.study.row import Case
from linkwise.study.subject import Subject
from linkwise.text import near_miss


@dataclass(frozen=True, eq=False)
class Study:
    """Every subject at every noise level by every method, once for each of `cycles` seeds from `first_seed` on.

    `snr_db` are signal-to-noise ratios (METHODS section 2); `quick` is how many cycles a quick run takes. Raises StudyError,
    naming the key, for what is missing, twice there, or no such number.
    """

    name: str
    subjects: tuple[Subject, ...]
    snr_db: tuple[float, ...]
    methods: tuple[StudyMethod, ...]
    first_seed: int = 1000
    cycles: int = 100
    quick: int = 5

    def __post_init__(self) -> None:
        named: dict[str, list[object]] = {
            "structure": [one.name for one in self.subjects],
            "snr_db": list(self.snr_db),
            "method": [one.name for one in self.methods],
        }
        for key, values in named.items():
            _check_distinct(key, values)
        for level in self.snr_db:
            if not math.isfinite(level):
                raise StudyError(f"a signal-to-noise ratio is a finite number of dB, got {level!r}", "snr_db")
        for key, value, least in (
            ("first_seed", self.first_seed, 0),
            ("cycles", self.cycles, 1),
            ("quick", self.quick, 1),
        ):
            if value < least:
                raise StudyError(f"it must be at least {least}, got {value}", key)

    def quickly(self) -> Study:
        """The same study with no more than its quick number of cycles."""
        return replace(self, cycles=min(self.cycles, self.quick))

    def cases(self) -> Iterator[Case]:
        """All cases, cycle by cycle, so that a study that is stopped has something of everything."""
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
        """The structure called `name` and all that is done with it; StudyError lists those there are."""
        return self._subjects[name] if name in self._subjects else _absent(name, "structure", self._subjects)

    def method(self, name: str) -> StudyMethod:
        """The method called `name`; StudyError lists those there are."""
        return self._methods[name] if name in self._methods else _absent(name, "method", self._methods)

    def cycle(self, case: Case) -> int:
        """Which cycle a case belongs to, 0 the first: the number that `Subject.simulate` asks for."""
        return case.seed - self.first_seed

    def place(self, case: Case) -> tuple[int, int, int, int]:
        """Where a case stands in tables: by structure, noise, method, seed, in the order of the study."""
        return (*self._places[case.structure, case.snr_db, case.method], case.seed)

    def document(self) -> dict[str, Any]:
        """The study file that gives this study, with every default filled in and every structure inside."""
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
        """The document as JSON: equal for equal studies."""
        return json.dumps(self.document(), indent=1, ensure_ascii=False)

    @cached_property
    def _subjects(self) -> dict[str, Subject]:
        return {one.name: one for one in self.subjects}

    @cached_property
    def _methods(self) -> dict[str, StudyMethod]:
        return {one.name: one for one in self.methods}

    @cached_property
    def _places(self) -> dict[tuple[str, float, str], tuple[int, int, int]]:
        return {
            (subject.name, level, method.name): (i, j, k)
            for i, subject in enumerate(self.subjects)
            for j, level in enumerate(self.snr_db)
            for k, method in enumerate(self.methods)
        }


def _check_distinct(key: str, values: Sequence[object]) -> None:
    if not values:
        raise StudyError("the study needs at least one", key)
    value, count = Counter(values).most_common(1)[0]
    if count > 1:
        raise StudyError(f"{value!r} is there {count} times; each must be another", key)


def _absent(name: str, kind: str, there: dict[str, Any]) -> Any:
    raise StudyError(f'there is no {kind} "{name}"{near_miss(name, there)}; there are {", ".join(there)}')
