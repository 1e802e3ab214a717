"""What no fit can find is refused before the search, with what to do: motion of one second suffices."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from structures import hysteretic_oscillator, link, named, structure

import linkwise as lw

SPRING = structure({"m1": 1.0}, link("l1", "m1-ground", "k*d + c*v"))
DAMPED = structure({"m1": 1.0}, link("l1", "m1-ground", "k*d + c*v"), link("damper", "m1-base", "c*v"))
CHAIN = lw.bnes_chain(2).unknown("all")
STOREYS = structure(
    {"m1": 1.0, "m2": 0.5}, link("lower", "m1-base", "k*d + c*v"), link("upper", "m2-m1", "k*d + c*v")
)
PAIR = structure(
    {"m1": 1.0, "m2": 1.0}, link("lower", "m1-ground", "k*d + c*v"), link("upper", "m2-m1", "k*d + c*v")
)
BOUC_WEN = {"k": 400.0, "c": 1.5, "F": 12.0, "x0": 0.02, "s": 0.7}
JOINT = hysteretic_oscillator(**BOUC_WEN).unknown("joint")
STARTED = {f"joint.{name}": value for name, value in BOUC_WEN.items()}
RAIL = structure({"m1": 1.0}, named("rail", "m1-ground", "dahl", sigma=1.0, Fc=1.0, c=1.0))


def shown(channels: str, seed: int = 1) -> lw.Record:
    """A second of motion at 200 Hz, of frequencies and noise by lot, in each of the channels."""
    rng, time, names = np.random.default_rng(seed), np.arange(201) / 200.0, tuple(channels.split())
    waves = np.sin(np.outer(time, rng.uniform(20.0, 60.0, len(names))) + rng.uniform(0.0, 6.0, len(names)))
    return lw.Record(0.0, 200.0, names, waves + 0.01 * rng.standard_normal(waves.shape))


def zeroed(seed: int) -> lw.Record:
    record = shown("x:m1 x:m2 force:m1 force:m2", seed)
    return replace(record, values=record.values * [1.0, 1.0, 0.0, 1.0])


ZERO = "no gain or delay of force:m1 .* is 0 throughout the record"
BOTH, BESIDE, AT_TOP = "x:m1 x:m2", "x:m1 x:m2 force:m1", "x:m1 x:m2 force:m2"

REFUSED: list[tuple[str | lw.Record | list[lw.Record], lw.Structure, dict[str, Any], str]] = [
    ("rel:x:m1 rel:x:m2 v:base", STOREYS, {"input_noise": "all"}, "v:base cannot be allowed for: what moves the"),
    ("rel:v:m1 rel:v:m2 x:base", STOREYS, {"input_noise": "all"}, "noise of x:base cannot be allowed for beside rel:v:m1"),
    ("rel:x:m1 rel:x:m2 a:base", STOREYS, {"input_noise": {"a:base": -1.0}}, "of a:base must be a positive number in m/s\\^2"),
    ("x:m1 x:m2 x:base", STOREYS, {"input_noise": ["a:base"]}, "the inputs that act on the structure are x:base"),
    ("x:m1 x:m2 x:base", STOREYS, {"gains": ["x:base"]}, "no gain of x:base can be estimated"),
    ("x:m1 x:base", SPRING, {"input_noise": "all"}, "no motion of a base that the structure stands on"),
    # its force follows the derivative of the noise, which is left out of what is counted in
    ("x:m1 x:base", DAMPED, {"input_noise": "all"}, r"no spring joins the base \(damper\)"),
    ("x:m1 force:m1", SPRING, {"clocks": ["x:m9"]}, "no clock of x:m9 can be estimated"),
    ("x:m1 force:m1", SPRING, {"clocks": {"x:m1": 1e6}}, "the clock of x:m1 must run fast by a number of ppm"),
    ("x:m1 force:m1", SPRING, {"harmonics": {"m2": 4.0}}, "no harmonic force on m2 can be estimated"),
    ("x:m1 force:m1", SPRING, {"harmonics": {"m1": 199.0}}, "must have a frequency from 2 Hz"),
    ("a:m1 force:m1", SPRING, {"corners": {"a:m1": -1.0}}, "corner of a:m1 must be a positive frequency in Hz, got -1"),
    ("x:m1 f:l1", SPRING, {"ambient": "all"}, "random forces and f:l1 cannot be estimated together"),
    ("x:m1", SPRING, {"input_noise": ["force:m1"]}, "no noise of an input can be estimated"),
    (BESIDE, CHAIN, {"ambient": ["m7"]}, "no ambient force can act on m7: the masses are m1, m2"),
    (BESIDE, CHAIN, {"ambient": {"m1": -1.0}}, "ambient force on m1 must be a positive number in N/sqrt\\(Hz\\)"),
    (BESIDE, CHAIN, {"input_noise": ["force:m2"]}, "no noise of force:m2"),
    (BESIDE, CHAIN, {"ambient": ["m1"], "input_noise": "all"}, "are the same to the mass: state one of them"),
    (BESIDE, CHAIN, {"ambient": ["m2"], "delays": ["x:m2"]}, "random forces and a delay of x:m2 cannot be estimated together"),
    (BESIDE, CHAIN, {"ambient": ["m2"], "admit": ["gain"]}, "random forces and errors of sensors to be admitted \\(gain\\)"),
    (BOTH, CHAIN, {"drifts": ["x:m2"], "ambient": ["m1"]}, "random forces and drift, hum or high pass of x:m2"),
    (BOTH, CHAIN, {"gains": ["x:m9"]}, "no gain of x:m9 can be estimated"),
    (BOTH, CHAIN, {"calibration": {"x:m9": 0.01}}, "no calibration of x:m9 can be stated"),
    (BOTH, CHAIN, {"calibration": {"x:m1": 1.0}}, "calibration of x:m1 must be .* got 1$"),
    (BOTH, CHAIN, {"drifts": {"x:m2": 1e-3}}, "the pieces of the drift of x:m2 must be .* s long at least, got 0.001 s"),
    (BOTH, CHAIN, {"drifts": {"x:m2": -1.0}}, "the drift of x:m2 must have a positive length in s, got -1.0"),
    (BOTH, CHAIN, {"hums": ["x:m2"]}, "hums takes frequencies in Hz by channel, as in"),
    (BOTH, CHAIN, {"hums": {"x:m2": "50"}}, "hums takes frequencies in Hz by channel, as in"),
    (BOTH, CHAIN, {"hums": {"x:m2": 600.0}}, "a frequency between 0 and half the rate, 100 Hz, got 600 Hz"),
    (BOTH, CHAIN, {"delays": ["x:m9"]}, "no delay of x:m9 can be estimated; did you mean"),
    (BOTH, CHAIN, {"delays": ["x:m1", "x:m1"]}, "x:m1 is named twice"),
    (AT_TOP, PAIR, {"gains": ["force:m1"]}, "no gain .*of force:m1 can be estimated.*force:m2"),
    (AT_TOP, PAIR, {"calibration": {"force:m1": 0.01}}, "no calibration of force:m1 .* and the inputs force:m2"),
    (zeroed(1), PAIR, {"gains": ["force:m1"]}, ZERO),
    ([zeroed(1), zeroed(2)], PAIR, {"gains": ["force:m1"]}, ZERO),
    ([shown(BOTH), shown("x:m1")], PAIR, {}, "need the same channels in the same order: x:m1, x:m2 in the first, x:m1 in"),
    ([shown(BOTH), shown("x:m1")], PAIR, {"offsets": ["x:m2"]}, "need the same channels in the same order"),
    ("state:joint.z force:m1", JOINT, {"starts": STARTED}, r"no channel shows the motion of a mass \(state:joint.z"),
    ("x:m1 f:joint force:m1", RAIL.unknown("all"), {}, "f:joint belongs to no link or state"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("record", "asked", "options", "message"),
    REFUSED,
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_what_no_fit_can_find_is_refused(
    record: str | lw.Record | list[lw.Record], asked: lw.Structure, options: dict[str, Any], message: str
) -> None:
    given = shown(record) if isinstance(record, str) else record
    with pytest.raises(lw.IdentificationError, match=message) as refused:
        lw.identify(given, asked, **options)
    assert set(refused.value.arguments) <= {*options, "channels"}


def test_units_that_are_not_told_apart_are_named_where_no_search_starts() -> None:
    """Accelerations a thousand times too small, and a force a thousand times too large, give the same equations."""
    values = {"s.k": 3000.0, "s.k3": 4e7, "s.c": 2.0}
    structure = lw.rig({"m1": 2.0}, {"s": "m1 - ground: k*d + k3*d**3 + c*v"}, values)
    force = "9*sin(30*t) + 7*sin(43*t + 1)"
    record = lw.simulate(structure, duration=4.0, rate=250.0, forces={"m1": force}, sensors=["a"])
    columns = record.with_noise(40.0, seed=0).values * [1e-3, 1.0]
    small = replace(record, values=columns, simulated=None)
    with pytest.raises(
        lw.IdentificationError, match=r"without another unit of force:m1.*or another unit of a:m1.*far less"
    ):
        lw.identify(small, structure.unknown("all"))
