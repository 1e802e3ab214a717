"""How far maximum likelihood reaches: starts off by a factor of two, a hidden primary, a million samples: `make benchmark`."""

from __future__ import annotations

import subprocess
import sys
from time import perf_counter

import numpy as np

import linkwise as lw

FIRST = 1000  # seed

LONG = """
import resource
import sys
import linkwise as lw

chain = lw.bnes_chain(2)
seen = []

def enough(report):
    seen.append(report)
    if len(seen) == 5:
        raise KeyboardInterrupt

record = lw.simulate(
    chain, duration=999.999, rate=1000.0, release={"v:m1": 1.0}, forces={"m1": "20*sin(150*t) + 15*sin(190*t)"}
).with_noise(30.0, seed=1)
fit = lw.identify(record, chain.unknown("all"), progress=enough)
print(len(record), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


def tried(n: int, decibel: float, factor: float, seeds: int, *sensors: str) -> tuple[int, int, float]:
    """How many fits of so many seeds are trusted, how many of these within 5 deviations of the truth, and seconds a fit."""
    chain = lw.bnes_chain(n)
    asked = chain.unknown("all")
    true = {p.name: float(chain.coefficient(p.name).value or 0.0) for p in asked.parameters}
    clean = lw.simulate(
        chain, release={"v:m1": 1.0 if n == 2 else 3.0}, duration=6.0, rate=1000.0, sensors=sensors
    )
    trusted = right = 0
    started = perf_counter()
    for seed in range(FIRST, FIRST + seeds):
        rng = np.random.default_rng(seed)
        starts = {name: value * factor ** rng.choice([-1.0, 1.0]) for name, value in true.items()}
        fit = lw.identify(clean.with_noise(decibel, seed=seed), asked, starts=starts)
        if fit.trusted:
            trusted += 1
            z = [
                abs(fit.coefficient(name).value - value) / (fit.coefficient(name).standard_error or np.inf)
                for name, value in true.items()
            ]
            right += max(z) < 5.0
    return trusted, right, (perf_counter() - started) / seeds


def test_starts_off_by_a_factor_of_two() -> None:
    trusted, right, seconds = tried(4, 20.0, 2.0, 100, "x")
    print(f"\nn = 4, 20 dB, starts off by 2: {trusted} of 100 trusted, {right} right, {seconds:.2f} s a fit")
    assert right >= 95


def test_a_hidden_primary() -> None:
    for factor in (1.2, 2.0):
        trusted, right, seconds = tried(2, 30.0, factor, 20, "x:m2")
        print(
            f"\nn = 2, only the sink seen, starts off by {factor}: {trusted} of 20 trusted, {right} right, {seconds:.2f} s"
        )
        assert right >= 18 or factor > 1.2
    trusted, right, seconds = tried(4, 30.0, 1.2, 10, "x:m2", "x:m4")
    print(
        f"n = 4, only the sinks seen, starts off by 1.2: {trusted} of 10 trusted, {right} right, {seconds:.2f} s"
    )


def test_a_million_samples_fit_into_two_gigabytes() -> None:
    started = perf_counter()
    run = subprocess.run([sys.executable, "-c", LONG], capture_output=True, text=True, check=True)
    samples, gigabytes = (float(word) for word in run.stdout.split())
    print(
        f"\n2 masses, {samples:.0f} samples: {gigabytes:.2f} GB at the peak, five steps in {perf_counter() - started:.0f} s"
    )
    assert gigabytes < 2.0
