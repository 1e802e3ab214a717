"""Options of discover: one frozen object, or the same as keywords."""

from dataclasses import fields

import pytest
from problems import chain_record

import linkwise as lw
from linkwise.discovery.candidates import DiscoveryKeywords

MASSES = {"m1": 1.0, "m2": 0.01}


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """A record of two masses."""
    return chain_record(2, duration=0.5).with_noise(40.0, seed=1)


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_an_object_asks_what_keywords_ask(record: lw.Record) -> None:
    names = {field.name for field in fields(lw.discovery.DiscoveryOptions)}
    assert names == set(DiscoveryKeywords.__annotations__)
    options = lw.discovery.DiscoveryOptions(terms=["v", "d"])
    short = record[:51]  # few samples for the candidates: 2 terms on m1-m2, m1-ground and m2-ground
    remarks = lw.discovery.check_discovery(short, MASSES, options)
    assert "102 samples for 6 candidates" in remarks[0]
    assert lw.discovery.check_discovery(short, MASSES, terms="v, d") == remarks
    discovery = lw.discover(record, MASSES, options).to_dict()
    by_keyword = lw.discover(record, MASSES, terms=["v", "d"]).to_dict()
    assert {**discovery, "seconds": 0.0} == {**by_keyword, "seconds": 0.0}


def test_both_at_once_invalid_terms_and_unknown_keywords_are_refused(record: lw.Record) -> None:
    options = lw.discovery.DiscoveryOptions()
    with pytest.raises(TypeError, match="got options and also terms; give one of the two"):
        lw.discover(record, MASSES, options, terms="v, d")
    with pytest.raises(TypeError, match="term"):
        lw.discovery.check_discovery(record, MASSES, term="v, d")  # type: ignore[call-arg]  # the point of the test
    with pytest.raises(lw.IdentificationError, match="the list of terms is empty"):
        lw.discovery.DiscoveryOptions(terms=[])
