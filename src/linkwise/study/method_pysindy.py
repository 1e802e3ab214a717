"""PySINDy itself as a method of a study that is judged by its terms; it needs the extra [peers]."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib import import_module
from time import perf_counter
from typing import Annotated, Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.errors import IdentificationError
from linkwise.records.record import Record
from linkwise.sindy.monomials import Monomials, tags
from linkwise.study.method import MethodResult, MethodTable, StudyMethod
from linkwise.study.method_sindy import sindy_verdict
from linkwise.study.subject import Subject
from linkwise.study.term_judgement import masses_alone, term_counts
from linkwise.study.true_monomials import true_monomials

_KIND = 'methods of the kind "pysindy"'
_RIDGE = 1e-6  # its own, 0.05, would bend columns of norm 1


@final
@dataclass(frozen=True)
class PySindyMethod(StudyMethod):
    """An equation for each mass in all monomials of all states up to `order`, by PySINDy.

    Velocities and accelerations are its smoothed differences over `window` samples, states are scaled to a standard deviation
    of 1 and columns and accelerations to a norm of 1, so that its `threshold` is a share of the right-hand side, which is how
    its users make a threshold mean the same in every equation. Threshold and window are by default those of PySINDy.
    """

    looks_for_terms: ClassVar[bool] = True

    name: str
    order: int = 3
    threshold: float = 0.1
    window: int = 11

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses_alone(subject, _KIND)
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        if record.inputs:
            raise IdentificationError(
                f'{_KIND} take no inputs, and the record has {", ".join(record.inputs)}; use the kind "sindy"'
            )
        if len(record) <= self.window:
            raise IdentificationError(
                f"{len(record)} samples are too few for smoothed differences over {self.window}"
            )
        library = _pysindy()
        masses, started = subject.true_structure.mass_names, perf_counter()
        tagged = tags(masses)
        smooth = library.SmoothedFiniteDifference(
            smoother_kws={"window_length": self.window, "polyorder": min(3, self.window - 1)}
        )
        x = np.column_stack([record.channel(f"x:{mass}") for mass in masses])
        v = np.asarray(smooth(x, record.step))
        a = np.asarray(smooth(v, record.step))
        names = Monomials(tuple(f"{kind}{tag}" for tag in tagged for kind in "xv"), self.order).names
        states = np.stack([x, v], axis=2).reshape(len(x), -1)
        with warnings.catch_warnings():  # where nothing is left of an equation it warns and goes on
            warnings.simplefilter("ignore")
            columns = np.asarray(
                library.PolynomialLibrary(degree=self.order).fit_transform(states / np.std(states, axis=0))
            )
            targets = a / np.linalg.norm(a, axis=0)
            optimizer = library.STLSQ(threshold=self.threshold, alpha=_RIDGE, normalize_columns=True)
            optimizer.fit(columns, targets)
        left = np.linalg.norm(targets - columns @ optimizer.coef_.T, axis=0)
        seconds = perf_counter() - started
        chosen = {
            (f"x{tag}''", names[column])
            for tag, equation in zip(tagged, optimizer.coef_, strict=True)
            for column in np.flatnonzero(equation)
        }
        truth = true_monomials(subject.true_structure)
        verdict = sindy_verdict(float(left.max()))
        return MethodResult(
            verdict.status,
            seconds,
            {},
            reason=verdict.value if verdict.forbids else "",
            terms=term_counts(truth & chosen, truth - chosen, chosen - truth),
        )

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "kind": "pysindy",
            "order": self.order,
            "threshold": self.threshold,
            "window": self.window,
        }


class PySindyTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["pysindy"]
    name: str = ""
    order: Annotated[int, msgspec.Meta(ge=1)] = 3
    threshold: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.1
    window: Annotated[int, msgspec.Meta(ge=3)] = 11

    def build(self) -> StudyMethod:
        return PySindyMethod(self.name or self.kind, self.order, self.threshold, self.window)


def _pysindy() -> Any:
    try:
        return import_module("pysindy")
    except ModuleNotFoundError as error:
        raise IdentificationError(
            f"{_KIND} need the library pysindy; install it with pip install 'linkwise[peers]'"
        ) from error
