"""Hosts that lack a mode in the band: the diagnosis names it by its frequency, and no error of a sensor."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from structures import HARDENING, host, link, structure

import linkwise as lw

FREQUENCIES = (3.3, 20.6, 57.7, 113.0)
SHAPES = {
    "tip": (3.2, -3.2, 3.2, -3.2),
    "mid": (1.1, 2.3, 0.06, -2.2),
    "root": (0.3, 1.5, 2.8, 2.5),
}
LAW = {"k": 200.0, "k3": 2e6, "c": 0.05}
ACCELEROMETERS = ("a:beam.tip", "a:beam.mid", "a:beam.root", "x:sink")
DISPLACEMENTS = ("x:beam.tip", "x:beam.mid", "x:beam.root", "x:sink")


def _beam(modes: Sequence[int], off: float = 1.0, **values: float) -> lw.Structure:
    """A cantilever by some of its modes, with a hardening sink at its tip; the second frequency is `off` by a factor."""
    frequencies = [FREQUENCIES[r] * (off if r == 1 else 1.0) for r in modes]
    shapes = {point: [shape[r] for r in modes] for point, shape in SHAPES.items()}
    beam = host("beam", frequencies, 0.01, shapes)
    return structure(
        {"sink": 0.03}, link("nes", "beam.tip-sink", HARDENING, **values), hosts=[beam], name="beam"
    )


def _hit(subject: lw.Structure, sensors: Sequence[str], seed: int) -> lw.Record:
    """Two hits near the root."""
    hits = "3*exp(-((t - 0.1)/0.003)**2) + 2.4*exp(-((t - 1.1)/0.003)**2)"
    record = lw.simulate(subject, forces={"beam.root": hits}, duration=2.0, rate=1000.0, sensors=sensors)
    return record.with_noise(30.0, seed=seed)


@pytest.mark.parametrize(
    ("true", "stated", "sensors", "seed"),
    [
        ((0, 1, 2, 3), (0, 1, 2), ACCELEROMETERS, 5215401),
        ((0, 1, 2, 3), (0, 1, 2), DISPLACEMENTS, 5215402),
        ((0, 1, 2), (0, 1), DISPLACEMENTS, 5215403),
    ],
    ids=["accelerations", "displacements", "third"],
)
def test_a_mode_that_a_host_lacks_is_named_by_its_frequency(
    true: Sequence[int], stated: Sequence[int], sensors: Sequence[str], seed: int
) -> None:
    fit = lw.identify(_hit(_beam(true, **LAW), sensors, seed), _beam(stated))
    cause = fit.diagnosis[0]
    assert not fit.trusted and (cause.kind, cause.where) == ("mode", "beam")
    # a peak as wide as the damping, 1 % to either side, whose neighbours are stated
    assert cause.size == pytest.approx(FREQUENCIES[true[-1]], rel=0.01)
    assert f"a mode near {cause.size:.3g} Hz that the host beam lacks" in fit.message
    assert fit.fit_verdicts == (lw.Verdict.UNEXPLAINED_FORCES,)


@pytest.mark.parametrize(("sensors", "seed"), [(ACCELEROMETERS, 5215404), (DISPLACEMENTS, 5215405)])
def test_a_frequency_that_is_off_is_no_mode_that_is_lacking(sensors: Sequence[str], seed: int) -> None:
    fit = lw.identify(_hit(_beam((0, 1, 2), **LAW), sensors, seed), _beam((0, 1, 2), off=1.04))
    assert not fit.trusted and fit.diagnosis[0].kind == "frequency"


def test_a_link_that_moves_a_mode_is_no_mode_that_is_lacking() -> None:
    """The sensors then lack the stated mode, which they should show."""
    true = _beam((0, 1, 2), **LAW)
    spring = link("ground", "beam.mid-ground", "k*d", k=3000.0)
    stiffer = structure({"sink": 0.03}, *true.links[-1:], spring, hosts=true.hosts, name="beam")
    fit = lw.identify(_hit(stiffer, ACCELEROMETERS, 5215406), _beam((0, 1, 2)))
    assert not fit.trusted and fit.diagnosis[0].kind == "link"
    assert "mode" not in {cause.kind for cause in fit.diagnosis}
