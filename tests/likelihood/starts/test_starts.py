"""Starts where no displacement is seen: elongations and coefficients read from forces, on seeds that trials never used."""

from __future__ import annotations

import numpy as np
import pytest
from present import present, some
from problems import chain_fit, chain_record
from structures import link, row_of_masses, structure

import linkwise as lw
from linkwise.likelihood.starts.coefficients import law_start
from linkwise.likelihood.starts.drift_tracking import elongations_from_forces
from linkwise.likelihood.starts.inverse_dynamics import (
    determines_links,
    link_signals,
    masses_from_links,
    needs_integration,
)
from linkwise.likelihood.starts.values import starting_values
from linkwise.signals.noise import channel_noise


def noisy(n: int, kind: str, seed: int) -> lw.Record:
    return chain_record(n, duration=3.0, sensors=(kind,)).with_noise(30.0, seed=seed)


def deviations(fit: lw.Estimate, true: lw.Structure) -> np.ndarray:
    """Errors of the coefficients in standard errors."""
    names = [parameter.name for parameter in fit.parameters]
    errors = fit.values - [true.coefficient(name).value for name in names]
    return np.asarray(errors / np.sqrt(np.diag(fit.covariance)))


@pytest.mark.parametrize(("n", "kind"), [(2, "v"), (2, "a"), (4, "v")])
def test_elongations_follow_from_forces(n: int, kind: str) -> None:
    true = lw.bnes_chain(n)
    record = noisy(n, kind, 1000)
    d, v = elongations_from_forces(link_signals(record, true, channel_noise(record)), true.links)
    for computed, exact in (
        (d, true.elongations(present(record.simulated).displacement).T),
        (v, true.elongations(present(record.simulated).velocity).T),
    ):
        # noise of 3 % in a force moves a place by a few per cent; a stretch on a wrong branch is off by wells, 100 %.
        # On seeds 2000 to 2007 the largest error was 6 to 61 % of the deviation, the mean one 1.1 to 3.5 %.
        assert np.abs(computed - exact).max() < exact.std()
        # twice the mean of those seeds, and a twentieth of what a wrong branch leaves
        assert np.sqrt(np.mean((computed - exact) ** 2, axis=1) / exact.var(axis=1)).max() < 0.05


def test_a_wrong_law_is_no_inverse() -> None:
    true = lw.bnes_chain(2)
    wrong = true.unknown("nes1.alpha").with_values({"nes1.alpha": 100.0})
    record = noisy(2, "v", 1000)
    d, _ = elongations_from_forces(link_signals(record, wrong, channel_noise(record)), wrong.links)
    exact = true.elongations(present(record.simulated).displacement).T
    # on seeds 2000 to 2007 72 %, where the true law leaves 2 %
    assert np.sqrt(np.mean((d[1] - exact[1]) ** 2)) > 0.2 * exact[1].std()


def test_integrated_velocities_alone_would_be_lost() -> None:
    true = lw.bnes_chain(2)
    record = noisy(2, "v", 1000)
    signals = link_signals(record, true, channel_noise(record))
    exact = true.elongations(present(record.simulated).displacement).T
    # a random walk: on seeds 2000 to 2007 it ends 33 to 120 % off, inverse dynamics 6 to 15 %
    assert np.abs(signals.d - exact)[1].max() > 0.2 * exact[1].std()


@pytest.mark.parametrize("kind", ["v", "a"])
def test_coefficients_follow_from_forces_without_any_start(kind: str) -> None:
    true = lw.bnes_chain(2)
    unknown, record = true.unknown("all"), noisy(2, kind, 1000)
    starts = law_start(record, unknown, channel_noise(record), {})
    for name in ("spring1.k", "nes1.alpha", "nes1.beta"):
        assert starts[name] == pytest.approx(true.coefficient(name).value, rel=0.1)  # annealing needs 20 %


def test_a_nonlinear_coefficient_needs_a_start() -> None:
    chain = lw.bnes_chain(2)
    slip = structure(
        {"m1": 1.0, "m2": 0.01}, link("slip1", "m1-ground", "k*d + F*tanh(v/s)"), chain.link("nes1")
    )
    with pytest.raises(lw.IdentificationError, match=r"not linear in s, which needs a start"):
        law_start(noisy(2, "v", 1000), slip, channel_noise(noisy(2, "v", 1000)), {})


