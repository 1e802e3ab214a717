"""`linkwise limit`: what it prints of a planned test, and what it says where sensors cannot tell."""

from pathlib import Path

import pytest
from commands import document, said
from structures import oscillator

import linkwise as lw

PLAN = "--duration 0.5 --rate 500 --release v:m1=1.0"


@pytest.fixture
def limit(tmp_path: Path) -> str:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    return f"limit {tmp_path}/chain.toml {PLAN}"


@pytest.mark.slow
def test_json_is_the_bound_of_the_library(limit: str) -> None:
    printed = document(f"{limit} --noise 20 --unknown nes1.alpha --unknown nes1.beta")
    expected = lw.limit(
        lw.bnes_chain(2),
        duration=0.5,
        rate=500.0,
        release={"v:m1": 1.0},
        noise=20.0,
        unknown=("nes1.alpha", "nes1.beta"),
    )
    assert list(printed["coefficients"]) == ["nes1.alpha", "nes1.beta"]
    alpha, error = printed["coefficients"]["nes1.alpha"], expected.standard_errors[0]
    assert alpha["standard_error"] == pytest.approx(error, rel=1e-12)
    assert alpha["relative_percent"] == pytest.approx(error, rel=1e-12)  # alpha is -100
    assert alpha["detectable"] == pytest.approx(3.605 * error, rel=1e-12)
    assert printed["links"]["nes1"]["nmse_percent"] == pytest.approx(expected.link("nes1").nmse, rel=1e-12)


def test_excitation_sensors_noise_and_segment_reach_it(limit: str) -> None:
    drive = "--impulse m2=0.01@0.2 --force m2=0.1*sin(2*pi*20*t) --sensors a:m2,v:m1"
    printed = document(f"{limit} {drive} --noise a:m2=3 --noise v:m1=10mm/s --segment 0.1")
    expected = lw.limit(
        lw.bnes_chain(2),
        duration=0.5,
        rate=500.0,
        release={"v:m1": 1.0},
        impulses=(lw.model.Impulse("m2", 0.01, 0.2),),
        forces={"m2": "0.1*sin(2*pi*20*t)"},
        sensors=("a:m2", "v:m1"),
        noise={"a:m2": 3.0, "v:m1": 0.01},
        segment=0.1,
    )
    assert printed["noise"] == {"a:m2": 3.0, "v:m1": 0.01} and printed["segment"] == 0.1
    errors = [coefficient["standard_error"] for coefficient in printed["coefficients"].values()]
    assert errors == pytest.approx(list(expected.standard_errors), rel=1e-12)


@pytest.mark.slow
def test_prints_a_table(limit: str) -> None:
    out = said(f"{limit} --noise 20").out
    assert "251 samples each of x:m1, x:m2 at 500 Hz, in one segment with a\nfree start" in out
    titles = ["coefficient", "value", "std. error", "relative", "detectable", "unit"]
    assert all(title in out for title in titles)
    assert "nes1.alpha" in out and "N/m^3" in out and "expected NMSE" in out and "nes1 barrier" in out


def test_says_what_sensors_cannot_tell(tmp_path: Path) -> None:
    """Without a force on it, a motion is the same when mass, stiffness and damping grow together."""
    lw.write_structure(oscillator("k*d + c*v", name="spring", k=400.0, c=0.5), tmp_path / "mass.toml")
    asked = f"limit {tmp_path}/mass.toml {PLAN} --noise 20 --unknown spring --unknown mass:m1"
    out = said(asked, 3).out
    assert "not identifiable" in out
    assert "! spring.k, spring.c and m1.mass are confounded: these sensors identify" in out
    assert "not identifiable" not in said(f"{asked} --force m1=5*sin(15*t)").out
