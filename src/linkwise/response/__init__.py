"""What a structure does next: steady motion over frequency, free vibration over amplitude, and where it comes to rest."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
