"""Inputs that lack samples are refused in the same words wherever the whole of an input is needed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from problems import PROBLEMS
from rigs import hysteretic, measured, run
from structures import beam_of_one_mode, link, oscillator

import linkwise as lw
from linkwise.records.channel import require_complete

FORCE = {"m1": "30*sin(50*t) + 40*sin(31*t + 1)"}
SPRING = link("spring", "beam.tip-ground", "k*d", k=500.0)


def _beam(*links: lw.Link) -> lw.Record:
    beam, force = beam_of_one_mode(*links, damping=0.01), {"beam.tip": "sin(130*t)"}
    return lw.simulate(beam, forces=force, duration=0.5, rate=400.0, sensors=["a:beam.tip"])


def _driven() -> tuple[lw.Record, lw.Structure]:
    structure = oscillator("k*d + c*v", k=900.0, c=1.0)
    return lw.simulate(structure, forces=FORCE, duration=1.0, rate=400.0), structure.unknown("all")


def _carried() -> tuple[lw.Record, lw.Structure]:
    structure = oscillator("k*d + c*v", to="base", k=900.0, c=1.0)
    sensors = ["rel:x:m1", "a:base"]
    record = lw.simulate(structure, base="0.01*sin(31*t)", duration=1.0, rate=400.0, sensors=sensors)
    return record, structure.unknown("all")


def _on_rig() -> tuple[lw.Record, lw.Structure]:
    return measured(run(hysteretic()), 1), hysteretic().unknown("damper")


def _on_host() -> tuple[lw.Record, lw.Structure]:
    return _beam(SPRING), beam_of_one_mode(SPRING, damping=0.01).unknown("all")


def _lacking(record: lw.Record) -> lw.Record:
    """The record without two samples of its input."""
    values = record.values.copy()
    values[[20, 60], record.channels.index(record.inputs[0])] = np.nan
    return replace(record, values=values)


@pytest.mark.slow
@pytest.mark.parametrize("case", [_driven, _carried, _on_rig, _on_host])
def test_every_method_refuses_a_gap_in_an_input(case: Callable[[], tuple[lw.Record, lw.Structure]]) -> None:
    record, structure = case()
    lacking = _lacking(record)
    with pytest.raises(lw.IdentificationError) as error:
        lw.identify(lacking, structure, method="ml")
    first, end = (f"{row / record.rate:.9g}" for row in (20, len(record) - 1))
    after = f"{61 / record.rate:.9g}"
    assert str(error.value) == (
        f"channel {record.inputs[0]}: 2 of {len(record)} samples are missing, the first at {first} s, and inputs must be "
        f"complete; cut the record to a piece without gaps (the longest: record.between({after}, {end})), or interpolate "
        "across gaps that are short against the changes of this input"
    )
    assert error.value.arguments == ("earliest", "latest")


def test_a_modal_test_refuses_a_gap_in_its_force() -> None:
    message = r"channel force:beam\.tip: 2 of 201 samples are missing"
    with pytest.raises(lw.IdentificationError, match=message):
        lw.modal.identify_host(_lacking(_beam()))


@pytest.mark.parametrize(
    ("missing", "longest"), [([0, 3], (4, 9)), ([9, 2], (3, 8)), ([6], (0, 5)), (range(1, 10), (0, 0))]
)
def test_the_longest_piece_without_a_gap_is_named(missing: list[int], longest: tuple[int, int]) -> None:
    record = PROBLEMS["two masses, 20 dB"].clean[100:110]
    values = record.values.copy()
    values[missing, 0] = np.nan
    lacking = replace(record, values=values, simulated=None)
    with pytest.raises(lw.IdentificationError) as error:
        require_complete("x:m1", lacking.channel("x:m1"), lacking.start, lacking.rate)
    named = str(error.value).partition("record.between(")[2].partition(")")[0]
    piece = lacking.between(*map(float, named.split(", ")))
    assert (piece.values == record.values[longest[0] : longest[1] + 1]).all()


def test_an_input_without_any_sample_is_named() -> None:
    message = r"channel force:m1: every sample is missing.*leave the channel out"
    with pytest.raises(lw.IdentificationError, match=message):
        require_complete("force:m1", np.full(3, np.nan), 0.0, 10.0)
    require_complete("force:m1", np.zeros(3), 0.0, 10.0)
