"""Which errors of sensors stay in the model, of those that are taken in one after another."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from present import present
from record_faults import changed
from structures import oscillator
from within import assert_within

import linkwise as lw
from linkwise.estimates.causes import Cause
from linkwise.likelihood import explained
from linkwise.likelihood.admitted import distinct_error
from linkwise.likelihood.checks.judgement import _rivals
from linkwise.likelihood.explained import (
    _by_causes,
    _by_event,
    _by_saturation,
    _Model,
    _with_errors,
)
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.terms import Drift

SPRING = oscillator("k*d + c*v", name="s", k=1000.0, c=1.0)
DELAY, HIGH_PASS = (
    Cause(kind, "a:m1", 1e-3, "", gain, 1e-4) for kind, gain in (("delay", 90.0), ("high pass", 60.0))
)


def answer(left: Sequence[Cause], chi_square: float = 1.0) -> Any:
    return SimpleNamespace(
        diagnosis=left,
        grade=lw.Grade.APPROXIMATE if left else lw.Grade.EXPLAINED,
        given_structure=SPRING,
        chi_square_per_sample=chi_square,
        samples=100,
    )


@pytest.mark.parametrize(
    ("alone", "kept"),
    [
        (answer([]), ["high pass"]),
        (answer([DELAY]), ["delay", "high pass"]),
        (answer([], 1.2), ["delay", "high pass"]),
    ],
)
def test_an_error_that_stood_for_the_one_behind_it_is_taken_out_again(alone: Any, kept: list[str]) -> None:
    """Where that alone leaves noise, and as little."""

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        kinds = {error.kind for error in options.errors}
        if kinds == {"high pass"}:
            return alone
        return answer([]) if len(kinds) == 2 else answer([HIGH_PASS])

    record = lw.Record(0.0, 100.0, ("a:m1",), np.random.default_rng(1).normal(size=(200, 1)))
    first = _Model(answered, SPRING, LikelihoodOptions(), [record], answer([DELAY]))
    assert [cause.kind for cause in _with_errors(first).added] == kept


@pytest.mark.parametrize("kind", ["high pass", "delay", "clock", "hum"])
def test_an_error_that_noise_of_an_input_hides_is_taken_in_before_that(kind: str) -> None:
    """Beside the noise that its channel shows, the diagnosis names another cause."""

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        return answer([] if options.errors and not options.random else [HIGH_PASS])

    rng, time = np.random.default_rng(2), np.arange(400) / 200.0
    force = 50.0 * (abs(time - 0.5) < 0.05) + 0.1 * rng.normal(size=len(time))
    record = lw.Record.from_arrays(time, {"a:m1": rng.normal(size=len(time)), "force:m1": force})
    first = _Model(answered, SPRING, LikelihoodOptions(), [record], answer([replace(HIGH_PASS, kind=kind)]))
    found = _with_errors(first)
    assert found.is_explained and [cause.kind for cause in found.added] == [kind]
    noisy = _with_errors(replace(first, answer=answer([replace(HIGH_PASS, kind="offset")])))
    assert noisy.added[0].kind == "input noise"

    def by_noise(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        if options.errors:
            raise lw.IdentificationError("the clock does not settle")
        return answer([] if options.random else [HIGH_PASS])

    resembles = _with_errors(replace(first, answered=by_noise))
    assert [cause.kind for cause in resembles.added] == ["input noise"]


@pytest.mark.parametrize("at", [-0.1, 2.1])
def test_an_event_at_an_end_of_a_record_leaves_it_whole(at: float) -> None:
    record = lw.Record(0.0, 100.0, ("x:m1",), np.zeros((201, 1)))
    event = Cause("event", "m1", at, "s", 90.0, 0.05)
    assert (
        _by_event(_Model(lambda *asked: answer([]), SPRING, LikelihoodOptions(), [record], answer([event])))
        is None
    )


@pytest.mark.parametrize(("alone", "kept"), [([], ["high pass"]), ([HIGH_PASS], ["event"])])
def test_an_error_behind_an_event_that_alone_leaves_noise_leaves_the_record_whole(
    alone: list[Cause], kept: list[str]
) -> None:
    """A clock that runs apart shows most where a motion is fastest, as an event does."""

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        return answer([] if len(records) == 2 else alone)

    record = lw.Record(0.0, 100.0, ("a:m1",), np.random.default_rng(3).normal(size=(201, 1)))
    left = answer([Cause("event", "m1", 1.0, "s", 90.0, 0.05), HIGH_PASS])
    found = present(_by_event(_Model(answered, SPRING, LikelihoodOptions(), [record], left)))
    assert [cause.kind for cause in found.added] == kept


@pytest.mark.parametrize(
    ("rivals", "kept"), [((), ["d**5"]), (("d*abs(d) of s",), []), (("d**3 of s",), ["d**5"])]
)
def test_a_term_stands_where_what_is_as_likely_and_moves_coefficients_otherwise_was_tried(
    rivals: tuple[str, ...], kept: list[str]
) -> None:
    """That which was tried leaves more, that which was not may be the right one."""
    first, second = (
        Cause("term", "s", 1.0, "N", gain, 0.1, term=form) for form, gain in (("d**5", 90.0), ("d**3", 88.0))
    )

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        return answer([]) if "d**5" in str(structure.links[0].law) else answer([first])

    record = lw.Record(0.0, 100.0, ("x:m1",), np.zeros((201, 1)))
    left = answer([replace(first, rivals=rivals), second])
    found = present(_by_causes(_Model(answered, SPRING, LikelihoodOptions(), [record], left)))
    assert [cause.term for cause in found.added if not cause.rivals] == kept


def test_no_missing_term_is_a_second_answer_where_a_drifting_gain_leaves_as_little() -> None:
    """With d**5 the damping would be 28 of its standard errors off, and only noise be left."""
    box = oscillator("k*d + c*v + k3*d**3", name="s", k=900.0, c=0.6, k3=4e5)
    clean = lw.simulate(box, duration=4.0, rate=200.0, release={"x:m1": 0.03})
    drifting = changed(clean, x_m1=lambda x: x * (1.0 + 0.01 * clean.time)).with_noise(40.0, seed=1150002)
    fit = lw.identify(drifting, box.unknown("all"))
    assert not fit.trusted and fit.alternative is None
    term, drift = fit.diagnosis[:2]
    assert drift.kind == "gain drift" and drift.name in term.rivals and term.name in drift.rivals


def test_a_line_is_a_second_answer_where_no_cause_that_moves_coefficients_leaves_as_little() -> None:
    """To within three standard errors; a force with memory is less likely by its reach."""
    line = Cause("harmonic force", "m1", 6.5, "Hz", 42.0, 0.0)
    slip = Cause("term", "s", 1.0, "N", 44.0, 0.1, term="hysteresis", shift=66.0)
    assert _rivals(slip, line) and not _rivals(replace(slip, shift=2.0), line)
    assert not _rivals(replace(slip, gain=42.0), line) and _rivals(
        replace(slip, gain=42.0, term="sign(v)"), line
    )


def test_what_hints_at_a_term_may_be_a_drift_of_a_gain_that_alone_is_no_hint() -> None:
    box = oscillator("k*d + c*v + k3*d**3", name="s", mass=1.6, k=2100.0, c=0.9, k3=1.6e7)
    clean = lw.simulate(box, duration=3.0, rate=200.0, release={"x:m1": 0.004})
    drifting = changed(clean, x_m1=lambda x: x * (1.0 + 0.02 * clean.time / 3.0)).with_noise(
        35.0, seed=1200329
    )
    fit = lw.identify(drifting, box.unknown("all"))
    assert fit.trusted and "hint at a force like d**5 in s" in fit.message
    assert "hint at a gain of x:m1 that drifts" in fit.message
    assert_within(fit, {"s.k": 2100.0, "s.c": 0.9, "s.k3": 1.6e7}, 4.5)


def test_a_drift_is_a_line_before_it_may_follow_the_motion() -> None:
    record = lw.Record(0.0, 100.0, ("x:m1",), np.zeros((201, 1)))
    line = Drift("x:m1").beside((), record)
    assert line == (Drift("x:m1", 2.0),)
    pieces = Drift("x:m1").beside(line, record)
    assert pieces == (Drift("x:m1"),) and Drift("x:m1").beside(pieces, record) is None


@pytest.mark.parametrize(("term", "form"), [("sign(v)", "tanh(1*v)"), ("d**3", "tanh(1*d)")])
def test_a_force_that_saturates_is_tried_where_no_terms_leave_noise(term: str, form: str) -> None:
    """In the motion that dissipates, or else in the elongation, and from the values of the answer as stated."""
    missing = Cause("term", "s", -0.2, "N", 90.0, 0.01, term=term)
    asked = SPRING.unknown("all")
    stated = answer([missing])
    stated.parameters, stated.values = asked.parameters, np.array([900.0, 2.0])
    wave = np.sin(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))[:, None]
    stated.motion = SimpleNamespace(d=np.sqrt(2.0) / 0.3 * wave, v=np.sqrt(2.0) / 0.3 * wave)
    tried = []

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        tried.append(structure)
        return answer([] if len(tried) == 2 else [missing])

    record = lw.Record(0.0, 100.0, ("x:m1",), np.zeros((201, 1)))
    found = _by_saturation(_Model(answered, asked, LikelihoodOptions(), [record], stated))
    assert found is not None and [cause.term for cause in found.added] == [form]
    [link] = tried[0].links
    starts = {name: coefficient.value for name, coefficient in link.coefficients.items()}
    assert starts == {"k": 900.0, "c": 2.0, "added": 0.2, "saturates": pytest.approx(10.0)}
    assert link.law.text.endswith("added*(tanh(saturates*v))" if "v" in term else "added*(tanh(saturates*d))")


def test_no_force_saturates_in_a_link_that_does_not_move() -> None:
    missing = Cause("term", "s", -0.2, "N", 90.0, 0.01, term="sign(v)")
    stated, still = answer([missing]), np.zeros((400, 1))
    stated.motion = SimpleNamespace(d=still, v=still)
    record = lw.Record(0.0, 100.0, ("x:m1",), np.zeros((201, 1)))
    model = _Model(lambda *asked: stated, SPRING, LikelihoodOptions(), [record], stated)
    assert _by_saturation(model) is None


@pytest.mark.parametrize("off", ["rel:x:m1", "a:base"])
def test_a_gain_is_that_of_the_base_or_of_the_sensor(off: str) -> None:
    """One is off by 3 %, and the record tells their ratio alone: a cubic stiffness may be off by twice as much."""
    true = oscillator("k*d + k3*d**3 + c*v", to="base", k=900.0, k3=2e5, c=1.5)
    base = "4e-3*sin(25*t) + 3e-3*sin(36*t + 1) + 2e-3*sin(17*t + 2)"
    clean = lw.simulate(true, base=base, duration=4.0, rate=200.0, sensors=["rel:x", "a:base"])
    record = replace(clean.with_noise(40.0, seed=4), simulated=None)
    values = np.where([str(name) == "a:base" for name in clean.channels], clean.values, record.values)
    values = values * np.where([str(name) == off for name in clean.channels], 1.03, 1.0)
    second = lw.identify(replace(record, values=values), true.unknown("all")).alternative
    assert second is not None
    assert {cause.where for cause in second.added if cause.kind == "gain"} == {"rel:x:m1", "a:base"}
    cubic = second.coefficient("link.k3")
    assert abs(present(cubic.value) - 2e5) < 2.0 * present(cubic.standard_error) < 4.0 * 2.0 * 0.03 * 2e5


def test_an_offset_is_not_told_from_a_term_as_likely_that_leaves_other_coefficients() -> None:
    """An even term in a bistable sink is like an offset of its displacement; a constant in a spring leaves all as it is."""
    even = Cause("term", "sink", -0.14, "N", 18.6, 0.03, term="d**2", shift=13.3)
    offset = Cause("offset", "x:m1", 4.5e-5, "m", 22.0, 1e-5, shift=6.7, rivals=(even.name,))
    assert distinct_error((offset, even)) is None
    assert distinct_error((offset,)) is offset
    assert distinct_error((offset, replace(even, term="1"))) is offset


@pytest.mark.parametrize("seconds", [None, -1.0])
def test_where_the_time_for_others_ends_the_answer_as_stated_stands(
    seconds: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so; no search that was under way then counts."""
    hardening = oscillator("k*d + c*v + k3*d**3", name="s", k=1000.0, c=2.0, k3=2e6)
    record = lw.simulate(hardening, release={"x:m1": 0.02}, duration=4.0, rate=200.0).with_noise(40.0, seed=5)
    if seconds is not None:
        monkeypatch.setattr(explained, "_SECONDS", seconds)
        monkeypatch.setattr(explained, "_TIMES", 0.0)
    fit = lw.identify(record, SPRING.unknown("all"))
    ended_early = any("limit of processor time" in remark for remark in fit.remarks)
    assert ended_early == (seconds is not None)
    assert (fit.alternative is None) == ended_early and not fit.trusted
