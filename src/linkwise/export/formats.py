"""The formats in which answers are exported, by the suffix of the file; what writes one loads when it is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from linkwise.errors import OutputError
from linkwise.registry import Registry


@dataclass(frozen=True)
class ExportFormat:
    """What a file of this format is, and `writer`, "module:function", which writes it.

    That function takes an `ExportedAnswer`, a path, and the name that the file will have, without its suffix.
    """

    title: str
    writer: str

    def load(self) -> Callable[..., Any]:
        """The function that writes."""
        module, _, name = self.writer.partition(":")
        function: Callable[..., Any] = getattr(import_module(module), name)
        return function


EXPORTS: Registry[ExportFormat] = Registry(
    "format",
    {
        ".py": ExportFormat(
            "a Python module: the force of each link as a function of arrays, with coefficients, errors and covariance",
            "linkwise.export.python:write",
        ),
        ".m": ExportFormat("the same as a function for MATLAB and Octave", "linkwise.export.matlab:write"),
        ".mat": ExportFormat("the numbers and laws as variables for MATLAB", "linkwise.export.mat:write"),
        ".csv": ExportFormat(
            "a table of the coefficients with units, errors and intervals",
            "linkwise.export.table:write_csv",
        ),
        ".xlsx": ExportFormat("the same table, and the covariance", "linkwise.export.table:write_xlsx"),
    },
    OutputError,
)


def listed_formats() -> list[str]:
    """A line for each format: its suffix, and what a file of it is."""
    width = max(map(len, EXPORTS))
    return [f"{suffix:{width}}  {entry.title}" for suffix, entry in EXPORTS.items()]
