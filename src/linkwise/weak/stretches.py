"""Stretches of consecutive windows of a record, over each of which sums are formed: the whole record, or pieces of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.window import Window


@dataclass(frozen=True, eq=False)
class Stretches:
    """E stretches of the windows of a record, which may share windows.

    Attributes
    ----------
    window : Window
        The test functions.
    thinning : int
        Stride in windows of the points that represent all samples.
    ranges : tuple of tuple of int
        The first window of each stretch, and the one behind its last.
    """

    window: Window
    thinning: int
    ranges: tuple[tuple[int, int], ...]

    @cached_property
    def _sizes(self) -> list[int]:
        """Numbers of points."""
        return [len(self.window.adjoint_windows(last - first, self.thinning)) for first, last in self.ranges]

    @cached_property
    def windows(self) -> Indices:
        """(P,) windows next to the points of all stretches, one stretch after the other, each as `Window.adjoint_windows`."""
        own = [
            first + self.window.adjoint_windows(last - first, self.thinning) for first, last in self.ranges
        ]
        return np.concatenate(own)

    @cached_property
    def parts(self) -> list[slice]:
        """Where the points of each stretch are."""
        ends = np.cumsum([0, *self._sizes]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]

    @cached_property
    def inside(self) -> Indices | slice:
        """Where the points between the first and the last centre of their stretch are."""
        edge = 2 * self.window.half
        if len(self.ranges) == 1:
            return slice(0, self._sizes[0] - edge)
        return np.concatenate([np.arange(part.start, part.stop - edge) for part in self.parts])

    @cached_property
    def parts_inside(self) -> list[slice]:
        """Where each stretch is among the points `inside`."""
        ends = np.cumsum([0, *(size - 2 * self.window.half for size in self._sizes)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]

    def adjoint(self, rows: Floats) -> Floats:
        """Sums of kernels over the windows of each stretch, as of `Window.adjoint`.

        Parameters
        ----------
        rows : array of shape (S, R)
            Weights of the windows of the record.

        Returns
        -------
        array of shape (K, S, P)
            The sums.
        """
        own = [self.window.adjoint(rows[:, first:last], self.thinning) for first, last in self.ranges]
        return own[0] if len(own) == 1 else np.concatenate(own, axis=2)

    def products(self, sums: Floats) -> Floats:
        """Products of sums over the points of each stretch.

        Parameters
        ----------
        sums : array of shape (s, P)
            The sums.

        Returns
        -------
        array of shape (E, s, s)
            The products.
        """
        return np.stack([sums[:, part] @ sums[:, part].T for part in self.parts])