def test_a_nonlinear_coefficient_starts_beside_linear_ones_that_forces_tell() -> None:
    def chain(**values: float) -> lw.Structure:
        slip = link("slip1", "m1-ground", "k*d + F*tanh(v/s)", **values)
        return structure({"m1": 1.0, "m2": 0.01}, slip, lw.bnes_chain(2).link("nes1"))

    true = {"k": 30000.0, "F": 8.0, "s": 0.3}
    run = lw.simulate(chain(**true), release={"v:m1": 3.0}, duration=3.0, rate=1000.0, sensors=["v"])
    record = run.with_noise(30.0, seed=2010)
    starts = law_start(record, chain(), channel_noise(record), {"slip1.s": 0.2})
    assert starts["slip1.k"] == pytest.approx(true["k"], rel=0.1)  # annealing needs 20 %
    for name in ("F", "s"):  # they were not numbers
        assert 0.5 * true[name] < starts[f"slip1.{name}"] < 2.0 * true[name]


def test_masses_follow_from_elongations() -> None:
    true = lw.bnes_chain(4)
    record = chain_record(4, sensors=("v",))
    moved = present(record.simulated)
    x, v = masses_from_links(
        record, true, true.elongations(moved.displacement).T, true.elongations(moved.velocity).T
    )
    assert np.abs(x - moved.displacement.T).max() < 1e-12  # identity
    assert np.abs(v - moved.velocity.T).max() < 1e-12


def test_what_tells_links() -> None:
    chain = lw.bnes_chain(2)
    record = noisy(2, "v", 1000)
    assert determines_links(record, chain)
    assert needs_integration(record, chain)
    assert not determines_links(record.select(["v:m1"]), chain)
    assert not determines_links(record, chain.unknown("mass:m2"))
    displaced = chain_record(2)
    assert determines_links(displaced, chain)
    assert not needs_integration(displaced, chain)


@pytest.mark.parametrize(
    ("n", "kind", "seed"), [(2, "v", 1000), (2, "a", 1000), (4, "v", 1000), (4, "v", 1001), (4, "a", 1000)]
)
def test_rates_and_accelerations_alone_identify_a_chain(n: int, kind: str, seed: int) -> None:
    true = lw.bnes_chain(n)
    fit = chain_fit(n, 30.0, seed, (kind,), duration=3.0)
    assert fit.status == "converged"
    # the level of the noise is found beforehand to 1.2 % a channel of 6 s: chi-square is within 3.6 % on sixteen such records
    # of other seeds, for which 5 % were asked; it scatters by the root of the number of samples
    assert abs(present(fit.chi_square_per_sample) - 1.0) < 0.05 * np.sqrt(6.0 / 3.0)
    # all deviations within four standard errors, of 5 to 10 coefficients a run: wrong once in 1000
    assert np.abs(deviations(fit, true)).max() < 4.0


HIDDEN = row_of_masses(
    [1.0, 0.5, 0.3],
    a=("k*d + k3*d**3 + c*v", {"k": 1000.0, "k3": 1e5, "c": 0.5}),
    b=("k*d + k3*d**3 + c*v", {"k": 600.0, "k3": 2e5, "c": 0.3}),
    h=("k*d + c*v", {"k": 300.0, "c": 0.2}),
)


def test_a_hidden_mass_needs_starts_for_its_own_links_only() -> None:
    """Of the other links the weak form tells them, as it does where the mass has no unknown."""
    release, asked = {"v:m1": 0.8}, HIDDEN.unknown("all")
    record = lw.simulate(HIDDEN, release=release, duration=8.0, rate=200.0, sensors=("x:m1", "x:m2"))
    record = record.with_noise(40.0, seed=4)
    own = {"h.k": 240.0, "h.c": 0.3}
    values, _ = starting_values([record], asked, own)
    by_name = dict(zip([p.name for p in asked.parameters], values, strict=True))
    assert {name: by_name[name] for name in own} == own
    fit = lw.identify(record, asked, method=lw.MaximumLikelihood(starts=own))
    assert fit.trusted
    for parameter in some(asked.parameters):
        found, true = fit.coefficient(parameter.name), present(HIDDEN.coefficient(parameter.name).value)
        assert abs(found.value - true) < 4.0 * present(found.standard_error)
    with pytest.raises(
        lw.IdentificationError, match=r"no starting value for .* no information on h\.k, h\.c"
    ):
        lw.identify(record, asked)
    with pytest.raises(lw.IdentificationError, match=r"no starting value for a\.k.* no information on h\.c"):
        lw.identify(record, asked, method=lw.MaximumLikelihood(starts={"h.k": 240.0}))
