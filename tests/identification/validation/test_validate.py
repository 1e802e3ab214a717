"""Validation: predictions of simulated records by the truth, by estimates and by wrong structures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from present import some
from problems import chain_record
from record_faults import without
from structures import HARDENING, THREE_TONES, duffing, host, link, structure

import linkwise as lw
from linkwise.identification.validated_answer import estimated_again
from linkwise.progress import silent

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unrendered")]


def forced(
    structure: lw.Structure, seed: int, snr: float = 40.0, sensors: tuple[str, ...] = ("x",)
) -> lw.Record:
    record = lw.simulate(structure, forces=THREE_TONES, duration=3.0, rate=500.0, sensors=sensors)
    return record.with_noise(snr, seed=seed)


@pytest.fixture(scope="module")
def answer() -> lw.Estimate:
    estimate = lw.identify(forced(duffing(), 1), duffing().unknown("all"))
    assert estimate.trusted
    return estimate


@pytest.fixture(scope="module")
def agreeing(answer: lw.Estimate) -> lw.Validation:
    return lw.validate(forced(duffing(), 2)[300:], answer, refit=True)


# --- the truth, and estimates of it


@pytest.mark.parametrize("sensors", [("v",), ("x", "a")])
def test_the_truth_leaves_the_noise(sensors: tuple[str, ...]) -> None:
    """Errors are as large as the noise that was added: of 1100 samples, to 4 standard deviations of 1/sqrt(2 N)."""
    record = forced(duffing(), 3, sensors=sensors)[217:]
    validation = lw.validate(record, duffing())
    assert validation.free_run and validation.trusted and validation.windows == 1
    clean = forced(duffing(), 3, 300.0, sensors)[217:]
    exact = lw.validate(
        clean, duffing()
    )  # noise below what arithmetic in single precision resolves is not asked for
    assert exact.trusted and all(score.fit_percent > 99.999 for score in exact.channels.values())
    for name, score in some(validation.channels.items()):
        noise = np.std(record.channel(name) - clean.channel(name))
        assert score.rmse == pytest.approx(noise, rel=4 / np.sqrt(2 * score.samples))
        assert score.expected >= score.noise
        measured = record.channel(name)[-score.samples :]
        assert score.nmse_percent == pytest.approx(100 * score.rmse**2 / np.var(measured), rel=1e-12)
        assert score.fit_percent == pytest.approx(100 - 10 * np.sqrt(score.nmse_percent), rel=1e-12)
        assert score.one_step_rmse == pytest.approx(score.one_step_expected, rel=0.1)


def test_an_estimate_predicts_another_record(agreeing: lw.Validation) -> None:
    """Three coefficients, estimated again from the other record, lie within the limits of their joint test."""
    assert agreeing.verdicts == (lw.Verdict.PREDICTION_AGREES,)
    names = [coefficient.name for coefficient in agreeing.coefficients]
    assert names == ["spring.k", "spring.k3", "spring.c"]
    assert all(coefficient.agrees for coefficient in some(agreeing.coefficients))
    assert agreeing.findings == ()
    assert agreeing.burn == pytest.approx(60 / 500.0, rel=1e-12)  # 5 % of 1201 samples
    text = str(agreeing)
    assert text.startswith("The prediction agrees") and "spring.k3" in text and "One free run" in text
    assert agreeing._repr_html_().startswith("<div")


def test_intervals_count_in_what_is_allowed(answer: lw.Estimate) -> None:
    record = forced(duffing(), 2)
    wide = lw.estimates.Posterior.of(answer)
    wide = replace(wide, covariance=100.0 * wide.covariance)
    exact, with_errors = lw.validate(record, answer.structure, refit=True), lw.validate(record, wide)
    assert with_errors.channels["x:m1"].expected > exact.channels["x:m1"].expected
    assert with_errors.channels["x:m1"].rmse == exact.channels["x:m1"].rmse
    assert not exact.coefficients and not exact.refittable
    assert not with_errors.coefficients and with_errors.refittable == ("spring.k", "spring.k3", "spring.c")
    assert "would free spring.k, spring.k3, spring.c." in " ".join(str(with_errors).split())
    # coefficients that are farther off beside dropped terms are so only together with these
    plain = lw.estimates.Posterior.of(answer)
    more = 99.0 * plain.covariance
    wide = replace(plain, covariance=plain.covariance + more, for_dropped_terms=more)
    validation, expected = (lw.validate(record, posterior, refit=True) for posterior in (wide, plain))
    limits = [result.channels["x:m1"].limit for result in (validation, expected)]
    assert limits[0] == pytest.approx(limits[1], rel=1e-6)
    errors = [result.coefficients[0].standard_error for result in (validation, expected)]
    assert errors[0] == pytest.approx(10.0 * errors[1])


def test_expected_errors_are_those_that_occur() -> None:
    """Over 6 records the squared error over its expectation is 1, to 4 standard deviations of their mean."""
    truth = duffing()
    ratios = []
    for seed in range(6):
        validation = lw.validate(forced(truth, seed, 20.0)[:600], truth, burn=0.1)
        deviation = validation.deviation.values
        error = validation.record.channel("x:m1")[:, None] - validation.predicted.values
        ratios.append(np.nanmean((error / deviation) ** 2))
    assert abs(np.mean(ratios) - 1.0) < 4 * np.std(ratios) / np.sqrt(len(ratios))


def test_a_stated_model_error_is_allowed_for() -> None:
    """A spring 0.5 % too stiff disagrees, unless the laws are known to leave 0.5 % of the forces."""
    record = forced(duffing(), 2, 60.0)
    off = duffing(k=904.5)
    assert lw.validate(record, off).verdicts == (lw.Verdict.PREDICTION_DISAGREES,)
    validation = lw.validate(record, off, model_error=0.005)
    assert validation.trusted and validation.model_error == 0.005


# --- what must be refused


def test_a_wrong_structure_disagrees(answer: lw.Estimate) -> None:
    """A record of a stiffer spring: the prediction is off, k is named, and the error is placed in the motion."""
    validation = lw.validate(forced(duffing(k=990.0), 2), answer, refit=True)
    assert not validation.trusted and validation.status == "prediction disagrees"
    assert not validation.channels["x:m1"].agrees
    assert [entry.name for entry in validation.coefficients if not entry.agrees] == ["spring.k"]
    assert any("spring.k: this record alone gives" in finding for finding in validation.findings)
    assert any("Over d of spring the error is largest" in finding for finding in validation.findings)


def test_the_error_is_shown_over_links_and_not_over_modes() -> None:
    payload = link("payload", "store-wing.tip", HARDENING, k=320.0, k3=2e6, c=0.2)
    shapes = {"tip": (0.8, -0.6), "joint": (0.5, 0.7)}
    wing = host("wing", (5.0, 6.5), 0.012, shapes, {(1, 2): 0.3})
    subject = structure({"store": 0.08}, payload, hosts=[wing])
    record = lw.simulate(subject, forces={"wing.joint": "sin(30*t)"}, duration=1.0, rate=250.0)
    validation = lw.validate(record.with_noise(40.0, seed=5), subject)
    quantities = [profile.quantity for profile in validation.profiles]
    assert quantities == ["time", "d of payload", "v of payload"]


# --- chaos


def test_a_chaotic_chain_is_predicted_in_windows() -> None:
    record = chain_record(4)[:1200].with_noise(30.0, seed=2)
    validation = lw.validate(record, lw.bnes_chain(4), burn=0.1)
    assert not validation.free_run and validation.windows > 8 and validation.trusted
    assert validation.window is not None and validation.window < record.duration / 8
    assert "is chaotic" in str(validation)
    for score in some(validation.channels.values()):
        # four deviations below; above, the state at the start of a window has errors of its own, measured 1.23
        assert 1.0 - 4 / np.sqrt(2 * score.samples) < score.rmse / score.noise < 2.0
    wrong = lw.validate(record, lw.bnes_chain(4).with_values({"nes1.beta": 1.1e6}), burn=0.1)
    assert wrong.verdicts == (lw.Verdict.PREDICTION_DISAGREES,)


# --- data as they are


def test_gaps_and_spare_channels_are_left_out() -> None:
    record = forced(duffing(), 2)
    values = record.values.copy()
    column = record.channels.index("x:m1")
    values[700:760, column] = np.nan
    values[::7, column] = np.nan
    spare = np.column_stack([values, np.zeros(len(record))])
    messy = lw.Record(record.start, record.rate, (*record.channels, "x:m9"), spare)
    validation = lw.validate(messy, duffing())
    assert validation.trusted and list(validation.channels) == ["x:m1"]
    assert validation.channels["x:m1"].samples == int(np.isfinite(values[75:, column]).sum())


@pytest.mark.parametrize(
    ("burn", "message"),
    [(2.99, "leaves 6 of 1501 samples"), (-1.0, "burn must be a positive time"), (1e-4, "needs at least 2")],
)
def test_a_burn_that_leaves_too_little_is_refused(burn: float, message: str) -> None:
    with pytest.raises(lw.RecordError, match=message) as caught:
        lw.validate(forced(duffing(), 2), duffing(), burn=burn)
    assert caught.value.arguments == ("burn",)
    record = forced(duffing(), 2)[:120]  # it may leave twenty samples and no fewer
    assert lw.validate(record, duffing(), burn=100 / 500.0).channels["x:m1"].samples == 20
    with pytest.raises(lw.RecordError, match="leaves 19 of 120 samples"):
        lw.validate(record, duffing(), burn=101 / 500.0)


def test_records_that_do_not_fit_the_structure_are_refused() -> None:
    record = forced(duffing(), 2)
    with pytest.raises(lw.RecordError, match="no response of m1"):
        lw.validate(record.select(["force:m1"]), duffing())
    elsewhere = lw.Record(0.0, 500.0, ("force:m7", "x:m1"), np.ones((400, 2)))
    with pytest.raises(lw.RecordError, match="acts on no mass"):
        lw.validate(elsewhere, duffing())
    with pytest.raises(lw.IdentificationError, match="inputs must be complete; cut the record"):
        lw.validate(without(record, force_m1=5), duffing())
    with pytest.raises(lw.StructureError, match=r"spring\.k is unknown"):
        lw.validate(record, duffing().unknown("spring.k"))
    with pytest.raises(lw.IdentificationError, match="model_error must be 0 or"):
        lw.validate(record, duffing(), model_error=-0.1)


# --- folders


def test_a_result_folder_is_an_answer(answer: lw.Estimate, agreeing: lw.Validation, tmp_path: Path) -> None:
    """What was written and read gives the same scores, to the digits of the structure file."""
    folder = lw.report.write_result(answer, tmp_path / "answer")
    validation = lw.validate(forced(duffing(), 2)[300:], folder)
    assert validation.channels["x:m1"].rmse == pytest.approx(agreeing.channels["x:m1"].rmse, rel=1e-8)
    assert len(validation.refittable) == 3 and not agreeing.refittable
    (folder / "covariance.csv").unlink()
    bare = lw.validate(forced(duffing(), 2)[300:], folder)
    assert not bare.coefficients and "taken as exact" in bare.remarks[0]
    inside = lw.validate(forced(duffing(), 2)[300:], tmp_path)  # as that of a first start
    assert inside.channels == bare.channels
    (folder / "result.json").unlink()
    with pytest.raises(lw.StructureError, match=r"there is no structure\.toml"):
        lw.validate(forced(duffing(), 2), tmp_path)


def test_the_folder_holds_numbers_figures_and_page(agreeing: lw.Validation, tmp_path: Path) -> None:
    folder = lw.report.write_result(agreeing, tmp_path / "validation")
    document = json.loads((folder / "validation.json").read_text())
    assert document["channels"]["x:m1"]["rmse"] == agreeing.channels["x:m1"].rmse
    assert document["free_run"] is True and document["burn"] == agreeing.burn
    names = {"prediction", "error", "motion", "spectrum"}
    assert {f"{name}.png" for name in names} < set(document["files"])
    predicted = lw.read_record(folder / "predicted.csv")
    assert np.nanmax(np.abs(predicted.values - agreeing.predicted.values)) < 1e-8
    page = (folder / "report.html").read_text()
    assert "spring.k3" in page and "Where in the motion" in page


# --- drives and sensors


RIG = structure(
    {"m1": 1.0, "m2": 0.2},
    link("mount", "m1-base", "k*d + c*v", k=900.0, c=2.0),
    link("joint", "m2-m1", HARDENING, k=150.0, k3=1e5, c=0.3),
)


@pytest.mark.parametrize("sensors", [("x:m1", "x:m2"), ("x:m2",)])
def test_a_rig_on_a_moving_base_with_hidden_masses(sensors: tuple[str, ...]) -> None:
    """The state of a mass without a sensor is worked out from the others; a joint 7 % too stiff is seen by either sensor."""
    base = "0.01*sin(20*t) + 0.005*sin(33*t)"
    record = lw.simulate(RIG, base=base, duration=2.0, rate=300.0).with_noise(40.0, seed=1)
    record = record.select(["x:base", *sensors])
    assert lw.validate(record, RIG).trusted
    assert not lw.validate(record, RIG.with_values({"joint.k": 160.0})).trusted


def hardening_pair() -> lw.Structure:
    law = "k*d + k3*d**3 + c*v"
    ground = link("a", "m1-ground", law, k=900.0, k3=3e5, c=1.5)
    upper = link("b", "m2-m1", law, k=500.0, k3=3e5, c=1.0)
    return structure({"m1": 1.0, "m2": 0.5}, ground, upper)


@pytest.mark.parametrize("gain", [1.0, 1.04])
def test_a_record_whose_sensor_is_off_refutes_the_laws_within_wide_intervals(gain: float) -> None:
    """The intervals of a short answer allow for an error of 4 % of a gain: the prediction was said to agree."""
    start = {"x:m1": 0.01}
    short = lw.simulate(hardening_pair(), release=start, duration=2.0, rate=400.0).with_noise(20.0, seed=1)
    answer = lw.identify(short, hardening_pair().unknown("all"))
    start["x:m2"] = -0.008
    record = lw.simulate(hardening_pair(), release=start, duration=4.0, rate=400.0).with_noise(35.0, seed=2)
    validation = lw.validate(replace(record, values=record.values * [1.0, gain]), answer, refit=True)
    assert answer.trusted and all(channel.agrees for channel in some(validation.channels.values()))
    if gain == 1.0:
        assert validation.trusted and not validation.remarks
    else:
        assert validation.verdicts == (lw.Verdict.LAWS_REFUTED,) and not validation.trusted
        assert "explained by a gain of x:m2 that is off by +3.87 %." in str(validation.remarks)


def test_a_record_that_any_prediction_agrees_with_tests_nothing(agreeing: lw.Validation) -> None:
    """A motion is predicted to within a multiple of itself: it agreed."""
    vacuous = {
        name: replace(entry, limit=1e3, nmse_percent=100.0) for name, entry in agreeing.channels.items()
    }  # in m
    assert all(entry.is_vacuous for entry in some(vacuous.values()))
    validation = replace(agreeing, channels=vacuous, coefficients=())
    assert validation.verdicts == (lw.Verdict.PREDICTION_NOT_TESTED,) and not validation.trusted
    score = replace(agreeing.channels["x:m1"], limit=1.0)  # m
    assert replace(agreeing, channels={"x:m1": score}).trusted  # as the coefficients, which the record tells
    assert replace(agreeing, channels={"x:m1": score}, coefficients=()).trusted  # as it shows the motion
    missed = {"x:m1": replace(score, nmse_percent=100.0)}
    assert not replace(agreeing, channels=missed, coefficients=()).trusted


def test_what_no_state_lets_follow_the_record_is_refused_without_a_warning() -> None:
    """A displacement 200 times too large, whose motion overflows, and a coefficient of a search that did not converge."""
    record = chain_record(2, duration=0.3).with_noise(30.0, seed=3)
    values = record.values * [201.168, 1.0]
    with pytest.raises(lw.SimulationError, match="runs to infinity; check its coefficients, and the units"):
        lw.validate(replace(record, values=values, simulated=None), lw.bnes_chain(2))
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    # the first overflows; the second grows so much in the burn that its growth alone is left of sensitivities
    for numbers in ({"beta": 1e16}, {"alpha": -2.655e5, "beta": 8200.0, "c": -0.033}):
        absurd = chain.with_values({f"nes1.{name}": value for name, value in numbers.items()})
        with pytest.raises(lw.SimulationError, match="no state is found from which the answer follows"):
            lw.validate(record[:201], absurd, burn=0.1)


def test_a_linear_host_with_overdamped_modes_is_validated() -> None:
    """Nothing but the state at the start is unknown there: covariances of a filter sink to rounding."""
    frequencies, damping = (5.0, 9.0, 20.0, 33.0, 48.0), (0.01, 2.0, 0.01, 0.02, 3.0)
    shapes = {"tip": (0.1, -0.05, 0.1, 0.03, -0.08), "mid": (0.04, 0.1, -0.07, 0.02, 0.05)}
    wing = structure({}, hosts=(host("wing", frequencies, damping, shapes),))
    forces, sensors = {"wing.tip": "20*exp(-((t - 0.5)/0.01)**2) + 3*sin(70*t)"}, ["a:wing.tip", "a:wing.mid"]
    record = lw.simulate(wing, forces=forces, duration=5.0, rate=200.0, sensors=sensors)
    assert lw.validate(record.with_noise(40.0, seed=1), wing).trusted


def test_damping_between_modes_stays_one_unknown_where_coefficients_are_estimated_again() -> None:
    """It is two dampers, of which one shares what the other has: each known to within by itself, they damp the modes too."""
    known_to_within = lw.Coefficient.unknown(0.1, sigma=0.2)

    def damped(between: lw.Coefficient | float, k3: lw.Coefficient | float) -> lw.Structure:
        wing = host("wing", (5.0, 6.0), 0.01, {"tip": (0.6, 0.5)}, {(1, 2): between})
        return structure({}, link("joint", "wing.tip-ground", "k3*d**3", k3=k3), hosts=[wing])

    sweep, sensors = {"wing.tip": "5*sin(2*pi*(2*t + 0.5*t**2))"}, ["a:wing.tip"]
    clean = lw.simulate(damped(0.3, 2e4), forces=sweep, duration=6.0, rate=200.0, sensors=sensors)
    record = clean.with_noise(40.0, seed=1)
    answer = lw.identify(record, damped(known_to_within, lw.Coefficient.unknown()))
    again = estimated_again(record, lw.estimates.Posterior.of(answer), silent)
    assert [parameter.name for parameter in again.parameters] == ["wing.mode1+mode2.damping", "joint.k3"]
    damping = again.coefficient("wing.mode1+mode2.damping")
    assert abs(damping.value - 0.3) < 4.0 * (damping.standard_error or 0.0)
