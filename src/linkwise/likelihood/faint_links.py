"""Links whose elongation hardly stands above the noise: whether their coefficients are determined far from the estimates.

The frequency of a faint vibration is like the peak of a periodogram: its phase, followed through the whole record, makes the
peak narrow, and other peaks are as high. What the curvature promises at a distance, the likelihood then does not keep: it
cannot rise by more than twice the energy of the elongation over that of the noise, and by no more than that energy to where
the link is rigid. Only vibration of its own counts: what the links beside it force upon a link follows them, whatever its
stiffness, and may stand far above the noise.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.local_optima import rises_by
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.shooting.segments import A, F, S, V, X
from linkwise.model.structure import Structure

_FAINT = 100.0  # energy over the noise: one peak of 1000 is mistaken for another with probability 1000 exp(-100 / 4) = 1e-8
_UNSEEN = 25.0  # energy over the noise: a rigid link explains the record to within five standard errors
_BY_PHASE = 4.0
"""Over the energy of the elongation: (value / error)^2 of a stiffness that the phase of a vibration determines better than
the size of the elongation, to which a force stretches the link in inverse proportion to it."""
_DISTANCE = 8.0  # standard errors
_LOW = 0.25  # of the rise of the cost that the curvature promises there


def undetermined_far_away(fit: LikelihoodFit, identified: Structure) -> tuple[str, ...]:
    """Names of the coefficients of faint links that may as well be far away.

    Those of a link whose elongation is not above the noise at all, where it has no coefficient that is known; without such a
    link those that may as well be eight standard errors away, tested one by one: all of a link whose elongation is faint, and
    those of elastic forces if only its own vibration determines them. Coefficients that other links share are not among
    them.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    identified : Structure
        The structure with the values of the fit.

    Returns
    -------
    tuple of str
        The names; none for a fit that did not converge.
    """
    system, energy = fit.segments.system, elongation_energy(fit)
    if fit.status is not AnnealingStatus.CONVERGED:
        return ()
    own_energy = np.where(energy < np.inf, own_part(fit), 1.0) * energy
    if not (own_energy < _FAINT).any():
        return ()
    in_links: dict[int, list[int]] = {}
    for link, column, _ in system.interactions:
        in_links.setdefault(column, []).append(link)
    own = [column for column, links in sorted(in_links.items()) if (own_energy[links] < _FAINT).all()]
    free = [column for column in own if fit.free[column]]
    names, elastic = system.parameters.names, _elastic(identified)
    unseen = (energy < _UNSEEN) & system.wholly_unknown
    undetermined = [column for column in free if unseen[in_links[column]].all()]
    if not undetermined:
        information = fit.values**2 / np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny)
        tested = [
            column
            for column in free
            if (energy[in_links[column]] < _FAINT).all()
            or (names[column] in elastic and information[column] > _BY_PHASE * energy[in_links[column]].sum())
        ]
        undetermined = [column for column in tested if not _rises(fit, column)]
    return tuple(names[column] for column in undetermined)


def _elastic(structure: Structure) -> frozenset[str]:
    """Names of the coefficients on which the elastic forces of links depend: a frequency determines these alone."""
    return frozenset(
        f"{link.name}.{name}"
        for link in structure.links
        for name in set(link.coefficients).intersection(symbols(link.law.elastic))
    )


def elongation_energy(fit: LikelihoodFit) -> Floats:
    """(L,) sum of squares of each link's elongation about its mean, in units of the noise of the sensors at its ends.

    Rates and their noise are counted alike. Infinite for links of which an end has no sensor, or the force or a state has.
    """
    segments = fit.segments
    sensors, incidence = segments.sensors, segments.system.incidence
    if sensors.shapes is not None:  # points show modes, of which each link moves several
        return np.full(incidence.shape[1], np.inf)
    orbit = fit.misfit.trajectories
    at = segments.at_samples
    motions = {
        X: orbit.links[at, 0],
        V: orbit.links[at, 1],
        A: np.einsum("il,mik->mlk", incidence, orbit.accelerations[at]),
    }
    energy = np.zeros(incidence.shape[1])
    is_measured = np.zeros(incidence.shape[1], dtype=bool)
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
        is_measured |= measured
        present = np.where(with_ends, shown[:, None], 1.0).min(axis=0)
        about_mean = np.var(motion, axis=(0, 2)) * motion.shape[0] * motion.shape[2] * present
        energy += np.where(measured, about_mean / np.where(measured, variance, 1.0), 0.0)
    energy[~is_measured] = np.inf
    energy[sensors.mass[sensors.kind == F]] = np.inf
    energy[segments.system.state_links[sensors.mass[sensors.kind == S]]] = np.inf
    return energy


def own_part(fit: LikelihoodFit) -> Floats:
    """(L,) part of the energy of each link's elongation that does not follow those of the other links at one of its ends.

    It is what their elongations, cubes and rates leave of it by least squares, at the end where that is less.
    """
    system = fit.segments.system
    motion = fit.misfit.trajectories.links[fit.segments.at_samples]
    d, v = (motion[:, kind].transpose(2, 0, 1).reshape(-1, motion.shape[2]) for kind in (0, 1))
    d = d - d.mean(axis=0)
    touches = system.incidence != 0.0
    parts = np.ones(d.shape[1])
    for link in range(d.shape[1]):
        power = max(float(np.vdot(d[:, link], d[:, link])), np.finfo(float).tiny)
        for mass in np.flatnonzero(touches[:, link]):
            beside = np.setdiff1d(np.flatnonzero(touches[mass]), link)
            columns = np.column_stack([np.ones(len(d)), d[:, beside], v[:, beside], d[:, beside] ** 3])
            columns /= np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
            left = d[:, link] - columns @ np.linalg.lstsq(columns, d[:, link], rcond=None)[0]
            parts[link] = min(parts[link], float(np.vdot(left, left)) / power)
    return parts


def _rises(fit: LikelihoodFit, column: int) -> bool:
    """Whether the cost rises on both sides of the estimate, everything else fitted again."""
    optimum = fit.optimum
    covariance = fit.covariance if optimum.of_white is None else optimum.of_white
    deviation = float(np.sqrt(covariance[column, column]))
    if not 0.0 < deviation < np.inf:
        return True
    step = _DISTANCE * covariance[column] / deviation
    is_fixed = np.arange(len(step)) == column
    limits = optimum.segments.system.parameters
    for side in (step, -step):
        theta = optimum.point.theta + side
        if not limits.lower[column] < theta[column] < limits.upper[column]:
            continue
        try:
            if not rises_by(_LOW, fit, theta, is_fixed, _DISTANCE):
                return False
        except IdentificationError:  # the motion runs to infinity
            continue
    return True
