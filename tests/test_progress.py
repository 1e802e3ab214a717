"""Progress: one protocol for all long work, and the parts of a whole."""

import inspect

import pytest
from public import public

import linkwise as lw
from linkwise.progress import part, rising, silent


def _parameters(thing: object) -> list[str]:
    return list(inspect.signature(thing).parameters) if inspect.isfunction(thing) else []


LONG = {name: value for name, value in public() if "progress" in _parameters(value)}


def test_a_part_is_a_piece_of_the_whole() -> None:
    reports: list[lw.estimates.ProgressReport] = []
    within = part(part(reports.append, 0.5, 1.0), 0.0, 0.5)
    for fraction in (0.0, 0.5, 1.0):
        within(lw.estimates.ProgressReport(fraction, "looking", 7))
    assert reports == [lw.estimates.ProgressReport(fraction, "looking", 7) for fraction in (0.5, 0.625, 0.75)]


def test_what_starts_again_does_not_take_back_what_was_done() -> None:
    reports: list[lw.estimates.ProgressReport] = []
    again = rising(reports.append)
    for fraction in (0.1, 0.7, 0.2, 0.8):
        again(lw.estimates.ProgressReport(fraction, f"at {fraction}", 7))
    told = ((0.1, "at 0.1"), (0.7, "at 0.7"), (0.7, "at 0.2"), (0.8, "at 0.8"))
    assert reports == [lw.estimates.ProgressReport(fraction, activity, 7) for fraction, activity in told]


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
