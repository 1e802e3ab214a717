"""The result folder of `validate`: validation.json, the prediction, and a page of scores and of where the prediction
fails.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from linkwise.files import write_record
from linkwise.identification.validation_result import (
    CHANNEL_HEAD,
    COEFFICIENT_HEAD,
    Validation,
    channel_rows,
    coefficient_rows,
    headline,
)
from linkwise.output import VALIDATION
from linkwise.plot.validations import (
    prediction_error_figure,
    prediction_figure,
    prediction_profile_figure,
    prediction_spectrum_figure,
)
from linkwise.report.figure_units import in_units_of_figures
from linkwise.report.result_folder import ResultFolder, Section
from linkwise.report.result_page import Head, sectioned


def _sections(validation: Validation) -> dict[str, Section]:
    """The sections of a validation by the names of their figures."""
    record = validation.record
    text = (
        f"{record.source or 'A record'}: {len(record)} samples at {record.rate:g} Hz, from {record.time[0]:g} to "
        f"{record.time[-1]:g} s. RMSE is the root mean square of measured minus predicted; allowed is the RMSE "
        f"that noise and the errors of the answer exceed in one record of a thousand. One step is the error of "
        "predictions one sample ahead. NMSE is the squared RMSE over the variance of the measured "
        "samples, fit is 100 % minus its root."
    )
    rows = [CHANNEL_HEAD, *in_units_of_figures(channel_rows(validation), slice(1, 5))]
    figure = partial(prediction_figure, validation)
    sections = {"prediction": Section("Prediction", [text], record.notes, rows, figure)}
    if validation.findings:
        sections["findings"] = Section("Findings", items=validation.findings)
    text = "The band is twice the standard deviation that noise and the errors of the answer give the difference."
    figure = partial(prediction_error_figure, validation)
    sections["error"] = Section("Error over time", [text], figure=figure)
    text = (
        "Root mean square of the error over all channels, each in % of the RMS of its channel, by elongation and velocity "
        "of the links along the predicted motion."
    )
    figure = partial(prediction_profile_figure, validation)
    sections["motion"] = Section("Where in the motion it fails", [text], figure=figure)
    if validation.spectra:
        text = (
            "Power spectral density of the measured channel, of the error, and of white noise of the stated or estimated "
            "size."
        )
        figure = partial(prediction_spectrum_figure, validation)
        sections["spectrum"] = Section("Error over frequency", [text], figure=figure)
    if validation.coefficients:
        limit = validation.coefficients[0].limit
        text = (
            "Each coefficient of the answer beside its estimate from this record alone; apart is their difference in standard "
            f"errors of both. Beyond {limit:.1f} they disagree: chance does that for one record of a thousand."
        )
        rows = [COEFFICIENT_HEAD, *coefficient_rows(validation)]
        sections["coefficients"] = Section("Coefficients", [text], rows=rows)
    return sections


def _write_data(result: Validation, folder: Path) -> None:
    """The responses as it predicts them, empty where they are not scored."""
    write_record(result.predicted, folder / "predicted.csv")


VALIDATION_FOLDER: ResultFolder[Validation] = sectioned(
    VALIDATION,
    lambda result: Head(headline(result), result.structure),
    _sections,
    [
        "compute with the answer; respond, absorb, design and export take its folder.",
        "see below where in the motion it fails, and identify again with what acts there.",
    ],
    _write_data,
)
"""What `validate` hands over."""
