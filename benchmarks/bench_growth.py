"""How cost and memory grow with the masses, with the samples and with states of links: maximum likelihood, the weak form and
discovery.

Every run stands in a process of its own, so that its peak memory is its own; times are those of whole calls without the
simulation, in the unit U, medians of RUNS records. LINKWISE_GROWTH_RUNS and LINKWISE_GROWTH_MASSES (the largest chain) make it
shorter.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from math import log10
from multiprocessing import get_context
from statistics import median
from time import perf_counter, process_time
from typing import ParamSpec, TypeVar

import numpy as np
import pytest
from within import masses as kilograms
from within import terms

import linkwise as lw
from linkwise.model.law import Law

RUNS = int(os.environ.get("LINKWISE_GROWTH_RUNS", "5"))
LARGEST = int(os.environ.get("LINKWISE_GROWTH_MASSES", "100"))
FIRST = 1000
DURATION, RATE = 6.0, 1000.0
CHAINS = {2: 0.2, 10: 1.2, 20: 3.0, 40: 7.0, 100: 20.0}
"""U that a chain of so many masses may take by maximum likelihood."""
EXPONENT = 1.3
GRID_SIDE, GRID_UNITS = 7, 30.0
MOST_MEMORY = 2e9
NUMBER = lw.Coefficient.number


@dataclass(frozen=True)
class Run:
    """Of one call: seconds, peak memory in bytes, whether trusted, rms of z and the share of intervals that cover, steps, and
    seconds of the processor, which do not depend on what else runs.
    """

    seconds: float
    memory: float
    trusted: bool
    z: float
    coverage: float
    steps: int
    processor: float


def true_values(structure: lw.Structure, asked: lw.Structure) -> np.ndarray:
    return np.array([structure.coefficient(p.name).value for p in asked.parameters])


def identified(structure: lw.Structure, record: lw.Record, method: str = "ml") -> Run:
    """All coefficients, from record to intervals; imports and caches are paid for by a small fit before."""
    small = lw.bnes_chain(2)
    lw.identify(
        lw.simulate(small, release={"v:m1": 1.0}, duration=0.5, rate=RATE).with_noise(30.0, seed=1),
        small.unknown("all"),
        method=method,
    )
    asked = structure.unknown("all")
    steps: list[object] = []
    started, began = perf_counter(), process_time()
    fit = lw.identify(record, asked, method=method, progress=lambda report: steps.append(report.detail))
    seconds, processor = perf_counter() - started, process_time() - began
    z = (fit.values - true_values(structure, asked)) / np.sqrt(np.diag(fit.covariance))
    return Run(
        seconds,
        1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        fit.trusted,
        float(np.sqrt(np.mean(z**2))),
        float(np.mean(np.abs(z) < 1.96)),
        sum(step is not None for step in steps),
        processor,
    )


def chain_record(masses: int) -> lw.Record:
    speed = 1.0 if masses == 2 else 3.0
    return lw.simulate(lw.bnes_chain(masses), release={"v:m1": speed}, duration=DURATION, rate=RATE)


def chain_fit(masses: int, seed: int, method: str = "ml") -> Run:
    return identified(lw.bnes_chain(masses), chain_record(masses).with_noise(20.0, seed=seed), method)


def grid() -> lw.Structure:
    """Masses of 1 kg in a square, two of its corners on springs; every third link between them is bistable."""
    side = GRID_SIDE
    pairs = [(side * i + j, side * i + j + 1) for i in range(side) for j in range(side - 1)]
    pairs += [(side * i + j, side * i + j + side) for i in range(side - 1) for j in range(side)]
    linear, bistable = Law.parse("k*d + c*v"), Law.parse("alpha*d + beta*d**3 + c*v")
    spring = {"k": NUMBER(1e4), "c": NUMBER(1.0)}
    well = {"alpha": NUMBER(-2e3), "beta": NUMBER(2e7), "c": NUMBER(0.5)}
    links = [
        lw.Link(f"l{k}", (f"m{two}", f"m{one}"), *((bistable, well) if k % 3 == 2 else (linear, spring)))
        for k, (one, two) in enumerate(pairs)
    ]
    links += [lw.Link(f"g{k}", (f"m{k}", "ground"), linear, spring) for k in (0, side**2 - 1)]
    masses = tuple(lw.Mass(f"m{k}", NUMBER(1.0)) for k in range(side**2))
    return lw.Structure("grid", masses, tuple(links))


def grid_fit(seed: int) -> Run:
    structure, random = grid(), np.random.default_rng(1)
    release = {f"v:{name}": 1.5 * float(random.normal()) for name in structure.mass_names}
    record = lw.simulate(structure, release=release, duration=DURATION, rate=RATE)
    return identified(structure, record.with_noise(30.0, seed=seed))


def wide_fit(samples: int, seed: int) -> Run:
    """Two masses, driven at their bistable link's wells for as many samples."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(
        chain, duration=samples / RATE, rate=RATE, forces={"m1": "60*sin(150*t) + 40*sin(190*t)"}
    )
    return identified(chain, record.with_noise(20.0, seed=seed))


def remembering() -> lw.Structure:
    """A mass on a Bouc-Wen link, and another on a Zener link on it."""
    joint = {"k": NUMBER(400.0), "c": NUMBER(1.5), "F": NUMBER(12.0), "x0": NUMBER(0.02), "s": NUMBER(0.7)}
    mount = {"k": NUMBER(300.0), "k1": NUMBER(600.0), "c1": NUMBER(12.0)}
    links = (
        lw.model.named_law("bouc-wen").link("joint", ("m1", "ground"), joint),
        lw.model.named_law("zener").link("mount", ("m2", "m1"), mount),
    )
    return lw.Structure("pair", (lw.Mass("m1", NUMBER(1.0)), lw.Mass("m2", NUMBER(0.5))), links)


