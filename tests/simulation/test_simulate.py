"""simulate(): exact solutions, energies, the horizon, and every way to ask for nonsense."""

import pickle
from typing import Any

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import oscillator

from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError
from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Excitation, Impulse, Sampled, TimeFunction
from linkwise.model.structure import Structure
from linkwise.records.record import EnergyBalance, Record
from linkwise.simulation.run import RunSchedule, integrate
from linkwise.simulation.simulate import simulate

OMEGA, ZETA = 10.0, 0.05
DAMPED = OMEGA * np.sqrt(1 - ZETA**2)


@pytest.fixture(scope="module")
def spring() -> Structure:
    return oscillator("k*d + c*v", mass=2.0, k=2.0 * OMEGA**2, c=4.0 * ZETA * OMEGA)


def response(time: Floats) -> Floats:
    """Displacement of `spring` after a unit jump of velocity at 0."""
    return np.where(time >= 0, np.exp(-ZETA * OMEGA * time) * np.sin(DAMPED * time) / DAMPED, 0.0)


def closes(record: Record, part: float = 1e-09) -> EnergyBalance:
    energy = present(record.simulated).energy
    assert np.abs(energy.residual).max() < part * np.abs(energy.supplied).max()
    return energy


def test_a_free_vibration_is_exact_on_any_scale(spring: Structure) -> None:
    for speed in (1.0, 1e-9, 1e4 / 7.0):
        record = simulate(spring, release={"v:m1": speed}, duration=5.0, rate=123.0)
        assert record.values[:, 0] == pytest.approx(speed * response(record.time), abs=1e-13 * speed)
        closes(record, 1e-12)


def test_blows_between_samples_add_up(spring: Structure) -> None:
    blows = [Impulse("m1", 3.0, 1.2345), Impulse("m1", -2.0, 0.5), Impulse("m1", 1.0)]
    record = simulate(spring, impulses=blows, duration=4.0, rate=50.0, sensors=("x", "v"))
    expected = sum(blow.momentum / 2.0 * response(record.time - blow.time) for blow in blows)
    assert record.channel("x:m1") == pytest.approx(expected, abs=1e-13)
    assert record.channel("v:m1")[[0, 25]] == pytest.approx(  # at a blow: the velocity after it
        [0.5, present(record.simulated).velocity[25, 0]]
    )
    energy = closes(record, 1e-12)
    assert energy.supplied[0] == pytest.approx(1.0**2 / (2 * 2.0), rel=1e-12)


def test_a_forced_vibration_settles_on_the_exact_one(spring: Structure) -> None:
    record = simulate(spring, forces={"m1": "4*sin(7*t)"}, duration=80.0, rate=20.0)
    late = record.between(70.0, 80.0)
    transfer = 1.0 / (2.0 * (OMEGA**2 - 49.0 + 2j * ZETA * OMEGA * 7.0))
    expected = np.imag(4.0 * transfer * np.exp(7j * late.time))
    assert late.channel("x:m1") == pytest.approx(expected, abs=1e-13)  # the rest has died down by exp(-35)
    assert record.channel("force:m1") == pytest.approx(4.0 * np.sin(7.0 * record.time), rel=1e-12)
    closes(record, 1e-12)


def test_a_moving_base_carries_the_mass() -> None:
    hung = oscillator("k*d + c*v", mass=2.0, to="base", k=2.0 * OMEGA**2, c=4.0 * ZETA * OMEGA)
    record = simulate(hung, base="0.1*sin(7*t)", duration=80.0, rate=20.0)
    late = record.between(70.0, 80.0)
    stiffness = OMEGA**2 + 2j * ZETA * OMEGA * 7.0
    expected = np.imag(0.1 * stiffness / (stiffness - 49.0) * np.exp(7j * late.time))
    assert late.channel("x:m1") == pytest.approx(expected, abs=1e-13)
    assert record.inputs == ("x:base",)
    assert np.array_equal(present(present(record.simulated).base), record.channel("x:base"))
    closes(record, 1e-12)


def test_samples_drive_as_their_expression_does(spring: Structure) -> None:
    time = np.arange(-10, 1011) / 100.0
    samples = Sampled(-0.1, 100.0, np.sin(7.0 * time))
    limited = Sampled(-0.1, 100.0, np.sin(7.0 * time), band_limited=True)
    exact, sampled, finer = (
        simulate(spring, forces={"m1": force}, duration=9.9, rate=33.0)
        for force in ("sin(7*t)", samples, limited)
    )
    quintic = 0.07**6 / 720  # of the force
    assert sampled.values[:, 0] == pytest.approx(exact.values[:, 0], abs=quintic)
    cut_off = 1e-6  # of the windowed sinc, whose samples end too
    assert finer.values[:, 0] == pytest.approx(exact.values[:, 0], abs=cut_off)
    closes(sampled, 1e-12)


