"""The paper's monomial SINDy as a method of a study: all monomials of all states, read as the force of each judged link."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Annotated, Any, Literal, final

import msgspec
import numpy as np

from linkwise.arrays import Floats
from linkwise.expression import polynomial
from linkwise.model.host_support import refuse_hosts
from linkwise.model.link import Link
from linkwise.model.memory_support import refuse_memory
from linkwise.model.rig_support import refuse_rig
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.sindy.conventions import Convention, noisy_states
from linkwise.sindy.force_reading import Reading, monomial_force, monomial_nmse
from linkwise.sindy.library import monomial_equations
from linkwise.sindy.monomials import tags
from linkwise.sindy.regression import REGRESSORS
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.linear_system import StreamedSystem
from linkwise.sindy.regression.regressor import RegressionFit, Regressor
from linkwise.study.method import MethodResult, MethodTable, StudyMethod
from linkwise.study.subject import Subject
from linkwise.verdict import Verdict


@final
@dataclass(frozen=True)
class MonomialMethod(StudyMethod):
    """Noise added as the `convention` says, all monomials up to `order`, a regressor, and a `reading` of the force.

    `regressor` is a name in `REGRESSORS`; `threshold` is that of "stlsq", None for the one of smallest BIC. Methods that
    differ in regressor or reading share the Gram matrix of a case; its time counts for each of them. Only the equations of
    masses with a single link are solved: others do not separate the forces of links. Raises IdentificationError for an unknown
    regressor, and for a threshold of one that has none.
    """

    name: str
    convention: Convention
    regressor: str = "least-squares"
    reading: Reading = "coefficients"
    order: int = 3
    threshold: float | None = None

    def __post_init__(self) -> None:
        self._regressor()

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        refuse_rig(subject.structure, 'methods of the kind "monomial"')
        refuse_memory(
            subject.structure.links, 'methods of the kind "monomial"', "maximum likelihood takes it"
        )
        refuse_hosts(subject.structure, 'methods of the kind "monomial"')
        equations, gram, seconds = _gram(clean, self.convention, snr_db, seed, self.order)
        started = perf_counter()
        fit = _fit(equations, gram, subject.structure, self._regressor())
        seconds += perf_counter() - started
        structure, links, coefficients = subject.structure, {}, {}
        for name in subject.judged_links:
            links[name] = monomial_nmse(fit, structure, name, clean, reading=self.reading)
            d, force = monomial_force(fit, structure, name, clean, reading=self.reading)
            coefficients.update(_coefficients(structure.link(name), d, force))
        return MethodResult(Verdict.CONVERGED.status, seconds, links, coefficients)

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "monomial",
            "convention": self.convention,
            "regressor": self.regressor,
            "reading": self.reading,
            "order": self.order,
            **({} if self.threshold is None else {"threshold": self.threshold}),
        }

    def _regressor(self) -> Regressor:
        regressor = REGRESSORS.lookup(self.regressor)()
        return regressor if self.threshold is None else regressor.with_threshold(self.threshold)


class MonomialTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["monomial", "classical"]  # "classical" is the old spelling
    convention: Convention
    name: str = ""
    regressor: str = "least-squares"
    reading: Reading = "coefficients"
    order: Annotated[int, msgspec.Meta(ge=1)] = 3
    threshold: Annotated[float, msgspec.Meta(ge=0, lt=1)] | None = None

    def build(self) -> StudyMethod:
        name = self.name or f"{self.kind}, {self.convention}"
        return MonomialMethod(name, self.convention, self.regressor, self.reading, self.order, self.threshold)


@lru_cache(maxsize=1)
def _gram(
    clean: Record, convention: Convention, snr_db: float, seed: int, order: int
) -> tuple[StreamedSystem, Gram, float]:
    """The equations of a case, their Gram matrix and the time in s that it took; the last one is cached."""
    states = noisy_states(clean, convention, snr_db, seed=seed)
    started = perf_counter()
    equations = monomial_equations(states, order)
    gram = Gram.of(equations)
    return equations, gram, perf_counter() - started


def _fit(equations: StreamedSystem, gram: Gram, structure: Structure, regressor: Regressor) -> RegressionFit:
    """Solve the equations of the masses with a single link.

    Standard errors, which are not used here, are NaN: the inverse of a matrix of 1771 columns takes longer than all else.
    """
    named = dict(zip(structure.mass_names, tags(structure.mass_names), strict=True))
    ends = [end for link in structure.links for end in link.between]
    targets = tuple(f"x{tag}''" for mass, tag in named.items() if ends.count(mass) == 1)
    columns = [equations.targets.index(target) for target in targets]
    scaled = np.zeros((len(gram.names), len(targets)))
    setting = np.zeros(len(targets))
    for number, column in enumerate(columns):
        scaled[:, number], setting[number], _ = regressor.solve(gram, column)
    norms = np.where(gram.norms[columns] > 0, gram.norms[columns], 1.0)
    return RegressionFit(
        names=gram.names,
        units=equations.units,
        targets=targets,
        coefficients=gram.unscaled(scaled),
        support=scaled != 0,
        standard_error=np.full_like(scaled, np.nan),
        contribution=np.abs(scaled) / norms,
        residual=np.full(len(targets), np.nan),
        setting=setting,
        paths=(),
    )


def _coefficients(link: Link, d: Floats, force: Floats) -> dict[str, float]:
    """The stiffness coefficients of a polynomial law that fit a force (N,) N at elongations `d` (N,) m.

    None for another law.
    """
    if polynomial(link.law.elastic, ("d",)) is None:
        return {}
    partials = link.law.partials(d, np.zeros_like(d), link.values).by_coefficient
    columns = {name: values for name, values in partials.items() if np.any(values)}
    sizes = [float(np.linalg.norm(values)) for values in columns.values()]
    matrix = np.column_stack([values / size for values, size in zip(columns.values(), sizes, strict=True)])
    solved = np.linalg.lstsq(matrix, force, rcond=None)[0] / sizes
    return {f"{link.name}.{name}": float(value) for name, value in zip(columns, solved, strict=True)}
