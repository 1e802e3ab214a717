"""Errors of sensors and inputs that intervals hold: small ones, beside a model error that intervals include.

A record whose laws are a little wrong shows a little of everything: a drift, a part of a sample of delay. The score test of
such an error says to first order what it would make of each coefficient. Where that is no more than an interval can hold, it
joins the covariance as a missing term does; an error that moves a coefficient by more takes trust from the answer.
"""

from __future__ import annotations

from collections.abc import Sequence

from linkwise.estimates.cause import Cause
from linkwise.likelihood.fit import LikelihoodFit

LARGEST_SHIFT = 3.0
"""Standard errors: the largest change of a coefficient that is trusted, by an error of a sensor or an input beside a model
error, by a missing link, or by a term beside noise. An interval that holds it is up to three times as wide."""
_KINDS = ("gain", "offset", "drift", "delay", "crosstalk", "mass", "force gain", "force delay")
"""Whose effect the first order tells. A filter of all sensors changes the motion that nonlinear links act by as well, noise of
inputs has no size that moves coefficients to a side, and what contradicts a stated value is no small error."""


def told_by_blocks(fit: LikelihoodFit) -> bool:
    """Whether intervals include errors that follow the motion: only where blocks of the records tell them."""
    return fit.model_error > 0.0 and fit.error_ratios is not None


def held_errors(fit: LikelihoodFit, causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """The errors of sensors and inputs among the `causes`, where one of them explains most and intervals hold them all.

    They do where they allow for a model error already, and each such error would move no coefficient by more than
    `LARGEST_SHIFT` of its standard errors, nor overturn what is said of one. None where an error is of another kind.
    """
    errors = tuple(cause for cause in causes if cause.is_instrument)
    if not errors or errors[0] is not causes[0] or not told_by_blocks(fit):
        return ()
    small = all(
        error.kind in _KINDS and 0.0 < error.shift <= LARGEST_SHIFT and not error.overturned
        for error in errors
    )
    return errors if small else ()


def of_held_errors(errors: Sequence[Cause]) -> str:
    """That an error of a sensor or an input explains most, and how little it would move the coefficients."""
    if not errors:
        return ""
    farthest = max(errors, key=lambda error: error.shift)
    return (
        f" {errors[0].description[0].upper()}{errors[0].description[1:]} would explain most of what is left. It would "
        f"change {farthest.shifted} by {farthest.shift:.2g} of its standard errors, and no coefficient by more; the intervals "
        "allow for that."
    )
