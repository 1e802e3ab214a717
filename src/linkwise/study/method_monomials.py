"""The paper's classical SINDy as a method of a study: all monomials of all states, read for the force of each judged link."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.expression import polynomial
from linkwise.model.link import Link
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
from linkwise.study.method import MethodResult, StudyMethod
from linkwise.study.subject import Subject
from linkwise.verdict import Verdict


@final
@dataclass(frozen=True)
class MonomialMethod(StudyMethod):
    """Noise where the `convention` puts it, all monomials up to `order`, a regressor, and a `reading` of the force.

    `regressor` is a name in `REGRESSORS`; `threshold` is that of "stlsq", None for the one of smallest BIC. Methods that
    differ in regressor or reading share the Gram matrix of a case; its time counts for each of them. Only the equations of
    masses with one link are solved: the others tell no link's force alone. Raises IdentificationError for an unknown
    regressor, and for a threshold of one that has none.
    """

    name: str
    convention: Convention
    regressor: str = "least-squares"
    reading: Reading = "coefficients"
    order: int = 3
    threshold: float | None = None

    def __post_init__(self) -> None:
        self._chosen()

    def answer(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        equations, gram, seconds = _gram(clean, self.convention, snr_db, seed, self.order)
        started = perf_counter()
        fit = _fit(equations, gram, subject.structure, self._chosen())
        seconds += perf_counter() - started
        structure, links, found = subject.structure, {}, {}
        for name in subject.judged_links:
            links[name] = monomial_nmse(fit, structure, name, clean, reading=self.reading)
            d, force = monomial_force(fit, structure, name, clean, reading=self.reading)
            found.update(_coefficients(structure.link(name), d, force))
        return MethodResult(Verdict.CONVERGED.status, seconds, links, found)

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "classical",
            "convention": self.convention,
            "regressor": self.regressor,
            "reading": self.reading,
            "order": self.order,
            **({} if self.threshold is None else {"threshold": self.threshold}),
        }

    def _chosen(self) -> Regressor:
        regressor = REGRESSORS.lookup(self.regressor)()
        return regressor if self.threshold is None else regressor.with_threshold(self.threshold)


@lru_cache(maxsize=1)
def _gram(
    clean: Record, convention: Convention, snr_db: float, seed: int, order: int
) -> tuple[StreamedSystem, Gram, float]:
    """The equations of a case, their Gram matrix and the seconds that it took; the last one is kept."""
    states = noisy_states(clean, convention, snr_db, seed=seed)
    started = perf_counter()
    equations = monomial_equations(states, order)
    gram = Gram.of(equations)
    return equations, gram, perf_counter() - started


def _fit(equations: StreamedSystem, gram: Gram, structure: Structure, regressor: Regressor) -> RegressionFit:
    """The equations of the masses that hold on to one link only. Standard errors, which nobody reads here, are NaN: the
    inverse of a matrix of 1771 columns takes longer than everything else.
    """
    named = dict(zip(structure.mass_names, tags(structure.mass_names), strict=True))
    ends = [end for link in structure.links for end in link.between]
    targets = tuple(f"x{tag}''" for mass, tag in named.items() if ends.count(mass) == 1)
    columns = [equations.targets.index(target) for target in targets]
    scaled = np.zeros((len(gram.names), len(targets)))
    setting = np.zeros(len(targets))
    for place, column in enumerate(columns):
        scaled[:, place], setting[place], _ = regressor.solve(gram, column)
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
    """The coefficients of a polynomial law, those of its stiffness, that come closest to a force (N,) at elongations d (N,);
    none for another law.
    """
    if polynomial(link.law.elastic, ("d",)) is None:
        return {}
    partials = link.law.partials(d, np.zeros_like(d), link.values).by_coefficient
    columns = {name: values for name, values in partials.items() if np.any(values)}
    sizes = [float(np.linalg.norm(values)) for values in columns.values()]
    matrix = np.column_stack([values / size for values, size in zip(columns.values(), sizes, strict=True)])
    solved = np.linalg.lstsq(matrix, force, rcond=None)[0] / sizes
    return {f"{link.name}.{name}": float(value) for name, value in zip(columns, solved, strict=True)}
