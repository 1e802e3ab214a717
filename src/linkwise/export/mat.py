"""An answer as variables for MATLAB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import savemat

from linkwise.export.answer import ExportedAnswer


def write(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write MAT v5 with cells of names and columns of numbers; `name` is not needed in it.

    `names`, `values`, `units` and `standard_errors` (NaN where there is none) are those of all masses and coefficients, and
    `covariance` that of `covariance_names`. `links` is a struct array: name, both ends, law, and the rates of states.
    `points` of hosts move by `shapes`, with a column for each of the `coordinates`.
    """
    every = answer.coefficients
    kinds = [("name", object), ("first", object), ("second", object), ("law", object), ("rates", object)]
    links = np.zeros((len(answer.links), 1), dtype=kinds)
    for number, link in enumerate(answer.links):
        rates = [f"{rate.name}: {rate.text}" for rate in link.law.rates]
        links[number, 0] = (link.name, *link.between, link.law.text, _cells(rates))
    content = {
        "structure": answer.structure.name,
        "version": answer.version,
        "note": answer.note,
        "names": _cells([f"{coefficient.owner}.{coefficient.name}" for coefficient in every]),
        "values": np.array([[coefficient.value] for coefficient in every]),
        "units": _cells([coefficient.unit for coefficient in every]),
        "standard_errors": np.array(
            [[np.nan if coefficient.error is None else coefficient.error] for coefficient in every]
        ),
        "covariance_names": _cells(list(answer.names)),
        "covariance": answer.covariance,
        "links": links,
        "points": _cells(list(answer.structure.points)),
        "coordinates": _cells(list(answer.structure.mass_names)),
        "shapes": answer.shapes,
    }
    savemat(path, content, format="5", oned_as="column", long_field_names=True)


def _cells(texts: list[str]) -> np.ndarray[tuple[int, int], np.dtype[np.object_]]:
    """A column of cells."""
    cells = np.empty((len(texts), 1), dtype=object)
    cells[:, 0] = texts
    return cells
