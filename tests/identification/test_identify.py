"""What `identify` answers: right laws with intervals, wrong laws refused, and what cannot be told said."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present, some
from problems import PROBLEMS, chain_record
from structures import link

import linkwise as lw
from linkwise.identification.identify import METHODS

UNKNOWN = lw.Coefficient.unknown
SAMPLING: dict[str, Any] = {"duration": 4.0, "rate": 1000.0}


def weak(record: lw.Record, structure: lw.Structure) -> lw.Estimate:
    return lw.identify(record, structure, method="weak")


def misses(fit: lw.Estimate, true: lw.Structure) -> dict[str, float]:
    """How many standard errors each parameter is off; 4 are reached once in 16 000."""
    deviations: dict[str, float] = {}
    for parameter in fit.parameters:
        owner, _, name = parameter.name.rpartition(".")
        value = true.mass(owner).mass.value if name == "mass" else true.link(owner).values[name]
        estimate = fit.coefficient(parameter.name)
        deviations[parameter.name] = abs(estimate.value - present(value)) / present(estimate.standard_error)
    return deviations


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    return lw.bnes_chain(2)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2).with_noise(30.0, seed=1)


@pytest.fixture(scope="module")
def pair() -> lw.Structure:
    """A mass on a spring, a smaller one on a hardening spring."""
    return PROBLEMS["masses unknown, a force applied"].structure


# --- what is found


def test_a_known_mass_sets_the_scale_of_another(record: lw.Record, chain: lw.Structure) -> None:
    fit = weak(record, chain.unknown("nes", "mass:m2"))
    # four standard errors: 6e-5 of chance each
    assert fit.trusted and max(misses(fit, chain).values()) < 4.0


@pytest.mark.slow
def test_a_clearance_is_found_from_a_start() -> None:
    """g enters k*max(d - g, 0) nonlinearly: Gauss-Newton from a start half as large."""
    problem = PROBLEMS["clearance"]
    fit = weak(problem.record(), problem.unknown_structure)
    value = fit.coefficient("stop.g").value
    assert fit.trusted and value == pytest.approx(2 * 0.0025, rel=0.01)  # the noise is 1 % of the motion
    nonlinear = r'link "stop": g enters the law .* nonlinearly and needs a start'
    far = r"does not determine stop\.k.*The search was at stop\.g = 1; give starts"
    for starts, message in (({}, nonlinear), ({"stop.g": 1.0}, far)):
        with pytest.raises(lw.IdentificationError, match=message):
            weak(problem.record(), replace(problem, starts=starts).unknown_structure)
    # F*tanh(v/s): v comes from smoothed displacements, which is said
    problem = PROBLEMS["friction curved in v"]
    fit = weak(problem.record(), problem.unknown_structure)
    assert "The law of link is nonlinear in v" in fit.findings[0]


# --- what is refused


def test_a_law_without_its_cubic_term_is_refused(record: lw.Record, chain: lw.Structure) -> None:
    short = link("nes1", "m2-m1", "alpha*d + c*v", alpha=UNKNOWN(), c=UNKNOWN())
    fit = weak(record, replace(chain, links=(chain.links[0], short)))
    assert not fit.trusted and fit.status == "chi-square off"
    # misfit in power ten times that of the noise; measured 20
    assert present(fit.chi_square_per_sample) > 10.0
    assert "a term is missing from a law, a link from the structure" in fit.message
    assert all(c.interval is None and c.standard_error is None for c in some(fit.links[1].coefficients))
    assert np.isnan(fit.force_band("nes1", 0.01)[1])


def test_a_missing_link_is_refused(pair: lw.Structure) -> None:
    """The small mass is also held by the ground, and the structure does not say so."""
    linked = replace(pair, links=(*pair.links, link("extra", "m2-ground", "k*d", k=150.0)))
    record = lw.simulate(linked, release={"v:m1": 1.0}, **SAMPLING).with_noise(40.0, seed=1)
    assert weak(record, linked.unknown("all")).trusted
    assert not weak(record, pair.unknown("all")).trusted


@pytest.mark.parametrize(
    ("factor", "message"), [(3.0, "the noise is smaller than stated"), (1 / 3, "or larger than stated")]
)
def test_wrong_noise_is_refused(record: lw.Record, chain: lw.Structure, factor: float, message: str) -> None:
    stated = {name: factor * sigma for name, sigma in present(record.simulated).noise.items()}
    fit = weak(replace(record, noise=stated), chain.unknown("nes"))
    assert not fit.trusted and message in fit.message
    assert weak(replace(record, noise=present(record.simulated).noise), chain.unknown("nes")).trusted


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "strong"}, "unknown method 'strong'; choose from 'ml', 'weak', 'sindy'"),
        ({"method": "sindy", "offsets": ["x:m1"], "gains": ["x:m2"]}, 'offsets, gains are for method "ml", not for "sindy"'),
        ({"method": lw.MaximumLikelihood(), "loss": lw.likelihood.Huber()},
         r"loss were given beside MaximumLikelihood\(\.\.\.\); give options to that object"),
        ({"loss": "huber"}, r"one of Gaussian\(\), Huber\(\) and Student\(\), got "),
        ({"loss": lw.likelihood.Huber}, r"one of Gaussian\(\), Huber\(\) and Student\(\), got "),
    ],
)  # fmt: skip
def test_foreign_options(
    record: lw.Record, chain: lw.Structure, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(lw.IdentificationError, match=message):
        lw.identify(record, chain.unknown("nes"), **options)


def test_what_is_no_question_is_refused(record: lw.Record, chain: lw.Structure) -> None:
    unknown, two = chain.unknown("nes"), [record[:500], record[500:]]
    several = 'several records are for method "ml", not for "weak", which takes one; got 2'
    with pytest.raises(lw.IdentificationError, match=several):
        lw.identify(two, unknown, method="weak")
    with pytest.raises(lw.IdentificationError, match="no record to identify from"):
        lw.identify([], unknown)
    with pytest.raises(lw.IdentificationError, match='every coefficient is a number: write "unknown"'):
        weak(record, chain)
    with pytest.raises(lw.IdentificationError, match="'ridge'; choose from 'stlsq', 'l1', 'least-squares'"):
        lw.PhysicsInformedSindy(regressor="ridge")
    with pytest.raises(TypeError, match="unexpected keyword argument 'ofsets'"):
        lw.identify(record, unknown, ofsets=["x:m1"])  # type: ignore[call-arg]  # what is tested


@pytest.mark.slow
def test_an_estimator_is_the_method_of_its_name(record: lw.Record, chain: lw.Structure) -> None:
    assert {name: kind.method for name, kind in METHODS.items()} == {name: name for name in METHODS}
    unknown = chain.unknown("nes")
    starts = {"nes1.alpha": -90.0, "nes1.beta": 9e5, "nes1.c": 0.01}
    options: dict[str, Any] = {"starts": starts, "loss": lw.likelihood.Huber()}
    for named, method in (({"method": "weak"}, lw.WeakForm()), (options, lw.MaximumLikelihood(**options))):
        by_name, by_object = (lw.identify(record, unknown, **how) for how in (named, {"method": method}))
        assert np.array_equal(by_name.values, by_object.values)
        assert np.array_equal(by_name.covariance, by_object.covariance)


# --- the paper's method


@pytest.mark.parametrize("regressor", ["stlsq", "l1", "least-squares"])
def test_sparse_regression_finds_the_laws_of_a_clean_record(chain: lw.Structure, regressor: str) -> None:
    clean = chain_record(2, duration=3.0, rate=2000.0)
    fit = lw.identify(clean, chain.unknown("all"), method=lw.PhysicsInformedSindy(regressor=regressor))
    assert fit.trusted and fit.chi_square_per_sample is None
    for true in some(chain.links):
        values = fit.structure.link(true.name).values
        assert values == pytest.approx(true.values, rel=0.02 if regressor == "l1" else 2e-3)  # l1 shrinks
        # in %: coefficients off by 0.02 leave 0.02^2; measured 2e-9 and less
        assert lw.nmse(true, fit.structure.link(true.name), clean) < 100 * 0.02**2
    found = some(fit.links[0].coefficients)
    assert all(c.interval is None and c.standard_error is not None for c in found)


def test_a_term_that_adds_nothing_is_dropped_and_named(chain: lw.Structure) -> None:
    wide = link("nes1", "m2-m1", "alpha*d + beta*d**3 + c*v + q*d**2", alpha=-100.0, beta=1e6, c=0.02, q=0.0)
    clean = chain_record(2, duration=3.0, rate=2000.0, sensors=("x", "v", "a"))
    fit = lw.identify(clean, replace(chain, links=(chain.links[0], wide)).unknown("nes"), method="sindy")
    assert fit.findings[0] == "nes1.q was dropped: its term adds less than the threshold."
    assert fit.coefficient("nes1.q").value == 0.0
