"""Ten masses simulated and their full cubic library fitted, by linkwise and by peers in one run: `make benchmark BENCH=peers`.

Each comparison runs in a process of its own for each of OpenBLAS's kernels that this processor can run, with one BLAS thread.
Ours and theirs take turns, and medians of processor time are compared, so that a busy machine slows both alike. The library
needs the extra [peers] (`.venv/bin/pip install -e '.[peers]'`) and is skipped without it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import Any

import heyoka
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_info

import linkwise as lw
from linkwise.simulation.integrator.taylor import TOLERANCE

KERNELS = {"Haswell": "avx2", "SkylakeX": "avx512f"}  # of OpenBLAS, and what the processor needs for each
THRESHOLD, PASSES = 0.01, 5
SEED = 1000
MASSES, SPEED, DURATION, RATE = 10, 3.0, 6.0, 1000.0
SENSORS = ("x", "v", "a")

Times = dict[str, list[float]]


def taking_turns(work: dict[str, Callable[[], object]], rounds: int) -> Times:
    """Processor time in s of each piece of work in every round; a first run of each, which loads and compiles, is left out."""
    for run in work.values():
        run()
    times: Times = {name: [] for name in work}
    for _ in range(rounds):
        for name, run in work.items():
            started = process_time()
            run()
            times[name].append(process_time() - started)
    return times


def record() -> lw.Record:
    return lw.simulate(
        lw.bnes_chain(MASSES), release={"v:m1": SPEED}, duration=DURATION, rate=RATE, sensors=SENSORS
    )


def simulation() -> Times:
    """simulate(), heyoka's grid by its own tolerance and by ours, and SciPy's DOP853 with a right-hand side in NumPy."""
    chain, grid = lw.bnes_chain(MASSES), np.arange(DURATION * RATE + 1) / RATE
    incidence, masses = chain.incidence.toarray(), chain.mass_values
    linear = np.array([link.values.get("k", link.values.get("alpha")) for link in chain.links])
    cubic = np.array([link.values.get("beta", 0.0) for link in chain.links])
    damping = np.array([link.values["c"] for link in chain.links])
    start = np.zeros(2 * MASSES)
    start[MASSES] = SPEED

    down, up = incidence.T.copy(), -incidence / masses[:, None]

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        d, v = down @ state[:MASSES], down @ state[MASSES:]
        return np.concatenate([state[MASSES:], up @ ((linear + cubic * d * d) * d + damping * v)])

    x, v = (heyoka.make_vars(*(f"{name}{mass}" for mass in range(MASSES))) for name in "xv")
    forces: list[list[Any]] = [[] for _ in x]
    for link, ends in enumerate(incidence.T):
        signs = [(float(sign), mass) for mass, sign in enumerate(ends) if sign]
        d, rate = (sum(sign * variable[mass] for sign, mass in signs) for variable in (x, v))
        # a power has no Taylor series at 0, products do
        force = linear[link] * d + damping[link] * rate + (cubic[link] * d * d * d if cubic[link] else 0.0)
        for sign, mass in signs:
            forces[mass].append(-sign * force)
    rates = [heyoka.sum(forces[mass]) / float(masses[mass]) for mass in range(MASSES)]
    equations = [*zip(x, v, strict=True), *zip(v, rates, strict=True)]

    def grid_of(taylor: Any) -> Callable[[], object]:
        def run() -> object:
            taylor.time, taylor.state[:] = 0.0, start
            return taylor.propagate_grid(grid)

        return run

    run = {
        "linkwise": lambda: lw.simulate(chain, release={"v:m1": SPEED}, duration=DURATION, rate=RATE),
        "heyoka": grid_of(heyoka.taylor_adaptive(equations, start)),
        "heyoka at our tolerance": grid_of(
            heyoka.taylor_adaptive(equations, start, tol=TOLERANCE, fast_math=True)
        ),
    }
    times = taking_turns(run, 41)
    dop853 = lambda: solve_ivp(slope, (0.0, DURATION), start, "DOP853", grid, rtol=1e-9, atol=1e-12)  # noqa: E731
    return times | taking_turns({"DOP853": dop853}, 5)


def library() -> Times:
    """1771 columns, 6001 rows, 20 equations, one threshold, five passes, columns normalised.

    What is easier for the peer is left to it: its columns are ready before its clock starts, ours are computed within ours.
    Targets have unit norm, so its threshold on normalised columns is the share of the right-hand side that ours is.
    """
    peer = __import__("pysindy")
    warnings.filterwarnings("ignore", "STLSQ did not converge")  # five passes are what is compared
    system = lw.sindy.monomial_equations(lw.sindy.noisy_states(record(), "states", 20.0, seed=SEED), 3)
    stored = system.stored()
    norms = np.linalg.norm(stored.target, axis=0)
    matrix, target = np.ascontiguousarray(stored.matrix), stored.target / norms
    optimizer = peer.STLSQ(threshold=THRESHOLD, alpha=1e-10, max_iter=PASSES, normalize_columns=True)
    times: Times = taking_turns({"linkwise": lambda: lw.sindy.Stlsq(THRESHOLD).fit(system)}, 5)
    started = process_time()
    optimizer.fit(matrix, target)
    times["PySINDy"] = [process_time() - started]
    times["linkwise"] += taking_turns({"linkwise": lambda: lw.sindy.Stlsq(THRESHOLD).fit(system)}, 5)[
        "linkwise"
    ]
    fit = lw.sindy.Stlsq(THRESHOLD).fit(system)
    apart = np.abs(optimizer.coef_ - fit.coefficients.T / norms[:, None]) * np.linalg.norm(matrix, axis=0)
    same = (optimizer.coef_ != 0) == fit.support.T
    assert same.mean() > 0.99
    assert np.max(apart[same.all(axis=1)], initial=0.0) < 1e-6
    return times


@pytest.fixture(params=KERNELS)
def kernel(request: pytest.FixtureRequest) -> str:
    """A kernel of OpenBLAS; skipped where this processor cannot run it."""
    name: str = request.param
    processor = Path("/proc/cpuinfo")
    if not processor.is_file() or KERNELS[name] not in processor.read_text(encoding="ascii").split():
        pytest.skip(f"this processor has no {KERNELS[name]}")
    return name


def measured(kernel: str, work: str) -> Times:
    """Times of `work` in a process with this kernel and one BLAS thread."""
    settings = {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, __file__, work],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    assert answer["kernels"] == [[kernel, 1]]
    times: Times = answer["times"]
    for name, seconds in times.items():
        low, middle, high = np.percentile(seconds, [25, 50, 75])
        print(f"\n{kernel}: {name} {middle:.4g} s ({low:.4g} to {high:.4g})", end="")
    print()
    return times


def test_ten_masses_take_little_more_than_heyokas_own_grid(kernel: str) -> None:
    times = measured(kernel, "simulation")
    ours = times.pop("linkwise")
    ratio = {name: np.median(ours) / np.median(theirs) for name, theirs in times.items()}
    print(
        f"{kernel}: simulate() takes {ratio['heyoka']:.2f} times heyoka's grid, "
        f"{ratio['heyoka at our tolerance']:.2f} times at our tolerance; {1 / ratio['DOP853']:.0f} times faster than DOP853"
    )
    assert ratio["heyoka"] < 1.3
    assert ratio["DOP853"] < 1 / 100


@pytest.mark.skipif(find_spec("pysindy") is None, reason="install the extra [peers] to compare with PySINDy")
def test_the_full_library_is_fitted_sixty_times_faster_than_by_pysindy(kernel: str) -> None:
    times = measured(kernel, "library")
    ratio = np.median(times["PySINDy"]) / np.median(times["linkwise"])
    print(f"{kernel}: {ratio:.0f} times faster than PySINDy")
    assert ratio > 60


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.exit(pytest.main(["-q", "-s", __file__]))
    taken = {"simulation": simulation, "library": library}[sys.argv[1]]()
    loaded = {
        (found["architecture"], found["num_threads"])
        for found in threadpool_info()
        if found["user_api"] == "blas"
    }
    print(json.dumps({"kernels": sorted(loaded), "times": taken}))
