"""The cases of the corpus of answers: a name, and what is asked of which record; seeds follow from names and are of no test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any
from zlib import crc32

from fault_catalogue import FAULTS, Fault, make_test
from problems import PROBLEMS, chain_record

import linkwise as lw

Ask = Callable[[int], Any]  # the answer to the record of a seed
Table = Iterator[tuple[str, Ask]]


class Skipped(Exception):
    """A measured record is not there."""


def seed(name: str) -> int:
    """Far from those of tests and benchmarks."""
    return 1_000_000_000 + crc32(name.encode())


def chains() -> Table:
    """The paper's chains, all coefficients unknown."""

    def ask(n: int, decibel: float, sensors: str, method: Any, seed: int) -> lw.Estimate:
        record = chain_record(n, duration=3.0, sensors=tuple(sensors)).with_noise(decibel, seed=seed)
        return lw.identify(record, lw.bnes_chain(n).unknown("all"), method=method)

    for n, levels in {
        2: (10, 15, 20, 30, 40),
        3: (20, 40),
        4: (10, 20, 40),
        6: (20, 40),
        10: (20, 40),
    }.items():
        for decibel in levels:
            yield f"chain/{n}/{decibel}dB/x/ml", partial(ask, n, decibel, "x", "ml")
    for n in (2, 4, 6):
        for decibel in (10, 20, 40):
            yield f"chain/{n}/{decibel}dB/x/weak", partial(ask, n, decibel, "x", "weak")
    for n, sensors, decibel in (
        (2, "v", 30),
        (2, "a", 30),
        (2, "a", 15),
        (4, "v", 30),
        (4, "a", 30),
        (2, "xa", 20),
    ):
        yield f"chain/{n}/{decibel}dB/{sensors}/ml", partial(ask, n, decibel, sensors, "ml")
    for n, sensors, decibel in ((2, "x", 40), (4, "x", 60), (2, "xva", 20)):
        yield f"chain/{n}/{decibel}dB/{sensors}/sindy", partial(ask, n, decibel, sensors, "sindy")


def problems() -> Table:
    """The problems of the tests, by all methods."""

    def ask(name: str, method: Any, seed: int) -> lw.Estimate:
        problem = PROBLEMS[name]
        return lw.identify(problem.record(seed), problem.unknown_structure, method=method)

    for name in PROBLEMS:
        for method in ("ml", "weak"):
            yield f"problem/{name.replace(', ', '-').replace(' ', '-')}/{method}", partial(ask, name, method)


def faults() -> Table:
    """The faults of the catalogue in the chain of two masses, and some in that of six."""

    def ask(fault: Fault, n: int, decibel: float, method: Any, seed: int) -> Any:
        test = make_test(fault, n, decibel, seed)
        record = fault.make(test)
        if method == "discover":
            masses = {
                mass.name: mass.mass.value if mass.mass.known else "unknown" for mass in test.stated.masses
            }
            return lw.discover(record, masses)
        return lw.identify(record, test.stated.unknown("all"), method=method)

    for fault in FAULTS:
        slug = fault.name.replace(", ", "-").replace(" %", "%").replace(" ", "-")
        yield f"fault/{slug}/2/40dB/ml", partial(ask, fault, 2, 40.0, "ml")


def _table(*families: Callable[[], Table]) -> dict[str, Callable[[], Any]]:
    return {name: partial(ask, seed(name)) for family in families for name, ask in family()}


CASES = _table(chains, problems, faults)
QUICK = ("chain/*", "problem/*")
