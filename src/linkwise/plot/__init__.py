"""Figures: each made by a function from a result; results know nothing of them."""

from linkwise.plot.force import force_figure
from linkwise.plot.histories import histories_figure
from linkwise.plot.style import save

__all__ = ["force_figure", "histories_figure", "save"]
