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
from linkwise.sindy.conventions import CONVENTIONS, MEANING, Convention, noisy_states
from linkwise.sindy.force_reading import READINGS, Reading, monomial_force, monomial_nmse
from linkwise.sindy.library import monomial_equations
from linkwise.sindy.regression.regressor import RegressionFit
from linkwise.sindy.regression.regressors import LeastSquares

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


def test_noise_on_displacement_alone_reaches_the_derivatives(record: Record) -> None:
    clean = differentiate(record)
    states = noisy_states(record, "displacement", 40.0, seed=1000, derivative="differences")
    noise = states.x - clean.x
    assert np.abs(_deviations(states.x, clean.x, 40.0)).max() < 4  # as above
    # White noise through the stencil (-1, 16, -30, 16, -1)/12: its sum of squares is the gain in variance.
    gain = 1414 / 144 * record.rate**4
    ratio = np.mean((states.a - clean.a)[3:-3] ** 2, axis=0) / np.mean(noise**2, axis=0)
    np.testing.assert_allclose(ratio, gain, rtol=0.2)  # correlated squares: 4 standard deviations of 5 %
    smooth = noisy_states(record, "displacement", 40.0, seed=1000)
    inside = np.isin(clean.time, smooth.time)
    assert np.all(np.mean((smooth.x - clean.x[inside]) ** 2, axis=0) < np.mean(noise**2, axis=0))


def test_noisy_velocities_are_differenced(record: Record) -> None:
    states = noisy_states(record, "differenced", 20.0, seed=1000)
    before = noisy_states(record, "states", 20.0, seed=1000)
    np.testing.assert_array_equal(states.x, before.x)
    np.testing.assert_array_equal(states.v, before.v)
    differences = (8 * (before.v[3:-1] - before.v[1:-3]) - (before.v[4:] - before.v[:-4])) * record.rate / 12
    # the same formula in another order of sums
    np.testing.assert_allclose(states.a[2:-2], differences, rtol=1e-10, atol=1e-10 * np.abs(states.a).max())


def test_a_seed_means_the_same_noise_in_every_convention(record: Record) -> None:
    by_states = noisy_states(record, "states", 30.0, seed=1001)
    by_differences = noisy_states(record, "displacement", 30.0, seed=1001, derivative="differences")
    np.testing.assert_array_equal(by_states.x, by_differences.x)
    assert not np.array_equal(by_states.x, noisy_states(record, "states", 30.0, seed=1002).x)


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


def test_readings_differ_where_only_some_terms_are_wrong(record: Record, exact: RegressionFit) -> None:
    spoilt = exact.coefficients.copy()
    column = exact.targets.index("x2''")
    spoilt[exact.names.index("x1*x2**2"), column] *= 1.01
    ends = replace(exact, coefficients=spoilt)
    assert monomial_nmse(ends, CHAIN, "nes1", record) < 1e-12
    # 1 % of one term: 4e-3 % here, where nothing is random, and 2e-3 % below
    assert monomial_nmse(ends, CHAIN, "nes1", record, reading="ends") > 1e-4
    spoilt[exact.names.index("x3**3"), column] = 1e7
    spoilt[exact.names.index("x1*x2**2"), column] /= 1.01
    others = replace(exact, coefficients=spoilt)
    assert monomial_nmse(others, CHAIN, "nes1", record, reading="ends") < 1e-12
    assert monomial_nmse(others, CHAIN, "nes1", record, reading="displacements") > 1e-4
    # ten per cent of a force are one per cent of its mean square
    wrong = replace(exact, coefficients=1.1 * exact.coefficients)
    truth = CHAIN.link("nes1").force(monomial_force(exact, CHAIN, "nes1", record)[0])
    expected = 100 * 0.01 * np.mean(truth**2) / np.var(truth)  # Eq. 8 by hand
    assert monomial_nmse(wrong, CHAIN, "nes1", record) == pytest.approx(expected, rel=1e-8)  # same numerics


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
