"""What one case of a study is, and the row that it leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median

FAILED = "failed"  # the status of a row without an answer
INTERNAL_ERROR = "internal error"  # the same, if the fault is linkwise's and not the case's
WORKER_DIED = "worker died"  # the same, if worker processes were killed, ran out of memory, or crashed
REPEATED = (INTERNAL_ERROR, WORKER_DIED)  # the cases of such rows are run again


@dataclass(frozen=True, order=True)
class Case:
    """One run of a study.

    Attributes
    ----------
    structure, method : str
        Names of the structure and the method.
    snr_db : float
        The signal-to-noise ratio in dB.
    seed : int
        The seed of the noise.

    Examples
    --------
    >>> import linkwise as lw
    >>> print(next(lw.study.read_study("paper").cases()))
    2 masses, 40 dB, classical, displacement, seed 1000
    """

    structure: str
    snr_db: float
    method: str
    seed: int

    @property
    def cell(self) -> tuple[str, float, str]:
        """Structure, noise level and method: what cases of several seeds share."""
        return self.structure, self.snr_db, self.method

    def __str__(self) -> str:
        return f"{self.structure}, {self.snr_db:g} dB, {self.method}, seed {self.seed}"


@dataclass(frozen=True, kw_only=True)
class MethodResult:
    """The result of one method for one case: the part of its row that a method answers for.

    Attributes
    ----------
    status : str
        The status of the estimate ("converged", "not converged", "chi-square off", "forces unexplained"); of rows also
        "failed" without one, "internal error" or "worker died".
    seconds : float
        Time of the estimate in s, without simulation and noise.
    links : mapping of str to float
        The NMSE in % (paper Eq. 8) of the force of each judged link.
    coefficients, standard_errors : mapping of str to float
        The identified coefficients by full name, in SI units, and their standard errors, if the method has such;
        none where the estimate is not to be trusted.
    reason : str
        Why there is no answer, or none to be trusted.
    terms : mapping of str to int
        How many terms of the answer are "right", and how many "missing" and "extra", of a method that looks for terms; empty
        for one that is told them.

    Examples
    --------
    >>> import linkwise as lw
    >>> study = lw.study.read_study("paper")
    >>> subject, method = study.subjects[0], study.method("weak")
    >>> result = method.evaluate(subject, subject.simulate(), snr_db=40.0, seed=1)
    >>> result.status, sorted(result.coefficients)
    ('converged', ['nes1.alpha', 'nes1.beta', 'nes1.c', 'spring1.c', 'spring1.k'])
    """

    status: str
    links: Mapping[str, float] = field(default_factory=dict)
    coefficients: Mapping[str, float] = field(default_factory=dict)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)
    reason: str = ""
    terms: Mapping[str, int] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether there is no answer."""
        return self.status in (FAILED, *REPEATED)

    @property
    def exact(self) -> bool | None:
        """Whether no term is missing and none is extra; None where terms are not looked for, or there is no answer."""
        return not (self.terms["missing"] or self.terms["extra"]) if self.terms else None

    @property
    def nmse(self) -> float | None:
        """The median of `links` in %, which tables of the study show; None if the case failed."""
        return median(self.links.values()) if self.links else None

    @property
    def worst(self) -> float | None:
        """The largest of `links` in %; None if the case failed."""
        return max(self.links.values(), default=None)


@dataclass(frozen=True)
class Row(MethodResult):
    """The outcome of one case of a study: which case it is, and the result of its method.

    Rows of one case are equal, except for `seconds`, whichever worker ran it and in whatever order, on processors of one
    kind. Two kinds round differently, and follow different orbits of a chaotic motion past its horizon.

    Attributes
    ----------
    structure, method : str
        Names of the structure and the method.
    masses : int
        The number of masses.
    snr_db : float
        The signal-to-noise ratio in dB.
    seed : int
        The seed of the noise.
    status, links, coefficients, standard_errors, seconds, reason, terms
        As in `MethodResult`.

    Examples
    --------
    >>> import linkwise as lw
    >>> row = lw.study.Row("bnes-2", 2, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.2, "nes2": 0.4})
    >>> row.nmse, row.failed
    (0.30000000000000004, False)
    """

    structure: str
    masses: int
    snr_db: float
    method: str
    seed: int

    @property
    def case(self) -> Case:
        """The case of this row."""
        return Case(self.structure, self.snr_db, self.method, self.seed)
