"""Inspection of a record before any model: what each channel holds, and what is wrong with it."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
