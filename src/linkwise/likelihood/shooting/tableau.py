"""Runge-Kutta coefficients: Cooper and Verner's order 8 for the flow, Nystroem's order 4 for sensitivities.

The eleven stages of the former have their abscissae at the five Lobatto points of the step, so inputs are needed at five times
a step, and stages 0, 8 and 10 are accurate states at its start, middle and end, which the latter uses.

References
----------
G. J. Cooper and J. H. Verner, SIAM J. Numer. Anal. 9, 389 (1972).
"""

from __future__ import annotations

import numpy as np

_s = np.sqrt(21.0)

#: Lobatto points of a step, fractions of it.
POINTS = np.array([0.0, (7 - _s) / 14, 0.5, (7 + _s) / 14, 1.0])
#: Which of POINTS each stage is evaluated at.
STAGE_POINT = (0, 2, 2, 3, 3, 2, 1, 1, 2, 3, 4)
#: The stage whose state is the middle of the step.
MIDDLE = 8

_ROWS = (
    (),
    (1 / 2,),
    (1 / 4, 1 / 4),
    (1 / 7, (-7 - 3 * _s) / 98, (21 + 5 * _s) / 49),
    ((11 + _s) / 84, 0, (18 + 4 * _s) / 63, (21 - _s) / 252),
    ((5 + _s) / 48, 0, (9 + _s) / 36, (-231 + 14 * _s) / 360, (63 - 7 * _s) / 80),
    (
        (10 - _s) / 42,
        0,
        (-432 + 92 * _s) / 315,
        (633 - 145 * _s) / 90,
        (-504 + 115 * _s) / 70,
        (63 - 13 * _s) / 35,
    ),
    (1 / 14, 0, 0, 0, (14 - 3 * _s) / 126, (13 - 3 * _s) / 63, 1 / 9),
    (1 / 32, 0, 0, 0, (91 - 21 * _s) / 576, 11 / 72, (-385 - 75 * _s) / 1152, (63 + 13 * _s) / 128),
    (
        1 / 14,
        0,
        0,
        0,
        1 / 9,
        (-733 - 147 * _s) / 2205,
        (515 + 111 * _s) / 504,
        (-51 - 11 * _s) / 56,
        (132 + 28 * _s) / 245,
    ),
    (
        0,
        0,
        0,
        0,
        (-42 + 7 * _s) / 18,
        (-18 + 28 * _s) / 45,
        (-273 - 53 * _s) / 72,
        (301 + 53 * _s) / 72,
        (28 - 28 * _s) / 45,
        (49 - 7 * _s) / 18,
    ),
)
STAGES = len(_ROWS)
WEIGHTS = np.array([1 / 20, 0, 0, 0, 0, 0, 0, 49 / 180, 16 / 45, 49 / 180, 1 / 20])


def _second_order() -> tuple[np.ndarray, np.ndarray]:
    """Rewrite the table for x'' = a: stage values as rows over (x, u, k_0, k_1, ...) with u = h v, k = h^2 a.

    Returns (STAGES, 2, 2 + STAGES) for the stages and (2, STAGES) for the closing sums of k.
    """
    table = np.zeros((STAGES, STAGES))
    for i, row in enumerate(_ROWS):
        table[i, : len(row)] = row
    stages = np.zeros((STAGES, 2, 2 + STAGES))
    stages[:, 0, 0] = 1.0
    stages[:, 0, 1] = table.sum(axis=1)
    stages[:, 1, 1] = 1.0
    stages[:, 0, 2:] = table @ table
    stages[:, 1, 2:] = table
    return stages, np.stack([WEIGHTS @ table, WEIGHTS])


STAGE_ROWS, CLOSING = _second_order()

#: Nystroem's method of order 4 (order 3 in the rates): rows over (d, h v, k_0, k_1) and closing sums of the pulls.
TANGENT_MIDDLE = np.array([[1, 1 / 2, 1 / 8], [0, 1, 1 / 2]], np.float32)
TANGENT_END = np.array([[1, 1, 0, 1 / 2], [0, 1, -1, 2]], np.float32)
TANGENT_CLOSING = np.array([[1 / 6, 1 / 3, 0], [1 / 6, 2 / 3, 1 / 6]], np.float32)
