"""Where noise goes and where derivatives come from; and what force a fit in monomials of all states amounts to."""

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record
from structures import link, with_links

from linkwise.errors import IdentificationError, RecordError
from linkwise.model.chains import bnes_chain
from linkwise.records.record import Record
from linkwise.signals.states import differentiate
from linkwise.simulation.simulate import simulate
from linkwise.sindy.conventions import (
    CONVENTIONS,
    MEANING,
    READINGS,
    Convention,
    Reading,
    monomial_force,
    monomial_nmse,
    noisy_states,
)
from linkwise.sindy.library import monomial_equations
from linkwise.sindy.regression.regressor import LeastSquares, RegressionFit

CHAIN = bnes_chain(4)


@pytest.fixture(scope="module")
def record() -> Record:
    return chain_record(4, duration=2.0, sensors=("x", "v", "a"))


@pytest.fixture(scope="module")
def exact(record: Record) -> RegressionFit:
    return LeastSquares().fit(monomial_equations(differentiate(record), 3))


def _deviations(noisy: np.ndarray, clean: np.ndarray, decibel: float) -> np.ndarray:
    """Of each column's mean square from what the noise level promises, in standard deviations of a mean of squares."""
    ratio = np.mean((noisy - clean) ** 2, axis=0) / (np.mean(clean**2, axis=0) * 10 ** (-decibel / 10))
    return np.asarray((ratio - 1) / np.sqrt(2 / len(clean)))


@pytest.mark.parametrize(("convention", "noisy"), [("states", "xv"), ("derivatives", "a")])
def test_noise_goes_where_the_convention_says(record: Record, convention: Convention, noisy: str) -> None:
    states, clean = noisy_states(record, convention, 20.0, seed=1000), differentiate(record)
    for kind in "xva":
        if kind in noisy:
            # Four channels, two-sided: beyond 4 once in 4000 seeds.
            assert np.abs(_deviations(getattr(states, kind), getattr(clean, kind), 20.0)).max() < 4
        else:
            np.testing.assert_array_equal(getattr(states, kind), getattr(clean, kind))


def test_forces_stay_with_the_states_in_every_convention_and_each_is_explained() -> None:
    force, sensors = {"m1": "sin(90*t)"}, ("x", "v", "a")
    pushed = simulate(bnes_chain(2), forces=force, duration=0.5, rate=1000.0, sensors=sensors)
    assert set(MEANING) == set(CONVENTIONS) == {"displacement", "states", "differenced", "derivatives"}
    for convention in CONVENTIONS:
        states = noisy_states(pushed, convention, 40.0, seed=1000)
        assert states.driven == ("m1",)
        assert np.isin(states.forces[:, 0], pushed.channel("force:m1")).all()


def test_what_cannot_be_a_study_is_refused(record: Record) -> None:
    message = "unknown noise convention 'both'; choose from \"displacement\": noise"
    with pytest.raises(RecordError, match=message):
        noisy_states(record, "both", 20.0, seed=0)  # type: ignore[arg-type]
    message = r'channel a:m1: is not in the record; .* simulate with sensors=\("x", "v", "a"\)'
    with pytest.raises(RecordError, match=message):
        noisy_states(record.select(["x:m1", "v:m1"]), "states", 20.0, seed=0)
    with pytest.raises(RecordError, match="channel x:m1: has noise already"):
        noisy_states(record.with_noise(20.0, seed=0), "states", 20.0, seed=0)
    with pytest.raises(RecordError, match=r"needs a simulated record, .* this one was measured"):
        noisy_states(replace(record, simulated=None), "states", 20.0, seed=0)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("link", ["nes1", "nes2"])
def test_exact_fits_give_the_force(record: Record, exact: RegressionFit, reading: Reading, link: str) -> None:
    d, force = monomial_force(exact, CHAIN, link, record, reading=reading)
    sink, primary = CHAIN.link(link).between
    stretch = record.channel(f"x:{sink}") - record.channel(f"x:{primary}")
    np.testing.assert_allclose(d, stretch, rtol=0, atol=1e-16)  # to the last digit of places of 0.1 m
    truth = CHAIN.link(link).force(d)
    # Same numerics: the 165 columns of a motion of two seconds have a condition number near 1e4.
    np.testing.assert_allclose(force, truth, rtol=0, atol=1e-8 * np.abs(truth).max())
    assert monomial_nmse(exact, CHAIN, link, record, reading=reading) < 1e-12


def test_a_link_may_begin_at_either_end(record: Record, exact: RegressionFit) -> None:
    sink = CHAIN.link("nes1")
    turned = with_links(CHAIN, replace(sink, between=sink.between[::-1]))
    for reading in READINGS:
        d, force = monomial_force(exact, turned, "nes1", record, reading=reading)
        before, as_before = monomial_force(exact, CHAIN, "nes1", record, reading=reading)
        np.testing.assert_allclose(d, -before, rtol=1e-12)
        np.testing.assert_allclose(force, -as_before, rtol=1e-12)


@pytest.mark.parametrize(("decibel", "paper"), [(40.0, 0.0018), (30.0, 0.0331), (20.0, 2.1564)])
def test_one_convention_comes_near_the_paper_and_another_cannot(decibel: float, paper: float) -> None:
    """Table 2 for two masses; medians of 15 seeds, which scatter by a factor of about 1.3 (tuned on others)."""
    chain = bnes_chain(2)
    record = chain_record(2, sensors=("x", "v", "a"))

    def median(convention: Convention) -> float:
        errors = []
        for seed in range(1000, 1015):
            states = noisy_states(record, convention, decibel, seed=seed)
            fit = LeastSquares().fit(monomial_equations(states, 3, equations_of=("m2",)))
            errors.append(monomial_nmse(fit, chain, "nes1", record))
        return float(np.median(errors))

    assert paper / 3 < median("differenced") < 3 * paper
    # Noise in the derivatives alone averages out, whatever its level.
    assert median("derivatives") < paper / 100


def test_forces_that_no_monomial_tells_are_refused(record: Record, exact: RegressionFit) -> None:
    with pytest.raises(IdentificationError, match="both ends of link spring2 carry other links"):
        monomial_force(exact, CHAIN, "spring2", record)
    message = r"unknown reading .*; choose from coefficients, ends, displacements"
    with pytest.raises(IdentificationError, match=message):
        monomial_force(exact, CHAIN, "nes1", record, reading="all")  # type: ignore[arg-type]
    with pytest.raises(RecordError, match="this one was measured"):
        monomial_force(exact, CHAIN, "nes1", replace(record, simulated=None))
    low = LeastSquares().fit(monomial_equations(differentiate(record), 1))
    with pytest.raises(IdentificationError, match=r"of link nes1 needs a column x2\*\*3, .* higher order"):
        monomial_force(low, CHAIN, "nes1", record)
    rough = with_links(CHAIN, link("nes1", "m2-m1", "F*tanh(d/s)", F=1.0, s=0.01))
    with pytest.raises(IdentificationError, match=r"F\*tanh\(d/s\) of link nes1 is not a polynomial in d"):
        monomial_force(exact, rough, "nes1", record)
    rest = chain_record(4, duration=0.1, sensors=("x", "v", "a"), speed=0.0)
    with pytest.raises(RecordError, match='true force of link "nes1" does not vary'):
        monomial_nmse(exact, CHAIN, "nes1", rest)
