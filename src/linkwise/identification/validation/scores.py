"""Scores of a prediction, channel by channel, beside what noise and the errors of the answer allow."""

from __future__ import annotations

import math

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.identification.validation.coefficients import LEVEL
from linkwise.identification.validation.prediction import Prediction
from linkwise.identification.validation.result import ChannelPrediction
from linkwise.model.structure import Structure
from linkwise.records.channel_units import channel_unit
from linkwise.records.record import Record

_ESTIMATED_NOISE = 1.2  # over the noise that is estimated from a record: how far that may be off


def channel_scores(
    record: Record,
    structure: Structure,
    prediction: Prediction,
    steps: tuple[Floats, Floats],
    noise: dict[str, float],
) -> dict[str, ChannelPrediction]:
    """The scores by channel.

    The squared error is a sum of squares: that of the noise is chi-square distributed with as many degrees of freedom as there
    are samples; those of initial states with at least one a start; those of coefficients and laws with at least one. Each is
    allowed its quantile.
    """
    names = record.responses
    level = LEVEL / len(names)
    once = float(scipy.special.chdtri(1, level))
    often = float(scipy.special.chdtri(prediction.starts, level)) / prediction.starts
    scores = {}
    for column, name in enumerate(names):
        measured = record.channel(name)
        error = measured - prediction.predicted[:, column]
        scored = np.isfinite(error)
        count, mean_square = int(scored.sum()), float(np.mean(error[scored] ** 2))
        parts = [
            float(np.mean(variance[scored, column]))
            for variance in (prediction.by_state, prediction.by_coefficients, prediction.by_laws)
        ]
        square = noise[name] ** 2
        allowed = square if name in record.noise else square * _ESTIMATED_NOISE**2
        allowed *= float(scipy.special.chdtri(count, level)) / count
        spread = float(np.var(measured[scored]))
        nmse = mean_square / spread if spread > 0.0 else math.inf
        ahead = measured - steps[0][:, column]
        scores[name] = ChannelPrediction(
            name=name,
            unit=channel_unit(record, name, structure),
            samples=count,
            rmse=math.sqrt(mean_square),
            nmse_percent=100.0 * nmse,
            fit_percent=100.0 * (1.0 - math.sqrt(nmse)),
            noise=noise[name],
            expected=math.sqrt(square + sum(parts)),
            limit=math.sqrt(allowed + often * parts[0] + once * (parts[1] + parts[2])),
            one_step_rmse=float(np.sqrt(np.nanmean(ahead**2))),
            one_step_expected=math.sqrt(square + float(np.nanmean(steps[1][:, column]))),
        )
    return scores
