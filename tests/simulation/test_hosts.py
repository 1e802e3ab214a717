"""A host moves as the masses and springs that its modes are those of."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from structures import NES, bodies, host, link, structure

import linkwise as lw


@cache
def two_masses() -> lw.Structure:
    """Two masses on springs, undamped, so that real modes take them apart."""
    springs = link("root", "a-ground", "k*d", k=3e4), link("between", "b-a", "k*d", k=2e4)
    return structure({"a": 1.0, "b": 0.5}, *springs)


def with_sink(subject: lw.Structure, end: str) -> lw.Structure:
    """A structure with a bistable sink at one of its places."""
    sink = link("nes", f"sink-{end}", NES, alpha=-100.0, beta=1e6, c=0.02)
    masses = (*subject.masses, *bodies({"sink": 0.01}))
    return replace(subject, masses=masses, links=(*subject.links, sink))


@cache
def as_host() -> lw.Structure:
    """The same two masses by their modes."""
    modes = lw.analysis.modes(two_masses())
    shapes = modes.shapes / np.sqrt(np.einsum("ir,i,ir->r", modes.shapes, [1.0, 0.5], modes.shapes))
    by_point = {"a": shapes[0].tolist(), "b": shapes[1].tolist()}
    return structure({}, hosts=[host("beam", modes.frequencies.tolist(), 0.0, by_point)])


def test_a_host_by_its_modes_moves_as_its_masses_do() -> None:
    """Displacements, accelerations and forces agree with those of the masses to the accuracy of two integrations."""
    masses, host = (
        lw.simulate(
            structure,
            forces={f"{prefix}a": "20*sin(60*t)"},
            impulses=[lw.model.Impulse(f"{prefix}b", 0.05)],
            sensors=["x", "a", "f:nes"],
            duration=0.5,
            rate=1000.0,
        )
        for structure, prefix in (
            (with_sink(two_masses(), "b"), ""),
            (with_sink(as_host(), "beam.b"), "beam."),
        )
    )
    assert host.channels[:3] == ("x:beam.a", "x:beam.b", "x:sink")
    for column, name in some(enumerate(masses.channels)):
        size = np.abs(masses.values[:, column]).max()
        # half a second of chaotic motion amplifies 1e-16 by less than 1e8
        assert np.abs(host.values[:, column] - masses.values[:, column]).max() < 1e-8 * size, name


def test_energy_of_a_host_balances_and_what_it_lacks_is_told() -> None:
    subject = with_sink(as_host(), "beam.b")
    record = lw.simulate(subject, forces={"beam.a": "20*sin(60*t)"}, duration=2.0, rate=500.0)
    energy = present(record.simulated).energy
    assert np.abs(energy.residual).max() < 1e-12 * np.abs(energy.supplied).max()
    with pytest.raises(lw.SimulationError, match=r"release these, such as x:beam\.mode1"):
        lw.simulate(subject, release={"x:beam.a": 0.1}, duration=1.0, rate=100.0)
    blow = [lw.model.Impulse("beam.c", 1.0)]
    with pytest.raises(lw.SimulationError, match=r"the masses and points are beam\.a, beam\.b, sink"):
        lw.simulate(subject, impulses=blow, duration=1.0, rate=100.0)
