"""What one case of a study is, and the row that it leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median

FAILED = "failed"  # the status of a row without an answer
DIED = "its worker process died "  # how the reason begins where workers were killed, ran out of memory, or crashed
FAULT = "this is a fault of linkwise: "  # how the reason begins where linkwise, not the case, is to blame


@dataclass(frozen=True, order=True)
class Case:
    """One run: `structure` and `method` by name, noise in dB, the seed of the noise."""

    structure: str
    snr_db: float
    method: str
    seed: int

    def __str__(self) -> str:
        return f"{self.structure}, {self.snr_db:g} dB, {self.method}, seed {self.seed}"


@dataclass(frozen=True)
class Row:
    """What came of one case; equal whoever ran it, and in whatever order, but for its `seconds`, on processors of one kind
    (two kinds round differently, and follow different orbits of a chaotic motion past its horizon).

    `links` holds the NMSE in % (paper Eq. 8) of every judged link; `coefficients` and `standard_errors` what was found, by
    full name, in SI units, where the method has such. `status` is that of the estimate ("converged", "not converged",
    "chi-square off", "forces unexplained"), or "failed": then there are no figures and `reason` says why. `seconds` is the
    time of the estimate alone, without simulation and noise; `masses` counts them.
    """

    structure: str
    masses: int
    snr_db: float
    method: str
    seed: int
    status: str
    links: Mapping[str, float] = field(default_factory=dict)
    coefficients: Mapping[str, float] = field(default_factory=dict)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)
    reason: str = ""

    @property
    def case(self) -> Case:
        """The case that this row is of."""
        return Case(self.structure, self.snr_db, self.method, self.seed)

    @property
    def failed(self) -> bool:
        """Whether there is no answer."""
        return self.status == FAILED

    @property
    def nmse(self) -> float | None:
        """The median of `links` in %: what a table of the study counts; None where the case failed."""
        return median(self.links.values()) if self.links else None

    @property
    def worst(self) -> float | None:
        """The largest of `links` in %."""
        return max(self.links.values(), default=None)
