"""Work that can be counted, where a clock would tell of the machine and of what else runs on it."""

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


class ComparedName(str):
    """A name whose every comparison and hash is a call, so that a search through a list of names shows in the count."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return str.__eq__(self, other)

    def __hash__(self) -> int:
        return str.__hash__(self)


def function_calls(action: Callable[[], object]) -> int:
    """How many functions `action` calls in this thread, those written in C among them."""
    calls = 0

    def count(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        action()
    finally:
        sys.setprofile(before)
    return calls
