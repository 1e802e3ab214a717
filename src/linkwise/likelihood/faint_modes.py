"""Frequencies and damping of modes that a record hardly shows: the curvature of the likelihood says too much of them.

The likelihood of a frequency is that of a peak of a periodogram: quadratic only within a part of its width. A mode that noise
hides has other peaks within what is known of it beforehand, about as likely as that which is found, and takes its damping from
the width of the one that it ends at.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.model.names import Name
from linkwise.model.structure import Structure

_WIDTH = 0.2  # of half the bandwidth of a mode: the largest standard error of its frequency for a quadratic likelihood
_SINGULAR = 1e-12  # of correlations: rounding


def with_faint_modes(fit: LikelihoodFit, identified: Structure) -> tuple[Floats, tuple[Name, ...]]:
    """The covariance of a fit in which faint modes keep the standard deviations known beforehand.

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
        The frequencies and damping of these modes.
    """
    segments, covariance = fit.segments, fit.covariance
    if segments.prior is None or not identified.hosts:
        return covariance, ()
    errors, known = np.sqrt(np.maximum(covariance.diagonal(), 0.0)), segments.prior.deviation
    alone = _alone(fit)
    places = {name: number for number, name in enumerate(segments.system.parameters.names)}
    duration = float(np.sum(segments.step)) * segments.steps
    factor, names = np.ones(len(fit.values)), []
    for place, frequency in places.items():
        mode = place.owner
        if mode not in identified.modes or place.key != "frequency":
            continue
        if not np.isfinite(known[frequency]):
            continue
        values = identified.link(mode).values
        if not alone[frequency] > _WIDTH * max(values["damping"] * values["frequency"], 0.5 / duration):
            continue
        for name in (place, Name(mode, "damping")):
            number = places.get(name)
            if number is not None and 0.0 < errors[number] < known[number] < np.inf:
                factor[number] = known[number] / errors[number]
                names.append(name)
    return covariance * np.outer(factor, factor), tuple(names)


def _alone(fit: LikelihoodFit) -> Floats:
    """(p,) standard errors with all other parameters held, 0 where there is none: a link that shifts a mode hides none."""
    alone, errors = np.zeros(len(fit.values)), np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    free = np.flatnonzero(fit.free & np.isfinite(errors) & (errors > 0.0))
    correlation = fit.covariance[np.ix_(free, free)] / np.outer(errors[free], errors[free])
    information = np.linalg.pinv(correlation, rcond=_SINGULAR, hermitian=True).diagonal()
    alone[free] = errors[free] / np.sqrt(np.maximum(information, 1.0))
    return alone
