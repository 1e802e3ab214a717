"""SINDy as a method of a study that is judged by its terms: sparse regression on derivatives of the noisy displacements."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Annotated, Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.terms import DEFAULT, parse_terms
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.signals.states import differentiate
from linkwise.sindy.estimate import MAX_UNEXPLAINED
from linkwise.sindy.library import link_columns, monomial_equations
from linkwise.sindy.monomials import tags
from linkwise.sindy.regression import REGRESSORS
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor
from linkwise.study.method import MethodResult, MethodTable, StudyMethod
from linkwise.study.subject import Subject
from linkwise.study.term_judgement import TermJudgement, masses_alone, term_counts
from linkwise.study.true_monomials import true_monomials
from linkwise.verdict import Verdict

Library = Literal["links", "monomials"]


@final
@dataclass(frozen=True)
class SindyMethod(StudyMethod):
    """Sparse regression for the terms themselves, from the displacements and the masses.

    The `library` "links" has one column for each of the `terms` on each link that there may be, which both masses share, as
    `discover` has; "monomials" has all monomials of all states up to `order`, and an equation for each mass. Monomials are not
    read as links, so that their rows have no error of forces. `threshold` is that of the regressor; None where it is chosen on
    rows held out. Raises IdentificationError for an unknown regressor, a threshold of one that has none, and terms that are no
    candidates.
    """

    looks_for_terms: ClassVar[bool] = True

    name: str
    library: Library = "links"
    terms: str = DEFAULT
    order: int = 3
    derivative: Derivative = "spline"
    regressor: str = "stlsq"
    threshold: float | None = None

    def __post_init__(self) -> None:
        self._regressor()
        parse_terms(self.terms)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses = masses_alone(subject, 'methods of the kind "sindy"')
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        if self.library == "links":
            return self._among_links(subject, clean, record, masses)
        return self._among_monomials(subject, record)

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "sindy",
            "library": self.library,
            **({"terms": self.terms} if self.library == "links" else {"order": self.order}),
            "derivative": self.derivative,
            "regressor": self.regressor,
            **({} if self.threshold is None else {"threshold": self.threshold}),
        }

    def _among_links(
        self, subject: Subject, clean: Record, record: Record, masses: dict[str, float | str]
    ) -> MethodResult:
        started = perf_counter()
        full = candidates_for([record], masses, self.terms).full_structure
        fit = self._regressor().fit(link_columns(differentiate(record, self.derivative), full))
        seconds = perf_counter() - started
        support = fit.support[:, 0]
        values = np.where(support, fit.coefficients[:, 0], 0.0)
        structure = full.with_values(dict(zip(fit.names, map(float, values), strict=True)))
        judgement = TermJudgement.of(structure, subject, clean)
        verdict = sindy_verdict(float(fit.residual[0]))
        return MethodResult(
            status=verdict.status,
            seconds=seconds,
            links=judgement.links,
            coefficients={
                name: float(value)
                for name, value, chosen in zip(fit.names, values, support, strict=True)
                if chosen
            },
            reason=verdict.value if verdict.forbids else "",
            terms=judgement.terms,
        )

    def _among_monomials(self, subject: Subject, record: Record) -> MethodResult:
        started = perf_counter()
        states = differentiate(record, self.derivative)
        equations = monomial_equations(states, self.order)
        gram, regressor = Gram.of(equations), self._regressor()
        chosen: set[tuple[str, str]] = set()
        unexplained = 0.0
        for number, target in enumerate(equations.targets):
            if target.endswith("''"):
                scaled = regressor.solve(gram, number)[0]
                chosen |= {(target, gram.names[column]) for column in np.flatnonzero(scaled)}
                squares = gram.sums.squares_at(scaled - gram.anchor[:, number], number)
                unexplained = max(unexplained, np.sqrt(squares) / (gram.norms[number] or 1.0))
        seconds = perf_counter() - started
        named = dict(zip(states.masses, tags(states.masses), strict=True))
        inputs = {(f"x{named[mass]}''", f"f{named[mass]}") for mass in states.driven}
        truth = true_monomials(subject.true_structure) | inputs
        counts = term_counts(truth & chosen, truth - chosen, chosen - truth)
        verdict = sindy_verdict(unexplained)
        reason = verdict.value if verdict.forbids else ""
        return MethodResult(verdict.status, seconds, {}, reason=reason, terms=counts)

    def _regressor(self) -> Regressor:
        regressor = REGRESSORS.lookup(self.regressor)()
        return regressor if self.threshold is None else regressor.with_threshold(self.threshold)


def sindy_verdict(unexplained: float) -> Verdict:
    """What `PhysicsInformedSindy` would say of a fit, by the share of the right-hand side that it leaves."""
    return Verdict.UNEXPLAINED_FORCES if unexplained > MAX_UNEXPLAINED else Verdict.CONVERGED


class SindyTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["sindy"]
    name: str = ""
    library: Library = "links"
    terms: str = DEFAULT
    order: Annotated[int, msgspec.Meta(ge=1)] = 3
    derivative: Derivative = "spline"
    regressor: str = "stlsq"
    threshold: Annotated[float, msgspec.Meta(ge=0, lt=1)] | None = None

    def build(self) -> StudyMethod:
        return SindyMethod(
            self.name or f"sindy, {self.library}",
            self.library,
            self.terms,
            self.order,
            self.derivative,
            self.regressor,
            self.threshold,
        )
