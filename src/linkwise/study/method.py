"""The methods of a study: the interface, and the methods that identify the coefficients of the links."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.estimates.estimate import Estimator
from linkwise.identification.identify import IdentificationMethod, identify, nmse
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.sindy.estimate import PhysicsInformedSindy
from linkwise.study.row import MethodResult
from linkwise.study.subject import Subject
from linkwise.verdict import Grade


class StudyMethod(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A method of a study; its fields are the keys of its table in a study file.

    Attributes
    ----------
    name : str
        Its name in the study; by default the kind of method.
    looks_for_terms : bool
        Whether it is not told the terms, and its answers are judged by them.

    Examples
    --------
    >>> import linkwise as lw
    >>> method = lw.study.read_study("paper").method("physics-informed")
    >>> isinstance(method, lw.study.StudyMethod), method.document()["kind"]
    (True, 'physics-informed')
    """

    name: str = ""
    looks_for_terms: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not self.name:
            msgspec.structs.force_setattr(self, "name", self.usual_name)

    @property
    def usual_name(self) -> str:
        """The name where none is given."""
        return str(getattr(self, "kind", type(self).__name__))

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

    def document(self) -> dict[str, Any]:
        """The table of a study file that defines this method.

        Returns
        -------
        dict
            Plain data, with the keys "name" and "kind" and the options of the method.
        """
        return {key: value for key, value in msgspec.to_builtins(self).items() if value is not None}


@final
class LinkByLink(StudyMethod, frozen=True, kw_only=True):
    """Maximum likelihood or the weak form (METHODS sections 5 and 4)."""

    kind: Literal["ml", "weak"]

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, self.kind)


@final
class PhysicsInformedMethod(StudyMethod, frozen=True):
    """The paper's physics-informed SINDy: derivatives, the columns of the links' own laws, sparse regression."""

    derivative: Derivative = "spline"
    regressor: str = "stlsq"
    kind: Literal["physics-informed"] = "physics-informed"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        PhysicsInformedSindy(self.derivative, self.regressor)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, PhysicsInformedSindy(self.derivative, self.regressor))


def _identify(
    subject: Subject, clean: Record, snr_db: float, seed: int, estimator: IdentificationMethod | Estimator
) -> MethodResult:
    record = subject.measured(clean).with_noise(snr_db, seed=seed)
    estimate = identify(record, subject.stated_structure(seed), method=estimator)
    names = [parameter.name for parameter in estimate.parameters]
    errors = np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0))
    if estimate.grade is Grade.REFUSED:
        errors = errors[:0]
    true, found = subject.true_structure, estimate.structure
    return MethodResult(
        status=estimate.status,
        seconds=estimate.seconds,
        links={name: nmse(true.link(name), found.link(name), clean) for name in subject.judged_links},
        coefficients=dict(zip(names, map(float, estimate.values), strict=True)),
        standard_errors=dict(zip(names, map(float, errors), strict=False)),
        reason="" if estimate.trusted else estimate.explanation,
    )
