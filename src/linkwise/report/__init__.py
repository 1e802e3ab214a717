"""The page that a reader opens first: one HTML file that needs nothing else, not even a network."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
