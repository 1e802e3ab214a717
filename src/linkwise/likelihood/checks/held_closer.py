"""What a model error or noise of an input hides: a missing term that explains most of what is left without it, or a change.

A model error lets the motion forget, and with it what a small term does over many periods: a score test beside the model error
is silent on friction that would change a damping by ten standard errors. Held ten times closer, the laws leave more than that.
Where one term would explain most of that, they lack it, and where a change of one coefficient would, it changes; an error
that is random leaves what neither explains. Noise of an input lets the motion forget likewise, and is found where there is
none; the motion is held closer with a tenth of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.expression import symbols
from linkwise.likelihood.checks.horizons import optimum_at
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.marginal import is_long, relaxation
from linkwise.likelihood.shooting.minimise import AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.tests.diagnosis import Diagnosis, diagnose
from linkwise.likelihood.tests.score_test import MEMORY_TERMS
from linkwise.model.coefficient import MASS
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel

_CLOSER = (0.1, 0.3)  # times the relaxation that stands for the model error, or the noise of inputs
_CLOSER_IF_LONG = (
    0.3,
)  # the same of long records, which were not held more closely because no search leads straight there
_STEPS = 40
_MOST = 0.5  # of what is left there


@dataclass(frozen=True, eq=False)
class CloserFit:
    """A `fit` whose motion is held closer to the laws than another: by how much more it leaves in -2 log likelihood, `left`,
    and the `diagnosis` of that.
    """

    fit: LikelihoodFit
    left: float
    diagnosis: Diagnosis

    def explains_most(self, gain: float) -> bool:
        """Whether what lowers -2 log likelihood by a `gain` explains most of what is left."""
        return gain > _MOST * self.left


def held_closer(fit: LikelihoodFit, identified: Structure, channels: Sequence[Channel]) -> CloserFit | None:
    """The fit with its motion held closer to the laws, and what explains what they leave there.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit with a model error, with noise of inputs, or whose links between segments were loosened.
    identified : Structure
        The structure with the values of the fit.
    channels : sequence of str
        The channels of the record.

    Returns
    -------
    CloserFit or None
        The closer fit; None where the motion cannot be held closer.
    """
    optimum = fit.optimum
    exact = not fit.random_forces and optimum.q <= AnnealingSchedule.final_q
    if exact or optimum.coloured is not None or any(force.ambient for force in fit.random_forces):
        return None
    for factor in _CLOSER_IF_LONG if is_long(optimum.segments) else _CLOSER:
        tight = _tightened(optimum, factor)
        closer = optimum_at(tight, tight.q, _STEPS)
        if closer.status is AnnealingStatus.INTERRUPTED:
            return None
        if closer.status is AnnealingStatus.CONVERGED:
            return _diagnosed(fit, closer, tight, identified, channels)
    return None


def _tightened(optimum: Optimum, factor: float) -> Optimum:
    """From where the motion is to be held closer: with the relaxation, or the noise of inputs, times a factor."""
    segments, random = optimum.segments, optimum.segments.random
    if random is None:
        return replace(optimum, q=max(factor * optimum.q, AnnealingSchedule.final_q))
    quieter = replace(random.scaled(np.full(len(random.rows), factor)), slope=None, origin=None)
    segments = replace(segments, random=quieter)
    return replace(optimum, segments=segments, q=relaxation(segments, optimum.scales, optimum.point))


def _diagnosed(
    fit: LikelihoodFit,
    closer: AnnealingFit,
    tight: Optimum,
    identified: Structure,
    channels: Sequence[Channel],
) -> CloserFit | None:
    """A search by the equations of `tight`, whose end is `closer`, with what explains what it leaves; None where that is not
    finite. The structure is `identified` with the values of the fit.
    """
    optimum, p = fit.optimum, len(fit.values)
    closer_fit = replace(
        fit,
        values=closer.point.theta,
        covariance=optimum.noise**2 * closer.covariance[:p, :p],
        free=~closer.at_bound[:p],
        misfit=closer.misfit,
        segments=tight.segments,
        optimum=replace(tight, point=closer.point, q=closer.q),
    )
    names = fit.segments.system.parameters.names
    closer_structure = identified.with_values(dict(zip(names, map(float, closer.point.theta), strict=True)))
    left = (closer.misfit.cost(closer.q) - fit.misfit.cost(optimum.q)) / optimum.noise**2
    if not np.isfinite(left):
        return None
    return CloserFit(closer_fit, left, diagnose(closer_fit, closer_structure, channels, terms=True))


def hidden_term(fit: LikelihoodFit, closer: CloserFit) -> tuple[Cause, float, float] | None:
    """The missing term, or error of a mass, that explains most of what the laws leave in a fit held `closer` than `fit`.

    With that by how much of its value it would change the coefficient that it changes most, and in standard errors of `fit`.
    """
    causes = closer.diagnosis.causes
    if not causes or causes[0].kind not in ("term", MASS) or not closer.explains_most(causes[0].gain):
        return None
    change, shift = 0.0, 0.0
    if causes[0].shifted:
        number = fit.segments.system.parameters.names.index(causes[0].shifted)
        error = float(np.sqrt(closer.fit.covariance[number, number]))
        changed, tiny = causes[0].shift * error, np.finfo(float).tiny
        change = changed / max(abs(float(fit.values[number])), tiny)
        shift = changed / max(float(np.sqrt(fit.covariance[number, number])), tiny)
    return causes[0], change, shift


def dissipates(term: str) -> bool:
    """Whether a missing term is a force that depends on the rate, or on its past."""
    return term in MEMORY_TERMS or (bool(term) and "v" in symbols(Law.parse(f"a*{term}").expression))
