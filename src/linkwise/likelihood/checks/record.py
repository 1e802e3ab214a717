"""The judgement on a fit, with errors of the records that are no small ones: clipped samples and whole channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from linkwise.estimates.causes import Cause
from linkwise.likelihood.checks.changed_coefficients import beside_changes
from linkwise.likelihood.checks.judgement import Judgement, assess
from linkwise.likelihood.checks.recording import (
    before_other_causes,
    clipped_samples,
    lacking_modes,
    recording_errors,
    with_understated_noise,
)
from linkwise.likelihood.checks.richer_laws import beside_richer_laws
from linkwise.likelihood.checks.skewed_profiles import with_skewed_profiles
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.optima.other_optima import with_faint_modes
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.verdict import Verdict

_MORE = 20.0  # times what any other cause explains: a mode that is lacking is no small error, as these are


def judge(
    fit: LikelihoodFit,
    identified: Structure,
    structures: Sequence[Structure],
    records: Sequence[Record],
    *,
    searched: bool = False,
) -> Judgement:
    """The judgement of `assess`, and where the laws leave more than noise, errors of the records before all other causes.

    The `structures` have their unknowns: that of which `identified` has the values found, after a search that of all that was
    offered before it. Without such an error one of them explains the records to within their noise, or the record itself shows
    it, so that no answer with it is trusted, and no other cause is likelier.
    """
    judgement = assess(fit, identified, records[0].channels, searched=searched)
    understated = with_understated_noise(judgement, fit, records)
    if understated is not None:
        return understated
    judgement = beside_changes(judgement, fit, records)
    judgement = with_skewed_profiles(judgement, fit, with_faint_modes(fit, identified)[1])
    if not searched:
        judgement = beside_richer_laws(judgement, fit, structures[0], records)
    if fit.random_forces or not (judgement.verdict.forbids or judgement.diagnosis):
        return judgement
    clipped = tuple(clipped_samples(fit, records))
    unexplained = judgement.verdict.forbids and not _leaves_noise(fit, judgement.verdict)
    of_channels = (recording_errors(records, structure) for structure in structures if unexplained)
    errors = (*clipped, *next(filter(None, of_channels), ()))
    if not errors:
        settled = judgement.verdict is not Verdict.NOT_CONVERGED  # else the forces of links are wrong
        lacking = (
            lacking_modes(fit, identified, records) if unexplained and settled and identified.hosts else ()
        )
        likeliest = max((cause.gain for cause in judgement.diagnosis), default=0.0)
        lacking = tuple(cause for cause in lacking if cause.gain > _MORE * likeliest)
        return _lacking(judgement, lacking) if lacking else before_other_causes(judgement, records)
    unsettled = judgement.verdict is Verdict.NOT_CONVERGED
    return Judgement(
        Verdict.NOT_CONVERGED if unsettled else Verdict.MEASUREMENT_ERROR,
        (f"{judgement.message} " if unsettled else "") + _explanation(errors, is_clipped=bool(clipped)),
        judgement.model_error,
        (*errors, *judgement.diagnosis),
    )


def _lacking(judgement: Judgement, causes: Sequence[Cause]) -> Judgement:
    """The judgement where hosts lack modes, before all other causes: errors of sensors look a little like them."""
    parts = [
        f"with {cause.description}, the forces on it explain {100.0 * cause.share:.3g} % of what its stated modes leave in "
        f"its sensors: {_ADVICE[cause.kind]}"
        for cause in causes
    ]
    return replace(
        judgement,
        verdict=Verdict.UNEXPLAINED_FORCES,
        message=f"The structure does not explain the record: {'; '.join(parts)}.",
        diagnosis=(*causes, *judgement.diagnosis),
    )


def _leaves_noise(fit: LikelihoodFit, verdict: Verdict) -> bool:
    """Whether the laws explain the records to within their noise, though the answer is not to be trusted."""
    unsettled = verdict is Verdict.NOT_CONVERGED and fit.model_error == 0.0 and not fit.chi_square_off
    return unsettled or verdict in _EXPLAINED


def _explanation(errors: Sequence[Cause], *, is_clipped: bool) -> str:
    """What the first of the errors means, and what mends it; the others look like it."""
    first, others = errors[0], errors[1:]
    advice = _ADVICE[first.kind].format(where=first.where, source=first.source, factor=_factor(first))
    if is_clipped:
        more = f" There is also {' and '.join(error.description for error in others)}." if others else ""
        return (
            f"The motion goes on beyond the range of {first.where}: {first.description} would lower -2 log likelihood by "
            f"{first.gain:.3g}.{more} Intervals of exact laws would not include that: {advice}."
        )
    alike = f" ({' or '.join(error.description for error in others)} would do the same)" if others else ""
    return (
        f"The laws do not explain the record as it stands, and explain it to within its noise but for one error: "
        f"{first.description}{alike}: {advice}, and identify again."
    )


def _factor(cause: Cause) -> str:
    return f"{1.0 / cause.size:g}" if cause.kind == "unit" else ""


_EXPLAINED = (Verdict.SEVERAL_OPTIMA, Verdict.HARDLY_DETERMINED, Verdict.COVARIANCE_NOT_POSITIVE)
"""Verdicts on laws that leave only noise."""

_ADVICE = {
    "sign": "change the sign of {where}",
    "unit": "multiply {where} by {factor}, or state its unit",
    "swapped": "exchange {where} and {source}",
    "high pass": "couple the sensor of {where} directly (DC), or integrate what it took off",
    "mode": "state that mode, or keep it of the matrices",
    "clipped": "mark these samples as missing (mark_missing), or measure with a larger range",
}
