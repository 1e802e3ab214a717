"""Discovery of structures: which links and terms a record shows among all candidates (METHODS section 9)."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
