"""What may be None or empty in general and is not in a test: `present(record.simulated).noise`, `some(fit.links)`."""

from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T")


def present(value: T | None) -> T:
    """The value, which must be there."""
    assert value is not None
    return value


def some(values: Iterable[T]) -> list[T]:
    """What a test loops over, which must not be nothing."""
    listed = list(values)
    assert listed
    return listed
