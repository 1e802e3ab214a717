"""Results travel between processes and are copied: pickle and deepcopy give an equal one that still answers."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw

CHAIN = lw.bnes_chain(2)
RELEASE = {"v:m1": 1.0}


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2, duration=1.0, rate=500.0).with_noise(30.0, seed=1)


MAKERS: dict[str, Callable[[lw.Record], Any]] = {
    "simulated record": lambda record: record,
    "measured record": lambda record: lw.Record.from_arrays(
        record.time, {"x:m1": record.channel("x:m1")}, noise={"x:m1": 1e-4}, notes=["A note."]
    ),
    "ml": lambda record: lw.identify(record, CHAIN.unknown("nes")),
    "weak": lambda record: lw.identify(record, CHAIN.unknown("nes"), method="weak"),
    "sindy": lambda record: lw.identify(record, CHAIN.unknown("nes"), method="sindy"),
    "discovery": lambda record: lw.discover(record, {"m1": 1.0, "m2": 0.01}),
    "limit": lambda record: lw.limit(CHAIN, duration=1.0, rate=500.0, noise=20.0, release=RELEASE),
    "absorption": lambda record: lw.absorb(CHAIN, duration=1.0, release=RELEASE),
    "free run": lambda record: lw.analysis.free_run(CHAIN, record),
    "equilibria": lambda record: lw.analysis.equilibria(CHAIN),
    "study": lambda record: lw.study.read_study("paper"),
    "structure": lambda record: CHAIN,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_a_copy_prints_itself_as_the_original(name: str, record: lw.Record) -> None:
    """An estimate still answers: forces and their bands, profiles."""
    original = MAKERS[name](record)
    for again in (pickle.loads(pickle.dumps(original)), copy.deepcopy(original), copy.copy(original)):
        assert type(again) is type(original)
        assert str(again) == str(original) and repr(again) == repr(original)
        if isinstance(original, lw.Estimate):
            d = np.linspace(-0.02, 0.02, 5)
            np.testing.assert_array_equal(original.force_band("nes1", d), again.force_band("nes1", d))
            assert again.to_dict() == original.to_dict()
    if name == "ml":
        again = pickle.loads(pickle.dumps(original))
        profile = lw.likelihood.profile_interval
        assert profile(again, "nes1.alpha") == profile(original, "nes1.alpha")


def test_a_copy_of_a_record_is_as_immutable(record: lw.Record) -> None:
    again = pickle.loads(pickle.dumps(record))
    np.testing.assert_array_equal(again.values, record.values)
    assert not again.values.flags.writeable
    with pytest.raises(TypeError):
        again.noise["x:m1"] = 1.0
    assert again.simulated is not None and again.simulated.noise == record.simulated.noise  # type: ignore[union-attr]
