"""The classical cubic library of ten masses against the machine's own matrix product: `make benchmark`."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

from linkwise.chains import bnes_chain
from linkwise.derive import differentiate
from linkwise.equations import StreamedEquations
from linkwise.library import monomial_equations
from linkwise.noise import noise_sigma
from linkwise.simulate import simulate
from linkwise.sparse.gram import Gram
from linkwise.sparse.stlsq import Stlsq


@pytest.fixture(scope="module")
def unit() -> float:
    """U: seconds for one product of two different matrices, 1771 x 6000 by 6000 x 1771, the best of three."""
    random = np.random.default_rng(0)
    left, right = random.normal(size=(1771, 6000)), random.normal(size=(6000, 1771))
    times = []
    for _ in range(3):
        started = perf_counter()
        left @ right
        times.append(perf_counter() - started)
    return min(times)


@pytest.fixture(scope="module")
def library() -> StreamedEquations:
    record = simulate(
        bnes_chain(10), release={"v:m1": 3.0}, duration=6.0, rate=1000.0, sensors=("x", "v", "a")
    )
    return monomial_equations(differentiate(record), 3)


def test_one_fit_of_the_full_library_costs_little_more_than_one_product(
    library: StreamedEquations, unit: float
) -> None:
    forming, solving = [], []
    for _ in range(3):
        started = perf_counter()
        gram = Gram.of(library)
        formed = perf_counter()
        fit = Stlsq(1e-5).fit_gram(gram, library.units, library.targets)
        forming.append(formed - started)
        solving.append(perf_counter() - formed)
    solved = perf_counter()
    chosen = Stlsq().fit_gram(gram, library.units, library.targets)
    path = perf_counter() - solved
    print(
        f"\n1771 columns, 6001 rows, 20 targets: Gram {min(forming) / unit:.2f} U, STLSQ "
        f"{min(solving) / unit:.2f} U, with the threshold chosen on its path {path / unit:.2f} U (U = {unit:.2f} s)"
    )
    np.testing.assert_array_equal(fit.support, chosen.support)
    assert (
        fit.support.sum() == 10 + 2 * 10 + 3 * 12 + 5 * 8
    )  # x' = v; frames at both ends, frames between, sinks
    assert min(forming) + min(solving) < 2 * unit


def test_the_noise_of_ten_channels_is_told_within_a_millisecond() -> None:
    samples = np.random.default_rng(1).normal(size=(6001, 10))
    times = []
    for _ in range(20):
        started = perf_counter()
        noise_sigma(samples)
        times.append(perf_counter() - started)
    print(f"\nnoise_sigma of 6001 x 10: {1e3 * min(times):.2f} ms")
    assert min(times) < 1e-3
