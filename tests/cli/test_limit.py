"""`linkwise limit`: what it prints of a planned test, and what it says where sensors cannot tell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from structures import oscillator

import linkwise as lw
from linkwise.cli import run

PLAN = ["--duration", "0.5", "--rate", "500", "--release", "v:m1=1.0"]


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    path = tmp_path / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), path)
    return path


def answer(chain: Path, *options: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What --json prints."""
    assert run(["limit", str(chain), *PLAN, *options, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    document: dict[str, Any] = json.loads(out)
    return document


def test_json_is_the_bound_of_the_library(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = answer(
        chain, "--noise", "20", "--unknown", "nes1.alpha", "--unknown", "nes1.beta", capsys=capsys
    )
    expected = lw.limit(
        lw.bnes_chain(2),
        duration=0.5,
        rate=500.0,
        release={"v:m1": 1.0},
        noise=20.0,
        unknown=("nes1.alpha", "nes1.beta"),
    )
    assert list(document["coefficients"]) == ["nes1.alpha", "nes1.beta"]
    alpha, error = document["coefficients"]["nes1.alpha"], expected.standard_errors[0]
    assert alpha["standard_error"] == pytest.approx(error, rel=1e-12)
    assert alpha["relative_percent"] == pytest.approx(error, rel=1e-12)  # alpha is -100
    assert alpha["detectable"] == pytest.approx(3.605 * error, rel=1e-12)
    assert document["links"]["nes1"]["nmse_percent"] == pytest.approx(expected.link("nes1").nmse, rel=1e-12)


def test_excitation_sensors_noise_and_segment_reach_it(
    chain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--impulse", "m2=0.01@0.2", "--force", "m2=0.1*sin(2*pi*20*t)", "--sensors", "a:m2,v:m1"]
    document = answer(
        chain, *options, "--noise-of", "a:m2=3", "--noise-of", "v:m1=0.01", "--segment", "0.1", capsys=capsys
    )
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
    assert document["noise"] == {"a:m2": 3.0, "v:m1": 0.01} and document["segment"] == 0.1
    errors = [coefficient["standard_error"] for coefficient in document["coefficients"].values()]
    assert errors == pytest.approx(list(expected.standard_errors), rel=1e-12)


def test_prints_a_table(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["limit", str(chain), *PLAN, "--noise", "20"]) == 0
    out = capsys.readouterr().out
    assert "251 samples each of x:m1, x:m2 at 500 Hz, in one segment with a\nfree start" in out
    titles = ["coefficient", "value", "std. error", "relative", "detectable", "unit"]
    assert all(title in out for title in titles)
    assert "nes1.alpha" in out and "N/m^3" in out and "expected NMSE" in out and "nes1 barrier" in out


def test_says_what_sensors_cannot_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a force on it, a motion is the same when mass, stiffness and damping grow together."""
    path = tmp_path / "mass.toml"
    lw.write_structure(oscillator("k*d + c*v", name="spring", k=400.0, c=0.5), path)
    unknown = ["--unknown", "spring", "--unknown", "mass:m1"]
    assert run(["limit", str(path), *PLAN, "--noise", "20", *unknown]) == 3
    out = capsys.readouterr().out
    assert "not identifiable" in out
    assert "! spring.k, spring.c and m1.mass are confounded: these sensors identify" in out
    assert run(["limit", str(path), *PLAN, "--noise", "20", *unknown, "--force", "m1=5*sin(15*t)"]) == 0
    assert "not identifiable" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ([], 2, "either --noise DB or --noise-of CHANNEL=SIGMA"),
        (["--noise", "20", "--noise-of", "x:m1=1e-4"], 2, "either --noise DB or --noise-of CHANNEL=SIGMA"),
        (["--noise-of", "x:m1=loud"], 2, "--noise-of: 'loud' is not a number"),
        (["--noise-of", "x:m1=1e-4"], 1, "x:m2 is missing"),
        (["--noise", "20", "--unknown", "nes9"], 2, '"nes9" is not a link'),
        (["--noise", "20", "--sensors", "x:m9"], 2, "unknown mass 'm9'"),
        (["--noise", "20", "--segment", "0"], 2, "0.0 is not in the range x>0"),
        (["--noise", "20", "--segment", "6", "--duration", "6"], 1, "On the command line: --segment S."),
    ],
)
def test_what_cannot_be_planned_is_one_paragraph(
    chain: Path, options: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["limit", str(chain), *PLAN, *options]) == code
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err