def remembering_fit(samples: int, seed: int) -> Run:
    """Two masses with a state in each of their links, driven by eight sines for as many samples at 200 Hz."""
    rng, structure = np.random.default_rng(seed), remembering()
    sines = zip(rng.uniform(2, 6, 8), rng.uniform(4, 60, 8), rng.uniform(0, 6, 8), strict=True)
    force = " + ".join(f"{a:.4f}*sin({w:.5f}*t + {p:.4f})" for a, w, p in sines)
    record = lw.simulate(structure, duration=(samples - 1) / 200.0, rate=200.0, forces={"m1": force})
    return identified(structure, record.with_noise(40.0, seed=seed))


@dataclass(frozen=True)
class Discovered:
    """Of one discovery: seconds, peak memory in bytes, and how many springs and cubic terms are missing or false."""

    seconds: float
    memory: float
    wrong: int
    dampers: int


def chain_discovery(masses: int, seed: int) -> Discovered:
    chain = lw.bnes_chain(masses)
    record = chain_record(masses).with_noise(30.0, seed=seed)
    started = perf_counter()
    found = lw.discover(record, kilograms(chain))
    seconds = perf_counter() - started

    mine, true = terms(found.structure), terms(chain)
    wrong = [text for _, text in mine ^ true]
    return Discovered(
        seconds,
        1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        sum(text != "v" for text in wrong),
        wrong.count("v"),
    )


P, T = ParamSpec("P"), TypeVar("T")


def alone(call: Callable[P, T], *arguments: P.args, **keywords: P.kwargs) -> T:
    """The result of a call in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        return executor.submit(call, *arguments, **keywords).result()


def row(what: str, runs: Sequence[Run], unit: float) -> str:
    seconds, memory = median(run.seconds for run in runs), max(run.memory for run in runs)
    z = float(np.sqrt(np.mean([run.z**2 for run in runs])))
    return (
        f"{what:<22} {sum(run.trusted for run in runs)}/{len(runs)}   {z:5.2f}   "
        f"{100 * np.mean([run.coverage for run in runs]):5.1f} %   {median(run.steps for run in runs):5.0f}   "
        f"{seconds:8.2f}   {seconds / unit:7.2f}   {memory / 1e9:5.2f}"
    )


HEAD = "record                 trusted  z rms   covered    steps    seconds      in U      GB"


def test_chains(unit: float) -> None:
    print(f"\nU = {unit:.2f} s\n{HEAD}")
    costs = {}
    for masses in (n for n in CHAINS if n <= LARGEST):
        runs = [alone(chain_fit, masses, FIRST + k) for k in range(RUNS)]
        print(row(f"chain, n = {masses}", runs, unit), flush=True)
        assert all(run.trusted for run in runs)
        assert max(run.memory for run in runs) < MOST_MEMORY
        costs[masses] = median(run.seconds for run in runs) / unit
    if LARGEST >= 20:
        last = max(costs)
        exponent = log10(costs[last] / costs[10]) / log10(last / 10)
        print(f"exponent from 10 to {last} masses: {exponent:.2f}")
        assert exponent < EXPONENT
    assert all(cost < CHAINS[masses] for masses, cost in costs.items())


def test_grid(unit: float) -> None:
    print(f"\n{HEAD}")
    runs = [alone(grid_fit, FIRST + k) for k in range(RUNS)]
    print(row(f"grid, {GRID_SIDE} x {GRID_SIDE}", runs, unit), flush=True)
    assert all(run.trusted for run in runs)
    assert median(run.seconds for run in runs) < GRID_UNITS * unit


def test_weak_form(unit: float) -> None:
    print(f"\n{HEAD}")
    runs = [alone(chain_fit, 10, FIRST + k, "weak") for k in range(RUNS)]
    print(row("weak form, n = 10", runs, unit), flush=True)
    print(f"1/{unit / median(run.seconds for run in runs):.0f} U")
    assert median(run.seconds for run in runs) < unit / 45.0


@pytest.mark.parametrize("samples", [100_000, 1_000_000])
def test_wide_records(unit: float, samples: int) -> None:
    print(f"\n{HEAD}")
    run = alone(wide_fit, samples, FIRST)
    print(row(f"{samples} samples", [run], unit), flush=True)
    assert run.trusted
    assert run.seconds < 90.0 and run.memory < MOST_MEMORY


def test_wide_records_of_links_with_memory(unit: float) -> None:
    print(f"\n{HEAD}")
    runs = []
    for samples in (25_000, 50_000, 100_000):
        runs.append(alone(remembering_fit, samples, FIRST))
        print(row(f"2 states, {samples}", runs[-1:], unit), flush=True)
    assert all(run.trusted for run in runs)
    print(f"CPU-s: {', '.join(f'{run.processor:.1f}' for run in runs)}")
    assert runs[-1].processor < 30.0
    first, second = np.diff([run.memory for run in runs])
    assert second < 2.5 * first  # of 25 000 and 50 000 samples more: 2 where it is linear


@pytest.mark.parametrize("masses", [10, 40, 100])
def test_discovery(unit: float, masses: int) -> None:
    if masses > LARGEST:
        pytest.skip("larger than asked for")
    found = alone(chain_discovery, masses, FIRST)
    print(
        f"\ndiscovery, n = {masses}: {found.seconds:.1f} s, {found.seconds / unit:.1f} U, {found.memory / 1e9:.2f} GB; "
        f"wrong springs and cubic terms {found.wrong}, wrong dampers {found.dampers}"
    )
    assert found.wrong == 0 and found.memory < MOST_MEMORY
    assert found.seconds < {10: 6.0 * unit, 40: 40.0, 100: 300.0}[masses]
