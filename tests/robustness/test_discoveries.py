"""Records that say too little: discovery ends with an answer or a reason, never with the failure of a matrix."""

from __future__ import annotations

import numpy as np
import pytest
from problems import chain_record
from structures import link, structure

import linkwise as lw
from linkwise.discovery.evidence import _larger
from linkwise.discovery.selection import QuadraticModel


def random_chain(rng: np.random.Generator) -> tuple[lw.Structure, float]:
    """A tree of 2 to 4 masses with linear, cubic and bistable links, and its highest frequency in Hz, near enough."""
    n = int(rng.integers(2, 5))
    masses: dict[str, float] = {}
    links, highest = [], 0.0
    for i in range(n):
        mass = float(10.0 ** rng.uniform(-2.0, 1.0))
        omega = 2.0 * np.pi * 10.0 ** rng.uniform(0.0, 1.3)
        highest = max(highest, omega / (2.0 * np.pi))
        k, c, size = mass * omega**2, 0.04 * mass * omega, 0.01
        law, values = [
            ("k*d + c*v", {"k": k, "c": c}),
            ("k*d + k3*d**3 + c*v", {"k": k, "k3": 0.5 * k / size**2, "c": c}),
            ("alpha*d + beta*d**3 + c*v", {"alpha": -k, "beta": k / size**2, "c": c}),
        ][int(rng.integers(3))]
        below = "ground" if i == 0 else f"m{rng.integers(1, i + 1)}"
        masses[f"m{i + 1}"] = mass
        links.append(link(f"l{i + 1}", f"m{i + 1}-{below}", law, **values))
    return structure(masses, *links, name="random"), highest


def attempt(record: lw.Record, masses: dict[str, float]) -> None:
    """An answer, or an error with a reason; any warning is an error of the test."""
    try:
        discovery = lw.discover(record, masses)
    except lw.IdentificationError as error:
        assert "m" in str(error)
        return
    assert str(discovery) and discovery.path and discovery.terms


@pytest.mark.parametrize("seed", [1, 2])
def test_the_chain_at_a_rate_that_is_too_low(seed: int) -> None:
    """100 Hz and 20 dB: four samples for a period of the sink."""
    record = chain_record(2, duration=3.0, rate=100.0)
    attempt(record.with_noise(20.0, seed=seed), {"m1": 1.0, "m2": 0.01})


@pytest.mark.parametrize("seed", range(4))
def test_random_records_of_any_rate_and_noise(seed: int) -> None:
    """5 to 50 samples for a period, 10 to 40 dB; the benchmark has more of them."""
    rng = np.random.default_rng(seed)
    subject, highest = random_chain(rng)
    rate = float(highest * 10.0 ** rng.uniform(0.7, 1.7))
    release = {f"v:m{rng.integers(1, subject.size + 1)}": 0.06 * highest}
    record = lw.simulate(subject, release=release, duration=min(20.0 / highest * 2.0, 1200 / rate), rate=rate)
    noisy = record.with_noise(float(rng.uniform(10.0, 40.0)), seed=seed)
    attempt(noisy, dict(zip(subject.mass_names, map(float, subject.mass_values), strict=True)))


def test_larger_models_end_where_all_others_depend_on_those_there_are() -> None:
    columns = np.random.default_rng(0).standard_normal((50, 3))
    columns = np.column_stack([columns, columns[:, 0] + columns[:, 1]])
    model = QuadraticModel(("a", "b", "c", "a + b"), columns.T @ columns, columns.T @ columns[:, 2])
    assert [numbers for numbers, _ in _larger(model, [0, 1])] == [[0, 1, 2]]


def test_a_variance_below_zero_is_no_deviation() -> None:
    model = QuadraticModel(("a",), np.eye(1), np.ones(1), scatter=-np.eye(1))
    assert np.isnan(model.solve([0]).z).all()
