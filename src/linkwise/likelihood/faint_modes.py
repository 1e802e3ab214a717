"""Frequencies of modes that a record hardly shows: the curvature of the likelihood says too much of them.

The likelihood of a frequency is that of a peak of a periodogram: quadratic only within a part of its width. A mode that noise
hides has other peaks within what is known of it beforehand, about as likely as that which is found.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.model.structure import Structure

_WIDTH = 0.2  # of half the bandwidth of a mode: the largest standard error of its frequency for a quadratic likelihood


def with_faint_modes(fit: LikelihoodFit, identified: Structure) -> tuple[Floats, tuple[str, ...]]:
    """The covariance of a fit in which frequencies of faint modes keep the standard deviation known beforehand.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    identified : Structure
        The structure with its values.

    Returns
    -------
    covariance : array of shape (p, p)
        The covariance; correlations stay.
    names : tuple of str
        The frequencies.
    """
    segments, covariance = fit.segments, fit.covariance
    if segments.prior is None or not identified.hosts:
        return covariance, ()
    known = segments.prior.deviation
    duration = float(np.sum(segments.step)) * segments.steps
    factor, names = np.ones(len(fit.values)), []
    for number, name in enumerate(segments.system.parameters.names):
        mode, _, key = name.rpartition(".")
        error = float(np.sqrt(max(covariance[number, number], 0.0)))
        if mode not in identified.modes or key != "frequency" or not 0.0 < error < known[number] < np.inf:
            continue
        values = identified.link(mode).values
        if error > _WIDTH * max(values["damping"] * values["frequency"], 0.5 / duration):
            factor[number] = known[number] / error
            names.append(name)
    return covariance * np.outer(factor, factor), tuple(names)
