"""Options of absorb: one frozen object, or the same as keywords."""

from dataclasses import fields

import numpy as np
import pytest

import linkwise as lw
from linkwise.absorption.comparison import AbsorptionKeywords
from linkwise.simulation.simulate import ExcitationKeywords

RELEASE = {"v:m1": 1.0}


def test_every_field_has_its_keyword() -> None:
    names = {field.name for field in fields(lw.absorption.AbsorptionOptions)} - {"excitation"}
    assert names == set(AbsorptionKeywords.__annotations__) - set(ExcitationKeywords.__annotations__)


def test_both_at_once_and_unknown_keywords_are_refused() -> None:
    options = lw.absorption.AbsorptionOptions.of(duration=0.5, release=RELEASE)
    with pytest.raises(TypeError, match="got options and also duration; give one of the two"):
        lw.absorb(lw.bnes_chain(2), options, duration=1.0)
    with pytest.raises(TypeError, match="setle"):
        lw.absorption.AbsorptionOptions.of(duration=0.5, setle=0.1)  # type: ignore[call-arg]  # the point of the test


def test_without_a_duration_three_decay_times_are_simulated() -> None:
    """Of the first mass alone: 2 m/c = 2 s each."""
    assert lw.absorb(lw.bnes_chain(2), release=RELEASE).time[-1] == 6.0
    undamped = lw.bnes_chain(2).with_values({"spring1.c": 0.0})
    frequency = np.sqrt(3e4) / (2.0 * np.pi)
    assert lw.absorb(undamped, release=RELEASE).time[-1] == pytest.approx(300.0 / frequency, rel=0.05)
