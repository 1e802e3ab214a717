"""Delays of sensors, and gains and delays of applied forces, found with the laws or refused."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present, some
from problems import chain_record
from structures import link, oscillator, row_of_masses, structure
from within import assert_within

import linkwise as lw
from linkwise.likelihood.options import AskedFor, errors_to_find, uncounted
from linkwise.likelihood.terms import Delay, Gain

pytestmark = pytest.mark.slow


CHAIN = lw.bnes_chain(2)
CHAIN_ASKED = CHAIN.unknown("all")
FINE = 10  # samples of the exact motion in one of the record
SENSORS = ("x:m1", "x:m2", "v:m1", "a:m2")


def late(name: str, tenths: int, seed: int, snr_db: float = 30.0) -> lw.Record:
    """Four channels, one of them late by `tenths` of a sample, from exact motion at ten times the rate."""
    fine = chain_record(2, duration=1.6, rate=1000.0 * FINE, sensors=SENSORS)
    start, count = 100, 1400
    columns = []
    for channel in SENSORS:
        first = start * FINE - (tenths if channel == name else 0)
        columns.append(fine.channel(channel)[first : first + count * FINE : FINE])
    record = lw.Record(0.0, 1000.0, SENSORS, np.stack(columns, axis=1))
    return record.with_noise(snr_db, seed=seed)


def delay_found(fit: lw.Estimate, name: str) -> tuple[float, float]:
    """The delay in s that the answer tells, and its standard error."""
    pattern = rf"{name} is late by (\S+) ms \(estimated with the other unknowns, standard error (\S+) ms\)\."
    [match] = [candidate for candidate in (re.match(pattern, line) for line in fit.findings) if candidate]
    return 1e-3 * float(match[1]), 1e-3 * float(match[2])


def test_a_delay_of_one_of_four_channels_is_found_with_the_laws() -> None:
    name, tenths = "v:m1", -7
    record = late(name, tenths, seed=31)
    fit = lw.identify(record, CHAIN_ASKED, delays=[name])
    delay, deviation = delay_found(fit, name)
    assert fit.trusted
    assert delay == pytest.approx(1e-4 * tenths, abs=2e-5)  # a fiftieth of a sample
    # five deviations, 6e-7 of chance; here, below and for the laws
    assert delay == pytest.approx(1e-4 * tenths, abs=5.0 * deviation)
    assert_within(fit, CHAIN, 5.0)


def test_a_delay_of_several_samples_is_found_after_whole_shifts() -> None:
    record = late("a:m2", 34, seed=32)
    fit = lw.identify(record, CHAIN_ASKED, delays=["a:m2"])
    delay, deviation = delay_found(fit, "a:m2")
    assert fit.trusted and delay == pytest.approx(3.4e-3, abs=5.0 * deviation)


def test_a_delay_is_admitted_and_without_that_not_trusted() -> None:
    record = late("x:m2", 3, seed=33)
    alone = lw.identify(record, CHAIN_ASKED, as_stated=True)
    assert not alone.trusted
    assert (alone.diagnosis[0].kind, alone.diagnosis[0].where) == ("delay", "x:m2")
    fit = lw.identify(record, CHAIN_ASKED, admit=["delay"])
    delay, deviation = delay_found(fit, "x:m2")
    assert fit.trusted and delay == pytest.approx(3e-4, abs=5.0 * deviation)


def test_a_delay_of_the_only_force_is_admitted_as_responses_that_are_early() -> None:
    """Two samples of 5 ms late, a multisine of 0.3 to 12 Hz; the diagnosis names the force."""
    structure = oscillator("k*d + b*d**3 + c*v", name="foot", k=400.0, b=3e4, c=1.2)
    lines = 2 * np.pi * np.arange(6, 240) / 20.0
    phases = np.random.default_rng(36).uniform(0.0, 2 * np.pi, len(lines))
    time = np.arange(4001) / 200.0
    applied, recorded = (
        0.55 * np.sin(lines * (time - delay)[:, None] + phases).sum(axis=1) for delay in (0.0, 0.01)
    )
    force = lw.model.Sampled(0.0, 200.0, applied)
    record = lw.simulate(structure, forces={"m1": force}, duration=20.0, rate=200.0).with_noise(35.0, seed=36)
    columns = np.stack([record.channel("x:m1"), recorded], axis=1)
    record = lw.Record(0.0, 200.0, ("x:m1", "force:m1"), columns)
    asked = structure.unknown("all")
    assert lw.identify(record, asked, as_stated=True).diagnosis[0].kind == "force delay"
    fit = lw.identify(record, asked, admit=["delay"])
    delay, deviation = delay_found(fit, "x:m1")
    assert fit.trusted and delay == pytest.approx(-0.01, abs=5.0 * deviation)
    assert_within(fit, structure)


QUAKE = "0.0004*sin(61*t) + 0.0003*sin(97*t + 1) + 0.0002*sin(131*t + 2) + 0.0001*sin(210*t)"
STOREY = oscillator("k*d + c*v", to="base", name="frame", k=19000.0, c=1.2)


def shaken(duration: float, late: float) -> lw.Record:
    """A storey on a shake table at 5.5 samples a period, whose sensor is `late` in s after that of the base."""
    record = lw.simulate(STOREY, base=QUAKE, duration=duration, rate=120.0, sensors=("a", "a:base"))
    record = record.with_noise(40.0, seed=1)
    early = lw.model.TimeFunction(QUAKE).derivative(record.time + late, 2)
    return replace(record, values=np.column_stack([record.channel("a:m1"), early]), simulated=None)


def explained(fit: lw.Estimate, late: float) -> None:
    """The fit is trusted, with a delay `late` in s and a stiffness within five deviations: 6e-7 of chance."""
    delay, deviation = delay_found(fit, "a:m1")
    assert_within(fit, {"frame.k": 19000.0}, 5.0)
    assert abs(delay - late) < 5.0 * deviation


def test_a_delay_of_all_that_a_sensor_on_a_moving_base_shows_is_found() -> None:
    """Half a sample, of which the base alone would leave nine times the noise."""
    explained(lw.identify(shaken(1.5, 0.0042), STOREY.unknown("all"), delays=["a:m1"]), 0.0042)


def test_a_base_that_is_late_is_admitted_as_a_response_that_is_early() -> None:
    """The diagnosis names the base, whose delay no parameter stands for."""
    record, unknown = shaken(1.5, -0.002), STOREY.unknown("all")
    first = lw.identify(record, unknown, as_stated=True).diagnosis[0]
    assert (first.kind, first.where) == ("delay", "a:base")
    explained(lw.identify(record, unknown, admit=["delay"]), -0.002)


def test_the_delay_of_the_only_input_is_that_of_the_responses() -> None:
    stated = {
        "a:base": lw.records.SensorUncertainty(delay=np.inf),
        "a:m1": lw.records.SensorUncertainty(gain=0.01),
    }
    record = lw.simulate(STOREY, base=QUAKE, duration=1.0, rate=120.0, sensors=("a", "a:base"))
    record = replace(record.with_noise(40.0, seed=2), uncertainty=stated)
    assert {*errors_to_find([record], AskedFor())} == {Gain("a:m1", 0.01), Delay("a:m1")}
    assert not uncounted([record], "ml")
    forced = lw.Record(0.0, 120.0, (*record.channels, "force:m1"), np.pad(record.values, ((0, 0), (0, 1))))
    assert Delay("a:base") in errors_to_find([replace(forced, uncertainty=stated)], AskedFor())
    displaced = lw.Record(0.0, 120.0, ("a:m1", "x:base", "force:m1"), forced.values)
    displaced = replace(displaced, uncertainty={"x:base": stated["a:base"]})
    [remark] = uncounted([displaced], "ml")
    assert "errors of x:base is not counted" in remark


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
ONE = oscillator("k*d + c*v", name="s", k=900.0, c=0.6)
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


def assert_error(
    fit: lw.Estimate, channel: str, true: float, kind: str = "gain"
) -> lw.estimates.SensorErrorEstimate:
    """The fit is trusted, and the error of this channel within five deviations of the truth: 6e-7 of chance."""
    found = error_of(fit, channel, kind)
    assert fit.trusted, str(fit)
    assert abs(found.value - true) < 5.0 * found.standard_error
    return found


def test_two_unknown_gains_are_found_with_the_laws() -> None:
    record = driven(gains={"force:m1": 1.05, "force:m2": 0.97})
    wrong = lw.identify(record, ASKED, as_stated=True)
    of_forces = [cause for cause in wrong.diagnosis if cause.kind == "force gain"]
    assert of_forces  # less acts than the first shows, and more than the second
    assert all((cause.size < 0.0) == (cause.where == "force:m1") for cause in of_forces)
    fit = lw.identify(record, ASKED, gains=["force:m1", "force:m2"])
    assert_within(fit, PAIR, 5.0)
    for channel, gain in (("force:m1", 1.05), ("force:m2", 0.97)):
        assert 0.0 < assert_error(fit, channel, gain).standard_error < 0.01
    assert any(line.startswith("force:m1 shows 1.0") and "of its force" in line for line in fit.findings)
    assert not any(cause.kind == "force gain" for cause in fit.diagnosis)


def test_an_unknown_gain_widens_every_interval_that_it_moves() -> None:
    record = driven({"m2": SECOND})
    known, unknown = lw.identify(record, ASKED), lw.identify(record, ASKED, gains=["force:m2"])
    narrow, larger = (present(fit.coefficient("lower.k").standard_error) for fit in (known, unknown))
    assert larger >= narrow
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
    asked = ONE.unknown("all")
    record = driven({"m1": FIRST}, subject=ONE)
    with pytest.raises(
        lw.IdentificationError, match=r"do not tell the gain of x:m1, force:m1: .* Leave one of them"
    ):
        lw.identify(record, asked, gains=["x:m1", "force:m1"])
    free = lw.simulate(ONE, release={"v:m1": 1.0}, duration=3.0, rate=RATE).with_noise(30.0, seed=3)
    with pytest.raises(lw.IdentificationError, match=r"do not tell the gain of x:m1: .* Leave it out"):
        lw.identify(free, asked, gains=["x:m1"])
    # of which one is known to within a part, which is the other's error then
    fit = lw.identify(record, asked, gains=["force:m1"], calibration={"x:m1": 0.01})
    assert fit.trusted and error_of(fit, "force:m1").standard_error == pytest.approx(0.01, rel=0.1)


def test_the_calibration_of_all_is_of_no_force() -> None:
    record = driven()
    gains = [Gain(name, 0.01) for name in record.responses]
    assert [*errors_to_find([record], AskedFor(calibration={"all": 0.01}))] == gains
    stated = replace(record, uncertainty={"force:m2": lw.records.SensorUncertainty(gain=0.02)})
    known = errors_to_find([stated], AskedFor(calibration={"all": 0.01}))
    assert [*known] == [*gains, Gain("force:m2", 0.02)]
    every, alone = (
        lw.identify(each, ASKED, calibration={"all": 0.01, **more})
        for each, more in ((stated, {}), (record, {"force:m2": 0.02}))
    )
    assert every.values == pytest.approx(alone.values, rel=1e-12)
    acting = [driven(gains=ZERO, seed=41), driven(seed=42)]
    assert errors_to_find(acting, AskedFor(gains=["force:m1"])) == (Gain("force:m1"),)  # in one of two
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
    assert_error(fit, "force:m1", 1.05)
    assert_within(fit, PAIR, 5.0)
    # of one mass a force that is too large is a response that is too small: neither is taken for the other
    single = driven({"m1": FIRST}, gains={"force:m1": 1.1}, subject=ONE)
    assert not lw.identify(single, ONE.unknown("all"), admit=["gain"]).sensor_errors


FIRST_ABSENT = "no gain of force:m1 can be estimated.*the record has .*force:m2"
FIRST_ZERO = "no gain or delay of force:m1 .* is 0 throughout the record"
ON_TIME, DRIVEN_AT_TOP, ZERO = (
    partial(late, "x:m1", 0, 34),
    partial(driven, {"m2": SECOND}),
    {"force:m1": 0.0},
)


@pytest.mark.parametrize(
    ("records", "asked", "options", "message"),
    [
        (ON_TIME, CHAIN_ASKED, {"delays": ["x:m9"]}, "no delay of x:m9 can be estimated; did you mean"),
        (ON_TIME, CHAIN_ASKED, {"delays": ["x:m1", "x:m1"]}, "x:m1 is named twice"),
        (lambda: [late("a:m2", 30, seed=36), late("a:m2", 30, seed=36).decimate(2)], CHAIN_ASKED, {"delays": ["a:m2"]},
         "late by more than a sample, which cannot be found from records of different"),
        (DRIVEN_AT_TOP, ASKED, {"gains": ["force:m1"]}, FIRST_ABSENT),
        (DRIVEN_AT_TOP, ASKED, {"calibration": {"force:m1": 0.01}}, "no calibration of force:m1 .* and the inputs force:m2"),
        (lambda: replace(driven(), interpolation={"force:m2": "held"}), ASKED, {"delays": ["force:m2"]},
         "no delay of force:m2, which is held between its samples"),
        (partial(driven, gains=ZERO), ASKED, {"gains": ["force:m1"]}, FIRST_ZERO),
        (lambda: [driven(gains=ZERO, seed=seed) for seed in (41, 42)], ASKED, {"gains": ["force:m1"]}, FIRST_ZERO),
    ],
)  # fmt: skip
def test_errors_of_channels_that_cannot_be_found_are_refused(
    records: Callable[[], lw.Record | list[lw.Record]],
    asked: lw.Structure,
    options: dict[str, Any],
    message: str,
) -> None:
    with pytest.raises(lw.IdentificationError, match=message):
        lw.identify(records(), asked, **options)


def test_a_delay_that_is_known_to_within_is_counted_and_one_that_is_diagnosed_admitted() -> None:
    record = driven(late={"force:m2": 1.5e-3})
    stated = replace(record, uncertainty={"force:m2": lw.records.SensorUncertainty(delay=2e-3)})
    for fit in (lw.identify(stated, ASKED), lw.identify(record, ASKED, admit=["delay"])):
        assert_error(fit, "force:m2", 1.5e-3, "delay")
        assert_within(fit, PAIR, 5.0)


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
    assert_error(fit, "force:m2", 1.05)
    assert_within(fit, pair, 5.0)


def test_a_discovery_finds_the_gain_of_a_force_with_the_structure() -> None:
    record = driven(gains={"force:m1": 1.05}, duration=6.0)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 1.0}, gains=["force:m1"])
    assert {(frozenset(entry.between), entry.law.text) for entry in discovery.structure.links} == {
        (frozenset(("m1", "ground")), "k*d + k3*d**3 + c*v"),
        (frozenset(("m2", "m1")), "k*d + c*v"),
    }
    assert discovery.trusted
    assert_error(discovery.estimate, "force:m1", 1.05)


@pytest.mark.usefixtures("unrendered")
def test_a_force_of_the_wrong_sign_is_named_beside_its_unknown_gain(tmp_path: Path) -> None:
    """The search makes the force vanish, ever larger gains later, and has no standard errors there."""
    fit = lw.identify(driven(gains={"force:m1": -1.0}, seed=41), ASKED, gains=["force:m1"], as_stated=True)
    assert not fit.trusted
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("sign", "force:m1")
    assert "change the sign of force:m1" in fit.message
    assert fit.sensor_errors == ()  # the gain is some 1e31
    lw.report.write_result(fit, tmp_path / "answer")
    assert not lw.validate(driven(seed=41), tmp_path / "answer").coefficients  # the folder can be read


ALL_OF_PAIR = ["x:m1", "x:m2", "force:m1", "force:m2"]


def test_unknown_gains_of_every_channel_are_refused_unless_a_known_law_sets_the_scale() -> None:
    """Twice the forces make twice the motion where every cubic is a quarter of itself."""
    record = driven(seed=41)
    with pytest.raises(
        lw.IdentificationError,
        match=r"do not tell the gain of x:m1, .*force:m2: another scale .* one of them out",
    ) as refusal:
        lw.identify(record, ASKED, gains=ALL_OF_PAIR)
    assert refusal.value.arguments == ("calibration",)
    fit = lw.identify(record, PAIR.unknown("lower.k", "lower.c", "upper"), gains=ALL_OF_PAIR)
    assert fit.trusted
    for error in some(fit.sensor_errors):
        assert abs(error.value - 1.0) < 5.0 * error.standard_error < 0.25
    assert lw.identify(record, ASKED, gains=ALL_OF_PAIR[1:]).trusted
