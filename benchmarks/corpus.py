"""The corpus of answers: what linkwise answers to some 440 questions, compared with stored answers: `make corpus`.

Every case of `corpus_cases` is run and its answer (values, standard errors, verdicts, ordered causes) compared with that in
`corpus.json`; what changed is listed by case, and the exit code is 1 when anything did. Only names that `import linkwise`
offers are used, so that it survives moves of modules. With --update the answers that changed are stored in place of the old
ones; with --add they are stored beside them, as for a processor whose linear algebra rounds otherwise.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from multiprocessing import get_context
from pathlib import Path
from statistics import quantiles
from time import perf_counter, process_time
from typing import Any

from corpus_answers import answer_of, refusal
from corpus_cases import CASES, QUICK
from corpus_models import Skipped

import linkwise as lw

STORED = Path(__file__).with_name("corpus.json")
VALUE = 0.02  # of a standard error, by which a value may move
ERROR = 0.02  # of a standard error, by which that may change
SIZE = 0.05  # of the size of a cause
NUMBER = 2e-3  # of a number without a standard error, such as chi-square or the level of a noise
ROUNDING = 1e-8  # of any number: differences below it are none
SHOWN = 6  # differences of a case that are listed
ENVIRONMENT = {  # of the workers: see the Makefile
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": "33554432",
    "MALLOC_TRIM_THRESHOLD_": "268435456",
}

Answer = dict[str, Any]


def run(name: str) -> tuple[Answer | None, float]:
    """The answer of a case and its seconds of processor time; None where its data are not there."""
    started = process_time()
    try:
        answer = answer_of(CASES[name]())
    except Skipped:
        return None, 0.0
    except Exception as error:  # the answer of a case may be that it is refused
        answer = refusal(error)
    return answer, process_time() - started


@dataclass
class Comparison:
    """The differences of an answer from a stored one: those that count, and the sizes of those that do not."""

    changes: list[str] = field(default_factory=list)
    shifts: list[float] = field(default_factory=list)  # of values, in standard errors
    rounded: bool = False  # whether a number differs within its tolerance

    @classmethod
    def of(cls, stored: Answer, new: Answer) -> Comparison:
        comparison = cls()
        for key in dict.fromkeys([*stored, *new]):
            comparison._compare(key, stored.get(key), new.get(key))
        return comparison if stored else cls(["no answer is stored"])

    def _compare(self, key: str, old: Any, new: Any) -> None:
        if key == "values" and isinstance(old, dict) and isinstance(new, dict):
            for name in self._common(old, new):
                self._value(name, old[name], new[name])
        elif key == "numbers" and isinstance(old, dict) and isinstance(new, dict):
            for name in self._common(old, new):
                self._number(name, old[name], new[name], NUMBER)
        elif key == "causes" and isinstance(old, list) and isinstance(new, list):
            self._causes(old, new)
        elif old != new:
            self.changes.append(f"{key}: {_shown(old)} -> {_shown(new)}")

    def _common(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
        self.changes += [f"{name}: {_shown(old[name])} -> nothing" for name in old if name not in new]
        self.changes += [f"{name}: nothing -> {_shown(new[name])}" for name in new if name not in old]
        return [name for name in old if name in new]

    def _value(self, name: str, old: Sequence[float | None], new: Sequence[float | None]) -> None:
        value, error = old
        if not error or value is None or new[0] is None or new[1] is None:
            self._number(name, value, new[0], NUMBER)
            if bool(error) != bool(new[1]):
                self.changes.append(f"{name}: standard error {_shown(error)} -> {_shown(new[1])}")
            return
        shift = abs(new[0] - value) / error
        grown = new[1] / error - 1.0
        self.rounded |= abs(new[0] - value) > ROUNDING * abs(value) or abs(grown) > ROUNDING
        self.shifts.append(shift)
        if (shift > VALUE and abs(new[0] - value) > ROUNDING * abs(value)) or abs(grown) > ERROR:
            self.changes.append(
                f"{name}: {value:.6g} +- {error:.3g} -> {new[0]:.6g} +- {new[1]:.3g}, {shift:.3g} standard errors off"
            )

    def _number(self, name: str, old: float | None, new: float | None, tolerance: float) -> None:
        if old is None or new is None:
            if old != new:
                self.changes.append(f"{name}: {_shown(old)} -> {_shown(new)}")
            return
        size, off = max(abs(old), abs(new)), abs(new - old)
        self.rounded |= off > ROUNDING * size
        if off > tolerance * size:
            self.changes.append(f"{name}: {old:.6g} -> {new:.6g}")

    def _causes(self, old: list[list[Any]], new: list[list[Any]]) -> None:
        """Causes are (kind, where, detail, size), the largest gain first."""
        if [cause[:3] for cause in old] != [cause[:3] for cause in new]:
            self.changes.append(f"causes: {_causes(old)} -> {_causes(new)}")
            return
        for before, after in zip(old, new, strict=True):
            self._number(f"size of {_causes([before])}", before[3], after[3], SIZE)


def _causes(causes: Iterable[Sequence[Any]]) -> str:
    return ", ".join(" ".join(filter(None, cause[:3])) for cause in causes) or "none"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(map(_shown, value)) or "none"
    return str(value)


def nearest(stored: Sequence[Answer], new: Answer) -> tuple[int, Comparison]:
    """The number of the stored answer that a new one is nearest to, and the differences from it."""
    comparisons = [Comparison.of(answer, new) for answer in stored]
    best = min(range(len(stored)), key=lambda number: len(comparisons[number].changes))
    return best, comparisons[best]


def answers(names: Sequence[str], workers: int) -> Iterator[tuple[str, Answer | None, float]]:
    """The answers of cases as they come, each worker with one thread of linear algebra."""
    os.environ.update({**ENVIRONMENT, **{key: os.environ[key] for key in ENVIRONMENT if key in os.environ}})
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(run, name): name for name in names}
        for future in as_completed(running):
            yield (running[future], *future.result())


def selected(globs: Sequence[str], quick: bool) -> list[str]:
    """The names of the cases that are asked for, in the order of the table."""
    globs = globs or (QUICK if quick else ["*"])
    missed = [glob for glob in globs if not any(fnmatchcase(name, glob) for name in CASES)]
    if missed:
        sys.exit(f"no case is called {', '.join(missed)}; some are {', '.join(list(CASES)[:5])}")
    return [name for name in CASES if any(fnmatchcase(name, glob) for glob in globs)]


def read(path: Path) -> dict[str, list[Answer]]:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def write(path: Path, stored: Mapping[str, list[Answer]]) -> None:
    """One case a line, in the order of the table; those that it no longer has are left out."""
    lines = [f"{json.dumps(name)}: {json.dumps(stored[name])}" for name in CASES if name in stored]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def report(comparisons: Mapping[str, tuple[int, Comparison]], skipped: int, several: set[str]) -> bool:
    """Print what changed and the summary; whether anything changed."""
    changed = {name: each for name, (_, each) in comparisons.items() if each.changes}
    for name in (name for name in CASES if name in changed):
        differences = changed[name].changes
        print(name)
        print("\n".join(f"    {line}" for line in differences[:SHOWN]))
        if len(differences) > SHOWN:
            print(f"    and {len(differences) - SHOWN} more differences")
    same = [each for _, each in comparisons.values() if not each.changes]
    close = sum(each.rounded for each in same)
    print(
        f"{len(same)} unchanged ({len(same) - close} to the last digit, {close} within the tolerance), {len(changed)} changed"
        + (f", {skipped} skipped for want of data" if skipped else "")
    )
    shifts = sorted((shift, name) for name, (_, each) in comparisons.items() for shift in each.shifts)
    if len(shifts) > 1:
        hundredths = quantiles([shift for shift, _ in shifts], n=100, method="inclusive")
        print(
            f"shifts of {len(shifts)} values in standard errors: median {hundredths[49]:.1g}, 90 % below "
            f"{hundredths[89]:.1g}, 99 % below {hundredths[98]:.1g}, largest {shifts[-1][0]:.2g} in {shifts[-1][1]}"
        )
    others = sorted(name for name, (number, _) in comparisons.items() if name in several and number > 0)
    if others:
        print(f"as on another processor: {', '.join(others)}")
    return bool(changed)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help='names of cases, as "faults/*"; all by default')
    parser.add_argument(
        "--quick", action="store_true", help="a fixed part of the cases, in a minute and a half"
    )
    parser.add_argument("--update", action="store_true", help="store the answers that changed")
    parser.add_argument(
        "--add", action="store_true", help="store the answers that changed beside those that are there"
    )
    parser.add_argument("--list", action="store_true", help="list the cases and run none")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--stored", type=Path, default=STORED, help="file of the stored answers")
    options = parser.parse_args(arguments)
    names, stored = selected(options.cases, options.quick), read(options.stored)
    if options.list:
        print("\n".join(names))
        return 0
    print(f"linkwise of {Path(lw.__file__).parent}", file=sys.stderr)
    comparisons: dict[str, tuple[int, Comparison]] = {}
    skipped, slow, started = 0, [], perf_counter()
    for number, (name, answer, seconds) in enumerate(answers(names, options.workers), 1):
        skipped += answer is None
        if answer is not None:
            slow.append((seconds, name))
            comparisons[name] = nearest(stored.get(name) or [{}], answer)
            if comparisons[name][1].changes and (options.update or options.add):
                stored[name] = [*(stored.get(name, []) if options.add else []), answer]
                write(options.stored, stored)  # now, since a long run may be interrupted
        state = "no data" if answer is None else "changed" if comparisons[name][1].changes else ""
        print(f"[{number}/{len(names)}] {name} {seconds:.1f} s {state}", file=sys.stderr, flush=True)
    print(
        f"{perf_counter() - started:.0f} s; slowest "
        + ", ".join(f"{name} {seconds:.1f} s" for seconds, name in sorted(slow, reverse=True)[:5]),
        file=sys.stderr,
    )
    several = {name for name, known in stored.items() if len(known) > 1}
    changed = report(comparisons, skipped, several)
    return int(changed and not (options.update or options.add))


if __name__ == "__main__":
    sys.exit(main())
