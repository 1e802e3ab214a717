"""Score tests of what a fit lacks: against fits with it, and linear regression."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present
from problems import bent_chain, rubbing_trio
from random_signals import random_force
from structures import link, oscillator, structure, with_links

import linkwise as lw
from linkwise.likelihood.random_forces import system_with
from linkwise.likelihood.tests import diagnosis, score_test
from linkwise.likelihood.tests.score_test import CandidateForce, Quadratic, determinant_slopes

CHAIN = lw.bnes_chain(2)


def bent(snr_db: float, seed: int, start: float = 0.0) -> lw.Record:
    """The paper's chain with a little of d**2 in its sink, and a gain of its first sensor."""
    noisy = bent_chain(250.0).clean.with_noise(snr_db, seed=seed)
    return replace(noisy, values=noisy.values * [1.1, 1.0], start=start)


def rubbed(link: lw.Link) -> lw.Record:
    """A base that moves, a force, friction, and sensors of all kinds."""
    driven = lw.simulate(
        with_links(rubbing_trio(), link), duration=2.0, rate=1000.0, sensors=("x", "v", "a"), release={"v:m1": 1.0},
        forces={"m2": "5*sin(400*t)"}, base="0.001*sin(300*t)",
    )  # fmt: skip
    shown = ("x:m1", "v:m2", "x:m2", "a:m3", "x:m3", "force:m2", "x:base")
    return driven.with_noise(30.0, seed=1002).select(shown)


SQUARE, DAMPER = link("extra", "m2-m1", "q*d**2", q=250.0), link("extra", "m2-base", "q*v", q=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "missing", "records", "options", "named"),
    [
        (CHAIN, SQUARE, [bent_chain(250.0).record(1004)], {}, ("term", "nes1", "d**2")),
        (CHAIN, SQUARE, [bent(30.0, 1001), bent(24.0, 1002, 10.0)], {"gains": ["x:m1"]}, ("term", "nes1", "d**2")),
        (rubbing_trio(), DAMPER, [rubbed(DAMPER)], {"starts": {"friction.s": 0.5}}, ("link", "m2-base", "v")),
    ],
    ids=["free", "calibrated", "on a base"],
)  # fmt: skip
def test_what_a_missing_term_gains_is_what_a_fit_with_it_takes_off_the_cost(
    stated: lw.Structure,
    missing: lw.Link,
    records: list[lw.Record],
    options: dict[str, Any],
    named: tuple[str, str, str],
) -> None:
    lacking, whole = (
        lw.identify(records, subject.unknown("all"), **options)
        for subject in (stated, with_links(stated, missing))
    )
    assert not lacking.trusted and lacking.model_error == 0.0
    cause = lacking.diagnosis[0]
    assert (cause.kind, cause.where, cause.term) == named
    took = (present(lacking.chi_square_per_sample) - present(whole.chi_square_per_sample)) * whole.samples
    # fits end within 0.02 of their least cost; beyond, the parabola is the cost to the third order in the force
    assert cause.gain == pytest.approx(took, rel=0.02)
    size = present(whole.coefficient("extra.q").value)
    assert abs(size - present(missing.coefficients["q"].value)) < 4.0 * present(
        whole.coefficient("extra.q").standard_error
    )
    motion = present(records[0].simulated)
    d, v = motion.displacement[:, 1] - motion.displacement[:, 0], motion.velocity[:, 1]
    along = d**2 if missing is SQUARE else v - 0.3 * np.cos(300.0 * records[0].time)
    assert abs(cause.size) == pytest.approx(abs(size) * np.sqrt(np.mean(along**2)), rel=0.05)


PARAMETERS, TESTED = 2, 3


