"""Laws that name recorded signals, identified and validated; what does not take them says so in a sentence."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from commands import document, said
from record_faults import changed

import linkwise as lw

TRUE = {"damper.k": 400.0, "damper.c0": 0.5, "damper.cu": 2.0}
VALVE = lw.rig({"m1": 1.0}, {"damper": "m1 - ground: k*d + (c0 + cu*u)*v"}, TRUE, signals={"u": "V"})
RATE = 200.0
Method = Literal["ml", "weak"]


def record(held: bool = False) -> lw.Record:
    """Four seconds of a valve that is moved while the mass swings."""
    time = np.arange(801) / RATE
    stem = 1.0 + np.sin(5.0 * time) if not held else np.where(np.sin(5.0 * time) > 0.0, 2.0, 0.0)
    return lw.simulate(
        VALVE,
        release={"x:m1": 0.05},
        duration=4.0,
        rate=RATE,
        forces={"m1": "3*sin(17*t) + 2*sin(23*t)"},
        signals={"u": lw.model.Sampled(0.0, RATE, stem, order=0 if held else 5)},
    ).with_noise(40.0, seed=491)


@pytest.mark.parametrize(("held", "method"), [(False, "ml"), (True, "ml"), (False, "weak"), (True, "weak")])
def test_a_valve_is_found_with_its_errors(held: bool, method: Method) -> None:
    measured = replace(record(held), simulated=None)
    if held:
        measured = replace(measured, interpolation={"signal:u": "held"})
    fit = lw.identify(measured, VALVE.unknown("all"), method=method)
    assert fit.trusted or method == "weak"  # to which four seconds leave friction open
    deviations = np.sqrt(fit.covariance.diagonal())
    assert np.abs((fit.values - list(TRUE.values())) / deviations).max() < 3.3  # of a thousand
    assert np.all(deviations < [0.2, 0.02, 0.03])
    assert fit.structure.signals == {"u": "V"}


@pytest.mark.slow
def test_a_law_that_lacks_its_signal_is_not_trusted() -> None:
    measured = replace(record(), simulated=None)
    constant = lw.rig({"m1": 1.0}, {"damper": "m1 - ground: k*d + c*v"})
    fit = lw.identify(measured, constant)
    assert not fit.trusted


@pytest.mark.slow
def test_correlated_noise_beside_an_error_that_was_added_hides_no_missing_signal() -> None:
    """On a short record a gain of +20 % and correlated noise stood for it, trusted."""
    short = replace(record()[:400].select(["x:m1", "force:m1"]), simulated=None)
    assert not lw.identify(short, lw.rig({"m1": 1.0}, {"damper": "m1 - ground: k*d + c*v"})).trusted


@pytest.mark.slow
def test_the_commands_take_signals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    columns = record()
    lw.write_structure(VALVE.unknown("all"), "valve.toml")
    names = ("laser", "hammer", "valve")
    table = np.column_stack([columns.time, columns.values])
    np.savetxt("run.csv", table, delimiter=",", header=",".join(["time", *names]), comments="")
    mapped = "--channel x:m1=laser --channel force:m1=hammer --channel signal:u[V]=valve"
    answer = document(f"identify run.csv valve.toml {mapped} -o answer")
    assert answer["trusted"]
    assert "u" in lw.read_structure("answer/structure.toml").signals
    scored = document(f"validate run.csv answer {mapped} --burn 0.5")
    assert scored["channels"]["x:m1"]["nmse_percent"] < 0.05
    assert "signal:u" in said(f"inspect run.csv {mapped}").out
    said("export answer --equations valve_motion.py")


def test_an_unknown_that_is_named_as_a_column_may_be_a_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    law = "m1 - ground: k*d + (c0 + cu*u)*v"
    lw.write_structure(lw.rig({"m1": 1.0}, {"valve": law}), "valve.toml")
    columns = record()[:200]
    table = np.column_stack([columns.time, columns.values])
    np.savetxt("run.csv", table, delimiter=",", header="time,x:m1,force:m1,u", comments="")
    told = said("identify run.csv valve.toml --method weak", 1).err
    assert "valve.u is unknown, and a column is named u" in told and "valve.cu is unknown" not in told
    assert 'write signals = { u = "UNIT" } at the top' in told and "give --channel signal:u=u." in told
    lw.write_structure(lw.rig({"m1": 1.0}, {"valve": law}, signals={"u": "V"}), "valve.toml")
    assert "column" not in said("identify run.csv valve.toml --method weak --channel signal:u=u").err


def test_sparse_regression_takes_no_signal() -> None:
    with pytest.raises(lw.StructureError, match=r'a signal \(u\), which is not supported in method "sindy"'):
        lw.identify(record(), VALVE.unknown("all"), method="sindy")


def test_a_record_without_the_signal_says_how_to_name_it() -> None:
    lacking = record().select(["x:m1", "force:m1"])
    with pytest.raises(lw.RecordError, match=r"a law names the signal u, .* Name a column signal:u\[V\]"):
        lw.identify(lacking, VALVE.unknown("all"))
    named = replace(record(), units={"signal:u": "A"})
    with pytest.raises(lw.RecordError, match="is stated in A, and the structure has the signal u in V"):
        lw.identify(named, VALVE.unknown("all"))


@pytest.mark.slow
def test_a_loudspeaker_is_found_from_voltage_current_and_displacement() -> None:
    law = lw.Law.parse("k*d + c*v - Bl*i", {"i": "(u - R*i - Bl*v)/L"}, signals={"u": "V"})
    true = {"k": 2300.0, "c": 1.2, "Bl": 5.3, "R": 6.4, "L": 4e-4}
    motor = lw.Link("motor", ("cone", "ground"), law, true)
    speaker = lw.Structure("loudspeaker", (lw.Mass("cone", "12 g"),), (motor,))
    voltage = "5*sin(400*t) + 3*sin(900*t + 1) + 4*sin(180*t)"
    run = lw.simulate(
        speaker, duration=0.25, rate=4000.0, signals={"u": voltage}, sensors=["x", "state:motor.i"]
    )
    measured = replace(run.with_noise(40.0, seed=492), simulated=None)
    cases: list[tuple[Method, list[str]]] = [("ml", [*true]), ("weak", ["k", "c", "Bl"])]
    for method, unknown in cases:
        fit = lw.identify(measured, speaker.unknown(*(f"motor.{name}" for name in unknown)), method=method)
        assert (
            fit.trusted or method == "weak"
        )  # to which the jump of the current at the start looks like outliers
        z = (fit.values - [true[name] for name in unknown]) / np.sqrt(fit.covariance.diagonal())
        assert np.abs(z).max() < 3.3  # of a thousand


@pytest.mark.slow
def test_intervals_allow_for_noise_of_a_signal() -> None:
    clean = record()
    noise = 0.03 * np.random.default_rng(494).standard_normal(len(clean))
    noisy = changed(clean, signal_u=lambda u: u + noise)
    fit = lw.identify(noisy, VALVE.unknown("all"))
    plain = lw.identify(replace(clean, simulated=None), VALVE.unknown("all"))
    assert "noise of signal:u of 0.0" in fit.message
    assert np.all(fit.covariance.diagonal() > 1.2 * plain.covariance.diagonal())
    z = (fit.values - list(TRUE.values())) / np.sqrt(fit.covariance.diagonal())
    assert np.abs(z).max() < 3.3  # of a thousand


def test_noise_of_a_signal_is_stated_as_that_of_other_inputs() -> None:
    """Intervals hold as much of it as was stated, and not only what the channel shows."""
    measured = replace(record(), simulated=None)
    plain = lw.identify(measured, VALVE.unknown("all"))
    stated = lw.identify(measured, VALVE.unknown("all"), input_noise={"signal:u": 0.05})
    assert stated.trusted and "noise of signal:u of 0.05 V" in stated.message
    assert np.all(stated.covariance.diagonal() > 1.2 * plain.covariance.diagonal())
    with pytest.raises(lw.IdentificationError, match=r"the noise of signal:u must be a positive number in V"):
        lw.identify(measured, VALVE.unknown("all"), input_noise={"signal:u": -1.0})


CASE = Path(__file__).parents[3] / "shared" / "cases" / "loudspeaker" / "klip.csv"


@pytest.mark.slow
@pytest.mark.skipif(not CASE.exists(), reason="needs ../shared")
def test_the_record_of_a_loudspeaker_with_its_voltage_is_explained() -> None:
    columns = {"time": "t", "x:cone[mm]": "X", "state:motor.i[A]": "I", "signal:u[V]": "U"}
    measured = lw.read_record(CASE, channels=columns)[:800]
    force = "Bl*(1 + b1*d + b2*d**2)"
    law = lw.Law.parse(
        f"k*d + k2*d**2 + k3*d**3 + c*v - {force}*i", {"i": f"(u - R*i - {force}*v)/L"}, signals={"u": "V"}
    )
    starts = {"b1": lw.Coefficient.unknown(1.0), "b2": lw.Coefficient.unknown(-1000.0)}
    unknown = dict.fromkeys(law.coefficients, lw.Coefficient.unknown()) | starts
    motor = lw.Link("motor", ("cone", "ground"), law, unknown)
    fit = lw.identify(measured, lw.Structure("loudspeaker", (lw.Mass("cone", "12 g"),), (motor,)))
    assert fit.trusted
    for name, value in {"motor.R": 6.4, "motor.L": 4e-4}.items():
        found = fit.coefficient(name)
        assert found.standard_error is not None
        assert abs(found.value - value) < 4.5 * found.standard_error
