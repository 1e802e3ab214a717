"""The measured record that comes with the documentation gives the answers that its page defends."""

import json
import shutil
from pathlib import Path

import pytest

from linkwise.cli import run

SHIPPED = Path(__file__).resolve().parents[2] / "docs" / "examples" / "bicycle-fork"
RECORD = "BrowserForkCompoundFirst1.mat"


def test_the_record_ships_with_its_licence() -> None:
    licence = (SHIPPED / "LICENSE.txt").read_text(encoding="utf-8")
    assert "BicycleParameters Authors" in licence and "Redistributions in binary form" in licence
    assert sum(path.stat().st_size for path in SHIPPED.iterdir()) < 100_000


@pytest.mark.slow
def test_dry_friction_is_found_and_predicts_what_it_has_not_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shutil.copytree(SHIPPED, tmp_path / "fork"))
    found, fit = {}, {}
    for law in ("viscous", "friction"):
        asked = ["identify", RECORD, f"{law}.toml", "--mapping", "sensors.toml"]
        assert run([*asked, "-o", law]) == 4
        found[law] = json.loads(Path(law, "result.json").read_text(encoding="utf-8"))
        assert run([*asked, "--to", "20", "-o", f"early-{law}"]) == 3  # too short for intervals
        capsys.readouterr()
        unseen = ["validate", RECORD, f"early-{law}", "--mapping", "sensors.toml", "--from", "20", "--json"]
        assert run(unseen) == 3
        fit[law] = json.loads(capsys.readouterr().out)["channels"]["v:fork"]["fit_percent"]
    assert {answer["grade"] for answer in found.values()} == {"approximate"}
    assert found["viscous"]["diagnosis"][0]["message"].startswith("a force like sign(v) in pivot")
    (link,), body = found["friction"]["links"], found["friction"]["masses"]["fork"]
    friction, stiffness = link["coefficients"]["F"], link["coefficients"]["k"]
    assert 20.0 * friction["standard_error"] < friction["value"]
    assert stiffness["standard_error"] == pytest.approx(0.13, rel=0.01)  # what is stated of it, and no more
    assert 0.0080 < body["standard_error"] < 0.0090
    small_swings = 15.1 * (1.590 / 6.28318) ** 2  # by the period alone, in kg m^2
    assert abs(body["value"] - small_swings) < body["standard_error"]
    assert fit["friction"] > 96.0 > 92.0 > fit["viscous"]
