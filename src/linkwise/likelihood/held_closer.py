"""What a model error or noise of an input hides: a missing term that explains most of what is left without it.

A model error lets the motion forget, and with it what a small term does over many periods: a score test beside the model error
is silent on friction that would change a damping by ten standard errors. Held ten times closer, the laws leave more than that.
Where one term would explain most of that, they lack it; an error that is random leaves what no term explains. Noise of an
input lets the motion forget likewise, and is found where there is none; the motion is held closer with a tenth of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.expression import symbols
from linkwise.likelihood.diagnosis import diagnose
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.long_records import held_at, is_long
from linkwise.likelihood.marginal import relaxation
from linkwise.likelihood.memory_forces import MEMORY_TERMS
from linkwise.likelihood.shooting.anneal import (
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    anneal,
)
from linkwise.model.law import Law
from linkwise.model.parameters import MASS
from linkwise.model.structure import Structure

_CLOSER = (0.1, 0.3)  # times the relaxation that stands for the model error, or the noise of inputs
_CLOSER_IF_LONG = (
    0.3,
)  # the same of long records, which were not held more closely because no search leads straight there
_STEPS = 40
_MOST = 0.5  # of what is left there


@dataclass(frozen=True)
class HiddenTerm:
    """The `cause`, and by how much of its value the term would change the coefficient that it changes most: `change`.

    `shift` is the same in standard errors of the fit, and `held` the fit that is held closer.
    """

    cause: Cause
    change: float
    shift: float
    closer_fit: LikelihoodFit

    @property
    def dissipates(self) -> bool:
        """Whether it depends on the rate, or on its past; an error of a mass is a force of inertia."""
        return self.cause.kind != MASS and self._depends_on_rate

    @property
    def _depends_on_rate(self) -> bool:
        return self.cause.term in MEMORY_TERMS or "v" in symbols(Law.parse(f"a*{self.cause.term}").expression)


def hidden_term(fit: LikelihoodFit, identified: Structure, channels: Sequence[str]) -> HiddenTerm | None:
    """The missing term, or error of a mass, that explains most of what the laws leave where the motion is held closer to them.

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
    HiddenTerm or None
        The term, or the mass; None where there is none, or the motion cannot be held closer.
    """
    optimum = fit.optimum
    exact = not fit.random_forces and optimum.q <= AnnealingSchedule.final_q
    if exact or optimum.coloured is not None or any(force.ambient for force in fit.random_forces):
        return None
    for factor in _CLOSER_IF_LONG if is_long(optimum.segments) else _CLOSER:
        tight = _tightened(optimum, factor)
        closer = _searched_closer(tight)
        if closer is None:
            continue
        if closer.status is AnnealingStatus.INTERRUPTED:
            return None
        if closer.status is AnnealingStatus.CONVERGED:
            return _explaining(fit, closer, tight, (identified, channels))
    return None


def _tightened(optimum: Optimum, factor: float) -> Optimum:
    """From where the motion is to be held closer: with the relaxation, or the noise of inputs, times a factor."""
    segments, random = optimum.segments, optimum.segments.random
    if random is None:
        return replace(optimum, q=max(factor * optimum.q, AnnealingSchedule.final_q))
    quieter = replace(random.scaled(np.full(len(random.rows), factor)), slope=None, origin=None)
    segments = replace(segments, random=quieter)
    return replace(optimum, segments=segments, q=relaxation(segments, optimum.scales, optimum.point))


def _searched_closer(tight: Optimum) -> AnnealingFit | None:
    """The search from where the motion is to be held closer; None where one in pieces does not lead to an optimum."""
    if is_long(tight.segments):
        return held_at(tight.segments, tight.point, tight.scales, tight.loss, tight.q)
    schedule = AnnealingSchedule(initial_q=tight.q, final_q=tight.q, max_steps=_STEPS)
    return anneal(tight.segments, tight.point, tight.scales, schedule, loss=tight.loss)


def _explaining(
    fit: LikelihoodFit,
    closer: AnnealingFit,
    tight: Optimum,
    structure_and_channels: tuple[Structure, Sequence[str]],
) -> HiddenTerm | None:
    """The term that explains most of what a fit leaves that is held `closer` than `fit`, by the equations of `tight`.

    `structure_and_channels` are the structure with the values of the fit, and the channels.
    """
    optimum, p = fit.optimum, len(fit.values)
    identified, channels = structure_and_channels
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
    causes = diagnose(closer_fit, closer_structure, channels, terms=True).causes
    if not causes or causes[0].kind not in ("term", MASS) or not causes[0].gain > _MOST * left:
        return None
    change, shift = 0.0, 0.0
    if causes[0].shifted:
        number = names.index(causes[0].shifted)
        error = float(np.sqrt(closer_fit.covariance[number, number]))
        changed, tiny = causes[0].shift * error, np.finfo(float).tiny
        change = changed / max(abs(float(fit.values[number])), tiny)
        shift = changed / max(float(np.sqrt(fit.covariance[number, number])), tiny)
    return HiddenTerm(causes[0], change, shift, closer_fit)
