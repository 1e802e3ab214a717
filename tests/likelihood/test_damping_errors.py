"""Damping between modes that a host lacks: named by the diagnosis, or told where the records do not rule it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from structures import Value, host, link, structure, with_links

import linkwise as lw
from linkwise.likelihood.damping_errors import largest_damping, nearest_pairs

FREQUENCIES, RATIO = (5.0, 6.5, 11.0), 0.012
SHAPES = {"tip": (0.8, -0.6, 0.9), "joint": (0.5, 0.7, -0.4)}
PAYLOAD = {"k": 320.0, "k3": 2e6, "c": 0.2}
BETWEEN = 0.5  # N s/m, of 0.86 N s/m at most, with which no motion gains energy
TONES = [
    (3.1, 0.4),
    (4.6, 2.1),
    (5.3, 5.0),
    (6.2, 1.1),
    (6.9, 3.3),
    (8.4, 0.2),
    (10.6, 4.4),
    (12.1, 2.6),
]  # Hz
FORCE = " + ".join(f"0.4*sin({2.0 * np.pi * frequency}*t + {phase})" for frequency, phase in TONES)


def wing(between: Mapping[tuple[int, int], Value] | None = None) -> lw.Structure:
    payload = link("payload", "store-wing.tip", "k*d + k3*d**3 + c*v", **PAYLOAD)
    return structure({"store": 0.08}, payload, hosts=[host("wing", FREQUENCIES, RATIO, SHAPES, between)])


@cache
def record(between: float, seed: int = 811) -> lw.Record:
    return lw.simulate(
        wing({(1, 2): between} if between else None),
        forces={"wing.joint": FORCE},
        duration=3.5,
        rate=250.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(25.0, seed=seed)


@pytest.mark.parametrize("between", [BETWEEN, -BETWEEN])
def test_damping_that_a_host_lacks_is_not_trusted_and_named(between: float) -> None:
    fit = lw.identify(record(between), wing().unknown("payload"))
    assert fit.verdicts == (lw.Verdict.MEASUREMENT_ERROR,)
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.unit) == ("damping between modes", "wing.mode1+mode2", "N s/m")
    assert 'damping = [ { modes = [1, 2], damping = "unknown" } ] of that host' in fit.message
    # to first order, of a damping that is half of that of the modes
    assert cause.size == pytest.approx(between, rel=0.3)


def test_as_the_diagnosis_says_the_damping_is_found() -> None:
    fit = lw.identify(record(BETWEEN), wing({(1, 2): lw.Coefficient.unknown()}).unknown("payload"))
    assert fit.trusted
    for name, true in {"wing.mode1+mode2.damping": BETWEEN, "payload.c": PAYLOAD["c"]}.items():
        estimate = fit.coefficient(name)
        # 1 of 8000 of two is further off
        assert abs(estimate.value - true) < 4.0 * present(estimate.standard_error)


def test_a_host_that_lacks_none_is_trusted() -> None:
    fit = lw.identify(record(0.0), wing().unknown("payload"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,)
    assert not fit.diagnosis


def test_damping_that_one_sensor_and_one_tone_do_not_rule_out_is_told() -> None:
    """A short record of one tone at one point: damping between modes may make a part of that of the payload."""
    tone = lw.simulate(
        wing(),
        forces={"wing.joint": f"0.4*sin({2.0 * np.pi * 5.1}*t)"},
        duration=3.0,
        rate=250.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(20.0, seed=812)
    asked = wing().unknown("payload")
    at_one_point = tone.select(["a:wing.tip", "force:wing.joint"])
    # about the middle, or in a well so far away that rounding decides: no channel shows where the store rests
    either = lw.identify(at_one_point, asked)
    if either.trusted:
        errors = (either.values - list(PAYLOAD.values())) / np.sqrt(either.covariance.diagonal())
        assert np.abs(errors).max() < 4.0
    else:
        assert either.fit_verdicts == (lw.Verdict.SEVERAL_OPTIMA,)
        assert any("Another set of values explains" in remark for remark in either.remarks)
    payload = replace(asked.link("payload").coefficients["k"], lower=0.0)  # about the middle
    about_middle = replace(
        asked.link("payload"), coefficients={**asked.link("payload").coefficients, "k": payload}
    )
    fit = lw.identify(at_one_point, with_links(asked, about_middle))
    assert fit.trusted
    told = [term for term in fit.unseen_terms if term.link == "wing.mode1+mode2"]
    for term in some(told):
        assert term.term == "v" and 0.0 < term.share <= 1.0 and term.standard_errors > 3.0
        assert "damping between the modes 1 and 2 of wing" in term.description
    bounded = lw.identify(tone, wing().unknown("payload"))  # the other sensors tell
    assert bounded.trusted
    assert not [term for term in bounded.unseen_terms if term.link.startswith("wing.mode")]


def test_the_nearest_pairs_are_tested_and_those_that_are_estimated_are_not() -> None:
    frequencies = [4.0 * 1.3**number for number in range(10)]
    many = structure({}, hosts=[host("wing", frequencies, 0.01, {"tip": [1.0] * 10})])
    pairs = [pair for _, pair in nearest_pairs(many)]
    assert len(pairs) == 30
    assert {second - first for first, second in pairs} == {1, 2, 3, 4}  # of 9, 8, 7 and 6 pairs
    assert all((first, first + 1) in pairs for first in range(1, 10))
    first, *others = nearest_pairs(wing(), ["wing.mode1+mode2.damping"])
    assert (first[1], [pair for _, pair in others]) == ((2, 3), [(1, 3)])
    assert nearest_pairs(structure({"m": 1.0}, link("s", "m-ground", "k*d", k=1.0))) == []


def test_a_larger_damping_than_the_largest_feeds_energy_into_a_motion() -> None:
    limits = largest_damping(wing())
    own = 4.0 * np.pi * RATIO * np.array(FREQUENCIES)
    for number, (first, second) in enumerate([(0, 1), (0, 2), (1, 2)]):
        limit = limits[f"wing.mode{first + 1}+mode{second + 1}"]
        block = np.array([[own[first], limit], [limit, own[second]]])
        assert abs(np.linalg.eigvalsh(block)[0]) < 1e-12 * own.max(), number  # it is singular
