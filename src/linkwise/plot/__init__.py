"""Figures of results. Each function draws on the Axes that it is given, or on those of a new figure, and returns them.

Functions whose names end in `_figure` put these pictures together as the commands write them. All take results and compute
nothing. Names load on first use, so that matplotlib is imported when something is drawn; `__init__.pyi` beside this file lists
them.
"""

from __future__ import annotations

from linkwise.registry import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
