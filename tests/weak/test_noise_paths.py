"""How noise of channels enters equations: many channels that pass through links alone, taken together as two."""

from __future__ import annotations

import numpy as np
import pytest
from judged import masses
from present import some
from problems import chain_record

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.weak import scatter
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations
from linkwise.weak.fit import assemble_blocks
from linkwise.weak.scatter import SlopeStatistics, score_blocks


def covariance(number: int) -> np.ndarray:
    """The covariance of the normal equations of one mass of four, each linked to all others and the ground."""
    record = chain_record(4).with_noise(30.0, seed=1000)
    structure = candidates_for([record], masses(lw.bnes_chain(4)), "v, d, d**2, d**3").full_structure
    equations = weak_equations(record, structure, read_displacements(record, structure), only=(number,))
    (patch,) = equations.patches
    values = np.random.default_rng(number).normal(size=len(structure.parameters)) * 1e3
    noisy = [(patch, SlopeStatistics.along(patch, equations, values))]
    weights = [1.0 / patch.largest()]
    blocks = ((which, block[0]) for which, block in score_blocks(noisy, weights, equations))
    total = assemble_blocks(blocks, len(values))
    assert isinstance(total, np.ndarray)
    used = patch.layout.free_parameters
    return total[np.ix_(used, used)]


def test_channels_of_one_equation_add_up_to_two(monkeypatch: pytest.MonkeyPatch) -> None:
    together = [covariance(number) for number in range(4)]
    monkeypatch.setattr(scatter, "_AS_TWO", 99)
    for number, ours in enumerate(some(together)):
        apart = covariance(number)
        scale = np.sqrt(np.outer(apart.diagonal(), apart.diagonal()))
        np.testing.assert_allclose(ours / scale, apart / scale, rtol=0.0, atol=1e-12)
