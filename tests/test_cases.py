"""Inputs of laboratories on which linkwise once failed: the value that is right, or the cause that has its name.

Each case stands for a kind, which the tests of its package make anew; the files themselves are not part of the product.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from commands import document

import linkwise as lw

CASES = Path(__file__).parents[2] / "shared" / "cases"
RIG = {"leaf.k": 2600.0, "leaf.c": 1.6, "bistable.alpha": -160.0, "bistable.beta": 5.2e6, "bistable.c": 0.09}
FRAME = {"frame.k": 900.0, "frame.k3": 2e5, "frame.c": 1.5}
MOUNT = {"mount.k": 5200.0, "mount.c": 2.5}
GAP = {
    **{f"s{n}.k": k for n, k in enumerate((38010.0, 16600.0, 15530.0, 9253.0, 10640.0, 12410.0), start=1)},
    "s3.h": 23280.0,
}
HITS = "--channel force:m1=Signal_0/y_values/values --channel a:m1=Signal_1/y_values/values"
LOGGED = "--channel 'x:m1[mm]=Laser1 [mm]' --channel 'x:m2[mm]=Laser2 [mm]'"
ISOLATED = "--channel 'force:m1=Force [N]' --channel 'a:m1=Acc [m/s^2]'"
IEPE = "--channel force:m1[N]=F --channel a:m1[m/s^2]=a --channel time=t"
SCOPE = "--channel 'x:m1[mm]=Channel A'"
FLOOR = "--channel a:m1=AccFloor --channel a:base=base.csv:AccBase"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here"),
]


class Case(NamedTuple):
    """A command in a folder, its exit code, what its coefficients are in truth, one of the causes that it names or takes out
    first, and a part of its message.
    """

    folder: str
    line: str
    code: int = 0
    truth: Mapping[str, float] = MappingProxyType({})
    causes: Set[str] = frozenset()
    message: str = ""


SENSORS = "rig1.toml --mapping sensors.toml"
ANSWERS = {
    "noisy load cell, hard": Case("hammer-rig", f"identify rig_hard.csv {SENSORS}", truth=RIG),
    "noisy load cell, soft": Case("hammer-rig", f"identify rig_soft.csv {SENSORS}", truth=RIG),
    "three storeys from MATLAB": Case("hammer-rig", "identify rig3.mat rig3.toml --mapping s3.toml"),
    "alternating current": Case("ac-coupled", f"identify run.csv s5.toml {ISOLATED}", 0, {"mount.k": 250.0, "mount.c": 2.0}),
    "corner at 0.1 Hz": Case("iepe-corner", f"identify corner01.csv s.toml {IEPE}"),
    "corner at 0.5 Hz": Case("iepe-corner", f"identify corner05.csv s.toml {IEPE}"),
    "two clocks": Case("two-loggers", f"identify floor.csv s.toml {FLOOR} --clock a:m1", 0, FRAME),
    "Testlab": Case("lms-mat", f"identify run.mat s.toml {HITS}", truth=MOUNT),
    "clearance": Case("bearing-gap", "identify run.csv us.toml", truth={"bearing.G": 5e-4, "seal.c": 20.0}),
    "two channels exchanged": Case("hammer-rig", f"identify swapped.csv {SENSORS}", 0, RIG, {"swapped x:frame"}),
    "one laser reversed": Case("hammer-rig", f"identify laser_flipped.csv {SENSORS}", 0, RIG, {"sign x:sink"}),
    "hammer reversed": Case("hammer-rig", "identify german.csv rig1.toml --mapping sg.toml", 0, RIG, {"sign force:frame"}),
    "sensor inverted": Case(
        "inverted-sensor", f"identify log.csv s.toml {LOGGED} --channel time=t", causes={"sign x:m1", "sign x:m2"},
    ),
    "asymmetric wells": Case("asymmetric-wells", "identify record.csv unknown.toml", 4, causes={"term d**2 s"}),
    "gap by the weak form": Case(
        "weak-gap", "identify record.csv unknown.toml --method weak", 3, message="the weak form is biased",
    ),
    "out of range, behind a hit": Case("picoscope", f"identify scope.csv s.toml {SCOPE}", 4, causes={"event"}),
    "rows lost": Case(
        "lost-samples", f"identify log.csv s.toml {LOGGED} --rate 500", 3, message="jumps between two samples",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", ANSWERS.values(), ids=ANSWERS)
def test_the_truth_is_inside_or_the_cause_is_named(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CASES / case.folder)
    answer = document(case.line, case.code)
    found = values(answer)
    for name, value in case.truth.items():
        estimate, error = found[name]
        assert abs(estimate - value) < 3.5 * error, name
    assert case.message in answer["message"]
    if case.causes:
        assert named(answer)[0] in case.causes


def test_repeats_at_coarse_steps_are_not_told_as_doubled() -> None:
    counts = np.load(CASES / "doubled" / "doubled_own.npz")
    record = lw.Record(0.0, float(counts["fs"]), ("a:b2",), counts["a:b2"][:, None])
    assert "doubled" not in {alert.kind for alert in lw.inspect(record).alerts}


def values(answer: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Value and standard error of each coefficient; without an error NaN, which is in no interval."""
    return {
        f"{link['name']}.{name}": (one["value"], one.get("standard_error") or math.nan)
        for link in answer["links"]
        for name, one in link["coefficients"].items()
    }


def named(answer: dict[str, Any]) -> list[str]:
    """What was taken into the model, and the causes in the order of the answer, with their places."""
    return [
        f"{cause['cause']} {cause['where']}".strip() for cause in (*answer["added"], *answer["diagnosis"])
    ]
