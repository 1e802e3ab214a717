"""What follows from a structure alone: wells, equilibria, modes, kinds of laws."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
