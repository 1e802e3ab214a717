"""A measurement counts once, what was done to it is told with the answer, and copies of answers answer alike."""

import copy
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")

CHAIN = lw.bnes_chain(2)
MASSES = {"m1": 1.0, "m2": 0.01}


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2, duration=1.0, rate=500.0).with_noise(30.0, seed=1)


def test_a_record_given_twice_is_refused(record: lw.Record) -> None:
    """It would narrow every interval by the square root of two."""
    for records in ([record, record], [record, record.select(["x:m2"])]):
        with pytest.raises(
            lw.RecordError, match=r"records 1 and 2 .* hold the same samples; give each record once"
        ):
            lw.identify(records, CHAIN.unknown("nes"))
    with pytest.raises(lw.RecordError, match="hold the same samples"):
        lw.discover([record, record], MASSES)
    with pytest.raises(lw.RecordError, match="hold the same samples"):
        lw.discovery.check_discovery([record, record], MASSES)


@pytest.mark.slow
def test_the_notes_of_all_records_are_in_the_result(record: lw.Record, tmp_path: Path) -> None:
    gap = record.channel("x:m2").copy()
    gap[10:20] = np.nan
    clean = chain_record(2, duration=1.0, rate=500.0, speed=0.8).with_noise(30.0, seed=3)
    with_gap = lw.Record.from_arrays(record.time, {"x:m1": record.channel("x:m1"), "x:m2": gap})
    fit = lw.identify([clean, with_gap], CHAIN.unknown("nes"))
    lw.report.write_result(fit, tmp_path / "answer")
    notes = json.loads((tmp_path / "answer" / "result.json").read_text())["notes"]
    assert notes == ["Noise of 30 dB per channel was added (seed 3).", "x:m2: 10 of 501 samples are missing."]
    assert lw.discover(clean, MASSES).to_dict()["notes"] == notes[:1]


@pytest.mark.parametrize("kind", ["mass", "link"])
def test_a_name_has_the_length_that_names_of_files_leave_it(kind: str) -> None:
    def renamed(name: str) -> lw.Structure:
        old = {"mass": '"m2"', "link": '"nes1"'}[kind]
        return lw.parse_structure(lw.model.format_structure(CHAIN).replace(old, f'"{name}"'))

    assert renamed("n" * 200).size == 2
    for name in ("n" * 201, "ü" * 101, "n" * 200_000):
        with pytest.raises(lw.StructureError, match="a name has at most 200 bytes") as error:
            renamed(name)
        assert len(str(error.value)) < 3000


RELEASE = {"v:m1": 1.0}


MAKERS: dict[str, Callable[[lw.Record], Any]] = {
    "simulated record": lambda record: record,
    "measured record": lambda record: lw.Record.from_arrays(
        record.time, {"x:m1": record.channel("x:m1")}, noise={"x:m1": 1e-4}, notes=["A note."]
    ),
    "ml": lambda record: lw.identify(record, CHAIN.unknown("nes")),
    "discovery": lambda record: lw.discover(record, {"m1": 1.0, "m2": 0.01}),
    "limit": lambda record: lw.limit(CHAIN, duration=1.0, rate=500.0, noise=20.0, release=RELEASE),
    "absorption": lambda record: lw.absorb(CHAIN, duration=1.0, release=RELEASE),
    "free run": lambda record: lw.analysis.free_run(CHAIN, record),
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
