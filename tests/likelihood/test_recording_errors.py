"""Errors of a whole channel are named before all other causes, and nothing else is taken for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy
from problems import chain_record
from structures import bodies, link, named, oscillator, row_of_masses, with_links

import linkwise as lw
from linkwise.likelihood.recording_errors import recording_errors

CHAIN = lw.bnes_chain(2)
PUSH = "20*sin(150*t) + 15*sin(190*t)"
Change = Callable[[lw.Record], lw.Record]


def changed(record: lw.Record, **channels: np.ndarray) -> lw.Record:
    """The record with other samples in channels, whose names have an underscore for the colon."""
    values = record.values.copy()
    for name, samples in channels.items():
        values[:, record.channels.index(name.replace("_", ":"))] = samples
    return replace(record, values=values, simulated=None)


def ac_coupled(record: lw.Record) -> lw.Record:
    high_pass = scipy.signal.butter(1, 0.5, "high", fs=record.rate, output="sos")
    return changed(record, x_m2=scipy.signal.sosfilt(high_pass, record.channel("x:m2")))


def driven() -> lw.Record:
    return lw.simulate(CHAIN, forces={"m1": PUSH}, duration=3.0, rate=1000.0)


ERRORS: dict[str, tuple[Callable[[], lw.Record], Change, tuple[str, str, str]]] = {
    "sign of a force": (
        driven,
        lambda record: changed(record, force_m1=-record.channel("force:m1")),
        ("sign", "force:m1", "change the sign of force:m1"),
    ),
    "sign of a displacement": (
        driven,
        lambda record: changed(record, x_m2=-record.channel("x:m2")),
        ("sign", "x:m2", "change the sign of x:m2"),
    ),
    "mm for m": (
        lambda: chain_record(2, duration=3.0),
        lambda record: changed(record, x_m2=1e3 * record.channel("x:m2")),
        ("unit", "x:m2", "multiply x:m2 by 0.001"),
    ),
    "kN for N": (
        driven,
        lambda record: changed(record, force_m1=1e-3 * record.channel("force:m1")),
        ("unit", "force:m1", "multiply force:m1 by 1000"),
    ),
    "swapped": (
        lambda: chain_record(2, duration=3.0),
        lambda record: changed(record, x_m1=record.channel("x:m2"), x_m2=record.channel("x:m1")),
        ("swapped", "x:m1", "exchange x:m1 and x:m2"),
    ),
    "AC coupled": (lambda: chain_record(2), ac_coupled, ("high pass", "x:m2", "DC")),
}


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_an_error_of_a_whole_channel_is_the_first_cause(error: str, snr_db: float) -> None:
    make, change, (kind, where, advice) = ERRORS[error]
    record = change(make().with_noise(snr_db, seed=71))
    fit = lw.identify(record, CHAIN.unknown("all"), method="ml")
    first = fit.diagnosis[0]
    assert (first.kind, first.where) == (kind, where) and first.is_instrument
    assert not fit.trusted and fit.coefficient("nes1.alpha").interval is None
    assert first.description in fit.message and advice in fit.message
    assert fit.to_dict()["diagnosis"][0]["cause"] == kind


@pytest.mark.parametrize("drive", [driven, lambda: chain_record(2, duration=3.0)])
@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_a_record_without_one_has_none(drive: Callable[[], lw.Record], snr_db: float) -> None:
    record = replace(drive().with_noise(snr_db, seed=72), simulated=None)
    assert recording_errors([record], CHAIN.unknown("all")) == ()
    assert lw.identify(record, CHAIN.unknown("all"), method="ml").trusted


WRONG = {
    "missing friction": with_links(
        CHAIN, named("rough", "m2-m1", "bouc-wen", k=0, c=0, F=0.3, x0=0.005, s=0.5)
    ),
    "missing relaxation": with_links(CHAIN, named("slow", "m2-m1", "zener", k=0.0, k1=10.0, c1=1.0)),
    "slow relaxation": with_links(CHAIN, named("slow", "m1-ground", "zener", k=0.0, k1=1000.0, c1=1000.0)),
    "missing link": with_links(CHAIN, link("extra", "m2-ground", "k*d", k=20.0)),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_a_law_that_is_wrong_is_not_taken_for_one(wrong: str, snr_db: float) -> None:
    clean = lw.simulate(WRONG[wrong], release={"v:m1": 1.0}, duration=6.0, rate=1000.0)
    record = replace(clean.with_noise(snr_db, seed=73), simulated=None)
    assert recording_errors([record], CHAIN.unknown("all")) == ()


@pytest.mark.parametrize("factor", [1e-3, 0.5, 1e3])
def test_a_mass_that_is_wrong_is_not_taken_for_one(factor: float) -> None:
    wrong = replace(CHAIN, masses=bodies({"m1": 1.0, "m2": 0.01 * factor})).unknown("all")
    record = replace(chain_record(2, duration=3.0).with_noise(30.0, seed=74), simulated=None)
    assert recording_errors([record], wrong) == ()


def test_what_the_equations_cannot_tell_apart_is_told_together() -> None:
    """Of one mass on a spring that is odd, the wrong sign of the force is that of the displacement."""
    spring = oscillator("k*d + c*v + k3*d**3", k=900.0, k3=2e5, c=1.5)
    push = {"m1": "15*sin(25*t) + 10*sin(33*t)"}
    record = lw.simulate(spring, forces=push, duration=6.0, rate=500.0).with_noise(30.0, seed=1)
    wrong = changed(record, force_m1=-record.channel("force:m1"))
    fit = lw.identify(wrong, spring.unknown("all"), method="ml")
    assert [(cause.kind, cause.where) for cause in fit.diagnosis[:2]] == [
        ("sign", "force:m1"),
        ("sign", "x:m1"),
    ]
    assert "the wrong sign of x:m1 would do the same" in fit.message


def test_the_part_of_a_long_record_that_moves_is_enough() -> None:
    """A record that rests for longer than is looked at."""
    clean = driven()
    rest = np.zeros((25_000, len(clean.channels)))
    long = replace(clean, values=np.concatenate([rest, clean.values]), simulated=None).with_noise(
        30.0, seed=1
    )
    wrong = changed(long, force_m1=-long.channel("force:m1"))
    found = recording_errors([wrong], CHAIN.unknown("all"))
    assert [(cause.kind, cause.where) for cause in found] == [("sign", "force:m1")]


def test_a_search_is_told_of_one_by_all_terms_that_were_offered() -> None:
    """The terms that are found in a wrong record are not those that explain the right one."""
    law = "k*d + c*v"
    row = row_of_masses([1.0, 0.1], low=(law, {"k": 2000.0, "c": 0.5}), high=(law, {"k": 150.0, "c": 0.05}))
    clean = lw.simulate(row, release={"v:m1": 1.0}, duration=4.0, rate=250.0)
    record = replace(clean.with_noise(40.0, seed=75), simulated=None)
    wrong = changed(record, x_m2=1e3 * record.channel("x:m2"))
    found = lw.discover(wrong, {"m1": 1.0, "m2": 0.1}, terms="linear")
    assert (found.diagnosis[0].kind, found.diagnosis[0].where) == ("unit", "x:m2") and not found.trusted
    right = lw.discover(record, {"m1": 1.0, "m2": 0.1}, terms="linear")
    assert right.trusted and right.diagnosis == ()
