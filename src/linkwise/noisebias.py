"""What noise adds to the products of atoms, window by window.

Two atoms of one equation see the same noise, so their product is biased even where each of them is right on average; that is
what makes ordinary regression wrong when noise grows (errors in variables; Fuller, Measurement Error Models, 1987). For
functions h, g of elongations d, d' whose noises have the covariance c, with h and g free of bias (`weakform`), the bias of
h(d) g(d') at one sample is

    c h' g' - c^2/2 h'' g'' + c^3/6 h''' g''' - ...

and in a window it is the sum of that over its samples, weighted by the product of both kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.atoms import Atom
from linkwise.weakform import PHI_2
from linkwise.window import Window

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Biases:
    """The biases of the products of p atoms of one mass: `constant` (p, p) in every window, and some that vary.

    `varying` lists (i, j, (R,)) with i <= j, to be added to the constant at (i, j) and (j, i).
    """

    constant: Floats
    varying: tuple[tuple[int, int, Floats], ...]

    def total(self, valid: Floats | None, windows: int) -> Floats:
        """(p, p): the sum over the windows that are `valid` (R,), or over all."""
        total = self.constant * (windows if valid is None else valid.sum())
        for i, j, bias in self.varying:
            amount = bias.sum() if valid is None else bias @ valid
            total[i, j] += amount
            if i != j:
                total[j, i] += amount
        return total


class BiasPlan:
    """Collects what must be filtered for the biases of all masses, so that it is filtered in a few large products."""

    def __init__(self, atoms: Sequence[Atom], window: Window) -> None:
        self.atoms, self.window = atoms, window
        self.gram = window.kernels @ window.kernels.T
        self.kernel = np.array([atom.kernel for atom in atoms], dtype=int)
        self.slope = np.array([atom.slope if isinstance(atom.slope, float) else 0.0 for atom in atoms])
        self.sign = np.array([atom.sign for atom in atoms])
        self.curved = [not isinstance(atom.slope, float) for atom in atoms]
        self.signals: dict[object, tuple[int, int, Floats]] = {}

    def constant(self, which: NDArray[np.intp], covariance: Floats) -> Floats:
        """(p + 1, p + 1): biases that are equal in all windows; the last row is the inertia, whose h is x itself.

        `covariance` is that of the noises in the elongations away from the mass and in its displacement.
        """
        kernel = np.append(self.kernel[which], PHI_2)
        slope = np.append(self.slope[which] * self.sign[which], 1.0)
        return np.outer(slope, slope) * covariance * self.gram[np.ix_(kernel, kernel)]

    def varying(
        self, which: NDArray[np.intp], signs: Floats, covariance: Floats
    ) -> list[tuple[int, int, object, float]]:
        """(i, j, key of a filtered signal, factor) for the biases that follow the motion; the signals are noted."""
        found = []
        last = len(which)
        for i, a in enumerate(which):
            if not self.curved[a]:
                continue
            for j in range(last + 1):
                if covariance[i, j] == 0.0:
                    continue
                if j == last:
                    found.append((i, j, self._slope_signal(a, PHI_2), covariance[i, j] * self.sign[a]))
                elif not self.curved[which[j]]:
                    factor = covariance[i, j] * self.sign[a] * self.sign[which[j]] * self.slope[which[j]]
                    if factor != 0.0:
                        found.append((i, j, self._slope_signal(a, int(self.kernel[which[j]])), factor))
                elif i <= j:
                    key = self._product_signal(a, which[j], covariance[i, j], signs[i] * signs[j])
                    found.append((i, j, key, self.sign[a] * self.sign[which[j]]))
        return found

    def _slope_signal(self, atom: int, kernel: int) -> object:
        key = (atom, kernel)
        if key not in self.signals:
            self.signals[key] = (int(self.kernel[atom]), kernel, np.asarray(self.atoms[atom].slope))
        return key

    def _product_signal(self, one: int, two: int, covariance: float, orientation: float) -> object:
        key = (one, two, covariance, orientation)
        if key not in self.signals:
            total: Floats | float = 0.0
            factor = -1.0 / orientation
            derivatives = zip(self.atoms[one].chain[1:], self.atoms[two].chain[1:], strict=False)
            for order, (h, g) in enumerate(derivatives, start=1):
                factor *= -covariance * orientation / order
                total = total + factor * h * g
            whole = np.broadcast_to(np.asarray(total, dtype=float), np.shape(self.atoms[one].slope))
            self.signals[key] = (int(self.kernel[one]), int(self.kernel[two]), whole)
        return key

    def filtered(self) -> dict[object, Floats]:
        """Every noted signal under the product of its two kernels: key -> (R,)."""
        groups: dict[tuple[int, int], list[object]] = {}
        for key, (first, second, _) in self.signals.items():
            groups.setdefault((min(first, second), max(first, second)), []).append(key)
        found: dict[object, Floats] = {}
        for (first, second), keys in groups.items():
            kernel = (self.window.kernels[first] * self.window.kernels[second])[None]
            signals = np.stack([self.signals[key][2] for key in keys])
            found.update(zip(keys, self.window.filter(signals, kernel)[0], strict=True))
        return found
