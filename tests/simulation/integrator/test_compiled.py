"""The compiled equations against energies by NumPy and exact solutions, and what becomes of kinks."""

import threading
from typing import Any

import numpy as np
import pytest
from present import present
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.simulation.simulate import SimulatedMotion

LAWS = [
    ("k*d + c*v + k3*d**3 - k5*d**5", {"k": 90.0, "c": 0.3, "k3": 500.0, "k5": 20.0}),
    ("k*d/(1 + (d/s)**2)", {"k": 90.0, "s": 0.05}),
    ("k*d*(e**2 + d**2)**0.25", {"k": 90.0, "e": 0.01}),
    ("k*s*sin(d/s) + c*v*cos(d/s)", {"k": 90.0, "s": 0.05, "c": 0.1}),
    ("k*d*exp(-d**2/s**2) + k1*d", {"k": 90.0, "s": 0.05, "k1": 30.0}),
    ("k*d + F*tanh(v/s)", {"k": 90.0, "F": 1.0, "s": 0.3}),
    ("k*d*sqrt(1 + d**2/s**2)", {"k": 90.0, "s": 0.05}),
    ("k*d*(e**2 + d**2)**p", {"k": 90.0, "e": 0.01, "p": 0.3}),
    ("k*d - q*d**2 + c*v**2*v", {"k": 90.0, "q": 100.0, "c": 0.2}),
]


