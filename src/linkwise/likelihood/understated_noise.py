"""Noise that is stated smaller than it is: residuals that are white, and larger than it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.judgement import Judgement
from linkwise.likelihood.whiteness import is_white
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma
from linkwise.verdict import Verdict

# times the noise: 1.44 in chi-square, which no number of samples that a fit has gives by chance
_EXCEEDED = 1.2
# times the noise: what neighbouring samples scatter by is noise within a few per cent where the motion is resolved
_SCATTERED = 100.0
_DOUBTED = (Verdict.NOT_CONVERGED, Verdict.NOISE_MISMATCH)


def with_understated_noise(
    judgement: Judgement, fit: LikelihoodFit, records: Sequence[Record]
) -> Judgement | None:
    """The judgement that says that the noise of channels is stated too small, where that alone is wrong; else None.

    What laws lack leaves residuals that follow the motion, from one sample to the next; those of noise are white.
    """
    if judgement.verdict not in _DOUBTED or fit.random_forces:
        return None
    if judgement.verdict is Verdict.NOT_CONVERGED:
        scattered = beyond_statement(records)
        if scattered:
            return replace(judgement, message=f"{judgement.message} {scattered}")
    if not np.isfinite(fit.chi_square):
        return None
    stated = {name for record in records for name in record.noise}
    exceeded = []
    for name, residuals in zip(fit.noise, fit.misfit.residuals.transpose(1, 2, 0), strict=True):
        counted = residuals[residuals != 0.0]
        ratio = float(np.sqrt(np.mean(counted**2))) if len(counted) else 0.0
        if ratio <= _EXCEEDED:
            continue
        if name not in stated or not is_white(residuals.ravel()):
            return None
        exceeded.append(f"{ratio:.2g} times in {name}, {fit.noise[name]:.2g} {records[0].unit(name)}")
    if not exceeded:
        return None
    which = " and ".join(exceeded)
    unsettled = judgement.verdict is Verdict.NOT_CONVERGED
    return replace(
        judgement,
        message=(
            f"The residuals exceed the noise that is stated ({which}), and are white, as noise is and what laws lack is not: "
            f"it is stated too small, and no interval is given.{' The search did not converge with it.' if unsettled else ''} "
            "State what it is, or leave it out, so that it is found with the laws."
        ),
    )


def beyond_statement(records: Sequence[Record]) -> str:
    """Whether samples of responses scatter far more than the noise that is stated of them.

    Parameters
    ----------
    records : sequence of Record
        The records.

    Returns
    -------
    str
        A sentence on such channels; empty where there are none.
    """
    scatters: dict[Channel, tuple[float, float]] = {}
    for record in records:
        responses = record.select(record.responses)
        for name, sigma in zip(responses.channels, noise_sigma(responses.values).tolist(), strict=True):
            stated = record.noise.get(name, 0.0)
            ratio = sigma / stated if stated > 0.0 else 0.0
            if ratio > max(_SCATTERED, scatters.get(name, (0.0, 0.0))[0]):
                scatters[name] = ratio, sigma
    if not scatters:
        return ""
    which = " and ".join(
        f"{ratio:.2g} times in {name}, {sigma:.2g} {name.unit}" for name, (ratio, sigma) in scatters.items()
    )
    return (
        f"Before any law, neighbouring samples scatter by far more than the noise that is stated ({which}): state what it is, "
        "or leave it out, so that it is found with the laws."
    )
