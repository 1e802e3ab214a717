"""Structures of many masses, whose equations are those of neighbourhoods, on several graphs."""

from collections.abc import Iterable, Sequence

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record, truth
from structures import HARDENING, link, named, structure, with_links
from within import assert_within

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import fit_bytes, require_room
from linkwise.likelihood.starts.values import starting_values

pytestmark = pytest.mark.slow


def linked(name: str, pairs: Iterable[tuple[int, int]], count: int, **values: lw.Coefficient) -> lw.Structure:
    """Masses of 1 kg with hardening links between pairs of them, -1 for the ground."""
    links = (
        link(
            f"l{number}",
            f"m{first}-" + ("ground" if second < 0 else f"m{second}"),
            HARDENING,
            **({"k": 2e4 + 500.0 * number, "k3": 3e7, "c": 2.0} | (values if number else {})),
        )
        for number, (first, second) in enumerate(pairs)
    )
    return structure({f"m{k}": 1.0 for k in range(count)}, *links, name=name)


def grid(side: int) -> lw.Structure:
    across = [(side * i + j, side * i + j + 1) for i in range(side) for j in range(side - 1)]
    down = [(side * i + j, side * i + j + side) for i in range(side - 1) for j in range(side)]
    return linked("grid", [(0, -1), *across, *down], side * side)


def tree(count: int) -> lw.Structure:
    return linked("tree", [(k, (k - 1) // 2 if k else -1) for k in range(count)], count)


def with_memory(count: int) -> lw.Structure:
    """A chain with a hysteretic link in its middle."""
    chain = linked("chain with memory", [(k, k - 1) for k in range(count) if k != 5], count)
    return with_links(chain, named("joint", "m5-m4", "bouc-wen", k=400.0, c=1.5, F=12.0, x0=0.002, s=0.7))


def shared(count: int) -> lw.Structure:
    """A chain of which all links have the same damping."""
    damping = lw.Coefficient.shared("l0.c")
    return linked("shared", [(k, k - 1) for k in range(count)], count, c=damping)


MANY: dict[str, tuple[lw.Structure, Sequence[str]]] = {
    "grid": (grid(4), ("x",)),
    "shared coefficients and unknown masses": (shared(12), ("x",)),
    "links with memory": (with_memory(10), ("x", "state")),
    "velocities and accelerations": (tree(12), ("v", "a")),
}


@pytest.mark.parametrize("name", MANY)
def test_coefficients_are_found_on_several_graphs(name: str) -> None:
    """Equations are those of neighbourhoods there; five standard errors, 6e-7 of chance."""
    true, sensors = MANY[name]
    release = {f"v:{mass}": (-1.0) ** k * (0.5 + 0.1 * k) for k, mass in enumerate(true.mass_names)}
    record = lw.simulate(true, release=release, duration=1.0, rate=1000.0, sensors=sensors)
    unknown = true.unknown("all", *(("mass:m3", "mass:m11") if "masses" in name else ()))
    fit = lw.identify(record.with_noise(40.0, seed=1), unknown)
    assert_within(fit, true, 5.0)


def test_intervals_of_many_masses() -> None:
    """The errors of all coefficients, weighed by their covariance: between the quantiles of 0.1 % and 99.9 %, for one seed."""
    chain = lw.bnes_chain(14)
    record = chain_record(14, duration=1.5).with_noise(20.0, seed=1000)
    fit = lw.identify(record, chain.unknown("all"))
    error = fit.values - truth(chain, fit.given_structure)
    assert fit.trusted and len(error) == 35
    low, high = scipy.stats.chi2.ppf([0.001, 0.999], len(error))
    assert low < error @ np.linalg.solve(fit.covariance, error) < high


@pytest.mark.parametrize("beta", [1.0, 1.5])
def test_a_cubic_term_that_is_held_too_large_leaves_more_than_noise(beta: float) -> None:
    record, chain = chain_record(14, duration=1.0).with_noise(20.0, seed=1002), lw.bnes_chain(14)
    held = present(chain.coefficient("nes3.beta").value) * beta
    asked = chain.unknown("all").with_values({"nes3.beta": held}).unknown("nes3.alpha", "nes3.c")
    options = LikelihoodOptions(ceiling=1.5, model_error=False)
    start, spread = starting_values([record], asked)
    fit = likelihood_fit([record], asked, start, spread=spread, options=options)
    assert fit.chi_square_off is (beta > 1.0)


def test_a_fit_without_room_is_refused_before_the_work() -> None:
    """200 masses over 6 s at 1 kHz: three dense blocks a node, 4.6 GB, and 3.8 GB of the border."""
    needed = fit_bytes(1200, 200, 400, 500)
    assert 3 * 8 * 1200 * 400**2 < needed < 9e9
    require_room(1200, 200, 400, 500, free=needed)
    with pytest.raises(
        lw.IdentificationError, match=r"for 200 masses over 1200 segments .* needs 8.45 GB, and 2 GB are free"
    ):
        require_room(1200, 200, 400, 500, free=2_000_000_000)
