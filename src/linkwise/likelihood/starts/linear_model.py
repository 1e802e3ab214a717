"""A linear system in samples, with random inputs and noise."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np

from linkwise.arrays import Floats


@dataclass(frozen=True, eq=False)
class LinearModel:
    """z_k+1 = transition z_k + drive u_k + w_k, y_k = observation z_k + direct u_k + e_k.

    Attributes
    ----------
    transition, process : array of shape (m, m)
        Transition over a sample, and covariance of w.
    observation : array of shape (C, m)
        What the channels show.
    noise : array of shape (C,)
        Variances of e.
    drive, direct : array of shape (m, r) and (C, r)
        Effect of known inputs.
    first : array of shape (m, m)
        Covariance of the first state, which has the mean 0.
    """

    transition: Floats
    process: Floats
    observation: Floats
    noise: Floats
    drive: Floats
    direct: Floats
    first: Floats


def recursion(matrix: Floats, first: Floats, added: Floats) -> Floats:
    """States of a stable system, in blocks side by side.

    Parameters
    ----------
    matrix : array of shape (m, m)
        Transition over a sample.
    first : array of shape (m,)
        The state z_0.
    added : array of shape (N, m)
        What is added: z_k+1 = `matrix` z_k + `added`_k.

    Returns
    -------
    array of shape (N + 1, m)
        The states.
    """
    count, m = added.shape
    length = max(1, isqrt(count))
    blocks = -(-count // length)
    states = np.zeros((blocks * length, m))
    states[:count] = added
    states = states.reshape(blocks, length, m)
    powers, starts = np.empty((length, m, m)), np.empty((blocks, m))
    powers[0] = matrix
    for k in range(1, length):  # as if every block started at 0
        states[:, k] += states[:, k - 1] @ matrix.T
        np.matmul(powers[k - 1], matrix, out=powers[k])
    starts[0] = first
    for block in range(1, blocks):
        starts[block] = powers[-1] @ starts[block - 1] + states[block - 1, -1]
    states += np.matmul(starts, powers.transpose(0, 2, 1)).transpose(1, 0, 2)
    return np.concatenate([first[None], states.reshape(-1, m)[:count]])