def test_held_samples_push_as_steps(spring: Structure) -> None:
    stepped = Sampled(0.0, 1.0, np.array([2.0, 0.0, 0.0]), order=0)
    record = simulate(spring, forces={"m1": stepped}, duration=2.0, rate=40.0)
    time, fine = record.time, np.linspace(0.0, 1.0, 4001)
    push = np.array([np.trapezoid(np.where(t >= fine, response(t - fine), 0.0), fine) for t in time])
    assert record.values[:, 0] == pytest.approx(push, abs=1e-7)  # trapezoidal rule at 0.25 ms


DRIVEN = {
    "released": {"release": {"v:m1": 3.0, "x:m2": 0.01}},
    "struck": {"impulses": (Impulse("m2", 0.02, 0.1234), Impulse("m3", 1.0))},
    "forced": {"forces": {"m1": "50*sin(90*t)", "m4": "0.5"}},
    "sampled": {"forces": {"m2": Sampled(0.0, 500.0, np.sin(np.arange(400.0)))}},
}


@pytest.mark.parametrize("drive", DRIVEN.values(), ids=DRIVEN)
def test_the_energy_balance_of_a_chain_closes(drive: dict[str, Any]) -> None:
    record = simulate(bnes_chain(4), duration=0.7, rate=200.0, **drive)
    energy = closes(record)
    assert energy.potential.shape == energy.dissipated.shape == (len(record), 4)
    assert np.all(np.diff(energy.dissipated, axis=0) >= 0.0)
    assert energy.supplied[-1] > 0.0


def test_two_masses_are_predictable_and_ten_are_not() -> None:
    """METHODS section 1: an error of 1e-4 is reached at 1.25 s; 1e-3 of the motion a little later."""
    calm, chaotic, wilder = (present(chain_record(masses).simulated).horizon for masses in (2, 10, 6))
    assert calm is None
    assert 1.2 < present(chaotic) < 1.8
    assert 0.8 < present(wilder) < 1.2


def test_sensors_are_what_was_asked_for(spring: Structure) -> None:
    record = simulate(spring, release={"x:m1": 0.1}, duration=1.0, rate=100.0, sensors=["a", "x"])
    assert record.channels == ("a:m1", "x:m1")
    v = present(record.simulated).velocity[:, 0]
    acceleration = -(OMEGA**2) * record.channel("x:m1") - 2 * ZETA * OMEGA * v
    assert record.channel("a:m1") == pytest.approx(acceleration, rel=1e-10, abs=1e-12)  # identity
    some = simulate(bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=100.0, sensors=["v:m2", "x"])
    assert some.channels == ("v:m2", "x:m1", "x:m2")
    assert np.array_equal(some.channel("v:m2"), present(some.simulated).velocity[:, 1])


def test_the_sampling_grid_is_free(spring: Structure) -> None:
    record = simulate(spring, release={"v:m1": 1.0}, times=np.linspace(0.35, 2.35, 9))
    assert (record.start, record.rate) == (0.35, 4.0)
    assert record.values[:, 0] == pytest.approx(response(record.time), abs=1e-13)
    less = simulate(spring, release={"v:m1": 1.0}, duration=0.3, rate=10.0)
    assert len(less) == 4  # 0.3*10 is 3 but for rounding
    closes(record, 1e-12)


def test_a_resting_structure_rests_and_a_simulated_record_survives_a_pickle(spring: Structure) -> None:
    record = simulate(spring, duration=1.0, rate=100.0)
    assert not record.values.any() and present(record.simulated).horizon is None
    assert not present(record.simulated).energy.residual.any()
    record = simulate(spring, release={"v:m1": 1.0}, duration=1.0, rate=100.0)
    again = pickle.loads(pickle.dumps(record.simulated))
    assert np.array_equal(again.energy.dissipated, present(record.simulated).energy.dissipated)


@pytest.mark.parametrize(
    ("law", "values", "time", "message"),
    [
        ("alpha*d", {"alpha": -100.0}, 1.2, "the motion diverges: at 1.2"),
        ("k3*d**3", {"k3": -100.0}, 0.69, "the motion diverges: at 0.697244 s the displacement of mass m1"),
        ("k*d + c*v", {"k": 100.0, "c": -1.0}, 23.0, "a link with negative stiffness or damping"),
        ("k*sqrt(1 + d/s)", {"k": 10.0, "s": 0.05}, 0.2, "the displacement of mass m1 is -0.05 m"),
    ],
)
def test_what_diverges_says_when_and_where(
    law: str, values: dict[str, Any], time: float, message: str
) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(oscillator(law, **values), release={"v:m1": 1.0}, duration=50.0, rate=100.0)
    assert message in str(caught.value)
    # when x passes 1e4 m: asinh(1e5)/10 = 1.22 s, the end of a closed form, 2 log(1e5) = 23.03 s; seen within a tenth
    assert caught.value.mass == "m1" and time <= present(caught.value.time) < 1.1 * time


