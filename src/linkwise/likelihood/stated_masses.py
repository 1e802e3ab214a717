"""Stated masses that may be off: where their scores make an answer doubtful, and what intervals hold of it.

Coefficients make up for nearly all of an error of a mass: with them, it scales all forces on it, and no more than the reaction
on its neighbours tells. Its score may then be too small to be significant among all that is tested, while coefficients are
dozens of standard errors off. There are few masses, so that a smaller score than among all causes says something. Where it
does not, the intervals hold what every mass to which it points would make of the coefficients, alone: masses look alike, as
one that is too heavy and another that is too light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.hypotheses import Hypothesis
from linkwise.likelihood.single_tests import SingleTests
from linkwise.model.names import MASS

LARGEST = 0.2  # relative error up to which the first order describes a gain or a mass; more is no error of a calibration

_CHANCE = 12.0  # with twice the logarithm of the number of masses: normal scores give one in 2000 fits
_HINT = 6.25  # the same: one in 80, as of usual terms
_AS_LIKELY = 0.5  # of the largest gain: another mass that gains more may be the one that is off
_FELT = 1.0  # standard errors: the least change of a coefficient of which something is said


class TestedMasses(Protocol):
    """Hypotheses, masses among them, the units of their sizes, and their tests."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]: ...

    @property
    def units(self) -> Floats: ...

    @property
    def tests(self) -> SingleTests: ...


@dataclass(frozen=True, eq=False)
class HintedMasses:
    """Masses to which residuals point: their `names` and relative `errors` (m,), the likeliest first.

    `moves` (p, m), in SI units, is what each of these errors alone makes of the coefficients.
    """

    names: tuple[str, ...]
    errors: Floats
    moves: Floats

    @property
    def covariance(self) -> Floats:
        """(p, p) what they add to that of the coefficients."""
        return np.asarray(self.moves @ self.moves.T)

    @property
    def hint(self) -> str:
        """What the residuals show of them."""
        return " or ".join(
            f"a mass of {name} that is off by {100.0 * error:+.2g} %"
            for name, error in zip(self.names, self.errors.tolist(), strict=True)
        )


def which_stated(hypotheses: Sequence[Hypothesis], unknowns: Sequence[str]) -> list[int]:
    """The numbers of the errors of masses that are not among the `unknowns`, by the names of these."""
    return [
        number
        for number, hypothesis in enumerate(hypotheses)
        if hypothesis.kind == MASS and f"{hypothesis.where}.{MASS}" not in unknowns
    ]


def likely_masses(hypotheses: Sequence[Hypothesis], gains: Floats) -> Bools:
    """Which of h hypotheses are errors of masses that chance hardly gives, where one of them gains more than all others.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        All that were tested.
    gains : array of shape (h,)
        What each would take off -2 log likelihood.

    Returns
    -------
    array of shape (h,)
        Those; whether they matter depends on what they would make of the coefficients.
    """
    are_masses = np.array([hypothesis.kind == MASS for hypothesis in hypotheses])
    if not are_masses.any() or not are_masses[int(np.argmax(gains))]:
        return np.zeros(len(are_masses), dtype=bool)
    return np.asarray(are_masses & (gains > _CHANCE + 2.0 * np.log(np.count_nonzero(are_masses))))


def hinted_masses(fit: LikelihoodFit, tested: TestedMasses) -> HintedMasses | None:
    """The masses to which the residuals of laws that leave only noise point.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    tested : TestedMasses
        What was tested at it.

    Returns
    -------
    HintedMasses or None
        Those that gain as much as chance gives to a mass of one fit in 80, and others nearly as likely, which would change a
        coefficient by more than its standard error; None without any.
    """
    optimum = fit.optimum
    stated = np.array(which_stated(tested.hypotheses, optimum.segments.system.parameters.names), dtype=int)
    gains = np.nan_to_num(tested.tests.gains[stated]) / (optimum.noise * beyond_white(fit)) ** 2
    largest = float(np.max(gains, initial=0.0))
    if not largest > _HINT + 2.0 * np.log(max(len(stated), 1)):
        return None
    errors = tested.tests.sizes[stated] * tested.units[stated]
    moves = tested.tests.changes[:, stated] * optimum.scales.theta[: len(fit.values), np.newaxis]
    moves = np.where(fit.free[:, np.newaxis], moves, 0.0)
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    felt = np.max(np.abs(moves) / deviations[:, np.newaxis], axis=0) > _FELT
    likely = np.flatnonzero(felt & (gains > _AS_LIKELY * largest) & (np.abs(errors) < LARGEST))
    if not len(likely):
        return None
    order = likely[np.argsort(-gains[likely])]
    names = tuple(tested.hypotheses[number].where for number in stated[order].tolist())
    return HintedMasses(names, errors[order], moves[:, order])


def beyond_white(fit: LikelihoodFit) -> float:
    """By how much scores scatter more than white noise makes them, beside a model error that follows the motion."""
    if fit.model_error == 0.0 or fit.error_ratios is None:
        return 1.0
    return max(1.0, float(np.max(fit.error_ratios)))
