"""Answers for other programs, one format a file: coefficients with errors and covariance, forces, equations of motion."""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
