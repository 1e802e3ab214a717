"""Results of estimators: values, covariance, links, findings and their text."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
