"""Discovery with no prior: structures found exactly, what was missed and why, time, and PySINDy beside it: `make benchmark`.

Times are of the whole call, from record to intervals and evidence, in the unit U: one NumPy product of two different
matrices, 1771 x 6000 by 6000 x 1771, in the same run; the quickest of several, as U is.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from time import perf_counter

import numpy as np
import pytest
from random_structures import random_case
from within import Terms, graph, masses, terms

import linkwise as lw

FIRST = 1000  # seeds from here on were never tuned on
DURATION, RATE = 6.0, 1000.0


@cache
def clean(n: int) -> lw.Record:
    """The paper's chain after its hit, displacements only."""
    release = {"v:m1": 1.0 if n == 2 else 3.0}
    return lw.simulate(lw.bnes_chain(n), release=release, duration=DURATION, rate=RATE)


@dataclass(frozen=True)
class Score:
    """One discovery against the truth: terms as both ends and a text; `doubts` is what the answer says against itself."""

    missing: Terms
    extra: Terms
    trusted: bool
    seconds: float
    doubts: tuple[str, ...]

    @classmethod
    def of(cls, record: lw.Record, truth: lw.Structure) -> Score:
        started = perf_counter()
        found = lw.discover(record, masses(truth))
        seconds = perf_counter() - started
        mine, true = terms(found.structure), terms(truth)
        wrong = [
            term
            for term in found.terms
            if term.kept != ((frozenset(term.between), _plain(term.term)) in true)
        ]
        doubts = [] if found.trusted else [f"not trusted: {found.estimate.message}"]
        doubts += [
            f"{'kept' if term.kept else 'dropped'} {term.name} by {term.margin:.1f}{'' if term.certain else ', in doubt'}"
            for term in wrong
        ]
        doubts += [f"{each.change}: {each.margin:+.1f}" for each in found.runners_up[:3]]
        doubts += found.remarks
        return cls(true - mine, mine - true, found.trusted, seconds, tuple(doubts))

    @property
    def exact(self) -> bool:
        return not self.missing and not self.extra

    @property
    def elastic(self) -> bool:
        """Whether every spring and every other term in d is right."""
        return not any(text != "v" for _, text in self.missing | self.extra)

    @property
    def dampers(self) -> bool:
        return not any(text == "v" for _, text in self.missing | self.extra)

    def told(self) -> str:
        """What went wrong, and what the answer itself has to say about it."""
        lines = [
            f"    {word} {'-'.join(sorted(ends))} {text}"
            for word, some in (("missing", self.missing), ("extra", self.extra))
            for ends, text in sorted(some, key=lambda each: (sorted(each[0]), each[1]))
        ]
        return "\n".join([*lines, *(f"        {each}" for each in self.doubts)])


def _plain(term: str) -> str:
    """A term as `terms` writes it."""
    return term.replace(" ", "")


def of_chain(n: int, decibel: float, seeds: int) -> list[Score]:
    chain = lw.bnes_chain(n)
    return [Score.of(clean(n).with_noise(decibel, seed=seed), chain) for seed in range(FIRST, FIRST + seeds)]


def show(what: str, scores: Sequence[Score], unit: float) -> None:
    """One line a case, and every miss below it."""
    seconds = [score.seconds for score in scores]
    print(
        f"{what:<16} exact {sum(s.exact for s in scores):>2}/{len(scores)}   springs and cubic terms "
        f"{sum(s.elastic for s in scores):>2}   dampers {sum(s.dampers for s in scores):>2}   trusted "
        f"{sum(s.trusted for s in scores):>2}   {np.median(seconds):6.2f} s, quickest {min(seconds) / unit:5.2f} U",
        flush=True,
    )
    for number, score in enumerate(scores):
        if not score.exact:
            print(f"  seed {FIRST + number}\n{score.told()}", flush=True)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_small_chains_are_exact_at_20_db(n: int, unit: float) -> None:
    scores = of_chain(n, 20.0, 20)
    print()
    show(f"n = {n}, 20 dB", scores, unit)
    assert all(score.exact and score.trusted for score in scores)


@pytest.mark.parametrize("n", [8, 10])
def test_springs_of_long_chains_are_right_at_20_db(n: int, unit: float) -> None:
    scores = of_chain(n, 20.0, 10)
    print()
    show(f"n = {n}, 20 dB", scores, unit)
    assert all(score.elastic for score in scores)
    assert sum(score.dampers for score in scores) >= 8


