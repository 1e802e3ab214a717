"""The likeliest motion and coefficients near those of the weak form: Gauss-Newton on the noise of all displacements together.

The weak form weights every window alike. Here residuals have the weight that the covariance of their noise gives them
(`residual_noise`), and the likeliest noise is taken out of the displacements, until the coefficients rest or nearly so, as in
generalised nonlinear least squares (Britt and Luecke, Technometrics 15, 233, 1973). The noise that is left in the motion is
independent of that in the residuals, so that products of both have no bias. Windows are a standard deviation apart: closer
ones would see motion beyond their band, on which chaotic structures depend so much that the steps do not converge.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.patch import Patch
from linkwise.weak.residual_noise import ResidualNoise
from linkwise.weak.smoothed_motion import smoothed_motion

_DISTANCE = 1.0  # standard deviations of a test function from one window to the next
_ROUNDS = (2, 5)  # at least, so that noise has left the motion, and at most
_AT_REST = 0.5  # standard errors: what a score loses by such a step is far less than its own error
_NEAR = 10.0
"""Standard errors: the last step that is accepted where a law lacks a term or the motion is chaotic, so that the steps do not
rest. Scores are taken beside the coefficients, which leaves them as they are to first order."""
_COLLINEAR = 1e-12


@dataclass(frozen=True, eq=False)
class LikelyMotion:
    """A structure at its likeliest motion.

    Attributes
    ----------
    system : WeakEquations
        The equations along the motion, which has no noise.
    noises : tuple of ResidualNoise
        Noise of the residuals of each patch.
    residuals : tuple of array of shape (R, m)
        The residuals of each patch, multiplied by the inverse of their covariance.
    values : array of shape (p,)
        The parameters.
    chi_square : float
        Sum of the squares of the residuals, weighted by their covariance, over its degrees of freedom: 1 for right laws.
    priors : array of shape (2, p)
        What priors of the parameters add to the sums of products of their columns, and to the slope by them; 0 without priors.
    """

    system: WeakEquations
    noises: tuple[ResidualNoise, ...]
    residuals: tuple[Floats, ...]
    values: Floats
    chi_square: float
    priors: Floats


def likely_motion(
    record: Record,
    structure: Structure,
    equations: WeakEquations,
    values: Mapping[str, float],
    free: Collection[str],
) -> LikelyMotion | None:
    """The likeliest motion of a structure and its coefficients with their priors, starting with those of the weak form.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns; those without one of the `values` are 0.
    equations : WeakEquations
        Equations on the record that the weak form has solved.
    values : mapping of str to float
        Their solution.
    free : collection of str
        The unknowns that are estimated; the others stay as they are.

    Returns
    -------
    LikelyMotion or None
        None where the steps do not come near to rest.

    Raises
    ------
    IdentificationError
        As `weak_equations`.
    numpy.linalg.LinAlgError
        If the covariance of the residuals is not positive definite.
    """
    window = equations.window
    measured = bridged(equations.motion)
    motion = smoothed_motion(measured, window)
    present = dict(values)
    for number in range(_ROUNDS[1]):
        system = weak_equations(
            record,
            structure,
            _at(equations.motion, motion[0]),
            window=window.spaced(_DISTANCE),
            rate_window=window,
            values=present,
        )
        names = system.parameters
        theta = np.array([present.get(name, 0.0) for name in names])
        own = np.array([name in free for name in names])
        noises = tuple(
            ResidualNoise.of(patch, system, equations.motion.floored_variance, theta, motion)
            for patch in system.patches
        )
        known = _priors(system, own)
        step, size, residuals, chi_square = _step(system, noises, theta, own, known, measured - motion[0])
        at_rest = size <= _AT_REST and number + 1 >= _ROUNDS[0]
        if at_rest or (number + 1 == _ROUNDS[1] and size <= _NEAR):
            priors = np.stack([known[1], known[1] * (theta + step - known[0])])
            return LikelyMotion(system, noises, residuals, theta, chi_square, priors)
        if not np.isfinite(size):
            return None
        present = dict(zip(names, (theta + step).tolist(), strict=True))
        noise = sum(
            own_noise.likeliest(weighted, measured.shape[1])
            for own_noise, weighted in zip(noises, residuals, strict=True)
        )
        motion = smoothed_motion(measured - noise, window)
    return None


def columns_of(patch: Patch, numbers: Indices) -> Floats:
    """The derivatives of the residuals of a patch with respect to some parameters.

    Parameters
    ----------
    patch : Patch
        The equations.
    numbers : array of int, shape (s,)
        Indices of the parameters.

    Returns
    -------
    array of shape (s, R, m)
        The derivatives.
    """
    columns = np.zeros((len(numbers), patch.rows.shape[1], len(patch.masses)))
    place = {number: position for position, number in enumerate(numbers.tolist())}
    for term, number in zip(
        patch.layout.free_terms.tolist(), patch.layout.free_parameters.tolist(), strict=True
    ):
        if number not in place:
            continue
        for mass in np.flatnonzero(patch.signs[:, term]):
            columns[place[number], :, mass] += patch.signs[mass, term] * patch.rows[term]
    return columns


def bridged(motion: MeasuredDisplacements) -> Floats:
    """Displacements with missing samples between their neighbours; windows with these have no equation.

    Parameters
    ----------
    motion : MeasuredDisplacements
        The displacements.

    Returns
    -------
    array of shape (n + 2, N)
        They without gaps, in m.
    """
    if motion.missing is None:
        return motion.displacements
    bridged, index = motion.displacements.copy(), np.arange(motion.displacements.shape[1])
    for row, missing in zip(bridged, motion.missing, strict=False):
        if missing.any() and not missing.all():
            row[missing] = np.interp(index[missing], index[~missing], row[~missing])
    return bridged


def _priors(system: WeakEquations, own: Bools) -> tuple[Floats, Floats]:
    """Means (p,) of the priors, and the information (p,) in them: 0 without one and of those that are not `own`."""
    parameters = system.structure_layout.structure.parameters
    means = np.array([parameter.start or 0.0 for parameter in parameters])
    return means, np.where(own, np.array([parameter.sigma for parameter in parameters]) ** -2.0, 0.0)


def _step(
    system: WeakEquations,
    noises: tuple[ResidualNoise, ...],
    theta: Floats,
    own: Bools,
    known: tuple[Floats, Floats],
    noise: Floats,
) -> tuple[Floats, float, tuple[Floats, ...], float]:
    """The step (p,) of the parameters, its largest part in standard errors, weighted residuals after it and chi-square.

    `known` are means and information of priors; `noise` (n + 2, N) is what the measured displacements have beside the motion
    of the `system`.
    """
    numbers, parts = np.flatnonzero(own), []
    normal, slope = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
    for patch, of_patch in zip(system.patches, noises, strict=True):
        residual = (patch.residual(theta).T + of_patch.passed(noise)) * patch.valid[:, None]
        whitened = of_patch.whitened(np.concatenate([columns_of(patch, numbers), residual[None]]))
        normal += whitened[:-1] @ whitened[:-1].T
        slope += whitened[:-1] @ whitened[-1]
        parts.append((of_patch, whitened))
    means, information = known
    normal += np.diag(information[own])
    scale = 1.0 / np.sqrt(np.maximum(normal.diagonal(), np.finfo(float).tiny))
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=_COLLINEAR, hermitian=True)
    scaled = -inverse @ (scale * (slope + (information * (theta - means))[own]))
    size = float(np.max(np.abs(scaled) / np.sqrt(inverse.diagonal()), initial=0.0))
    step = np.zeros(len(own))
    step[numbers] = scale * scaled
    residuals = tuple(
        of_patch.weighted(whitened[-1:] + step[None, numbers] @ whitened[:-1])[0]
        for of_patch, whitened in parts
    )
    cost = sum(np.sum(whitened[-1] ** 2) for _, whitened in parts)
    cost += (slope - (information * (theta + step - means))[own]) @ step[numbers]
    count = sum(patch.windows * len(patch.masses) for patch in system.patches) - len(numbers)
    return step, size, residuals, float(cost) / max(count, 1.0)


def _at(motion: MeasuredDisplacements, displacements: Floats) -> MeasuredDisplacements:
    """Displacements (n + 2, N) without noise in place of those measured."""
    return replace(
        motion,
        displacements=displacements,
        base=None if motion.base is None else displacements[-2],
        source_variance=np.zeros_like(motion.source_variance),
    )
