"""The paper's chain: Eq. 1, Table 1."""

from typing import Any

import numpy as np
import pytest

from linkwise.errors import StructureError
from linkwise.model.chains import bnes_chain


@pytest.mark.parametrize("n", [2, 4, 10])
def test_defaults_are_table_1(n: int) -> None:
    chain = bnes_chain(n)
    assert chain.mass_names == tuple(f"m{i}" for i in range(1, n + 1))
    np.testing.assert_array_equal(chain.mass_values, np.tile([1.0, 0.01], n // 2))
    assert [link.name for link in chain.links] == [
        f"{kind}{i}" for i in range(1, n // 2 + 1) for kind in ("spring", "nes")
    ]
    for cell in range(1, n // 2 + 1):
        spring, sink = chain.link(f"spring{cell}"), chain.link(f"nes{cell}")
        assert spring.between == (f"m{2 * cell - 1}", f"m{2 * cell - 3}" if cell > 1 else "ground")
        assert sink.between == (f"m{2 * cell}", f"m{2 * cell - 1}")
        assert spring.values == {"k": 30000.0, "c": 1.0}
        assert sink.values == {"alpha": -100.0, "beta": 1e6, "c": 0.02}


def test_forces_are_equation_1_for_four_masses() -> None:
    """M x'' = -B f against Eq. (1) written out, at a random state."""
    rng = np.random.default_rng(4)
    x, v = 0.02 * rng.standard_normal(4), rng.standard_normal(4)
    chain = bnes_chain(4)
    d, rate = chain.elongations(x), chain.elongations(v)
    ours = chain.incidence @ [float(link.force(d[i], rate[i])) for i, link in enumerate(chain.links)]

    def sink(i: int, j: int) -> float:
        return float(-100.0 * (x[i] - x[j]) + 1e6 * (x[i] - x[j]) ** 3 + 0.02 * (v[i] - v[j]))

    paper = [
        1.0 * v[0] + 30000.0 * x[0] + sink(0, 1) + 1.0 * (v[0] - v[2]) + 30000.0 * (x[0] - x[2]),
        sink(1, 0),
        1.0 * (v[2] - v[0]) + 30000.0 * (x[2] - x[0]) + sink(2, 3),
        sink(3, 2),
    ]
    np.testing.assert_allclose(ours, paper, rtol=1e-12)


def test_every_parameter_can_be_replaced_for_all_cells_or_one_by_one() -> None:
    names = {"primary_mass": "m3.mass", "sink_mass": "m4.mass", "k": "spring2.k", "c": "spring2.c",
             "sink_c": "nes2.c", "alpha": "nes2.alpha", "beta": "nes2.beta"}  # fmt: skip
    for name, full in names.items():
        assert bnes_chain(4, **{name: 7.0}).coefficient(full).value == 7.0
        cells = bnes_chain(4, **{name: [5.0, 6.0]})
        first = full.replace("m3", "m1").replace("m4", "m2").replace("2.", "1.")
        first = "m2.mass" if name == "sink_mass" else first
        assert (cells.coefficient(first).value, cells.coefficient(full).value) == (5.0, 6.0)


@pytest.mark.parametrize(
    ("masses", "given", "message"),
    [
        (3, {}, r"the number of masses must be even and at least 2, .* got 3"),
        (0, {}, r"the number of masses must be even and at least 2, .* got 0"),
        (-2, {}, r"the number of masses must be even and at least 2, .* got -2"),
        (4.0, {}, r"the number of masses must be an integer, got 4.0"),
        (4, {"alpha": [1.0, 2.0, 3.0]}, r"alpha: expected one number, or one for each of 2 cells, got"),
        (4, {"k": "stiff"}, r"k: expected one number, or one for each of 2 cells, got 'stiff'"),
        (4, {"sink_mass": [0.01, 0.0]}, r'mass "m4": the mass must be positive, got 0.0 kg'),
    ],
)  # fmt: skip
def test_what_is_no_chain_is_refused(masses: int, given: dict[str, Any], message: str) -> None:
    with pytest.raises(StructureError, match=message):
        bnes_chain(masses, **given)
