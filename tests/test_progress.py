"""Progress: one protocol for all long work, and the parts of a whole."""

import inspect

import pytest
from public import public

import linkwise as lw
from linkwise.progress import silent


def _parameters(thing: object) -> list[str]:
    return list(inspect.signature(thing).parameters) if inspect.isfunction(thing) else []


LONG = {name: value for name, value in public() if "progress" in _parameters(value)}


def test_all_long_work_takes_the_same_and_is_silent_without() -> None:
    known = {"absorb", "discover", "identify", "limit", "study.run_study", "simulate", "report.write_result"}
    assert known <= set(LONG)
    for name, function in LONG.items():
        parameter = inspect.signature(function).parameters["progress"]
        stated = parameter.annotation, parameter.default, parameter.kind
        assert stated == ("Progress", silent, inspect.Parameter.KEYWORD_ONLY), name


@pytest.mark.slow
def test_a_limit_tells_how_far_it_is() -> None:
    reports: list[lw.estimates.ProgressReport] = []
    lw.limit(
        lw.bnes_chain(2), duration=1.0, rate=200.0, noise=20.0, release={"v:m1": 1.0}, progress=reports.append
    )
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions) and reports[-1] == lw.estimates.ProgressReport(0.5, "sensitivities")
