"""The methods of a study: the interface, and the methods that identify the coefficients of the links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.estimates.estimate import Estimator
from linkwise.identification.force_error import nmse
from linkwise.identification.identify import IdentificationMethod, identify
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.sindy.estimate import PhysicsInformedSindy
from linkwise.study.subject import Subject


@dataclass(frozen=True)
class MethodResult:
    """The result of one method for one case: its part of a row, with the same fields.

    Attributes
    ----------
    status : str
        The status of the estimate, as in `Row`.
    seconds : float
        Computing time in s.
    links : mapping of str to float
        NMSE of the force in %, by the names of the links that are judged.
    coefficients : mapping of str to float
        Identified values in SI units, by full name, such as "nes1.alpha".
    standard_errors : mapping of str to float
        Their standard errors in SI units; empty where the estimate is not to be trusted.
    reason : str
        Why the estimate is not to be trusted; empty where it is.
    terms : mapping of str to int
        The numbers of "right", "missing" and "extra" terms; empty where the method is told the terms.

    Examples
    --------
    >>> import linkwise as lw
    >>> study = lw.read_study("paper")
    >>> subject, method = study.subjects[0], study.method("weak")
    >>> result = method.evaluate(subject, subject.simulate(), snr_db=40.0, seed=1)
    >>> result.status, sorted(result.coefficients)
    ('converged', ['nes1.alpha', 'nes1.beta', 'nes1.c', 'spring1.c', 'spring1.k'])
    """

    status: str
    seconds: float
    links: Mapping[str, float]
    coefficients: Mapping[str, float] = field(default_factory=dict)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    terms: Mapping[str, int] = field(default_factory=dict)


class StudyMethod(ABC):
    """A method of a study.

    Attributes
    ----------
    name : str
        Its name in the study.
    looks_for_terms : bool
        Whether it is not told the terms, and its answers are judged by them.

    Examples
    --------
    >>> import linkwise as lw
    >>> method = lw.read_study("paper").method("physics-informed")
    >>> isinstance(method, lw.study.StudyMethod), method.document()["kind"]
    (True, 'physics-informed')
    """

    name: str
    looks_for_terms: ClassVar[bool] = False

    @abstractmethod
    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        """Add noise to a record, identify the structure from it, and compare the result with the truth.

        Parameters
        ----------
        subject : Subject
            The structure, with what is measured, unknown and judged.
        clean : Record
            A record of it without noise.
        snr_db : float
            The signal-to-noise ratio in dB of the noise that is added.
        seed : int
            The seed of the noise.

        Returns
        -------
        MethodResult
            Errors of the forces, and the coefficients.

        Raises
        ------
        LinkwiseError
            If nothing can be identified.
        """

    @abstractmethod
    def document(self) -> dict[str, Any]:
        """The table of a study file that defines this method.

        Returns
        -------
        dict
            Plain data, with the keys "name" and "kind" and the options of the method.
        """


class MethodTable(msgspec.Struct, forbid_unknown_fields=True):
    """The table of a kind of method in a study file: its fields are the keys, and `build` makes the method."""

    @abstractmethod
    def build(self) -> StudyMethod:
        """The method. Raises IdentificationError where something in it is unknown."""


@final
@dataclass(frozen=True)
class LinkByLink(StudyMethod):
    """Maximum likelihood or the weak form (METHODS sections 5 and 4)."""

    name: str
    kind: Literal["ml", "weak"]

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, self.kind)

    def document(self) -> dict[str, Any]:
        return {"name": self.name, "kind": self.kind}


class LinkByLinkTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["ml", "weak"]
    name: str = ""

    def build(self) -> StudyMethod:
        return LinkByLink(self.name or self.kind, self.kind)


@final
@dataclass(frozen=True)
class PhysicsInformedMethod(StudyMethod):
    """The paper's physics-informed SINDy: derivatives, the columns of the links' own laws, sparse regression."""

    name: str
    derivative: Derivative = "spline"
    regressor: str = "stlsq"

    def __post_init__(self) -> None:
        PhysicsInformedSindy(self.derivative, self.regressor)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, PhysicsInformedSindy(self.derivative, self.regressor))

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "physics-informed",
            "derivative": self.derivative,
            "regressor": self.regressor,
        }


class PhysicsInformedTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["physics-informed"]
    name: str = ""
    derivative: Literal["spline", "savgol", "differences"] = "spline"
    regressor: str = "stlsq"

    def build(self) -> StudyMethod:
        return PhysicsInformedMethod(self.name or self.kind, self.derivative, self.regressor)


def _identify(
    subject: Subject,
    clean: Record,
    snr_db: float,
    seed: int,
    estimator: IdentificationMethod | Estimator,
) -> MethodResult:
    record = subject.measured(clean).with_noise(snr_db, seed=seed)
    estimate = identify(record, subject.stated_structure(seed), method=estimator)
    names = [parameter.name for parameter in estimate.parameters]
    errors = np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0)) if estimate.trusted else ()
    return MethodResult(
        status=estimate.status,
        seconds=estimate.seconds,
        links={
            name: nmse(subject.true_structure.link(name), estimate.structure.link(name), clean)
            for name in subject.judged_links
        },
        coefficients=dict(zip(names, map(float, estimate.values), strict=True)),
        standard_errors=dict(zip(names, map(float, errors), strict=False)),
        reason="" if estimate.trusted else estimate.explanation,
    )
