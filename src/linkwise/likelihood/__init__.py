"""Maximum likelihood on the raw record: fits by multiple shooting, their judgement, and the answer."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
