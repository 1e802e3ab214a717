"""The prediction of load cells by links alone on a rig, along the recorded motion."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, RecordError
from linkwise.estimates.uncertainty import Posterior
from linkwise.identification.validation.coefficients import uncertain
from linkwise.identification.validation.prediction import Prediction
from linkwise.likelihood.prescribed.fit import motion_deviations
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.records import BASE_CHANNEL, cell_name, cell_noise, rig_forces
from linkwise.likelihood.prescribed.search import Minimum, minimise
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_SUBSTEPS = 8  # between samples
_PRIOR = 1e-6  # of the normal matrix, for combinations of states that the start does not determine


def rig_channels(record: Record, structure: Structure) -> Record:
    """The motion of the base and the forces of the links; RecordError where the record does not hold them."""
    cells = [cell_name(structure, link) for link in range(len(structure.links))]
    shown = [name for name in cells if name in record.channels]
    if not shown or BASE_CHANNEL not in record.channels:
        raise RecordError(
            f"links alone on a rig are compared along {BASE_CHANNEL} with {', '.join(cells)}, and the record holds "
            f"{', '.join(record.channels)}"
        )
    return record.select([BASE_CHANNEL, *shown])


def rig_prediction(
    record: Record, structure: Structure, posterior: Posterior | None, burn: int, law_error: float
) -> tuple[Prediction, dict[str, float]]:
    """The forces by the laws, with states at the start from the first `burn` samples, and the noise by channel.

    That noise is of the load cell and of the motion, along which the forces are computed.
    """
    try:
        forces = rig_forces(record, structure)
    except IdentificationError as error:
        raise RecordError(str(error)) from None
    noise = cell_noise([record], structure)
    free = structure if posterior is None or not posterior.names else uncertain(posterior)
    problem = RigProblem(free, (forces,)).with_substeps(_SUBSTEPS)
    theta = np.array([structure.coefficient(p.name).value or 0.0 for p in free.parameters])
    minimum, covariance = _started(RigProblem(structure, (forces,)).with_substeps(_SUBSTEPS), noise, burn)
    minimum = Minimum(np.append(theta, minimum.unknowns), minimum.cost, minimum.paths, minimum.converged)
    count, cells = len(record), len(problem.links)
    slopes = problem.jacobian(minimum.paths).reshape(cells, count, -1)
    of_states, of_coefficients = slopes[..., len(theta) :], slopes[..., : len(theta)]
    moved = motion_deviations(problem, minimum).reshape(cells, count)
    every = problem.records[0].motion.substeps
    predicted = np.stack([path.force()[::every] for path in minimum.paths], axis=1)
    predicted[:burn] = np.nan
    spread = np.zeros((count, cells)) + law_error * np.nanstd(predicted, axis=0)
    order = [] if posterior is None else [posterior.names.index(p.name) for p in free.parameters]
    known = np.zeros((0, 0)) if posterior is None else posterior.beside_terms_kept[np.ix_(order, order)]
    motion = problem.records[0].motion
    prediction = Prediction(
        predicted=predicted,
        by_state=_variance(of_states, covariance),
        by_coefficients=_variance(of_coefficients, known),
        by_laws=spread**2,
        d=np.outer(motion.d[::every], structure.base_incidence),
        v=np.outer(motion.v[::every], structure.base_incidence),
        starts=1,
        window=None,
        horizon=None,
    )
    levels = {
        cell_name(structure, link): float(np.hypot(noise[link], np.sqrt(np.mean(moved[number] ** 2))))
        for number, link in enumerate(problem.links)
    }
    return prediction, levels


def _started(problem: RigProblem, noise: dict[int, float], burn: int) -> tuple[Minimum, Floats]:
    """The states at the start that explain the forces of the first `burn` samples best, and their covariance."""
    weights = np.concatenate(
        [
            np.where(np.arange(len(problem.cell(number))) < burn, 1.0 / noise[link], 0.0)
            for number, (_, link, _) in enumerate(problem.states)
        ]
    )
    start = np.zeros(problem.size)
    paths = problem.paths(start)
    if not all(path.converged for path in paths):
        raise RecordError("the states of a link run away along the recorded motion")
    minimum = minimise(problem, start, weights) if problem.size else Minimum(start, 0.0, paths, True)
    slopes = weights[:, None] * problem.jacobian(minimum.paths)
    normal = slopes.T @ slopes
    powers = np.concatenate([np.mean(path.states**2, axis=0) for path in minimum.paths])
    # a state that the start does not show, as behind backlash, is as uncertain as it is large later on
    normal += _PRIOR * np.diag(normal.diagonal()) + np.diag(1.0 / np.where(powers > 0.0, powers, 1.0))
    return minimum, np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _variance(slopes: Floats, covariance: Floats) -> Floats:
    """Variances (N, C) of forces with derivatives (C, N, q) by what has this covariance."""
    return np.asarray(np.einsum("cnq,qr,cnr->nc", slopes, covariance, slopes))
