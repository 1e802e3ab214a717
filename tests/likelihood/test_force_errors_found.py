"""Gains and delays of applied forces that are unknown, or known to within, found with the laws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from present import present, some
from structures import host, link, row_of_masses, structure

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.sensor_priors import errors_to_find, uncounted
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.untold_gains import untold_gains

RATE = 200.0
FIRST, SECOND = (
    f"{40.0 * size}*({' + '.join(f'sin({w}*t + {w * w / 7.0})' for w in range(start, 100, 5))})"
    for size, start in ((1.0, 3), (0.6, 5))
)
PAIR = row_of_masses(
    [1.0, 1.0],
    lower=("k*d + k3*d**3 + c*v", {"k": 900.0, "k3": 2e5, "c": 0.6}),
    upper=("k*d + c*v", {"k": 1000.0, "c": 0.6}),
)
ASKED = PAIR.unknown("all")
WEIGHED = PAIR.unknown("all", "mass:m1", "mass:m2")
BOTH = {"m1": FIRST, "m2": SECOND}


def driven(
    forces: Mapping[str, str] = BOTH,
    *,
    gains: Mapping[str, float] | None = None,
    late: Mapping[str, float] | None = None,
    subject: lw.Structure = PAIR,
    duration: float = 3.0,
    seed: int = 1,
) -> lw.Record:
    """A pair under forces, whose channels show these times their gains, `late` in s."""
    record = lw.simulate(subject, forces=dict(forces), duration=duration, rate=RATE).with_noise(
        35.0, seed=seed
    )
    values = record.values.copy()
    for name, text in forces.items():
        column = record.channels.index(f"force:{name}")
        shown = lw.model.TimeFunction(text).value(record.time - (late or {}).get(f"force:{name}", 0.0))
        values[:, column] = shown * (gains or {}).get(f"force:{name}", 1.0)
    return replace(record, values=values, simulated=None)


def error_of(fit: lw.Estimate, channel: str, kind: str = "gain") -> lw.estimates.SensorErrorEstimate:
    [found] = [error for error in fit.sensor_errors if (error.channel, error.kind) == (channel, kind)]
    return found


def assert_right(fit: lw.Estimate, asked: lw.Structure = ASKED) -> None:
    """Trusted, and every coefficient within five standard errors: 6e-7 of chance each."""
    assert fit.trusted
    for parameter in some(asked.parameters):
        estimate = fit.coefficient(parameter.name)
        error = estimate.value - present(PAIR.coefficient(parameter.name).value)
        assert abs(error) < 5.0 * present(estimate.standard_error)


def test_two_unknown_gains_are_found_with_the_laws() -> None:
    record = driven(gains={"force:m1": 1.05, "force:m2": 0.97})
    wrong = lw.identify(record, ASKED)
    of_forces = [cause for cause in wrong.diagnosis if cause.kind == "force gain"]
    assert of_forces  # less acts than the first shows, and more than the second
    assert all((cause.size < 0.0) == (cause.where == "force:m1") for cause in of_forces)
    fit = lw.identify(record, ASKED, gains=["force:m1", "force:m2"])
    assert_right(fit)
    for channel, gain in (("force:m1", 1.05), ("force:m2", 0.97)):
        found = error_of(fit, channel)
        assert 0.0 < found.standard_error < 0.01
        assert abs(found.value - gain) < 5.0 * found.standard_error
    assert any(line.startswith("force:m1 shows 1.0") and "of its force" in line for line in fit.findings)
    assert not any(cause.kind == "force gain" for cause in fit.diagnosis)


@pytest.mark.parametrize(
    ("kind", "size", "said"),
    [
        ("force gain", -0.0476, "a force 4.76 % smaller than force:m1 shows"),
        ("force gain", 0.03, "a force 3 % larger than force:m1 shows"),
        ("force delay", 5e-4, "a force 0.5 ms later than force:m1 shows"),
        ("force delay", -5e-4, "a force 0.5 ms earlier than force:m1 shows"),
    ],
)
def test_the_diagnosis_says_what_acts_beside_what_a_channel_shows(kind: str, size: float, said: str) -> None:
    unit = "1" if kind == "force gain" else "s"
    assert lw.estimates.Cause(kind, "force:m1", size, unit, 90.0, 1e-4).description == said


def test_an_unknown_gain_widens_every_interval_that_it_moves() -> None:
    record = driven({"m2": SECOND})
    known, unknown = lw.identify(record, ASKED), lw.identify(record, ASKED, gains=["force:m2"])
    at = [
        (fit.coefficient("lower.k").value, fit.coefficient("lower.k").standard_error)
        for fit in (known, unknown)
    ]
    assert present(at[1][1]) >= present(at[0][1])
    wide = lw.identify(record, WEIGHED, calibration={"force:m2": 0.02})
    for name in ("lower.k", "upper.k", "m1.mass", "m2.mass"):
        estimate = wide.coefficient(name)
        # of coefficients that follow the force alone, to the errors that the record leaves beside 2 %
        assert present(estimate.standard_error) / estimate.value == pytest.approx(0.02, rel=0.1)


def test_nothing_tells_the_gain_where_every_mass_is_unknown() -> None:
    record = driven({"m2": SECOND})
    with pytest.raises(
        lw.IdentificationError, match=r"nothing tells the gain of force:m2: .* state how well"
    ):
        lw.identify(record, WEIGHED, gains=["force:m2"])
    with pytest.raises(lw.IdentificationError, match="nothing tells the gain of force:m2"):
        lw.discover(record, {"m1": "unknown", "m2": "unknown"}, gains=["force:m2"])
    two = driven()
    assert lw.identify(two, WEIGHED, gains=["force:m2"]).trusted  # the other force sets the scale


def test_gains_that_stand_for_each_other_are_refused() -> None:
    """A linear oscillator shows the ratio of two gains alone, and one that swings freely none at all."""
    one = structure({"m1": 1.0}, link("s", "m1-ground", "k*d + c*v", k=900.0, c=0.6))
    asked = one.unknown("all")
    record = driven({"m1": FIRST}, subject=one)
    with pytest.raises(
        lw.IdentificationError, match=r"do not tell the gain of x:m1, force:m1: .* Leave one of them"
    ):
        lw.identify(record, asked, gains=["x:m1", "force:m1"])
    free = lw.simulate(one, release={"v:m1": 1.0}, duration=3.0, rate=RATE).with_noise(30.0, seed=3)
    with pytest.raises(lw.IdentificationError, match=r"do not tell the gain of x:m1: .* Leave it out"):
        lw.identify(free, asked, gains=["x:m1"])
    # of which one is known to within a part, which is the other's error then
    fit = lw.identify(record, asked, gains=["force:m1"], calibration={"x:m1": 0.01})
    assert fit.trusted and error_of(fit, "force:m1").standard_error == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("collinear", [1e-3, 1e-8])
def test_a_gain_is_told_unless_its_column_is_that_of_the_others(collinear: float) -> None:
    """Two columns that differ by a part of themselves, both far more precise alone than their values."""
    columns = np.array([[1.0, 1.0], [0.0, np.sqrt(collinear)]]) * 1e8
    covariance: np.ndarray = np.linalg.inv(columns.T @ columns)
    told = collinear > 1e-5
    assert untold_gains(["x:m1"], np.ones(1), covariance, 1) == (() if told else ("x:m1",))


def test_the_calibration_of_all_is_of_no_force() -> None:
    record = driven()
    channels = dict.fromkeys(record.responses, 0.01)
    assert errors_to_find([record], calibration={"all": 0.01})["calibration"] == channels
    stated = replace(record, uncertainty={"force:m2": lw.records.SensorUncertainty(gain=0.02)})
    assert errors_to_find([stated], calibration={"all": 0.01})["calibration"] == channels | {"force:m2": 0.02}
    every, alone = (
        lw.identify(each, ASKED, calibration={"all": 0.01, **more})
        for each, more in ((stated, {}), (record, {"force:m2": 0.02}))
    )
    assert every.values == pytest.approx(alone.values, rel=1e-12)
    assert not any("not counted" in line for line in every.findings)


def test_what_is_stated_of_inputs_and_not_counted_is_told() -> None:
    record = replace(driven(), uncertainty={"force:m1": lw.records.SensorUncertainty(gain=0.01, offset=0.1)})
    [remark] = uncounted([record], "ml")
    assert remark.startswith("What is stated of the errors of force:m1 is not counted: offsets of forces")
    counted = replace(driven(), uncertainty={"force:m1": lw.records.SensorUncertainty(gain=0.01, delay=1e-3)})
    assert not uncounted([counted], "ml")
    assert "not counted" in uncounted([counted], "weak")[0]


def test_a_gain_beyond_its_calibration_is_told_once() -> None:
    record = driven(gains={"force:m1": 1.1})
    fit = lw.identify(record, ASKED, calibration={"force:m1": 0.005})
    assert not fit.trusted
    named = [(cause.kind, cause.where) for cause in fit.diagnosis if "force:m1" in cause.where]
    assert named == [("prior", "gain of force:m1")]


def test_a_gain_is_admitted_where_the_diagnosis_names_it_alone() -> None:
    record = driven(gains={"force:m1": 1.05})
    fit = lw.identify(record, ASKED, admit=["gain"])
    found = error_of(fit, "force:m1")
    assert_right(fit)
    assert abs(found.value - 1.05) < 5.0 * found.standard_error
    # of one mass a force that is too large is a response that is too small: neither is taken for the other
    one = structure({"m1": 1.0}, link("s", "m1-ground", "k*d + c*v", k=900.0, c=0.6))
    single = driven({"m1": FIRST}, gains={"force:m1": 1.1}, subject=one)
    assert not lw.identify(single, one.unknown("all"), admit=["gain"]).sensor_errors


def test_a_force_that_no_channel_shows_has_no_gain() -> None:
    record = driven({"m2": SECOND})
    for keywords in ({"gains": ["force:m1"]}, {"delays": ["force:m1"]}):
        with pytest.raises(
            lw.IdentificationError,
            match=r"no gain or delay of force:m1 can be estimated.*has the forces force:m2",
        ):
            lw.identify(record, ASKED, **keywords)  # type: ignore[arg-type]  # of one of the keywords
    with pytest.raises(
        lw.IdentificationError, match=r"no calibration of force:m1 .* and the forces force:m2"
    ):
        lw.identify(record, ASKED, calibration={"force:m1": 0.01})


@pytest.mark.parametrize("delay", [1.5e-3, -12e-3])
def test_a_delay_of_one_of_two_forces_is_found(delay: float) -> None:
    record = driven(late={"force:m2": delay})
    fit = lw.identify(record, ASKED, delays=["force:m2"])
    found = error_of(fit, "force:m2", "delay")
    assert_right(fit)
    # a hundredth of a sample of 5 ms
    assert found.standard_error < 5e-5
    assert abs(found.value - delay) < 5.0 * found.standard_error


def test_a_delay_that_is_known_to_within_is_counted_and_one_that_is_diagnosed_admitted() -> None:
    record = driven(late={"force:m2": 1.5e-3})
    stated = replace(record, uncertainty={"force:m2": lw.records.SensorUncertainty(delay=2e-3)})
    for fit in (lw.identify(stated, ASKED), lw.identify(record, ASKED, admit=["delay"])):
        found = error_of(fit, "force:m2", "delay")
        assert_right(fit)
        assert abs(found.value - 1.5e-3) < 5.0 * found.standard_error


def test_no_delay_of_a_force_that_jumps_is_found_beside_others() -> None:
    record = replace(driven(), interpolation={"force:m2": "held"})
    with pytest.raises(
        lw.IdentificationError, match="no delay of force:m2, which is held between its samples"
    ):
        lw.identify(record, ASKED, delays=["force:m2"])


def test_the_columns_of_gains_and_delays_of_forces_are_difference_quotients() -> None:
    """Of data and of defects, beside a gain and a delay of a sensor, in records of different length."""
    record = driven(duration=1.0)
    theta = np.array([present(PAIR.coefficient(p.name).value) for p in ASKED.parameters])
    options = LikelihoodOptions(
        gains=("force:m2", "x:m1", "force:m1"), delays=("force:m1", "x:m2", "force:m2"), model_error=False
    )
    optimum = likelihood_fit([record, record[:107]], ASKED, theta, options=options).optimum
    gains, delays = np.array([1.05, 0.97, 0.9]), np.array([2e-3, -1e-3, -3e-3])
    point = replace(optimum.point, gains=gains, delays=delays)
    misfit = evaluate(optimum.segments, point, optimum.scales, Gaussian())
    linear = linearise(optimum.segments, misfit, optimum.scales, Gaussian())

    for q in (1.0, 1e-3):
        gradient = -2.0 * linear.equations(q).corner_gradient / optimum.scales.theta
        for number in range(len(gradient) - 6, len(gradient)):
            shift = np.zeros(len(gradient))
            shift[number] = 1e-6 * optimum.scales.theta[number]
            ends = (
                evaluate(
                    optimum.segments,
                    point.moved(point.nodes, point.border + sign * shift),
                    optimum.scales,
                    Gaussian(),
                ).cost(q)
                for sign in (1.0, -1.0)
            )
            upper, lower = ends
            # tangents are kept in single precision, and their order is four
            assert gradient[number] == pytest.approx((upper - lower) / (2.0 * shift[number]), rel=1e-2)


def test_beside_a_moving_base_a_gain_is_of_the_applied_force_alone() -> None:
    """In coordinates of the base each mass carries a force of inertia, too, which no load cell shows."""
    pair = structure(
        {"m1": 1.0, "m2": 1.0},
        link("lower", "m1-base", "k*d + c*v", k=900.0, c=0.6),
        link("upper", "m2-m1", "k*d + k3*d**3 + c*v", k=1000.0, k3=2e5, c=0.6),
    )
    record = lw.simulate(
        pair, base="0.004*sin(31*t) + 0.004*sin(17*t)", forces={"m2": SECOND}, duration=3.0, rate=RATE,
        sensors=("rel:x", "a:base"),
    ).with_noise(35.0, seed=2)  # fmt: skip
    values = record.values.copy()
    exact = lw.model.TimeFunction("0.004*sin(31*t) + 0.004*sin(17*t)").derivative(record.time, 2)
    values[:, record.channels.index("a:base")] = exact
    values[:, record.channels.index("force:m2")] = 1.05 * lw.model.TimeFunction(SECOND).value(record.time)
    asked = pair.unknown("all")
    fit = lw.identify(replace(record, values=values, simulated=None), asked, gains=["force:m2"])
    found = error_of(fit, "force:m2")
    assert fit.trusted and abs(found.value - 1.05) < 5.0 * found.standard_error
    for parameter in some(asked.parameters):
        estimate = fit.coefficient(parameter.name)
        error = estimate.value - present(pair.coefficient(parameter.name).value)
        assert abs(error) < 5.0 * present(estimate.standard_error)


def test_the_gain_of_a_force_at_a_point_of_a_host_is_found() -> None:
    beam = structure(
        {"store": 0.2},
        link("stop", "store-beam.tip", "k*d + c*v", k=2000.0, c=0.5),
        hosts=[host("beam", [20.0], 0.005, {"tip": [1.0]})],
    )
    record = lw.simulate(
        beam, forces={"beam.tip": FIRST}, duration=2.0, rate=500.0, sensors=["x:beam.tip", "x:store"]
    ).with_noise(35.0, seed=3)
    values = record.values.copy()
    values[:, record.channels.index("force:beam.tip")] = 1.05 * lw.model.TimeFunction(FIRST).value(
        record.time
    )
    fit = lw.identify(
        replace(record, values=values, simulated=None), beam.unknown("stop"), gains=["force:beam.tip"]
    )
    found = error_of(fit, "force:beam.tip")
    assert fit.trusted and abs(found.value - 1.05) < 5.0 * found.standard_error
    assert abs(fit.coefficient("stop.k").value - 2000.0) < 5.0 * present(
        fit.coefficient("stop.k").standard_error
    )


def test_a_gain_is_found_in_a_structure_of_many_masses() -> None:
    row = row_of_masses([1.0] * 12, **{f"s{k}": ("k*d + c*v", {"k": 900.0, "c": 1.5}) for k in range(12)})
    record = driven({"m12": FIRST}, gains={"force:m12": 1.05}, subject=row)
    fit = lw.identify(record, row.unknown("all"), gains=["force:m12"])
    found = error_of(fit, "force:m12")
    assert fit.trusted and abs(found.value - 1.05) < 5.0 * found.standard_error


def test_a_discovery_finds_the_gain_of_a_force_with_the_structure() -> None:
    record = driven(gains={"force:m1": 1.05}, duration=6.0)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 1.0}, gains=["force:m1"])
    assert {(frozenset(entry.between), entry.law.text) for entry in discovery.structure.links} == {
        (frozenset(("m1", "ground")), "k*d + k3*d**3 + c*v"),
        (frozenset(("m2", "m1")), "k*d + c*v"),
    }
    found = error_of(discovery.estimate, "force:m1")
    assert discovery.trusted and abs(found.value - 1.05) < 5.0 * found.standard_error
