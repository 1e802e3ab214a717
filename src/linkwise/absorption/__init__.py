"""What sinks do for a structure: how it goes on without them, where energy goes, how often they cross wells."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
