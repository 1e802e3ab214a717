"""The compiled equations against energies, exact solutions and orbits of the reference, kinks, and SciPy in their place."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from problems import chain_record, paper_speed
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.simulation.integrator.dop853 import ScipySystem
from linkwise.simulation.integrator.formulas import CompiledSystem, SystemShape
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


ALIKE: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("k*d + c*v + k3*d**3", {"k": 90.0, "c": 0.3, "k3": 500.0}, {}),
    ("k*d + F*tanh(v/s) - q*abs(d)*d", {"k": 90.0, "F": 1.0, "s": 0.3, "q": 30.0}, {}),
    ("k*d + F*sign(v) + kg*max(d - g, 0)", {"k": 400.0, "F": 0.3, "kg": 2000.0, "g": 0.01}, {"forces": {"m1": "4*sin(13*t)"}}),
    ("k*d + c*v", {"k": 90.0, "c": 0.3}, {"impulses": (lw.model.Impulse("m1", 0.2, 0.11),)}),
]  # fmt: skip
BOUC_WEN = {"k": 500.0, "c": 1.0, "F": 5.0, "x0": 5e-3, "s": 0.6}


@pytest.fixture
def by_scipy(monkeypatch: pytest.MonkeyPatch) -> list[CompiledSystem]:
    """SciPy's systems in place of heyoka's, and those that were made."""
    made: list[CompiledSystem] = []

    def system(shape: SystemShape) -> CompiledSystem:
        made.append(ScipySystem(shape))
        return made[-1]

    monkeypatch.setattr("linkwise.simulation.run.compiled_system", system)
    monkeypatch.setattr("linkwise.simulation.batch.compiled_system", system)
    return made


def moved(law: str, values: dict[str, Any], drive: dict[str, Any]) -> lw.Record:
    return lw.simulate(
        oscillator(law, mass=0.7, **values),
        release={"v:m1": 0.8},
        duration=0.6,
        rate=200.0,
        sensors=["x:m1", "v:m1"],
        **drive,
    )


@pytest.mark.parametrize(("law", "values", "drive"), ALIKE, ids=[law for law, _, _ in ALIKE])
def test_as_heyoka(
    law: str, values: dict[str, Any], drive: dict[str, Any], request: pytest.FixtureRequest
) -> None:
    by_heyoka = moved(law, values, drive).values
    made = request.getfixturevalue("by_scipy")
    error = np.abs(moved(law, values, drive).values - by_heyoka).max(axis=0) / np.abs(by_heyoka).max(axis=0)
    assert made and error.max() < 1e-9  # steps of a tolerance of 1e-12, some hundred of them


def test_energies_balance_and_states_of_links_follow(by_scipy: list[CompiledSystem]) -> None:
    record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 0.3}, duration=0.1, rate=500.0)
    truth = record.simulated
    assert truth is not None and np.abs(truth.energy.residual).max() < 1e-9 and truth.horizon is None
    joint = lw.rig(
        {"m1": 1.0}, {"joint": "m1 - ground: bouc-wen"}, {f"joint.{k}": v for k, v in BOUC_WEN.items()}
    )
    slid = lw.simulate(
        joint, release={"v:m1": 0.4}, duration=0.3, rate=200.0, sensors=["x:m1", "state:joint.z"]
    )
    assert np.abs(slid["state:joint.z"]).max() > 0.5 and by_scipy


def test_a_motion_that_diverges_is_refused_alike(by_scipy: list[CompiledSystem]) -> None:
    with pytest.raises(lw.SimulationError, match="the motion diverges: at "):
        lw.simulate(oscillator("k*d - q*d**3", k=1.0, q=1e6), release={"x:m1": 1.0}, duration=1.0, rate=100.0)


BLOCKED = """
import json, sys
sys.modules["heyoka"] = None
import linkwise as lw
chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 0.3}, duration=0.4, rate=500.0).with_noise(20.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"))
names = ("nes1.alpha", "nes1.beta", "nes1.c")
found = {name: (fit.coefficient(name).value, fit.coefficient(name).standard_error) for name in names}
second = lw.simulate(chain, release={"v:m1": 0.2}, duration=0.2, rate=500.0).with_noise(40.0, seed=2)
scores = lw.validate(second, chain).channels
limited = lw.limit(chain, release={"v:m1": 0.3}, duration=0.06, rate=500.0, noise=20.0)
absorbed = lw.absorb(chain, duration=0.05, release={"v:m1": 0.3})
print(json.dumps([found, sorted(scores), limited.grade.value, str(absorbed)[:9]]))
"""


@pytest.mark.slow
def test_questions_are_answered_with_heyoka_blocked(chain: lw.Structure) -> None:
    done = subprocess.run([sys.executable, "-c", BLOCKED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found, channels, grade, absorbed = json.loads(done.stdout)
    record = lw.simulate(chain, release={"v:m1": 0.3}, duration=0.4, rate=500.0).with_noise(20.0, seed=1)
    fit = lw.identify(record, chain.unknown("nes"))
    for name, (value, error) in found.items():
        assert abs(value - fit.coefficient(name).value) < 1e-3 * error
    assert channels == ["x:m1", "x:m2"] and absorbed == "With its " and grade == "explained"


_SIMULATE = """
import linkwise as lw
lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.01, rate=1000.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
@pytest.mark.parametrize(
    ("variables", "folders"),
    [
        ({"HOME": "home"}, {"home/.cache/linkwise"}),
        ({"HOME": "home", "HEYOKA_CACHE_DIR": "chosen"}, {"chosen"}),
        ({"HOME": "a file"}, set()),  # where no folder can be made
    ],
)
def test_compiled_code_stays_in_a_folder(
    tmp_path: Path, variables: dict[str, str], folders: set[str]
) -> None:
    (tmp_path / "a file").touch()
    left = {"HEYOKA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"}
    environment = {name: value for name, value in os.environ.items() if name not in left}
    environment |= {name: str(tmp_path / value) for name, value in variables.items()}
    subprocess.run([sys.executable, "-c", _SIMULATE], env=environment, cwd=tmp_path, check=True)
    assert {str(path.parent.relative_to(tmp_path)) for path in tmp_path.rglob("cache.db")} == folders


def departure(folder: Path, n: int, **changes: float) -> Floats:
    """Largest error of each channel over the whole file, relative to the largest value of the channel."""
    table = np.loadtxt(folder / f"bnes_{n}.csv", delimiter=",", skiprows=1)
    rows = np.rint(1000.0 * table[:, 0]).astype(int)
    chain, release = lw.bnes_chain(n, **changes), {"v:m1": paper_speed(n)}
    record = lw.simulate(chain, release=release, duration=table[-1, 0], rate=1000.0)
    assert record.channels == tuple(f"x:m{i + 1}" for i in range(n))
    worst: Floats = np.abs(record.values[rows] - table[:, 1:]).max(axis=0)
    size: Floats = np.abs(table[:, 1:]).max(axis=0)
    return worst / size


@pytest.mark.parametrize("n", [2, 6, 10])
def test_follows_the_reference_to_the_end_of_the_file(shared_reference: Path, n: int) -> None:
    """The files end where ordinary double precision has departed by 1e-6; see trajectory.EXTENDED_WORK for the margin."""
    assert departure(shared_reference, n).max() < 1e-6


def test_the_two_mass_chain_does_what_the_paper_shows() -> None:
    """Fig. 2: the sink crosses between its wells until 2.3 to 2.5 s and rests at +0.0099 m."""
    record = chain_record(2, duration=60.0)
    d = record.channel("x:m2") - record.channel("x:m1")
    crossings = record.time[1:][np.diff(np.sign(d)) != 0]
    assert 2.3 < crossings[-1] < 2.5
    early = record.between(5.0, 6.0).channel("x:m2")
    assert early.mean() == pytest.approx(0.0099, abs=1e-4)
    assert d[-1] == pytest.approx(0.01, rel=1e-8)  # sqrt(-alpha/beta), what moves has died down by exp(-30)
