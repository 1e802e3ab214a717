"""The checks of a fit, in their order: what each asks, and what it does to the answer."""

from __future__ import annotations

from collections.abc import Collection

from linkwise.likelihood.checks import recording, verdicts
from linkwise.likelihood.checks.changed_coefficients import changed_coefficients
from linkwise.likelihood.checks.host_modes import modes_of_hosts
from linkwise.likelihood.checks.judgement import Check, Examined, Judgement
from linkwise.likelihood.checks.skewed_profiles import skewed_profiles
from linkwise.likelihood.checks.windows import exponential_window
from linkwise.runtime import one_blas_thread

VERDICTS = (
    Check("convergence", "refuses", verdicts.convergence),
    Check("samples written twice", "refuses", recording.samples_written_twice),
    Check("standard errors", "refuses", verdicts.standard_errors),
    Check("event", "approximates", verdicts.event),
    Check("level of the noise", "approximates", verdicts.level_of_noise),
    Check("noise found of inputs", "approximates", verdicts.noise_found_of_inputs),
    Check("error of a measurement", "approximates", verdicts.error_of_measurement),
    Check("unexplained forces", "approximates", verdicts.unexplained_forces),
    Check("systematic misfit", "approximates", verdicts.systematic_misfit),
    Check("spectra of random forces", "approximates", verdicts.spectra_of_forces),
    Check("filter of all sensors", "approximates", verdicts.filter_of_all_sensors),
    Check("whiteness", "approximates", verdicts.whiteness),
    Check("values far away", "refuses", verdicts.values_far_away),
    Check("another position of rest", "refuses", verdicts.another_rest),
    Check("regularity", "refuses", verdicts.regularity),
    Check("model error", "approximates", verdicts.model_error),
)
"""Checks that find the verdict, in their order: the first that has one does."""

FINDINGS = (
    Check("hidden terms", "approximates", verdicts.term_hidden_by_model_error),
    Check("unrecorded forces", "names", verdicts.remarks_on_forces),
    Check("motion that goes on", "names", verdicts.motion_that_goes_on),
    Check("noise of inputs", "widens", verdicts.noise_of_inputs),
    Check("hints at masses and sensors", "widens", verdicts.hinted_errors),
    Check("hints at an event", "widens", verdicts.hinted_event),
    Check("hints at missing terms", "widens", verdicts.hinted_terms),
    Check("asymmetry of wells", "widens", verdicts.asymmetric_wells),
    Check("stated noise", "names", recording.understated_noise),
    Check("changes along the record", "approximates", changed_coefficients),
    Check("motion that begins anew", "approximates", verdicts.motion_that_begins_anew),
    Check("exponential window", "refuses", exponential_window),
    Check("skewed profiles", "widens", skewed_profiles),
    Check("clipped samples and errors of channels", "refuses", recording.errors_of_records),
    Check("modes that hosts lack", "approximates", modes_of_hosts),
    Check("motion that runs away", "refuses", verdicts.motion_that_runs_away),
    Check("uneven samples", "names", recording.uneven_samples),
)
"""Checks that follow, in their order, each on what those before it said."""


def judge(of: Examined, *, without: Collection[str] = ()) -> Judgement:
    """The judgement on a fit by all checks in turn, `without` those of some names."""
    judgement: Judgement | None = None
    with one_blas_thread():
        for check in VERDICTS:
            if judgement is None and check.name not in without:
                judgement = check.judge(of)
        assert judgement is not None  # the last check always has a verdict
        for check in FINDINGS:
            if not (judgement.is_final or check.name in without):
                judgement = check.judge(of, judgement) or judgement
    return judgement
