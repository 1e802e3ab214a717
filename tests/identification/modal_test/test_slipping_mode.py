"""A mode that slips a little is found as one, with errors that count it, and two modes that lie close as two."""

import numpy as np
import pytest
from structures import host, link, structure

import linkwise as lw

SHAPES = {"tip": (1.0, -0.9), "left": (0.2, 0.5), "right": (-0.25, 0.4)}
SLIP = "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"


def tapped(frequencies: tuple[float, float], *joints: lw.Link) -> lw.Record:
    return lw.simulate(
        structure({}, *joints, hosts=[host("beam", frequencies, 0.0012, SHAPES)]),
        forces={"beam.tip": "2*exp(-((t - 0.02)/0.004)**2)"},
        duration=3.0,
        rate=600.0,
        sensors=["a:beam.tip", "a:beam.left", "a:beam.right"],
    ).with_noise(45.0, seed=3)


@pytest.mark.slow
def test_a_mode_that_slips_is_one() -> None:
    joint = link("joint", "beam.left-beam.right", "F*z", {"z": SLIP}, F=0.9, s=0.5, x0=4e-5)
    found = lw.modal.identify_host(tapped((79.4, 140.0), joint))
    assert len(found.host.modes) == 2
    assert not found.trusted
    mode = found.host.modes[0]
    stiffness = (2.0 * np.pi * 79.4) ** 2 + 0.45**2 * 0.9 / 4e-5  # of small motion
    small = float(np.sqrt(stiffness)) / (2.0 * np.pi)
    # half a bandwidth: at this level the joint slips, which its scatter does not tell
    assert abs((mode.frequency.value or 0.0) - small) < 0.0012 * small
    assert abs(abs(mode.shape["tip"]) - 1.0) < 0.02


@pytest.mark.slow
def test_two_modes_within_their_bandwidth_are_two() -> None:
    found = lw.modal.identify_host(tapped((80.0, 80.05)))
    assert len(found.host.modes) == 2
    assert found.trusted


@pytest.mark.slow
def test_what_a_joint_leaves_is_not_blamed_on_the_force() -> None:
    joint = link("joint", "beam.left-beam.right", "F*z", {"z": SLIP}, F=0.6, s=0.5, x0=1.2e-5)
    found = lw.modal.identify_host(tapped((79.4, 140.0), joint))
    assert not any("hardly moves" in text for text in found.remarks)
