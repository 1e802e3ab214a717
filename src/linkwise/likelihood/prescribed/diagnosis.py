"""What may be wrong on a rig beside noise, tested by its score: zero errors, a delay, and terms that a law lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.cause import Cause
from linkwise.likelihood.prescribed.covariance import newey_west
from linkwise.likelihood.prescribed.fit import RigFit
from linkwise.likelihood.prescribed.records import BASE_CHANNEL, cell_name
from linkwise.model.law import Law

_GAIN = 25.0  # in -2 log likelihood: five standard deviations
_OF_SHIFTS = 16.0  # of what also moves a coefficient: four, by chance once in 1300 fits of a dozen causes
_ALIKE = 10.0  # of gain, by which an offset of the displacement must be the better explanation
_SEPARATE = 1e-6  # of the power of a column: less beside the others, and they stand for it
_SHIFT = 3.0  # standard errors by which a term or a delay must move a coefficient to count
_TERMS = ("d", "d**2", "d**3", "d**5", "v", "v*abs(v)", "v**3", "d**2*v")
_SATURATING = 0.1  # of the largest rate, at which the friction that is tested saturates


@dataclass(frozen=True, eq=False)
class _Tested:
    """A cause of unit size, and the forces (R,) in N that it adds."""

    cause: Cause
    column: Floats


def rig_causes(fit: RigFit) -> tuple[Cause, ...]:
    """What would explain a part of the residuals, the largest gain first.

    Offsets of any significant size, and of terms and delays those that would move a coefficient by three standard errors.
    """
    problem = fit.problem
    jacobian = problem.jacobian(fit.minimum.paths)[:, fit.free]
    weights, columns = fit.weights, fit.weights[:, None] * jacobian
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), 1e-300)
    p = len(problem.parameters)
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))[fit.free]
    of_laws = np.flatnonzero(fit.free) < p
    causes = []
    for tested in (*_offsets(fit), *_terms(fit), *_delays(fit)):
        column = weights * tested.column
        follow = np.linalg.lstsq(columns / size, column, rcond=1e-10)[0]
        beside = column - columns / size @ follow
        power = float(beside @ beside)
        if not power > _SEPARATE * float(column @ column):
            continue
        whitened = weights * fit.residuals
        score = float(beside @ whitened)
        rows = (beside * (whitened - score / power * beside))[:, None]  # of what is left with the cause
        variance = max(power, float(newey_west(problem, rows)[0, 0]) if fit.model_force > 0.0 else 0.0)
        gain = score**2 / variance
        moved = np.abs(follow / size * score / power)[of_laws]
        told = deviations[of_laws] > 0.0
        shift = float(np.max(moved[told] / deviations[of_laws][told], initial=0.0))
        if gain > _GAIN if tested.cause.kind == "offset" else gain > _OF_SHIFTS and shift > _SHIFT:
            unit = float(np.sqrt(np.mean(tested.column**2))) if tested.cause.kind == "term" else 1.0
            causes.append(
                replace(
                    tested.cause,
                    size=score / power * unit,
                    gain=gain,
                    standard_error=float(np.sqrt(variance)) / power * unit,
                    shift=shift,
                )
            )
    return tuple(sorted(causes, key=lambda cause: (cause.where == BASE_CHANNEL) * _ALIKE - cause.gain))


def _offsets(fit: RigFit) -> Iterator[_Tested]:
    """Offsets of load cells and of the displacement that are not among the unknowns."""
    problem, p = fit.problem, len(fit.problem.parameters)
    every = replace(problem, cell_offsets=problem.links, motion_offset=True).jacobian(fit.minimum.paths)
    for number, link in enumerate(problem.links):
        if link not in problem.cell_offsets:
            cause = Cause("offset", cell_name(problem.structure, link), 1.0, "N", 0.0, 0.0)
            yield _Tested(cause, every[:, p + number])
    if not problem.motion_offset:
        yield _Tested(Cause("offset", BASE_CHANNEL, 1.0, "m", 0.0, 0.0), every[:, p + len(problem.links)])


def _terms(fit: RigFit) -> Iterator[_Tested]:
    """Forms of force that the law of each link may lack."""
    for link in fit.problem.links:
        motions = _motions(fit, link)
        fastest = max(float(np.abs(v).max()) for _, v in motions)
        for text in (*_TERMS, f"tanh(v/{_SATURATING * fastest!r})" if fastest > 0.0 else "v"):
            law = Law.parse(text)
            with np.errstate(all="ignore"):
                parts = [np.broadcast_to(law.force(d, v, {}), d.shape) for d, v in motions]
            name = "tanh(v)" if text.startswith("tanh") else text
            cause = Cause("term", fit.problem.structure.links[link].name, 1.0, "N", 0.0, 0.0, term=name)
            yield _Tested(cause, _column(fit, link, parts))


def _delays(fit: RigFit) -> Iterator[_Tested]:
    """A delay of each load cell, to first order."""
    for link in fit.problem.links:
        parts = []
        for (record, other, _), path in zip(fit.problem.states, fit.minimum.paths, strict=True):
            motion = fit.problem.records[record].motion
            if other == link:
                parts.append(-np.gradient(path.force())[:: motion.substeps] / motion.step)
        cause = Cause("delay", cell_name(fit.problem.structure, link), 1.0, "s", 0.0, 0.0)
        yield _Tested(cause, _column(fit, link, parts))


def _motions(fit: RigFit, link: int) -> list[tuple[Floats, Floats]]:
    """Elongation and rate of a link at the samples of each record."""
    return [
        (path.d[:: motion.substeps], path.v[:: motion.substeps])
        for (record, other, _), path in zip(fit.problem.states, fit.minimum.paths, strict=True)
        for motion in (fit.problem.records[record].motion,)
        if other == link
    ]


def _column(fit: RigFit, link: int, parts: list[Floats]) -> Floats:
    """(R,) forces of one link in all records among those of all, 0 where a sample is missing."""
    rows, left = [], list(parts)
    for number, (_, other, _) in enumerate(fit.problem.states):
        cell = fit.problem.cell(number)
        rows.append(np.where(np.isfinite(cell), left.pop(0), 0.0) if other == link else np.zeros(len(cell)))
    return np.asarray(np.nan_to_num(np.concatenate(rows)))
