"""The covariance H^-1 J H^-1 of the coefficients of a large structure, near the diagonal only.

The whole matrix would be dense. Entries near the diagonal follow from the complex step (Squire and Trapp 1998): the imaginary
part of (H + i e J)^-1 = H^-1 - i e H^-1 J H^-1 + O(e^2), for an e whose square is below rounding. Ordered so that H and J are
block tridiagonal, that inverse follows near its diagonal from one sweep down the blocks and one up (Takahashi 1973). Time and
memory are linear in the number of coefficients for chains of parts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from linkwise.arrays import Floats, Indices

_STEP = 1e-30  # e, right_blocks matrices of order 1


def sandwich(h: csc_array, j: csc_array, rows: Indices, columns: Indices) -> Floats:
    """Entries of h^-1 j h^-1 where h or j has entries.

    Parameters
    ----------
    h : sparse array of shape (p, p)
        Symmetric and positive definite.
    j : sparse array of shape (p, p)
        Symmetric.
    rows, columns : array of int, shape (k,)
        Positions of the entries.

    Returns
    -------
    array of shape (k,)
        The entries.

    References
    ----------
    W. Squire and G. Trapp, SIAM Rev. 40, 110 (1998); K. Takahashi, J. Fagan and M.-S. Chin, Proc. 8th PICA Conf., 63 (1973).
    """
    scale = 1.0 / np.sqrt(h.diagonal())
    scaled = [matrix.multiply(scale[:, None]).multiply(scale).tocoo() for matrix in (h, j)]
    step = _STEP / max(float(np.max(np.abs(scaled[1].data), initial=0.0)), np.finfo(float).tiny)
    position = np.empty(len(scale), dtype=np.intp)
    position[reverse_cuthill_mckee((abs(h) + abs(j)).tocsr(), symmetric_mode=True)] = np.arange(len(scale))
    diagonal_blocks, right_blocks = _inverse(
        position[np.concatenate([matrix.row for matrix in scaled])],
        position[np.concatenate([matrix.col for matrix in scaled])],
        np.concatenate([scaled[0].data.astype(complex), 1j * step * scaled[1].data]),
        len(scale),
    )
    size = diagonal_blocks.shape[1]
    first, last = np.minimum(position[rows], position[columns]), np.maximum(position[rows], position[columns])
    block, inside = np.divmod(first, size)
    last_block, along = np.divmod(last, size)
    values = np.where(
        last_block == block, diagonal_blocks[block, inside, along], right_blocks[block, inside, along]
    )
    return np.asarray(-values.imag / step * scale[rows] * scale[columns])


def _inverse(
    rows: Indices, columns: Indices, data: NDArray[np.complex128], count: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The inverse of a symmetric matrix, sum of `data` at `rows` and `columns`, in blocks as wide as its band.

    Its blocks on the diagonal (K, b, b), and to the right of them (K, b, b), the last one of those without meaning.
    """
    size = max(int(np.max(np.abs(rows - columns))), 1)
    blocks = -(-count // size)
    diagonal, right = np.zeros((2, blocks, size, size), dtype=complex)
    padding = np.arange(count, blocks * size) % size
    diagonal[-1, padding, padding] = 1.0
    block, inside = np.divmod(rows, size)
    step, along = columns // size - block, columns % size
    for target, chosen in ((diagonal, step == 0), (right, step == 1)):
        np.add.at(target, (block[chosen], inside[chosen], along[chosen]), data[chosen])
    inverses = [np.linalg.inv(diagonal[0])]
    for k in range(1, blocks):
        coupling = right[k - 1].copy()
        right[k - 1] = inverses[-1] @ coupling
        inverses.append(np.linalg.inv(diagonal[k] - coupling.T @ right[k - 1]))
    diagonal_blocks, right_blocks = np.stack(inverses), np.zeros_like(right)
    for k in reversed(range(blocks - 1)):
        right_blocks[k] = -right[k] @ diagonal_blocks[k + 1]
        diagonal_blocks[k] -= right_blocks[k] @ right[k].T
    return diagonal_blocks, right_blocks
