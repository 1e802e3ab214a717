"""Absorption: 10 000 free decays over a grid of two parameters, against the time and the balance asked: `make benchmark`."""

from __future__ import annotations

from time import perf_counter

import numpy as np

import linkwise as lw


def test_ten_thousand_free_decays_in_two_minutes() -> None:
    """The two-mass chain of the paper, 6 s at the default rate, alpha and beta on 100 values each."""
    over = {"nes1.alpha": np.linspace(-200.0, -20.0, 100), "nes1.beta": np.geomspace(1e5, 2e6, 100)}
    started = perf_counter()
    found = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=6.0, release={"v:m1": 1.0})
    seconds = perf_counter() - started
    shares = sum(found[name.name] for name in found.quantities if name.name.startswith("share:"))
    apart = np.abs(shares + found["remaining"] - 1.0).max()
    print(
        f"\n{found.completed.size} free decays of 6 s: {seconds:.1f} s, {seconds / found.completed.size * 1e3:.2f} ms a run; "
        f"shares add up to 1 within {apart:.0e}; sinks take up to {100 * found['sinks_share'].max():.1f} % "
        f"at {found.best('sinks_share')}"
    )
    assert found.completed.all()
    assert seconds < 120.0
    assert apart < 1e-6


def test_one_answer_takes_a_moment() -> None:
    """The chains of the paper's Figs. 3 and 5, after compilation."""
    for n, speed in ((2, 1.0), (8, 3.0)):
        times = []
        for _ in range(3):
            started = perf_counter()
            found = lw.absorb(lw.bnes_chain(n), duration=6.0, release={"v:m1": speed})
            times.append(perf_counter() - started)
        closure = max(found.with_sinks.closure, found.without.closure)
        print(
            f"\n{n} masses with and without sinks, 6 s: {min(times) * 1e3:.0f} ms; the balance closes to {closure:.0e}"
        )
        assert min(times) < 2.0 and closure < 1e-6
