"""Compilation, large chains, long inputs, and the margins to the 400-bit orbits: `make benchmark`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import heyoka
import numpy as np
import pytest

from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Sampled
from linkwise.model.law import Law
from linkwise.model.structure import Coefficient, Link, Mass, Structure
from linkwise.records.record import Record
from linkwise.simulation.integrator.formulas import system_of_thread
from linkwise.simulation.simulate import simulate

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference"


def best(run: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of several runs."""
    times = []
    for _ in range(repeats):
        started = perf_counter()
        run()
        times.append(perf_counter() - started)
    return min(times)


def afresh(run: Callable[[], object]) -> float:
    """Seconds of a run that has to compile, with the caches of the compiler itself switched off."""
    system_of_thread.cache_clear()
    on = heyoka.llvm_state.get_diskcache_enabled()
    limit = heyoka.llvm_state.get_memcache_limit()
    heyoka.llvm_state.set_diskcache_enabled(False)
    heyoka.llvm_state.set_memcache_limit(0)
    try:
        return best(run, 1)
    finally:
        heyoka.llvm_state.set_memcache_limit(limit)
        heyoka.llvm_state.set_diskcache_enabled(on)


def chain(n: int, duration: float = 6.0) -> Record:
    return simulate(bnes_chain(n), release={"v:m1": 1.0 if n == 2 else 3.0}, duration=duration, rate=1000.0)


def test_ten_masses_with_compilation_and_what_is_computed_when_asked() -> None:
    first = afresh(lambda: chain(10))
    record = chain(10)
    energy = best(lambda: record.simulated.diagnostics.energy, 1)
    horizon = best(lambda: record.simulated.diagnostics.horizon, 1)
    balance = np.abs(record.simulated.energy.residual).max() / record.simulated.energy.supplied.max()
    print(
        f"\n10 masses, 6 s, 6001 samples: with compilation {first:.2f} s; when asked: energies {energy * 1e3:.0f} ms (closing "
        f"to {balance:.0e}), horizon {horizon * 1e3:.1f} ms ({record.simulated.horizon} s)"
    )
    assert first < 3.0


def test_a_thousand_masses_cost_ten_times_a_hundred() -> None:
    run = {n: best(lambda n=n: chain(n, 1.0), 3) for n in (100, 1000)}
    whole = afresh(lambda: chain(1000, 1.0))
    print(
        f"\n1 s of 100 masses {run[100] * 1e3:.0f} ms, of 1000 masses {run[1000] * 1e3:.0f} ms "
        f"({run[1000] / 10 / run[100]:.2f} times per mass); 1000 masses with compilation {whole:.1f} s"
    )
    assert whole < 60.0
    assert run[1000] / 1000 < 2.0 * run[100] / 100


@pytest.mark.parametrize("band_limited", [False, True])
def test_a_long_sampled_input_takes_seconds(band_limited: bool) -> None:
    numbers = {name: Coefficient.number(value) for name, value in {"k": 1e5, "c": 40.0, "k3": 1e6}.items()}
    link = Link("link", ("m1", "ground"), Law.parse("k*d + c*v + k3*d**3"), numbers)
    structure = Structure("oscillator", (Mass("m1", Coefficient.number(1.0)),), (link,))
    noise = np.random.default_rng(0).standard_normal(65536)
    force = Sampled(0.0, 1000.0, noise, band_limited=band_limited)
    seconds = best(lambda: simulate(structure, forces={"m1": force}, duration=65.5, rate=1000.0), 1)
    print(f"\n1 mass, 65536 samples of force{', band-limited' * band_limited}: {seconds:.2f} s")
    assert seconds < 5.0


@pytest.mark.parametrize("n", [2, 4, 6, 8, 10])
def test_margin_to_the_reference(n: int) -> None:
    if not REFERENCE.is_dir():
        pytest.skip("no reference orbits beside the checkout")
    table = np.loadtxt(REFERENCE / f"bnes_{n}.csv", delimiter=",", skiprows=1)
    values = chain(n, table[-1, 0]).values[np.rint(1000.0 * table[:, 0]).astype(int)]
    error = (np.abs(values - table[:, 1:]).max(axis=0) / np.abs(table[:, 1:]).max(axis=0)).max()
    print(
        f"\n{n} masses: {error:.1e} from the 400-bit orbit at {table[-1, 0]:g} s, {1e-6 / error:.0f} times inside 1e-6"
    )
    assert error < 1e-6
