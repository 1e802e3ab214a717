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


@dataclass(frozen=True, eq=False)
class InnerStretches:
    """The points of stretches but for those between centres whose sums would have windows outside, a few at each end.

    The others between centres are shared where stretches overlap, so that they cost less than those of `Stretches`, and sums
    of squares over them are hardly smaller.

    Attributes
    ----------
    window, thinning, ranges
        As of `Stretches`.
    """

    window: Window
    thinning: int
    ranges: tuple[tuple[int, int], ...]

    @cached_property
    def _whole(self) -> tuple[int, int]:
        """The windows that hold all stretches, from a multiple of twice the distance of the points."""
        first, spacing = min(first for first, _ in self.ranges), 2 * self.thinning
        return first // spacing * spacing, max(last for _, last in self.ranges)

    @cached_property
    def _shared(self) -> tuple[Indices, Indices]:
        """The windows next to the points between centres, of the two phases that `Window.adjoint` samples."""
        thinned = np.arange(*self._whole, self.thinning)
        return thinned[::2], thinned[1::2]

    @cached_property
    def inside(self) -> slice:
        """Where the points between centres are."""
        return slice(0, sum(map(len, self._shared)))

    @cached_property
    def windows(self) -> Indices:
        """(P,) the windows next to points between centres, and then of each stretch `half` times the first and the last."""
        ends = [(first, last - 1) for first, last in self.ranges]
        return np.concatenate([*self._shared, np.repeat(np.ravel(ends), self.window.half)])

    @cached_property
    def parts(self) -> list[slice]:
        """Where the points of the first phase in each stretch are, also those whose sums would have windows outside."""
        return [slice(*np.searchsorted(self._shared[0], ends).tolist()) for ends in self.ranges]

    def adjoint(self, rows: Floats) -> Floats:
        """Sums of kernels over windows at the points; arguments and shapes as of `Stretches.adjoint`."""
        shared = self.window.adjoint(rows[:, slice(*self._whole)], self.thinning)[:, :, self.inside]
        return np.concatenate(
            [shared, *(self.window.edges(rows[:, first:last]) for first, last in self.ranges)], axis=2
        )

    def products(self, sums: Floats) -> Floats:
        """(E, s, s) products of sums (s, P) over the points of each stretch."""
        edges = sums[:, self.inside.stop :].reshape(len(sums), len(self.ranges), -1).transpose(1, 0, 2)
        total, first, margin = edges @ edges.transpose(0, 2, 1), 0, self.window.neighbours + 1
        for windows in self._shared:
            for of_stretch, (low, high) in zip(total, self.ranges, strict=True):
                ends = first + np.searchsorted(windows, (low + margin, max(high - margin, low + margin)))
                part = sums[:, slice(*ends.tolist())]
                of_stretch += part @ part.T
            first += len(windows)
        return total
