"""Sensitivities of hosts, whose modes and dampers between them act as matrices over the modes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from present import present
from structures import coefficient, host, link, structure

import linkwise as lw
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangents import LinearLinks, tangent_forces

RATE, COUNT = 200.0, 101
WING = host(
    "wing",
    (5.0, 9.0, 14.0),
    0.01,
    {"tip": (0.1, 0.2, -0.1), "mid": (0.15, -0.1, 0.1)},
    {(1, 2): 0.3, (2, 3): -0.1},
).known_to_within(frequency=0.01, damping=0.2, shape=0.02)
JOINT = lw.model.named_law("bouc-wen").link(
    "joint",
    ("store", "wing.mid"),
    {
        name: coefficient(value)
        for name, value in {"k": 4e3, "c": 1.0, "F": 2.0, "s": 0.6, "x0": 0.05}.items()
    },
)
"""A link with a state, between two points with shapes that are unknown."""
MOUNT = link("mount", "store-ground", "k*d + c*v", k=50.0, c=0.1)
TRUE = structure({"store": 2.0}, JOINT, MOUNT, hosts=(WING,))
ASKED = TRUE.unknown("joint")


def segments_of(refine: int, shown: str = "a:store") -> Segments:
    time = np.arange(COUNT) / RATE
    channels = ("a:wing.tip", shown, "state:joint.z", "force:wing.tip")
    values = np.stack([0.0 * time, 0.0 * time, 0.0 * time, np.sin(40.0 * time)], axis=1)
    record = lw.Record(
        0.0, RATE, channels, values, noise={"a:wing.tip": 1.0, shown: 1.0, "state:joint.z": 0.1}
    )
    return SensorModel.of([record], (), ()).segments([record], ASKED, System.of(ASKED), refine)


def linearised_at(segments: Segments, *, seed: int) -> tuple[Misfit, Scales]:
    """The misfit at nodes drawn at random, with units of states and parameters."""
    rng = np.random.default_rng(seed)
    m = segments.system.dimension
    size = np.repeat([0.01, 0.3, 0.3], [m // 2, m // 2, m % 2])
    theta = np.array([present(TRUE.coefficient(p.name).value) for p in ASKED.parameters])
    point = Iterate(size[:, None] * rng.normal(size=(m, segments.count)), theta, np.zeros(0), np.ones(0))
    scales = Scales(np.ones(3), size, np.maximum(np.abs(theta), 0.01))
    misfit = evaluate(segments, point, scales, Gaussian())
    assert np.isfinite(misfit.residuals).all()
    return misfit, scales


@pytest.mark.parametrize("refine", [1, 4])
def test_modes_as_matrices_have_the_sensitivities_of_modes_as_links(
    refine: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    segments = segments_of(refine)
    misfit, scales = linearised_at(segments, seed=1)
    assert len(segments.system.linear_links) == 3 + 2 * 2 + 1  # all but the joint
    as_matrices = linearise(segments, misfit, scales, Gaussian())
    monkeypatch.setattr(LinearLinks, "of", lambda *_: None)
    as_links = linearise(segments, misfit, scales, Gaussian())
    for own, other in ((as_matrices.data, as_links.data), (as_matrices.defects, as_links.defects)):
        for name in ("state", "right", "corner"):
            expected = getattr(other, name)
            # single precision, summed in another order
            assert_allclose(getattr(own, name), expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())


def test_load_cells_in_linear_links_show_their_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their sensitivities were zeros where the links act as matrices."""
    segments = segments_of(1, "f:mount")
    misfit, scales = linearised_at(segments, seed=3)
    linear = linearise(segments, misfit, scales, Gaussian())
    monkeypatch.setattr(LinearLinks, "of", lambda *_: None)
    as_links = linearise(segments, misfit, scales, Gaussian())
    expected = as_links.data.state
    assert_allclose(linear.data.state, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())


def test_steps_of_several_lengths_leave_modes_as_links() -> None:
    segments = segments_of(1)
    misfit, scales = linearised_at(segments, seed=2)
    mechanics, step = segments.system.at(misfit.point.theta), segments.step.copy()
    step[-1] *= 0.5
    forces, _ = tangent_forces(mechanics, misfit.trajectories, step, scales.theta, inputs=segments.inputs)
    assert LinearLinks.of(mechanics, forces, segments.step) is not None
    assert LinearLinks.of(mechanics, forces, step) is None
