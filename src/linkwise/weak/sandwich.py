"""The covariance H^-1 J H^-1 of the coefficients of a large structure, near the diagonal only.

All of it would be dense. What is near follows from (H + i e J)^-1 = H^-1 - i e H^-1 J H^-1 + O(e^2): for an e whose square
is nothing beside 1, the imaginary part is the covariance to rounding (Squire and Trapp 1998). Ordered so that H and J are
block tridiagonal, that inverse is known near its diagonal after one sweep down the blocks and one up (Takahashi 1973). Time
and memory are linear in the structure while it is a chain of parts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from linkwise.arrays import Floats, Indices

_STEP = 1e-30  # e, beside matrices of order 1


def sandwich(h: csc_array, j: csc_array, rows: Indices, columns: Indices) -> Floats:
    """Entries (k,) of h^-1 j h^-1 at `rows` and `columns` (k,), places where h or j is not empty.

    `h` (p, p) is symmetric and positive definite, `j` (p, p) symmetric.
    """
    scale = 1.0 / np.sqrt(h.diagonal())
    scaled = [each.multiply(scale[:, None]).multiply(scale).tocoo() for each in (h, j)]
    step = _STEP / max(float(np.max(np.abs(scaled[1].data), initial=0.0)), np.finfo(float).tiny)
    place = np.empty(len(scale), dtype=np.intp)
    place[reverse_cuthill_mckee((abs(h) + abs(j)).tocsr(), symmetric_mode=True)] = np.arange(len(scale))
    near, beside = _inverse(
        place[np.concatenate([each.row for each in scaled])],
        place[np.concatenate([each.col for each in scaled])],
        np.concatenate([scaled[0].data.astype(complex), 1j * step * scaled[1].data]),
        len(scale),
    )
    size = near.shape[1]
    first, last = np.minimum(place[rows], place[columns]), np.maximum(place[rows], place[columns])
    block, inside = np.divmod(first, size)
    other, along = np.divmod(last, size)
    found = np.where(other == block, near[block, inside, along], beside[block, inside, along])
    return np.asarray(-found.imag / step * scale[rows] * scale[columns])


def _inverse(
    rows: Indices, columns: Indices, data: NDArray[np.complex128], count: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The inverse of a symmetric matrix, sum of `data` at `rows` and `columns`, in blocks as wide as its band.

    Its blocks on the diagonal (K, b, b), and to the right of them (K, b, b), the last one of those without meaning.
    """
    size = max(int(np.max(np.abs(rows - columns))), 1)
    blocks = -(-count // size)
    diagonal, right = np.zeros((2, blocks, size, size), dtype=complex)
    spare = np.arange(count, blocks * size) % size
    diagonal[-1, spare, spare] = 1.0
    block, inside = np.divmod(rows, size)
    step, along = columns // size - block, columns % size
    for target, here in ((diagonal, step == 0), (right, step == 1)):
        np.add.at(target, (block[here], inside[here], along[here]), data[here])
    inverses = [np.linalg.inv(diagonal[0])]
    for k in range(1, blocks):
        coupling = right[k - 1].copy()
        right[k - 1] = inverses[-1] @ coupling
        inverses.append(np.linalg.inv(diagonal[k] - coupling.T @ right[k - 1]))
    near, beside = np.stack(inverses), np.zeros_like(right)
    for k in reversed(range(blocks - 1)):
        beside[k] = -right[k] @ near[k + 1]
        near[k] -= beside[k] @ right[k].T
    return near, beside
