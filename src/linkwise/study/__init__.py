"""Monte Carlo studies: cases of structure, noise level, method and seed, the store of their rows, and executors."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
