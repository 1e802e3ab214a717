"""Discovery from sensors whose noise is correlated, and where forces act that no channel shows, or shows with noise."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import scipy.linalg
from present import present, some
from problems import chain_record
from random_signals import autoregressive, differenced
from structures import row_of_masses
from within import assert_discovered, masses

import linkwise as lw

pytestmark = pytest.mark.slow


RATE, STIFFNESS, DAMPING = 100.0, 1000.0, 3.0  # N/m, N s/m of both links; masses of 1 kg
STEADY = 2000  # samples before a record, after which its start is forgotten
NOISE = 1e-4  # m, of displacements of some mm


def noisy(record: lw.Record, draw: Callable[..., np.ndarray], seed: int) -> lw.Record:
    """`record` with noise 30 dB below the power of each channel, which it does not state."""
    size = np.sqrt(np.mean(record.values**2, axis=0)) * 10.0**-1.5
    return replace(
        record, values=record.values + size * draw(np.random.default_rng(seed), record.values.shape)
    )


def test_coloured_noise_is_told_from_missing_terms() -> None:
    chain, clean = lw.bnes_chain(2), chain_record(2, duration=3.0)
    discovery = lw.discover(noisy(clean, differenced, 7), masses(chain))
    assert_discovered(discovery, chain)
    assert discovery.estimate.model_error == 0.0 and all(term.certain for term in discovery.kept)


def test_the_evidence_counts_how_well_gains_are_known() -> None:
    """A gain that both sensors share scales the cubic term alone, by the square of it."""
    chain, clean = lw.bnes_chain(2), chain_record(2, duration=3.0)
    remembering = partial(autoregressive, correlation=0.7)  # in the first sensor, white in the second
    discovery = lw.discover(noisy(clean, remembering, 7), masses(chain), calibration={"common": 0.005})
    assert discovery.trusted
    cubic = next(term for term in discovery.kept if term.name == "m2-m1.k3")
    assert abs(cubic.value / cubic.z) == pytest.approx(
        2.0 * 0.005 * cubic.value, rel=0.03
    )  # beside noise of 0.1 %
    for term in some(discovery.kept):  # of one fit in two ways
        assert term.standard_error == pytest.approx(
            present(discovery.estimate.coefficient(term.name).standard_error), rel=0.01
        )


def truth() -> lw.Structure:
    link = "k*d + c*v", {"k": STIFFNESS, "c": DAMPING}
    return row_of_masses([1.0, 1.0], l1=link, l2=link)


def displacements(forces: np.ndarray) -> np.ndarray:
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
    rng, count = np.random.default_rng(seed), 1000
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


def test_ambient_vibration_gives_the_structure() -> None:
    discovery = lw.discover(ambient(11), masses(truth()), terms="v, d, d**3", ambient="all")
    assert_discovered(discovery, truth(), 5.0)
    assert [force.where for force in discovery.estimate.random_forces] == ["m1", "m2"]
    assert any("it is not tested whether terms stand in for a form" in remark for remark in discovery.remarks)


@pytest.mark.usefixtures("memory_not_sought")
def test_a_discovery_with_an_ambient_force_on_one_of_two_shaken_masses_is_not_trusted() -> None:
    discovery = lw.discover(ambient(11), masses(truth()), terms="v, d", ambient=["m1"])
    assert not discovery.trusted
    [cause] = [cause for cause in discovery.diagnosis if cause.kind == "ambient"]
    assert cause.where == "m2"
    assert not [term for term in discovery.terms if term.certain]


def test_noise_of_a_load_cell_gives_no_false_term() -> None:
    discovery = lw.discover(load_cell(12), masses(truth()), input_noise={"force:m1": 0.1})
    assert_discovered(discovery, truth(), 5.0)
    assert [force.where for force in discovery.estimate.random_forces] == ["force:m1"]
    assert all(term.certain for term in some(discovery.kept))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"terms": "d, v, tanh(v/vr)"}, "parameters of terms (tanh(v/vr)) and random forces cannot be estimated together"),
        ({"ambient": ["m3"]}, "no ambient force can act on m3: the masses are m1, m2"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(lw.IdentificationError) as error:
        lw.discover(ambient(11), masses(truth()), **{"ambient": "all", **options})  # type: ignore[arg-type]
    assert words in str(error.value)
