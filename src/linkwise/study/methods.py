"""The methods of a study: those that identify the coefficients of links, and discovery; sparse regression that looks for
terms is in `sindy_methods`.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.discovery.candidates import DiscoveryOptions
from linkwise.discovery.discover import discover
from linkwise.discovery.terms import DEFAULT
from linkwise.estimates.estimate import Estimator
from linkwise.estimates.scoring import align_truth, term_score
from linkwise.identification.identify import IdentificationMethod, identify, nmse
from linkwise.model.law import Law
from linkwise.model.link import LENGTH, Link, refuse_memory
from linkwise.model.structure import Structure, refuse_hosts, refuse_rig
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.sindy.estimate import PhysicsInformedSindy
from linkwise.study.subject import MethodResult, Subject
from linkwise.verdict import Grade, status_of


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
    errors = np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0)).tolist()
    true, found = subject.true_structure, estimate.structure
    return MethodResult(
        status=estimate.status,
        seconds=estimate.seconds,
        links={name: nmse(true.link(name), found.link(name), clean) for name in subject.judged_links},
        coefficients=dict(zip(names, map(float, estimate.values), strict=True)),
        standard_errors={} if estimate.grade is Grade.REFUSED else dict(zip(names, errors, strict=False)),
        reason="" if estimate.trusted else estimate.explanation,
    )


_NO_FORCE = Law.parse("0")


def judged(structure: Structure, subject: Subject, clean: Record) -> tuple[dict[str, float], dict[str, int]]:
    """The errors of links in % and the numbers of terms of a structure, every coefficient a number, against the true one
    along its motion `clean`.

    The NMSE of a true link is that of the link between the same ends, 100 % and more where there is none.
    """
    truth = subject.true_structure
    score = term_score(structure, truth)
    aligned, links = align_truth(structure, truth), {}
    found = {frozenset(link.between): link for link in reversed(structure.links)}
    for name in subject.judged_links:
        true = truth.link(name)
        link = found.get(frozenset(true.between))
        true = true if link is None else aligned.link(link.name)
        links[name] = nmse(true, link or Link(name, true.between, _NO_FORCE, {}), clean)
    return links, {name: len(getattr(score, name)) for name in ("right", "missing", "extra")}


def masses_alone(subject: Subject, method: str) -> dict[str, float | str]:
    """The masses by name, in kg or, of what turns, with their unit: all that a `method` that looks for links is told.

    Raises IdentificationError for a structure of another kind than masses on links.
    """
    structure = subject.true_structure
    refuse_rig(structure, method)
    refuse_memory(structure.links, method, "maximum likelihood takes it")
    refuse_hosts(structure, method)
    values = zip(structure.masses, structure.mass_values.tolist(), strict=True)
    return {m.name: value if m.unit == LENGTH else f"{value!r} {m.mass_unit}" for m, value in values}


@final
class DiscoveryMethod(StudyMethod, frozen=True):
    """`discover` with candidate `terms` on every link (METHODS section 9).

    It is told the masses and nothing of links; what is `unknown` of a structure does not matter. Coefficients of its rows are
    those of the discovered structure, by its own names. Raises IdentificationError for terms that are no candidates.
    """

    looks_for_terms: ClassVar[bool] = True

    terms: str = DEFAULT
    kind: Literal["discover"] = "discover"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        DiscoveryOptions(terms=self.terms)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses = masses_alone(subject, 'methods of the kind "discover"')
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        discovery = discover(record, masses, terms=self.terms)
        links, terms = judged(discovery.structure, subject, clean)
        values = [(link.name, *entry) for link in discovery.structure.links for entry in link.values.items()]
        return MethodResult(
            status=status_of(discovery.verdicts),
            seconds=discovery.seconds,
            links=links,
            coefficients={f"{link}.{name}": float(value) for link, name, value in values},
            reason=next((verdict.value for verdict in discovery.verdicts if verdict.forbids), ""),
            terms=terms,
        )