def test_each_thread_has_its_own_integrator() -> None:
    chain, answers = lw.bnes_chain(2), {}

    def run(k: int) -> None:
        stiffer = lw.bnes_chain(2, k=30000.0 + k)
        answers[k] = lw.simulate(stiffer, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).values

    threads = [threading.Thread(target=run, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).values
    assert np.array_equal(answers[0], alone)
    assert not np.array_equal(answers[1], alone)


def closes(record: lw.Record, part: float = 1e-12) -> None:
    """The energy balance, an identity."""
    energy = present(record.simulated).energy
    assert np.abs(energy.residual).max() < part * energy.supplied.max()


@pytest.mark.slow
@pytest.mark.parametrize(("law", "values"), LAWS, ids=[law for law, _ in LAWS])
def test_every_law_does_the_work_that_numpy_gives_it(law: str, values: dict[str, Any]) -> None:
    """Along a motion that a force drives, energies are those of the law as NumPy evaluates it."""
    drive: dict[str, Any] = {"release": {"v:m1": 0.8, "x:m1": 0.01}, "forces": {"m1": "2*cos(5*t)"}}
    closes(lw.simulate(oscillator(law, mass=0.7, **values), duration=0.5, rate=50.0, **drive), 1e-11)


@pytest.mark.slow
def test_a_chain_with_a_moving_base_and_sampled_forces_balances() -> None:
    ends = ("base-m1", "m2-m1", "m3-m2", "m3-ground")
    links = (link(f"l{i}", end, "k*d + c*v + k3*d**3", k=50.0, c=0.2, k3=300.0) for i, end in enumerate(ends))
    frame = structure({f"m{i}": 1.0 + 0.1 * i for i in range(1, 4)}, *links)
    force = lw.model.Sampled(-0.1, 40.0, np.random.default_rng(0).standard_normal(100))
    drive: dict[str, Any] = {"release": {"x:m2": 0.1}, "forces": {"m2": force}, "base": "0.1*sin(6*t)**2"}
    closes(lw.simulate(frame, duration=0.3, rate=30.0, **drive), 1e-11)


def contact(time: Floats, speed: float, gap: float, frequency: float) -> Floats:
    """A free mass that flies at `speed`, meets a spring of that circular frequency at `gap` and comes back."""
    since, lasts = time - gap / speed, np.pi / frequency
    inside = gap + speed / frequency * np.sin(frequency * since)
    return np.where(since < 0, speed * time, np.where(since < lasts, inside, gap - speed * (since - lasts)))


CONTACTS = [
    "kc*max(d - g, 0)",
    "kc*(abs(d - g) + d - g)/2",
    "kc*(d - min(d, g))",
    "kc*(d - g)*(1 + sign(d - g))/2",
]


@pytest.mark.parametrize("law", CONTACTS)
def test_a_gap_is_met_exactly(law: str) -> None:
    structure = oscillator(law, kc=4e4, g=0.1)
    record = lw.simulate(structure, release={"v:m1": 2.0}, duration=0.2, rate=1000.0)
    assert record.values[:, 0] == pytest.approx(contact(record.time, 2.0, 0.1, 200.0), abs=1e-13)
    motion = present(record.simulated).diagnostics
    assert isinstance(motion, SimulatedMotion) and len(motion.run.kinks) == 2
    closes(record)


def sliding(time: Floats, start: float, shift: float, frequency: float) -> Floats:
    """Dry friction, before it sticks: half waves about centres at +shift and -shift in turn."""
    half = np.floor(time * frequency / np.pi)
    amplitude = start - shift * (2 * half + 1)
    return shift * (-1.0) ** half + amplitude * np.cos(frequency * time)


def test_dry_friction_slides_exactly_and_where_it_sticks_it_is_refused_with_advice() -> None:
    structure = oscillator("k*d + F*sign(v)", k=100.0, F=1.0)
    record = lw.simulate(structure, release={"x:m1": 1.0}, duration=10.0, rate=100.0)
    assert record.values[:, 0] == pytest.approx(sliding(record.time, 1.0, 0.01, 10.0), abs=1e-12)
    with pytest.raises(lw.SimulationError) as caught:
        lw.simulate(structure, release={"x:m1": 0.055}, duration=10.0, rate=100.0)
    # 0.055, -0.035, 0.015, 0.005: F holds 0.01
    assert caught.value.time == pytest.approx(3 * np.pi / 10.0, rel=1e-9)
    assert caught.value.mass == "m1"
    assert "link 'link' (law k*d + F*sign(v)) sticks" in str(caught.value)
    assert "replace the jump by a steep slope, such as F*tanh(v/s)" in str(caught.value)
    with pytest.raises(lw.SimulationError, match=r"at 0 s .* sticks"):
        lw.simulate(structure, duration=1.0, rate=100.0)
    # a jump that is crossed ever faster: at rest after infinitely many crossings in finite time
    with pytest.raises(lw.SimulationError, match="sticks"):
        jump = oscillator("F*sign(d) + G*sign(v)", F=1.0, G=0.5)
        lw.simulate(jump, release={"v:m1": 1.0}, duration=100.0, rate=10.0)


@pytest.mark.parametrize(
    "pulse",
    [
        "exp(-((t - 1)/0.01)**2)",
        "(tanh((t - 1)/0.001) - tanh((t - 1.02)/0.001))/2",
        "max(0, 1 - abs(t - 1)/0.01)",
    ],
)
def test_a_short_pulse_on_a_resting_structure_is_not_stepped_over(pulse: str) -> None:
    structure = oscillator("k*d", k=100.0)
    record = lw.simulate(structure, forces={"m1": pulse}, duration=3.0, rate=1000.0)
    excitation = lw.model.Excitation(forces={"m1": pulse})
    momentum = np.trapezoid(excitation.forces["m1"].value(t := np.linspace(0.9, 1.1, 200_001)), t)
    fastest = np.abs(present(record.simulated).velocity[:, 0]).max()
    assert fastest == pytest.approx(momentum, rel=0.02)  # less what the spring does meanwhile
    closes(record, 1e-11)  # to the rounding over the many steps in a short pulse


def test_a_kink_that_symmetry_holds_at_zero_is_watched_when_symmetry_breaks() -> None:
    """Two masses released alike move alike until rounding parts them: the link between them pushes them apart."""
    pair = structure(
        {"m1": 1.0, "m2": 1.0},
        link("l1", "m1-ground", "k*d + c*v", k=100.0, c=0.5),
        link("l2", "m2-ground", "k*d + c*v", k=100.0, c=0.5),
        link("l3", "m2-m1", "a*d + b*d*abs(d)", a=-150.0, b=1000.0),
    )
    alike = lw.simulate(pair, release={"v:m1": 1.0, "v:m2": 1.0}, duration=10.0, rate=100.0)
    assert alike.values[:, 0] == pytest.approx(alike.values[:, 1], abs=1e-12)
    nudge = {"m1": "1e-6*max(0, t - 5)"}
    struck = lw.simulate(pair, release={"v:m1": 1.0, "v:m2": 1.0}, forces=nudge, duration=40.0, rate=100.0)
    d = struck.values[-1, 1] - struck.values[-1, 0]
    # where k d + 2 (a d + b d |d|) = 0; the rest decays by exp(-10)
    assert d == pytest.approx(-0.1, abs=1e-4)
    closes(struck)
