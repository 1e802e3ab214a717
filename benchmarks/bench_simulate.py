"""Simulation against SciPy's DOP853, large chains, long inputs, and the margins to the 400-bit orbits: `make benchmark`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import heyoka
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Sampled
from linkwise.model.law import Law
from linkwise.model.structure import Coefficient, Link, Mass, Structure
from linkwise.records.record import Record
from linkwise.simulation.integrator.taylor import system_of_thread
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


@pytest.fixture(scope="module")
def dop853() -> float:
    """Seconds of SciPy's DOP853 for 10 masses, 6 s, 6001 samples, with a right-hand side in NumPy, the best of three."""
    structure = bnes_chain(10)
    incidence, masses, n = structure.incidence.toarray(), structure.mass_values, structure.size
    linear = np.array([link.values.get("k", link.values.get("alpha")) for link in structure.links])
    cubic = np.array([link.values.get("beta", 0.0) for link in structure.links])
    damping = np.array([link.values["c"] for link in structure.links])
    down, up = incidence.T.copy(), -incidence / masses[:, None]

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        d, v = down @ state[:n], down @ state[n:]
        return np.concatenate([state[n:], up @ ((linear + cubic * d * d) * d + damping * v)])

    start, times = np.zeros(2 * n), np.arange(6001) / 1000.0
    start[n] = 3.0
    return best(lambda: solve_ivp(slope, (0.0, 6.0), start, "DOP853", times, rtol=1e-9, atol=1e-12), 3)


def test_ten_masses_a_hundred_times_faster_than_scipy(dop853: float) -> None:
    first = afresh(lambda: chain(10))
    again = best(lambda: chain(10), 30)
    record = chain(10)
    energy = best(lambda: record.simulated.diagnostics.energy, 1)
    horizon = best(lambda: record.simulated.diagnostics.horizon, 1)
    balance = np.abs(record.simulated.energy.residual).max() / record.simulated.energy.supplied.max()
    print(
        f"\n10 masses, 6 s, 6001 samples: DOP853 {dop853:.3f} s; simulate() {again * 1e3:.1f} ms, {dop853 / again:.0f} times "
        f"faster; with compilation {first:.2f} s\n  when asked: energies {energy * 1e3:.0f} ms (closing to {balance:.0e}), "
        f"horizon {horizon * 1e3:.1f} ms ({record.simulated.horizon} s)"
    )
    assert again < dop853 / 100.0
    assert first < dop853


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