def test_a_structure_far_too_stiff_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("linkwise.simulation.run.MOST_STEPS", 20_000)
    schedule = RunSchedule(oscillator("k*d", k=1e16), Excitation({"x:m1": 1.0}), np.arange(101) / 100.0)
    message = r"takes more than \d+ steps between two output times, mass m1 .* check stiffnesses"
    with pytest.raises(SimulationError, match=message):
        integrate(schedule, schedule.times)


def sampled(end: float, start: float = 0.0) -> Sampled:
    return Sampled(start, 10.0, np.zeros(round((end - start) * 10) + 1))


REFUSED = {
    "no duration": ({"duration": 0.0}, "duration must be positive and finite, got 0.0 s"),
    "one sample": ({"duration": 0.001}, "0.001 s at 100 Hz is less than one sampling interval"),
    "too many samples": ({"rate": 1e15}, "at 1e+15 Hz are 1e+15 samples, more than memory can hold; simulate a sh"),
    "neither": ({"duration": None}, "duration in s and rate in Hz, or times, must be given"),
    "both": ({"times": [0.0, 1.0]}, "times cannot be combined with duration or rate"),
    "uneven": ({"duration": None, "rate": None, "times": [0.0, 1.0, 3.0]}, "times must be evenly spaced"),
    "past": ({"duration": None, "rate": None, "times": [-1.0, 0.0, 1.0]}, "two increasing numbers, not negative"),
    "release": ({"release": {"x:m12": 1.0}}, "unknown mass 'm12' in a release; did you mean \"m2\"?; the masses are m1, m2"),
    "kind": ({"release": {"a:m1": 1.0}}, "unknown release 'a:m1'; expected a displacement, such as x:m1, or a velocity, v:m1"),
    "late": ({"impulses": [Impulse("m1", 1.0, 1.0)]}, "the impulse on m1 at 1 s is after the end of the simulation (1 s)"),
    "force": ({"forces": {"x": "1"}}, "unknown mass 'x' in a force; the masses are m1, m2"),
    "short": ({"forces": {"m1": sampled(0.9)}}, "on m1 is sampled from 0 to 0.9 s, but the simulation runs from 0 to 1 s"),
    "no base": ({"base": "sin(t)"}, 'no link has "base" as an end; write "base" instead of "ground"'),
    "sensor": ({"sensors": ["q:m1"]}, "invalid sensor: 'q:m1' is not a channel: unknown kind 'q'; choose from x"),
    "input": ({"sensors": ["force:m1"]}, "force:m1 is an input, which is recorded whenever it drives the structure"),
    "no sensor": ({"sensors": ()}, 'sensors must have at least one kind, "x", "v" or "a"'),
}  # fmt: skip


@pytest.mark.parametrize(("keywords", "message"), REFUSED.values(), ids=REFUSED)
def test_nonsense_is_refused(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(bnes_chain(2), **{"duration": 1.0, "rate": 100.0, **keywords})
    assert message in str(caught.value)


def test_a_base_that_does_not_move_by_itself_and_an_unknown_are_asked_for() -> None:
    hung = oscillator("k*d", to="base", k=1.0)
    message = r"link 'link' has .base. as an end, but the motion of the base is not given"
    with pytest.raises(SimulationError, match=message):
        simulate(hung, duration=1.0, rate=100.0)
    with pytest.raises(SimulationError, match=r"the motion of the base is sampled from 0\.5 to 2 s"):
        simulate(hung, base=sampled(2.0, 0.5), duration=1.0, rate=100.0)
    with pytest.raises(StructureError, match=r"nes1.*alpha.*unknown.*give it a number, or identify it first"):
        simulate(bnes_chain(2).unknown("nes"), release={"v:m1": 1.0}, duration=1.0, rate=100.0)


def test_sensors_relative_to_the_base_and_of_the_base() -> None:
    structure = oscillator("k*d", mass=2.0, to="base", k=400.0)
    base = "0.01*sin(20*t) + 0.002*t**2"
    sensors = ["x", "v", "a", "rel:x", "rel:v", "rel:a", "a:base"]
    record = simulate(structure, base=base, duration=0.5, rate=200.0, sensors=sensors)
    assert record.inputs == ("a:base",)
    motion = TimeFunction(base)
    shown = [motion.value(record.time), motion.derivative(record.time), motion.derivative(record.time, 2)]
    for kind, of_base in zip("xva", shown, strict=True):
        relative = record.channel(f"{kind}:m1") - of_base
        assert record.channel(f"rel:{kind}:m1") == pytest.approx(relative, abs=1e-12)
    assert record.channel("a:base") == pytest.approx(shown[2], abs=1e-12)
    with pytest.raises(SimulationError, match="sensor rel:x needs a base that moves"):
        simulate(oscillator("k*d", k=400.0), duration=0.5, rate=200.0, sensors=["rel:x"])
