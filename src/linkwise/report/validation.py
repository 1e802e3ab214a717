"""The result folder of `validate`: validation.json, the prediction, and a page of scores and of where the prediction
fails.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from linkwise.files import write_record
from linkwise.identification.validation.result import (
    CHANNEL_HEAD,
    COEFFICIENT_HEAD,
    Validation,
    channel_rows,
    coefficient_rows,
    headline,
)
from linkwise.model.structure_file import write_structure
from linkwise.output import VALIDATION
from linkwise.plot.validations import (
    prediction_error_figure,
    prediction_figure,
    prediction_profile_figure,
    prediction_spectrum_figure,
)
from linkwise.report.page import Build, Head, ResultFolder, Section, sectioned, sections_of


def _scores(validation: Validation) -> Section:
    """The scores of the channels, and the record against the prediction."""
    record = validation.record
    text = (
        f"{record.source or 'A record'}: {len(record)} samples at {record.rate:g} Hz, from {record.time[0]:g} to "
        f"{record.time[-1]:g} s. RMSE is the root mean square of measured minus predicted; allowed is the RMSE "
        f"that noise and the errors of the answer exceed in one record of a thousand. One step is the error of "
        "predictions one sample ahead. NMSE is the squared RMSE over the variance of the measured "
        "samples, fit is 100 % minus its root."
    )
    rows = [CHANNEL_HEAD, *channel_rows(validation)]
    figure = partial(prediction_figure, validation)
    return Section("Prediction", [text], items=record.notes, rows=rows, figure=figure)


def _findings(result: Validation) -> Section | None:
    """What disagrees."""
    return Section("Findings", items=result.findings) if result.findings else None


def _error(result: Validation) -> Section:
    """The error over time."""
    text = "The band is twice the standard deviation that noise and the errors of the answer give the difference."
    return Section("Error over time", [text], figure=partial(prediction_error_figure, result))


def _profiles(result: Validation) -> Section:
    """The error over the motion of the links."""
    text = (
        "Root mean square of the error over all channels, each in % of the RMS of its channel, by elongation and velocity "
        "of the links along the predicted motion."
    )
    return Section("Where in the motion it fails", [text], figure=partial(prediction_profile_figure, result))


def _spectra(result: Validation) -> Section | None:
    """The error over frequency, where the record is long enough."""
    if not result.spectra:
        return None
    text = "Power spectral density of the measured channel, of the error, and of white noise of the stated or estimated size."
    return Section("Error over frequency", [text], figure=partial(prediction_spectrum_figure, result))


def _coefficients(validation: Validation) -> Section | None:
    """The coefficients estimated again from this record, where the answer has a covariance."""
    if not validation.coefficients:
        return None
    limit = validation.coefficients[0].limit
    text = (
        "Each coefficient of the answer beside its estimate from this record alone; apart is their difference in standard "
        f"errors of both. Beyond {limit:.1f} they disagree: chance does that for one record of a thousand."
    )
    return Section("Coefficients", [text], rows=[COEFFICIENT_HEAD, *coefficient_rows(validation)])


SECTIONS: dict[str, Build[Validation]] = {
    "prediction": _scores,
    "findings": _findings,
    "error": _error,
    "motion": _profiles,
    "spectrum": _spectra,
    "coefficients": _coefficients,
}
"""The sections of a validation, in order; the name of a section is that of its figure's files."""


def _write_data(result: Validation, folder: Path) -> None:
    """The structure, and the responses as it predicts them, empty where they are not scored."""
    write_structure(result.structure, folder / "structure.toml")
    write_record(result.predicted, folder / "predicted.csv")


VALIDATION_FOLDER: ResultFolder[Validation] = sectioned(
    VALIDATION,
    lambda result: Head(headline(result), result.structure),
    partial(sections_of, SECTIONS),
    _write_data,
)
"""What `validate` hands over."""