def equations(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (N, p + f) of parameters and what is tested, and residuals (N,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((60, PARAMETERS + TESTED)), rng.standard_normal(60)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_column_that_is_not_finite_leaves_the_others_as_they_are(value: float) -> None:
    """One such column ended the tests of all, so that no error of a sensor and no missing term was named."""
    columns, residuals = equations(2)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    apart = Quadratic(curvature, slope, curvature).tests(PARAMETERS)
    infinite, others = PARAMETERS + 1, [0, 2]
    curvature[infinite], curvature[:, infinite], slope[infinite] = value, value, value
    for scatter in (curvature, 1.0 * curvature):
        tests = Quadratic(curvature, slope, scatter).tests(PARAMETERS)
        assert tests.gains[1] == 0.0 and tests.sizes[1] == 0.0
        np.testing.assert_allclose(tests.gains[others], apart.gains[others], rtol=1e-12)
        np.testing.assert_allclose(tests.sizes[others], apart.sizes[others], rtol=1e-12)


RATE, DURATION = 200.0, 10.0
CUBIC = oscillator("k*d + c*v + k3*d**3", k=987.0, c=6.0, k3=4e4)
LINEAR = oscillator("k*d + c*v", k=987.0, c=6.0).unknown("all")


@pytest.fixture(scope="module")
def in_load_cell() -> lw.Record:
    forces = {"m1": random_force(np.random.default_rng(3), DURATION, RATE)}
    return lw.simulate(CUBIC, forces=forces, duration=DURATION, rate=RATE, sensors=["x", "f"])


def with_noise_of(in_load_cell: lw.Record, displacement: float, load: float) -> lw.Record:
    """The record with noise of these standard deviations in m and N."""
    rng = np.random.default_rng(4)
    deviations = {"x:m1": displacement, "f:link": load, "force:m1": 0.0}
    channels = {
        name: in_load_cell.channel(name) + sigma * rng.standard_normal(len(in_load_cell))
        for name, sigma in deviations.items()
    }
    return lw.Record.from_arrays(in_load_cell.time, channels)


@pytest.mark.slow
@pytest.mark.parametrize(("displacement", "load"), [(3e-4, 0.05), (1e-3, 0.02)])
def test_a_missing_term_is_found_in_the_load_cell_as_large_as_a_fit_finds_it(
    in_load_cell: lw.Record, displacement: float, load: float
) -> None:
    """It was tested in the motion alone, and d**5 named in its place with up to half more than its force."""
    record = with_noise_of(in_load_cell, displacement, load)
    lacking, fitted = lw.identify(record, LINEAR), lw.identify(record, CUBIC.unknown("all"))
    cause = lacking.diagnosis[0]
    assert (cause.kind, cause.where, cause.term) == ("term", "link", "d**3")
    k3, unit = fitted.coefficient("link.k3"), np.sqrt(np.mean(in_load_cell.channel("x:m1") ** 6))
    # the first order, in the motion that the wrong law follows: a term of 2 % of the force changes that by as much
    assert cause.size == pytest.approx(k3.value * unit, rel=0.03)
    assert cause.standard_error > present(k3.standard_error) * unit  # with the model error of the wrong law


def test_a_law_that_lacks_nothing_has_no_cause_in_its_load_cell(in_load_cell: lw.Record) -> None:
    fit = lw.identify(with_noise_of(in_load_cell, 3e-4, 0.05), CUBIC.unknown("all"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.diagnosis == ()


@pytest.mark.parametrize(
    ("sensors", "options"),
    [(("x",), {"input_noise": {"force:m1": 0.1}}), (("a",), {"ambient": {"m1": 0.01}})],
    ids=["noise of an input", "ambient force in the middle of whose segments are samples"],
)
def test_slopes_of_the_determinant_are_those_of_structures_with_a_term(
    monkeypatch: pytest.MonkeyPatch, sensors: tuple[str, ...], options: dict[str, Any]
) -> None:
    """To within what a term bends the motion by within a sample: of a linear chain nothing."""
    chain = structure(
        {"m1": 1.0, "m2": 0.5},
        link("l1", "m1-ground", "k*d + c*v", k=2000.0, c=1.0),
        link("l2", "m2-m1", "k*d + c*v", k=1000.0, c=0.5),
    )
    force = random_force(np.random.default_rng(5), 0.5, 500.0, highest=40.0)
    record = lw.simulate(chain, duration=0.5, rate=500.0, forces={"m1": force}, sensors=sensors)
    record = record.with_noise(30.0, seed=5)
    if "ambient" in options:
        record = record.select([str(channel) for channel in record.responses])
    calls = list[tuple[Any, ...]]()

    def noted(*arguments: Any) -> np.ndarray:
        calls.append(arguments)
        return determinant_slopes(*arguments)

    monkeypatch.setattr(diagnosis, "determinant_slopes", noted)
    lw.identify(record, chain.unknown("all"), as_stated=True, **options)
    optimum, identified, masses, candidates, _ = calls[0]
    whole = score_test._without_unknowns(optimum)
    sample = float(whole.segments.step[0]) * whole.segments.refine
    places = (*identified.mass_names, "base", "ground")

    def with_term(candidate: CandidateForce, size: float) -> float:
        ends = places[candidate.first], places[candidate.second]
        wider = with_links(identified, lw.Link("t", ends, f"q*({candidate.law.text})", {"q": size}))
        return score_test._log_determinant(
            replace(whole, segments=replace(whole.segments, system=system_with(wider, masses, sample)))
        )

    forces = [(one, step) for one, step in candidates if isinstance(one, CandidateForce)]
    slopes = determinant_slopes(optimum, identified, masses, forces)
    steps = np.array([step for _, step in forces])
    differences = np.array(
        [-0.25 * (with_term(one, step) - with_term(one, -step)) / step for one, step in forces]
    )
    np.testing.assert_allclose(slopes * steps, differences * steps, rtol=0.01, atol=1e-3)
    assert np.abs(slopes * steps).max() > 0.01
