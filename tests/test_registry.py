"""Registries: lazy entries, and what a wrong name is told."""

import pytest

from linkwise.errors import IdentificationError
from linkwise.registry import Registry


def test_an_unknown_name_lists_those_there_are() -> None:
    registry: Registry[int] = Registry("window", {"hann": 1, "hamming": 2}, IdentificationError)
    with pytest.raises(IdentificationError) as error:
        registry.lookup("haming")
    assert (
        str(error.value)
        == "unknown window 'haming'; did you mean \"hamming\"?; choose from 'hann', 'hamming'"
    )
    with pytest.raises(KeyError):
        registry["haming"]
