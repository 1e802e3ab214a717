"""Options of absorb: one frozen object, or the same as keywords."""

from dataclasses import fields

import numpy as np
import pytest

import linkwise as lw
from linkwise.absorption.options import AbsorptionKeywords
from linkwise.output import to_json
from linkwise.simulation.simulate import ExcitationKeywords

RELEASE = {"v:m1": 1.0}


def test_every_field_has_its_keyword() -> None:
    names = {field.name for field in fields(lw.absorption.AbsorptionOptions)} - {"excitation"}
    assert names == set(AbsorptionKeywords.__annotations__) - set(ExcitationKeywords.__annotations__)


def test_an_object_asks_what_keywords_ask() -> None:
    keywords: AbsorptionKeywords = {
        "duration": 0.5, "settle": 0.1, "harvesters": {"nes1": 0.01}, "release": RELEASE,
    }  # fmt: skip
    options = lw.absorption.AbsorptionOptions.of(**keywords)
    assert dict(options.excitation.release) == RELEASE and options.settle == 0.1
    chain, over = lw.bnes_chain(2), {"nes1.alpha": [-150.0, -60.0]}
    assert lw.absorb(chain, options).to_dict() == lw.absorb(chain, **keywords).to_dict()
    maps = (
        lw.absorption.absorption_map(chain, over, options),
        lw.absorption.absorption_map(chain, over, **keywords),
    )
    # as text, in which what is missing is equal
    assert to_json(maps[0].to_dict()) == to_json(maps[1].to_dict())


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
