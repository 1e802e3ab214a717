"""SciPy's integrator where heyoka has no wheels, the folder of compiled equations, and orbits of the reference."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import chain_record, paper_speed
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.simulation.integrator.dop853 import ScipySystem
from linkwise.simulation.integrator.formulas import CompiledSystem, SystemShape

LAWS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
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


@pytest.mark.parametrize(("law", "values", "drive"), LAWS, ids=[law for law, _, _ in LAWS])
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
