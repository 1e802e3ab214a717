"""Discovery where forces act that no channel shows, or shows with noise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy
from present import some
from structures import row_of_masses

import linkwise as lw
from linkwise.arrays import Floats

RATE, STIFFNESS, DAMPING = 100.0, 1000.0, 3.0  # N/m, N s/m of both links; masses of 1 kg
STEADY = 2000  # samples before a record, after which its start is forgotten
MASSES = {"m1": 1.0, "m2": 1.0}
NOISE = 1e-4  # m, of displacements of some mm


def truth() -> lw.Structure:
    link = "k*d + c*v", {"k": STIFFNESS, "c": DAMPING}
    return row_of_masses([*MASSES.values()], l1=link, l2=link)


def displacements(forces: Floats) -> Floats:
    """(N, 2) in forces (N, 2) that are constant in each sample."""
    pulls, still = np.array([[2.0, -1.0], [-1.0, 1.0]]), np.zeros((2, 2))
    matrix = np.block(
        [[still, np.eye(2), still], [-STIFFNESS * pulls, -DAMPING * pulls, np.eye(2)], [np.zeros((2, 6))]]
    )
    step = scipy.linalg.expm(matrix / RATE)[:4]
    state, out = np.zeros(4), np.empty((len(forces), 2))
    for number, force in enumerate(forces):
        out[number] = state[:2]
        state = step @ np.append(state, force)
    return out


@cache
def ambient(seed: int) -> lw.Record:
    """In white forces of 1 N on both masses."""
    rng, count = np.random.default_rng(seed), 1500
    x = displacements(rng.standard_normal((STEADY + count, 2)))[STEADY:]
    return lw.Record(0.0, RATE, ("x:m1", "x:m2"), x + NOISE * rng.standard_normal(x.shape))


@cache
def load_cell(seed: int) -> lw.Record:
    """In a force on the first mass, held between its samples, whose channel has noise of a tenth of it."""
    rng, count = np.random.default_rng(seed), 1500
    applied = np.convolve(rng.standard_normal(count), np.ones(4) / 2.0, mode="same")
    x = displacements(np.column_stack([applied, np.zeros(count)]))
    noisy = [x + 0.1 * NOISE * rng.standard_normal(x.shape), applied + 0.1 * rng.standard_normal(count)]
    channels = ("x:m1", "x:m2", "force:m1")
    return lw.Record(0.0, RATE, channels, np.column_stack(noisy), interpolation={"force:m1": "held"})


def assert_found(discovery: lw.Discovery) -> None:
    assert discovery.trusted, discovery
    assert lw.discovery.term_score(discovery.structure, truth()).exact
    for parameter in some(discovery.estimate.parameters):
        coefficient = discovery.estimate.coefficient(parameter.name)
        true = STIFFNESS if parameter.name.endswith(".k") else DAMPING
        # five standard errors, which chance exceeds in 6e-7 of estimates
        assert abs(coefficient.value - true) < 5.0 * float(coefficient.standard_error or 0.0)


def test_ambient_vibration_gives_the_structure() -> None:
    discovery = lw.discover(ambient(11), MASSES, terms="v, d, d**3", ambient="all")
    assert_found(discovery)
    assert [force.where for force in discovery.estimate.random_forces] == ["m1", "m2"]
    assert any("it is not tested whether terms stand in for a form" in remark for remark in discovery.remarks)


def test_a_discovery_with_an_ambient_force_on_one_of_two_shaken_masses_is_not_trusted() -> None:
    discovery = lw.discover(ambient(11), MASSES, terms="v, d, d**3", ambient=["m1"])
    assert not discovery.trusted
    [cause] = [cause for cause in discovery.diagnosis if cause.kind == "ambient"]
    assert cause.where == "m2"
    assert not [term for term in discovery.terms if term.certain]


def test_noise_of_a_load_cell_gives_no_false_term() -> None:
    discovery = lw.discover(load_cell(12), MASSES, input_noise={"force:m1": 0.1})
    assert_found(discovery)
    assert [force.where for force in discovery.estimate.random_forces] == ["force:m1"]
    assert all(term.certain for term in some(discovery.kept))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"terms": "d, v, tanh(v/vr)"},
            "parameters of terms (tanh(v/vr)) and random forces cannot be estimated together",
        ),
        ({"delays": ["x:m1"]}, "random forces and a delay of x:m1 cannot be estimated together"),
        ({"admit": ["gain"]}, "random forces and errors of sensors to be admitted (gain)"),
        ({"ambient": ["m3"]}, "no ambient force can act on m3: the masses are m1, m2"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(lw.IdentificationError) as error:
        lw.discover(ambient(11), MASSES, **{"ambient": "all", **options})  # type: ignore[arg-type]
    assert words in str(error.value)
