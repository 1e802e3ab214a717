"""What may be wrong on a rig beside noise, tested by its score: zero errors, a delay, and terms that a law lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.prescribed.covariance import newey_west
from linkwise.likelihood.prescribed.fit import RigFit
from linkwise.likelihood.prescribed.records import BASE_CHANNEL, cell_name
from linkwise.model.law import Law

_GAIN = 25.0  # in -2 log likelihood: five standard deviations
_OF_SHIFTS = 16.0 + 2.0 * np.log(
    10.0
)  # of what also moves a coefficient: four deviations, the largest of about ten causes
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
    tested = (*_offsets(fit), *_terms(fit), *_delays(fit))
    follow, beside = _beside_unknowns(fit, np.stack([hypothesis.column for hypothesis in tested], axis=1))
    scores = beside.T @ (fit.weights * fit.residuals)
    powers = np.sum(beside**2, axis=0)
    noise = _noise_of_scores(fit, beside)
    of_laws = np.flatnonzero(fit.free) < len(fit.problem.parameters)
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))[fit.free][of_laws]
    determined = deviations > 0.0
    causes = []
    for number, hypothesis in enumerate(tested):
        power = float(powers[number])
        if not power > _SEPARATE * float(np.sum((fit.weights * hypothesis.column) ** 2)):
            continue
        size = float(scores[number]) / power
        variance = float(noise[number])
        if fit.model_force > 0.0:
            variance = max(variance, power, _scatter(fit, beside[:, number], size))
        gain = float(scores[number]) ** 2 / variance
        shift = float(
            np.max(np.abs(size * follow[of_laws, number][determined]) / deviations[determined], initial=0.0)
        )
        if gain > _GAIN if hypothesis.cause.kind == "offset" else gain > _OF_SHIFTS and shift > _SHIFT:
            unit = float(np.sqrt(np.mean(hypothesis.column**2))) if hypothesis.cause.kind == "term" else 1.0
            error = float(np.sqrt(variance)) / power * unit
            causes.append(
                replace(hypothesis.cause, size=size * unit, gain=gain, standard_error=error, shift=shift)
            )
    return tuple(sorted(causes, key=lambda cause: (cause.where == BASE_CHANNEL) * _ALIKE - cause.gain))


def _beside_unknowns(fit: RigFit, columns: Floats) -> tuple[Floats, Floats]:
    """By how much the free unknowns (f, q) follow causes of unit size, and the weighted forces (R, q) that these leave."""
    weighted = fit.weights[:, None] * fit.problem.jacobian(fit.minimum.paths)[:, fit.free]
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", weighted, weighted)), 1e-300)
    columns = fit.weights[:, None] * columns
    follow = np.linalg.lstsq(weighted / size, columns, rcond=1e-10)[0]
    return follow / size[:, None], columns - weighted / size @ follow


def _noise_of_scores(fit: RigFit, beside: Floats) -> Floats:
    """(q,) variances of scores by white noise of the load cells, and by that of the motion, which smoothing correlates."""
    rows = fit.weights[:, None] * beside
    moved = fit.problem.noise_of_motion(fit.minimum.paths, rows)
    return np.asarray(np.sum((fit.cells[:, None] * rows) ** 2, axis=0) + np.sum(moved**2, axis=0))


def _scatter(fit: RigFit, beside: Floats, size: float) -> float:
    """Variance of a score by what is left with its cause, which follows the motion where laws are inexact."""
    left = fit.weights * fit.residuals - size * beside
    return float(newey_west(fit.problem, (beside * left)[:, None])[0, 0])


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
        for (record, link_of_path, _), path in zip(fit.problem.states, fit.minimum.paths, strict=True):
            motion = fit.problem.records[record].motion
            if link_of_path == link:
                parts.append(-np.gradient(path.force())[:: motion.substeps] / motion.step)
        cause = Cause("delay", cell_name(fit.problem.structure, link), 1.0, "s", 0.0, 0.0)
        yield _Tested(cause, _column(fit, link, parts))


def _motions(fit: RigFit, link: int) -> list[tuple[Floats, Floats]]:
    """Elongation and rate of a link at the samples of each record."""
    return [
        (path.d[:: motion.substeps], path.v[:: motion.substeps])
        for (record, link_of_path, _), path in zip(fit.problem.states, fit.minimum.paths, strict=True)
        for motion in (fit.problem.records[record].motion,)
        if link_of_path == link
    ]


def _column(fit: RigFit, link: int, parts: list[Floats]) -> Floats:
    """(R,) forces of one link in all records among those of all, 0 where a sample is missing."""
    rows, left = [], list(parts)
    for number, (_, link_of_cell, _) in enumerate(fit.problem.states):
        cell = fit.problem.cell(number)
        rows.append(
            np.where(np.isfinite(cell), left.pop(0), 0.0) if link_of_cell == link else np.zeros(len(cell))
        )
    return np.asarray(np.nan_to_num(np.concatenate(rows)))