@pytest.mark.parametrize("decibel", [30.0, 40.0])
def test_all_chains_are_exact_where_noise_is_low(decibel: float, unit: float) -> None:
    print()
    wrong = 0
    for n in (2, 4, 6, 8, 10):
        scores = of_chain(n, decibel, 3)
        show(f"n = {n}, {decibel:g} dB", scores, unit)
        wrong += sum(not score.exact for score in scores)
    assert wrong == 0


def test_what_10_db_leaves(unit: float) -> None:
    """Nothing is promised here but the two masses; the rest is printed."""
    print()
    for n in (2, 4, 6, 8, 10):
        scores = of_chain(n, 10.0, 3)
        show(f"n = {n}, 10 dB", scores, unit)
        if n == 2:
            assert all(score.exact for score in scores)


def test_structures_that_nobody_tuned_on() -> None:
    """50 random ones at 30 dB: who is linked to whom."""
    print()
    right = 0
    for seed in range(FIRST, FIRST + 50):
        case = random_case(seed)
        started = perf_counter()
        found = lw.discover(case.record.with_noise(30.0, seed=seed), masses(case.structure))
        seconds = perf_counter() - started
        mine, true = graph(found.structure), graph(case.structure)
        right += mine == true
        missing = len(terms(case.structure) - terms(found.structure))
        extra = len(terms(found.structure) - terms(case.structure))
        print(
            f"seed {seed}: {case.structure.size} masses, {len(true)} links, graph {'right' if mine == true else 'WRONG'}, "
            f"terms {missing} missing {extra} extra, {'trusted' if found.trusted else 'not trusted'}, {seconds:.1f} s",
            flush=True,
        )
        if mine != true:
            print(_why(found, true - mine, mine - true), flush=True)
            assert not found.trusted or all(_doubted(found, pair) for pair in true ^ mine)
    print(f"exact graph: {right} of 50")
    assert right >= 45


def _doubted(found: lw.Discovery, pair: frozenset[str]) -> bool:
    """Whether the answer itself says that a link may be otherwise: a candidate on it is in doubt, or was never tested."""
    terms_of_pair = [term for term in found.terms if frozenset(term.between) == pair]
    return not terms_of_pair or any(not term.certain for term in terms_of_pair)


def _why(found: lw.Discovery, missing: set[frozenset[str]], extra: set[frozenset[str]]) -> str:
    """The evidence that the answer gives on the links that are wrong."""
    lines = [f"    {found.estimate.message}" if not found.trusted else ""]
    for word, pairs in (("missing", missing), ("extra", extra)):
        for pair in pairs:
            of_pair = [
                term
                for term in found.terms
                if frozenset(term.between) == pair and term.kept == (word == "extra")
            ]
            nearest = ", ".join(
                f"{term.name} margin {term.margin:.1f}{'' if term.certain else ' in doubt'}"
                for term in sorted(of_pair, key=lambda term: term.margin)
            )
            lines.append(f"    {word} {'-'.join(sorted(pair))}: {nearest or 'dropped without a test'}")
    lines += [f"    runner-up {each.change}: {each.margin:+.1f}" for each in found.runners_up[:3]]
    lines += [f"    {each}" for each in found.remarks]
    return "\n".join(line for line in lines if line)


def test_the_cost_of_one_discovery(unit: float) -> None:
    print()
    for n, allowed in ((6, 3.0), (10, 10.0)):
        quickest = min(score.seconds for score in of_chain(n, 20.0, 4))
        print(f"n = {n}: {quickest:.2f} s, {quickest / unit:.2f} U of {allowed:g} U", flush=True)
        assert quickest < allowed * unit


def test_forty_masses(unit: float) -> None:
    """3280 candidates at 30 dB in ten minutes."""
    (score,) = of_chain(40, 30.0, 1)
    print()
    show("n = 40, 30 dB", [score], unit)
    assert score.seconds < 600.0
    assert not any(text == "d" for _, text in score.missing | score.extra)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_beside_pysindy(n: int) -> None:
    """On the same record at 20 dB, each in a process of its own, counted in monomials of the accelerations of all masses.

    What is easier for the peer is left to it: its threshold is the one of many with the fewest wrong monomials.
    """
    peers = pytest.importorskip("peers_discovery", reason="install the extra [peers] to compare with PySINDy")
    print()
    found = {}
    for method in (peers.by_linkwise, peers.by_sindy, peers.by_weak_sindy):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            found[method.__name__] = alone.submit(method, n, 20.0, FIRST).result()
        print(f"n = {n}, {method.__name__:<14} {found[method.__name__]}", flush=True)
    ours = found.pop("by_linkwise")
    assert ours.missing == ours.extra == 0
    assert all(peer.missing + peer.extra > 0 for peer in found.values())
