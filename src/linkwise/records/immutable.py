"""Arrays that nobody can change."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats


def read_only(values: ArrayLike) -> Floats:
    """`values` as a read-only float64 array in C order, copied unless it is one already."""
    array = np.asarray(values)
    if array.flags.writeable or array.dtype != np.float64 or not array.flags.c_contiguous:
        array = np.array(array, dtype=np.float64, order="C")
        array.setflags(write=False)
    return array
