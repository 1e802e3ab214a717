"""Links whose elongation hardly stands above the noise: whether their coefficients are determined far from the estimates.

The frequency of a faint vibration is like the peak of a periodogram: its phase, followed through the whole record, makes the
peak narrow, and other peaks are as high. What the curvature promises at a distance, the likelihood then does not keep: it
cannot rise by more than twice the energy of the elongation over that of the noise, and by no more than that energy to where
the link is rigid.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.local_optima import rises_by
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.shooting.segments import A, F, S, V, X

_FAINT = 100.0  # energy over the noise: one peak of 1000 is mistaken for another with probability 1000 exp(-100 / 4) = 1e-8
_UNSEEN = 25.0  # energy over the noise: a rigid link explains the record to within five standard errors
_DISTANCE = 8.0  # standard errors
_LOW = 0.25  # of the rise of the cost that the curvature promises there


def undetermined_far_away(fit: LikelihoodFit) -> tuple[str, ...]:
    """Names of the coefficients of faint links that may as well be far away.

    Those of a link whose elongation is not above the noise at all, where it has no coefficient that is known; without such a
    link those that may as well be eight standard errors away, tested one by one. Coefficients that other links share are not
    among them.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    tuple of str
        The names; none for a fit that did not converge.
    """
    system, energy = fit.segments.system, elongation_energy(fit)
    if fit.status is not AnnealingStatus.CONVERGED or not (energy < _FAINT).any():
        return ()
    in_links: dict[int, list[int]] = {}
    for link, column, _ in system.interactions:
        in_links.setdefault(column, []).append(link)
    own = [column for column, links in sorted(in_links.items()) if (energy[links] < _FAINT).all()]
    free = [column for column in own if fit.free[column]]
    unseen = (energy < _UNSEEN) & system.wholly_unknown
    undetermined = [column for column in free if unseen[in_links[column]].all()]
    if not undetermined:
        undetermined = [column for column in free if not _rises(fit, column)]
    return tuple(system.parameters.names[column] for column in undetermined)


def elongation_energy(fit: LikelihoodFit) -> Floats:
    """(L,) sum of squares of each link's elongation about its mean, in units of the noise of the sensors at its ends.

    Rates and their noise are counted alike. Infinite for links of which an end has no sensor, or the force or a state has.
    """
    segments = fit.segments
    sensors, incidence = segments.sensors, segments.system.incidence
    if sensors.shapes is not None:  # points show modes, of which each link moves several
        return np.full(incidence.shape[1], np.inf)
    orbit = fit.misfit.trajectories
    at = slice(None, segments.steps, segments.refine)
    motions = {
        X: orbit.links[at, 0],
        V: orbit.links[at, 1],
        A: np.einsum("il,mik->mlk", incidence, orbit.accelerations[at]),
    }
    energy = np.zeros(incidence.shape[1])
    seen = np.zeros(incidence.shape[1], dtype=bool)
    variances = fit.optimum.scales.sigma**2
    for kind, motion in motions.items():
        own = np.full(len(incidence), np.inf)
        chosen = sensors.kind == kind
        own[sensors.mass[chosen]] = variances[chosen]
        shown = np.ones(len(incidence))
        shown[sensors.mass[chosen]] = segments.observed[:, chosen].mean(axis=(0, 2))
        with_ends = incidence != 0.0
        variance = np.where(with_ends, own[:, None], 0.0).sum(axis=0)
        measured = np.isfinite(variance)
        seen |= measured
        present = np.where(with_ends, shown[:, None], 1.0).min(axis=0)
        about_mean = np.var(motion, axis=(0, 2)) * motion.shape[0] * motion.shape[2] * present
        energy += np.where(measured, about_mean / np.where(measured, variance, 1.0), 0.0)
    energy[~seen] = np.inf
    energy[sensors.mass[sensors.kind == F]] = np.inf
    energy[segments.system.state_links[sensors.mass[sensors.kind == S]]] = np.inf
    return energy


def _rises(fit: LikelihoodFit, column: int) -> bool:
    """Whether the cost rises on both sides of the estimate, everything else fitted again."""
    optimum = fit.optimum
    covariance = fit.covariance if optimum.of_white is None else optimum.of_white
    deviation = float(np.sqrt(covariance[column, column]))
    if not 0.0 < deviation < np.inf:
        return True
    step = _DISTANCE * covariance[column] / deviation
    held = np.arange(len(step)) == column
    limits = optimum.segments.system.parameters
    for side in (step, -step):
        theta = optimum.point.theta + side
        if not limits.lower[column] < theta[column] < limits.upper[column]:
            continue
        try:
            if not rises_by(_LOW, fit, theta, held, _DISTANCE):
                return False
        except IdentificationError:  # the motion runs to infinity
            continue
    return True
