"""How many threads the BLAS libraries of this process use."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """A block in which BLAS works on the calling thread alone.

    A product that takes microseconds is done before a second thread is awake, and on a busy machine it would wait for that
    thread's turn: milliseconds.
    """
    limited: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """The BLAS libraries that are loaded; finding them costs milliseconds."""
    return ThreadpoolController()
