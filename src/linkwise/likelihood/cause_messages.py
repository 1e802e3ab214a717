"""What the verdict on a fit says of the causes that would explain what it leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.likelihood.force_spectra import BEHIND_FILTER, SPECTRAL_KINDS, UNSTEADY
from linkwise.likelihood.held_errors import LARGEST_SHIFT


def would_explain(cause: Cause) -> str:
    return f"{cause.description} would lower -2 log likelihood by {cause.gain:.3g}"


def likeliest(causes: Sequence[Cause], part: str = "of what is left") -> str:
    return f" Most {part} would be explained by {causes[0].description}." if causes else ""


def moved(causes: Sequence[Cause]) -> str:
    """Which coefficient the likeliest cause would change most, where it would change by more than its interval says."""
    if not causes or causes[0].shift <= LARGEST_SHIFT:
        return ""
    return (
        f" With it, {causes[0].shifted} would change by {causes[0].shift:.2g} of the standard errors of the laws as stated; "
        "the intervals allow for that."
    )


def of_instrument(cause: Cause) -> str:
    """What an error in what was recorded or stated means for the answer."""
    if cause.kind in ("input noise", "ambient"):
        kind = "an ambient force on" if cause.kind == "ambient" else "noise of"
        more = "more of it, or let it be found" if cause.remark else f"{kind} {cause.where}"
        return (
            f", but {would_explain(cause)}. It excites the structure, and coefficients, above all dampings, would be "
            f"wrong by more than their intervals say, so none is given: allow for {more}."
        )
    if cause.kind == UNSTEADY:
        return (
            f", but {would_explain(cause)}. The strongest parts tell most, so intervals would be at least "
            f"{np.hypot(1.0, cause.size):.2g} times too narrow, and none is given: use parts of the record in which the level "
            "is about the same."
        )
    if cause.remark.endswith(BEHIND_FILTER):
        return (
            f", but {would_explain(cause)}. All frequencies tell the level of the forces, and dampings would be wrong by more "
            "than their intervals say, so none is given: resample the accelerations at twice the frequency up to which the "
            "filter is flat, by their Fourier transform."
        )
    if cause.kind in SPECTRAL_KINDS:
        return (
            f", but {would_explain(cause)}. The laws take up what such forces differ by from white and independent ones, and "
            "would be wrong by more than their intervals say, so none is given: record the forces, or the structure where "
            "nothing but applied forces or its own decay moves it."
        )
    return (
        f", but {would_explain(cause)}, more than any missing term. Coefficients would be wrong by more than their intervals "
        "say, so none is given: correct it, or estimate it with the other unknowns."
    )


def of_error_beside_terms(error: Cause) -> str:
    """What an error means that moves a coefficient farther than intervals hold, beside the terms that they count."""
    return (
        f", but {would_explain(error)}, and beside the terms that would explain more it would change {error.shifted} by "
        f"{error.shift:.2g} of its standard errors. Intervals do not include that, so none is given: correct it, or estimate "
        "it with the other unknowns."
    )


def of_systematic_misfit(cause: Cause) -> str:
    """What a misfit that follows the motion means for the answer."""
    overturned = ""
    if cause.overturned:
        overturned = f", and {', '.join(cause.overturned)} would have no certain sign, or another one"
    return (
        f", but what is left follows the motion: {would_explain(cause)}{overturned}. Intervals would count that as noise, "
        "so none is given; a term or a link is missing, or a sensor has an error."
    )
