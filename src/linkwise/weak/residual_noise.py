"""Covariance of the residuals of weak equations due to noise, over masses and windows, as a banded matrix with its factor.

The residual of window k in the equation of mass i has the noise e of each displacement under

    Z = m phi'' + k(t) phi - c(t) phi'

with the slopes k and c of the laws at every sample, so that its covariance is Z D Z', D the variances of the noise. Windows
farther apart than one length share no sample. Near a resonance inertia and stiffness nearly cancel: there residuals have
little noise, which the inverse of the covariance gives its weight (Aitken, Proc. R. Soc. Edinburgh 55, 42, 1935).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.weak.banded_triangle import BandedTriangle
from linkwise.weak.equations import WeakEquations
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import slopes_of_links
from linkwise.weak.weak_form import INNER, PHI, PHI_1, PHI_2
from linkwise.weak.window import Window

_FLOOR = 1e-8  # of the mean variance: what rounding leaves of the smallest ones


@dataclass(frozen=True, eq=False)
class ResidualNoise:
    """How the noise of displacements enters the residuals of a patch, and the factor of their covariance.

    Attributes
    ----------
    window : Window
        The test functions.
    variance : array of shape (c,)
        Variances of the noise of the nodes in m^2.
    kernels : mapping of (int, int) to array of shape (T, R)
        By position of the mass in the patch and node, what the samples of the node under each window are multiplied by.
    factor : array of shape (b, m R)
        Lower Cholesky factor L in bands; the m equations of a window stand together. Windows with missing samples are apart.
    triangle : BandedTriangle
        The same in blocks.
    """

    window: Window
    variance: Floats
    kernels: Mapping[tuple[int, int], Floats]
    factor: Floats
    triangle: BandedTriangle

    @classmethod
    def of(
        cls,
        patch: Patch,
        system: WeakEquations,
        variance: Floats,
        values: Floats,
        motion: tuple[Floats, Floats],
    ) -> ResidualNoise:
        """The noise of the residuals of a patch of masses.

        Parameters
        ----------
        patch : Patch
            The equations.
        system : WeakEquations
            All equations of the record.
        variance : array of shape (n + 2,)
            Variances of the noise of the nodes in m^2.
        values : array of shape (p,)
            The parameters.
        motion : tuple of array of shape (n + 2, N)
            Displacements in m and rates in m/s at which laws have their slopes.

        Returns
        -------
        ResidualNoise
            The noise.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the covariance is not positive definite.
        """
        window, layout, count = system.window, patch.layout, system.windows
        d, v = (system.structure_layout.elongations(x, layout.links.tolist()) for x in motion)
        slopes = slopes_of_links(layout, values, d, v)
        inertia = layout.inertia.at(values)[:, None] * window.kernels[PHI_2]
        kernels = {}
        for mass, coupling in enumerate(layout.noise_couplings):
            for node, own, passed in zip(
                coupling.sources.tolist(), coupling.inertia, coupling.passed, strict=True
            ):
                kernel = np.zeros((window.length, count))
                for first, chosen in ((0, ~coupling.inner), (INNER, coupling.inner)):
                    if first and not chosen.any():
                        continue
                    under = np.lib.stride_tricks.sliding_window_view(
                        passed[chosen] @ slopes[:, coupling.links[chosen]], window.length, axis=1
                    )
                    stiffness, damping = under[:, :: window.stride][:, :count].transpose(0, 2, 1)
                    kernel += stiffness * window.kernels[first + PHI][:, None]
                    kernel -= damping * window.kernels[first + PHI_1][:, None]
                if own:
                    kernel += own * inertia[mass][:, None]
                if not patch.valid.all():
                    kernel *= patch.valid
                kernels[mass, node] = kernel
        reach = 1 + (window.length - 1) // window.stride
        band = np.zeros((reach * len(layout.masses), count * len(layout.masses)))
        for row, columns, products in _products(kernels, variance, window, len(layout.masses)):
            band[row, columns] += products
        mean = band[0].reshape(count, -1).mean(axis=0)
        apart = np.where(patch.valid > 0.0, _FLOOR, 1.0)
        band[0] += (apart[:, None] * mean).ravel()
        factor = scipy.linalg.cholesky_banded(band, lower=True, overwrite_ab=True)
        return cls(window, variance, kernels, factor, BandedTriangle.of(factor))

    def whitened(self, columns: Floats) -> Floats:
        """Columns as white noise of variance 1 would have them: sums of their products have the weight of the covariance.

        Parameters
        ----------
        columns : array of shape (s, R, m)
            The columns.

        Returns
        -------
        array of shape (s, m R)
            The columns multiplied by the inverse of L.
        """
        return np.asarray(self.triangle.forward(columns.reshape(len(columns), -1).T).T)

    def weighted(self, whitened: Floats) -> Floats:
        """What `whitened` columns are multiplied by the inverse of the covariance.

        Parameters
        ----------
        whitened : array of shape (s, m R)
            The columns, whitened.

        Returns
        -------
        array of shape (s, R, m)
            The products.
        """
        masses = 1 + max(mass for mass, _ in self.kernels)
        return np.asarray(self.triangle.backward(whitened.T).T.reshape(len(whitened), -1, masses))

    def passed(self, displacements: Floats) -> Floats:
        """What small changes of displacements add to the residuals.

        Parameters
        ----------
        displacements : array of shape (c, N)
            The changes in m of the nodes.

        Returns
        -------
        array of shape (R, m)
            Changes of the residuals.
        """
        under = np.lib.stride_tricks.sliding_window_view(displacements, self.window.length, axis=1)
        under = under[:, :: self.window.stride]
        masses = 1 + max(mass for mass, _ in self.kernels)
        total = np.zeros((under.shape[1], masses))
        for (mass, node), kernel in self.kernels.items():
            total[:, mass] += np.einsum("tr,rt->r", kernel, under[node])
        return total

    def likeliest(self, weighted: Floats, samples: int) -> Floats:
        """The likeliest noise of displacements that gives residuals.

        Parameters
        ----------
        weighted : array of shape (R, m)
            The residuals, multiplied by the inverse of their covariance.
        samples : int
            Length N of the record.

        Returns
        -------
        array of shape (c, N)
            Noise of the nodes in m.
        """
        noise, stride = np.zeros((len(self.variance), samples)), self.window.stride
        for (mass, node), kernel in self.kernels.items():
            acting = self.variance[node] * weighted[:, mass]
            for sample, of_sample in enumerate(kernel):
                noise[node, sample : sample + stride * len(acting) : stride][: len(acting)] += (
                    acting * of_sample
                )
        return noise


def _products(
    kernels: Mapping[tuple[int, int], Floats], variance: Floats, window: Window, masses: int
) -> Iterator[tuple[int, slice, Floats]]:
    """Parts of the covariance in the lower bands: row, columns, and what is added to these."""
    stride, length = window.stride, window.length
    reach = 1 + (length - 1) // stride
    for (first, node), early in kernels.items():
        for (second, node_of_late), late in kernels.items():
            if node_of_late != node or variance[node] <= 0.0:
                continue
            for lag in range(0 if second >= first else 1, reach):
                rows = early.shape[1] - lag
                overlap = early[lag * stride :, :rows], late[: length - lag * stride, lag:]
                products = variance[node] * np.einsum("tr,tr->r", *overlap)
                yield lag * masses + second - first, slice(first, rows * masses, masses), products
