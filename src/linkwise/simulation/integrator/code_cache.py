"""Where compiled equations are kept between processes.

heyoka keeps up to 20 GB in one folder for all programs, and each process that compiles reads it from end to end: with 1.7 GB
there, the first simulation takes twice as long. linkwise keeps a few of its own.
"""

from __future__ import annotations

import os
from pathlib import Path

import heyoka

_CHOSEN_BY_USER = "HEYOKA_CACHE_DIR"
_LARGEST = 2**26  # bytes: some hundreds of structures


def use_own_cache() -> None:
    """Keep what this process compiles in a small folder of linkwise, unless the user chose one for heyoka."""
    if os.environ.get(_CHOSEN_BY_USER):
        return
    state = heyoka.llvm_state
    shared = Path(state.get_diskcache_path())
    if not shared.name:  # no home: the working directory is no place for a cache
        state.set_diskcache_enabled(False)
        return
    try:
        state.set_diskcache_path(str(shared.with_name("linkwise")))
        state.set_diskcache_limit(_LARGEST)
    except RuntimeError:  # a home that cannot be written to
        state.set_diskcache_enabled(False)
