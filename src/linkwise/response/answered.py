"""What is asked about: a structure, with the posterior and the visited ranges of the answer that it comes from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, read_posterior
from linkwise.model.structure import Structure
from linkwise.model.structure_file import read_structure
from linkwise.output import RESULT

Answer = Structure | Estimate | Posterior | str | Path
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class AskedStructure:
    """A structure, the `posterior` that it was drawn from if it was identified, and the `ranges` in m that the elongations of
    its links visited in the record, where they are known.
    """

    structure: Structure
    posterior: Posterior | None = None
    ranges: Ranges = field(default_factory=dict)

    @classmethod
    def of(cls, answer: Answer) -> AskedStructure:
        """What an answer holds; of one without intervals the structure alone. Raises the errors of reading."""
        match answer:
            case Structure():
                return cls(answer)
            case Posterior():
                return cls(answer.structure, answer)
            case Estimate():
                ranges = {found.link.name: found.d_range for found in answer.links}
                try:
                    return cls(answer.structure, Posterior.of(answer), ranges)
                except IdentificationError:
                    return cls(answer.structure, None, ranges)
        path = Path(answer)
        if not (path / COVARIANCE).exists():
            return cls(read_structure(path), None, _ranges(path))
        posterior = read_posterior(path)
        return cls(posterior.structure, posterior, _ranges(path))

    def farthest(self, d: Floats) -> str:
        """The link whose elongation in `d` (M, L) m goes farthest beyond the range it visited; "" where none does."""
        worst, most = "", 1.0
        for number, link in enumerate(self.structure.links):
            low, high = self.ranges.get(link.name, (0.0, 0.0))
            if high > low:
                middle, half = 0.5 * (low + high), 0.5 * (high - low)
                beyond = float(np.abs(d[:, number] - middle).max() / half)
                worst, most = (link.name, beyond) if beyond > most else (worst, most)
        return worst


def _ranges(folder: Path) -> Ranges:
    """The ranges that the result in a folder states."""
    try:
        links = json.loads((folder / RESULT).read_text(encoding="utf-8"))["links"]
        ranges = {str(link["name"]): link["range"]["d"] for link in links}
        return {name: (float(low), float(high)) for name, (low, high) in ranges.items()}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
