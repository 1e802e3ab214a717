"""Discovery from velocities alone and from accelerations alone: chains of the paper at 30 dB, a rig under a hammer at 25 dB.

No displacement is measured, so an answer is trusted only where the laws leave no more than noise. What is counted is how often
the graph and all terms are right, how many answers are trusted, and whether each link that is missing or false is among the
candidates in doubt. LINKWISE_SEEDS says how many
records of each there are (default 10).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import perf_counter

import numpy as np
import pytest
from within import graph, masses, terms

import linkwise as lw

FIRST = 1000
SEEDS = int(os.environ.get("LINKWISE_SEEDS", "10"))
RATE, DURATION = 1000.0, 6.0
HIT, PEAK = 0.004, 60.0  # s and N of one blow of the hammer
RIG = """
name = "rig"
[[mass]]
name = "m1"
mass = 2.0
[[mass]]
name = "m2"
mass = 1.0
[[mass]]
name = "m3"
mass = 1.5
[[mass]]
name = "m4"
mass = 0.5
[[link]]
name = "foot"
between = ["m1", "ground"]
law = "k*d + c*v"
coefficients = { k = 2e4, c = 6.0 }
[[link]]
name = "column"
between = ["m2", "m1"]
law = "k*d + c*v"
coefficients = { k = 1.2e4, c = 3.0 }
[[link]]
name = "arm"
between = ["m3", "m1"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = 8e3, k3 = 3e9, c = 3.0 }
[[link]]
name = "tip"
between = ["m4", "m2"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = 3e3, k3 = 2e9, c = 1.0 }
"""


def blows(times: np.ndarray) -> lw.model.Sampled:
    """Half sines that start at the given times in s, and are recorded as the force channel of a hammer is."""
    time = np.arange(round(DURATION * RATE) + 1) / RATE
    after = time[:, None] - times
    force = np.where((after >= 0.0) & (after < HIT), PEAK * np.sin(np.pi * after / HIT), 0.0)
    return lw.model.Sampled(0.0, RATE, force.sum(axis=1))


def of_chain(n: int, sensor: str) -> tuple[lw.Structure, lw.Record]:
    chain = lw.bnes_chain(n)
    release = {"v:m1": 1.0 if n == 2 else 3.0}
    return chain, lw.simulate(chain, release=release, duration=DURATION, rate=RATE, sensors=(sensor,))


def of_rig() -> tuple[lw.Structure, lw.Record]:
    rig = lw.parse_structure(RIG)
    forces = {"m1": blows(np.array([0.1, 3.1])), "m4": blows(np.array([1.6, 4.6]))}
    return rig, lw.simulate(rig, forces=forces, duration=DURATION, rate=RATE, sensors=("a",))


CASES: dict[str, tuple[Callable[[], tuple[lw.Structure, lw.Record]], float]] = {
    f"chain of {n}, {word} alone": (lambda n=n, sensor=sensor: of_chain(n, sensor), 30.0)  # type: ignore[misc]
    for n in (2, 4, 6)
    for sensor, word in (("v", "velocities"), ("a", "accelerations"))
}
CASES["hammer rig, accelerations alone"] = (of_rig, 25.0)


@pytest.mark.parametrize("name", CASES)
def test_structures_without_displacements(name: str) -> None:
    simulated, decibel = CASES[name]
    truth, clean = simulated()
    exact, graphs, trusted, unnamed, false_certain, seconds = 0, 0, 0, 0, 0, []
    print()
    for seed in range(FIRST, FIRST + SEEDS):
        started = perf_counter()
        found = lw.discover(clean.with_noise(decibel, seed=seed), masses(truth))
        seconds.append(perf_counter() - started)
        mine, true = graph(found.structure), graph(truth)
        right = terms(truth)
        exact, graphs = exact + (terms(found.structure) == right), graphs + (mine == true)
        trusted += found.trusted
        doubtful = {frozenset(term.between) for term in found.doubtful}
        unnamed += len((mine ^ true) - doubtful)
        false_certain += sum(
            term.certain and term.kept != ((frozenset(term.between), term.term.replace(" ", "")) in right)
            for term in found.terms
        )
        if mine != true:
            wrong = [
                f"{word} {'-'.join(sorted(pair))}"
                for word, pairs in (("missing", true - mine), ("false", mine - true))
                for pair in pairs
            ]
            print(f"  seed {seed}: {', '.join(wrong)}; {found.estimate.message[:100]}", flush=True)
    print(
        f"{name}, {decibel:g} dB: exact {exact} of {SEEDS}, graph {graphs}, trusted {trusted}; "
        f"wrong links not named as doubtful {unnamed}, "
        f"false decisions told as certain {false_certain}; median {np.median(seconds):.1f} s"
    )
    assert unnamed == 0
    assert false_certain == 0
