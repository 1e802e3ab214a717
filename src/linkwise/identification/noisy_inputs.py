"""What noise of the inputs of a planned test does to the motion: forces along the motion that is expected, one of each sample.

Noise is normal and below half the sampling rate, and moves the response to the first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.likelihood.fisher_information import RandomInputs
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.likelihood.tests.columns import FittedMotion
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.record import Record


def noise_of_inputs(record: Record, structure: Structure, noise: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of the noise of the inputs among those of all channels.

    Raises IdentificationError for an input of which it cannot be allowed for.
    """
    stated = {name: float(sigma) for name, sigma in noise.items() if name in record.inputs}
    of_rates = {
        f"signal:{name}"
        for link in structure.links
        for _, rate in link.law.named_rates
        for name in link.law.signals
        if name in symbols(rate)
    }
    for name in stated:
        if name in of_rates or (name.endswith(f":{BASE}") and name != f"x:{BASE}"):
            raise IdentificationError(
                f"noise of {name} is not allowed for in limits of accuracy: that of forces, of x:{BASE} and of signals "
                "in forces of links is"
            )
    return stated


def random_inputs(
    segments: Segments,
    point: Iterate,
    scales: Scales,
    structure: Structure,
    noise: Mapping[str, float],
    refinement: int,
) -> RandomInputs:
    """The forces on masses by the noise of the inputs.

    Parameters
    ----------
    segments : Segments
        The test in segments, `refinement` steps of the flow a sample.
    point : Iterate
        The states and values that are expected.
    scales : Scales
        Units of the unknowns.
    structure : Structure
        The structure with its unknowns.
    noise : mapping of str to float
        Standard deviations of samples of the inputs, in SI units.
    refinement : int
        Steps in a sample.

    Returns
    -------
    RandomInputs
        Those, with an amplitude for each sample of each input.
    """
    misfit = evaluate(segments, point, scales, Gaussian())
    motion = FittedMotion(Optimum(segments, misfit, scales, 0.0, 1.0, Gaussian()), structure)
    every, sums, steps = [], [], 2 * refinement // segments.flow_steps_per_tangent
    for name, sigma in noise.items():
        pulls = _pulls(motion, structure, name)  # (2 J + 1, n, K)
        masses, places = np.flatnonzero(np.any(pulls, axis=(0, 2))), np.arange(len(pulls))
        samples = np.arange(0, len(pulls), steps)
        shapes = sigma * np.sinc((places[:, None] - samples) / steps)  # (2 J + 1, d)
        forces = (pulls[:, masses, None] * shapes[:, None, :, None]).reshape(len(pulls), -1, pulls.shape[2])
        acting = np.repeat(masses, len(samples))
        forces = forces.astype(np.float32)
        every.append(CandidateForces(np.full(len(acting), -1), acting, forces[::2], forces[1::2]))
        sums.append(np.tile(np.eye(len(samples)), (len(masses), 1)))
    return RandomInputs(reduce(CandidateForces.joined, every), scipy.linalg.block_diag(*sums))


def _pulls(motion: FittedMotion, structure: Structure, channel: str) -> Floats:
    """(2 J + 1, n, K) forces on the masses in N by an error of one of an input; of hits none between these."""
    kind, _, place = channel.partition(":")
    incidence = motion.segments.system.incidence
    if kind == "force":
        number = structure.mass_names.index(place)
        applied = motion.input(motion.applied[:, :, number])
        return np.asarray((applied != 0.0)[:, None] * np.eye(structure.size)[number][:, None])
    if kind == "signal":
        d, v, inside = motion.links
        number = len(motion.segments.system.states) + list(structure.signals).index(place)
        by_input = np.stack(
            [motion.mechanics.by_signal(number, *along) for along in zip(d, v, inside, strict=True)]
        )
    else:
        by_input = motion.segments.system.base[:, None] * motion.slopes[0]
    return np.asarray(-np.einsum("nl,jlk->jnk", incidence, by_input))
