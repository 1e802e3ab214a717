"""The likeliest motion and coefficients near those of the weak form: Gauss-Newton on the noise of all displacements together.

The weak form weights every window alike. Here residuals have the weight that the covariance of their noise gives them
(`residual_noise`), and the likeliest noise is taken out of the displacements, until the coefficients rest or nearly so, as in
generalised nonlinear least squares (Britt and Luecke, Technometrics 15, 233, 1973). The noise that is left in the motion is
independent of that in the residuals, so that products of both have no bias. Windows are a standard deviation apart: closer
ones would see motion beyond their band, on which chaotic structures depend so much that the steps do not converge.

Solutions of many columns with the Cholesky factor of a banded matrix.

LAPACK solves a banded triangle column by column, at the speed of memory. In blocks as wide as the band it has one triangle and
one square a block, and all columns go through both at once by products of blocks (Golub and Van Loan, "Matrix computations",
4th edition 2013, section 4.5.1).

Covariance of the residuals of weak equations due to noise, over masses and windows, as a banded matrix with its factor.

The residual of window k in the equation of mass i has the noise e of each displacement under

    Z = m phi'' + k(t) phi - c(t) phi'

with the slopes k and c of the laws at every sample, so that its covariance is Z D Z', D the variances of the noise. Windows
farther apart than one length share no sample. Near a resonance inertia and stiffness nearly cancel: there residuals have
little noise, which the inverse of the covariance gives its weight (Aitken, Proc. R. Soc. Edinburgh 55, 42, 1935).

Forces of links along the smoothed motion, also where they have states that are measured or eliminated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.linalg import blas

from linkwise.arrays import Bools, Floats, Indices
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.displacements import Elimination, MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import slopes_of_links
from linkwise.weak.weak_form import INNER, PHI, PHI_1, PHI_2
from linkwise.weak.window import Window, smoothed_motion


@dataclass(frozen=True, eq=False)
class BandedTriangle:
    """A lower triangle L of N rows in K blocks of b rows, of which the last is filled up with those of the unit matrix.

    Attributes
    ----------
    diagonal : array of shape (K, b, b)
        Its blocks, transposed: upper triangles; what is below these is of no meaning.
    below : array of shape (K - 1, b, b)
        What each block but the first has of the one before it, transposed.
    size : int
        N.
    """

    diagonal: Floats
    below: Floats
    size: int

    @classmethod
    def of(cls, bands: Floats) -> BandedTriangle:
        """The blocks of a triangle.

        Parameters
        ----------
        bands : array of shape (b, N)
            Its bands, the diagonal first, as `scipy.linalg.cholesky_banded` gives them.

        Returns
        -------
        BandedTriangle
            The triangle.
        """
        b, size = bands.shape
        columns, full, count = bands.T, size // b, -(-size // b)
        whole, last = columns[: full * b].reshape(full, b, b), columns[full * b :]
        diagonal, below = np.empty((count, b, b)), np.zeros((count - 1, b, b))
        if len(last):
            diagonal[full] = np.eye(b)
        for number in range(b):
            diagonal[:full, number, number:] = whole[:, number, : b - number]
            below[:, number, :number] = whole[: count - 1, number, b - number :]
        for number, column in enumerate(last):
            diagonal[full, number, number : len(last)] = column[: len(last) - number]
        return cls(diagonal, below, size)

    def forward(self, columns: Floats) -> Floats:
        """Solve with the triangle.

        Parameters
        ----------
        columns : array of shape (N, s)
            The columns.

        Returns
        -------
        array of shape (N, s)
            The solution y of L y = columns.
        """
        blocks = self._blocks(columns)
        for number, own in enumerate(blocks):
            if number:
                own -= self.below[number - 1].T @ blocks[number - 1]
            blas.dtrsm(1.0, self.diagonal[number].T, own.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        return np.asarray(blocks.reshape(-1, columns.shape[1])[: self.size])

    def backward(self, columns: Floats) -> Floats:
        """Solve with the transpose of the triangle.

        Parameters
        ----------
        columns : array of shape (N, s)
            The columns.

        Returns
        -------
        array of shape (N, s)
            The solution y of L' y = columns.
        """
        blocks = self._blocks(columns)
        for number in range(len(blocks) - 1, -1, -1):
            own = blocks[number]
            if number + 1 < len(blocks):
                own -= self.below[number] @ blocks[number + 1]
            blas.dtrsm(1.0, self.diagonal[number].T, own.T, side=1, lower=1, overwrite_b=1)
        return np.asarray(blocks.reshape(-1, columns.shape[1])[: self.size])

    def _blocks(self, columns: Floats) -> Floats:
        """(K, b, s) a copy of columns (N, s), filled up with zeros."""
        count, b, _ = self.diagonal.shape
        blocks = np.zeros((count * b, columns.shape[1]))
        blocks[: self.size] = columns
        return blocks.reshape(count, b, -1)


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


_DISTANCE = 1.0  # standard deviations of a test function from one window to the next
_ROUNDS = (2, 5)  # at least, so that noise has left the motion, and at most
_AT_REST = 0.5  # standard errors: what a score loses by such a step is far less than its own error
_NEAR = 10.0
"""Standard errors: the last step that is accepted where a law lacks a term or the motion is chaotic, so that the steps do not
rest. Scores are taken beside the coefficients, which leaves them as they are to first order."""
_COLLINEAR = 1e-12


@dataclass(frozen=True, eq=False)
class LikelyMotion:
    """A structure at its likeliest motion.

    Attributes
    ----------
    system : WeakEquations
        The equations along the motion, which has no noise.
    noises : tuple of ResidualNoise
        Noise of the residuals of each patch.
    residuals : tuple of array of shape (R, m)
        The residuals of each patch, multiplied by the inverse of their covariance.
    values : array of shape (p,)
        The parameters.
    chi_square : float
        Sum of the squares of the residuals, weighted by their covariance, over its degrees of freedom: 1 for right laws.
    priors : array of shape (2, p)
        What priors of the parameters add to the sums of products of their columns, and to the slope by them; 0 without priors.
    """

    system: WeakEquations
    noises: tuple[ResidualNoise, ...]
    residuals: tuple[Floats, ...]
    values: Floats
    chi_square: float
    priors: Floats


def likely_motion(
    record: Record,
    structure: Structure,
    equations: WeakEquations,
    values: Mapping[str, float],
    free: Collection[str],
) -> LikelyMotion | None:
    """The likeliest motion of a structure and its coefficients with their priors, starting with those of the weak form.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns; those without one of the `values` are 0.
    equations : WeakEquations
        Equations on the record that the weak form has solved.
    values : mapping of str to float
        Their solution.
    free : collection of str
        The unknowns that are estimated; the others stay as they are.

    Returns
    -------
    LikelyMotion or None
        None where the steps do not come near to rest.

    Raises
    ------
    IdentificationError
        As `weak_equations`.
    numpy.linalg.LinAlgError
        If the covariance of the residuals is not positive definite.
    """
    window = equations.window
    measured = bridged(equations.motion)
    motion = smoothed_motion(measured, window)
    present = dict(values)
    for number in range(_ROUNDS[1]):
        system = weak_equations(
            record,
            structure,
            _at(equations.motion, motion[0]),
            window=window.spaced(_DISTANCE),
            rate_window=window,
            values=present,
        )
        names = system.parameters
        theta = np.array([present.get(name, 0.0) for name in names])
        own = np.array([name in free for name in names])
        noises = tuple(
            ResidualNoise.of(patch, system, equations.motion.floored_variance, theta, motion)
            for patch in system.patches
        )
        known = _priors(system, own)
        step, size, residuals, chi_square = _step(system, noises, theta, own, known, measured - motion[0])
        at_rest = size <= _AT_REST and number + 1 >= _ROUNDS[0]
        if at_rest or (number + 1 == _ROUNDS[1] and size <= _NEAR):
            priors = np.stack([known[1], known[1] * (theta + step - known[0])])
            return LikelyMotion(system, noises, residuals, theta, chi_square, priors)
        if not np.isfinite(size):
            return None
        present = dict(zip(names, (theta + step).tolist(), strict=True))
        noise = sum(
            own_noise.likeliest(weighted, measured.shape[1])
            for own_noise, weighted in zip(noises, residuals, strict=True)
        )
        motion = smoothed_motion(measured - noise, window)
    return None


def columns_of(patch: Patch, numbers: Indices) -> Floats:
    """The derivatives of the residuals of a patch with respect to some parameters.

    Parameters
    ----------
    patch : Patch
        The equations.
    numbers : array of int, shape (s,)
        Indices of the parameters.

    Returns
    -------
    array of shape (s, R, m)
        The derivatives.
    """
    columns = np.zeros((len(numbers), patch.rows.shape[1], len(patch.masses)))
    place = {number: position for position, number in enumerate(numbers.tolist())}
    for term, number in zip(
        patch.layout.free_terms.tolist(), patch.layout.free_parameters.tolist(), strict=True
    ):
        if number not in place:
            continue
        for mass in np.flatnonzero(patch.signs[:, term]):
            columns[place[number], :, mass] += patch.signs[mass, term] * patch.rows[term]
    return columns


def bridged(motion: MeasuredDisplacements) -> Floats:
    """Displacements with missing samples between their neighbours; windows with these have no equation.

    Parameters
    ----------
    motion : MeasuredDisplacements
        The displacements.

    Returns
    -------
    array of shape (n + 2, N)
        They without gaps, in m.
    """
    if motion.missing is None:
        return motion.displacements
    bridged, index = motion.displacements.copy(), np.arange(motion.displacements.shape[1])
    for row, missing in zip(bridged, motion.missing, strict=False):
        if missing.any() and not missing.all():
            row[missing] = np.interp(index[missing], index[~missing], row[~missing])
    return bridged


def _priors(system: WeakEquations, own: Bools) -> tuple[Floats, Floats]:
    """Means (p,) of the priors, and the information (p,) in them: 0 without one and of those that are not `own`."""
    parameters = system.structure_layout.structure.parameters
    means = np.array([parameter.start or 0.0 for parameter in parameters])
    return means, np.where(own, np.array([parameter.sigma for parameter in parameters]) ** -2.0, 0.0)


def _step(
    system: WeakEquations,
    noises: tuple[ResidualNoise, ...],
    theta: Floats,
    own: Bools,
    known: tuple[Floats, Floats],
    noise: Floats,
) -> tuple[Floats, float, tuple[Floats, ...], float]:
    """The step (p,) of the parameters, its largest part in standard errors, weighted residuals after it and chi-square.

    `known` are means and information of priors; `noise` (n + 2, N) is what the measured displacements have beside the motion
    of the `system`.
    """
    numbers, parts = np.flatnonzero(own), []
    normal, slope = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
    for patch, of_patch in zip(system.patches, noises, strict=True):
        residual = (patch.residual(theta).T + of_patch.passed(noise)) * patch.valid[:, None]
        whitened = of_patch.whitened(np.concatenate([columns_of(patch, numbers), residual[None]]))
        normal += whitened[:-1] @ whitened[:-1].T
        slope += whitened[:-1] @ whitened[-1]
        parts.append((of_patch, whitened))
    means, information = known
    normal += np.diag(information[own])
    scale = 1.0 / np.sqrt(np.maximum(normal.diagonal(), np.finfo(float).tiny))
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=_COLLINEAR, hermitian=True)
    scaled = -inverse @ (scale * (slope + (information * (theta - means))[own]))
    size = float(np.max(np.abs(scaled) / np.sqrt(inverse.diagonal()), initial=0.0))
    step = np.zeros(len(own))
    step[numbers] = scale * scaled
    residuals = tuple(
        of_patch.weighted(whitened[-1:] + step[None, numbers] @ whitened[:-1])[0]
        for of_patch, whitened in parts
    )
    cost = sum(np.sum(whitened[-1] ** 2) for _, whitened in parts)
    cost += (slope - (information * (theta + step - means))[own]) @ step[numbers]
    count = sum(patch.windows * len(patch.masses) for patch in system.patches) - len(numbers)
    return step, size, residuals, float(cost) / max(count, 1.0)


def _at(motion: MeasuredDisplacements, displacements: Floats) -> MeasuredDisplacements:
    """Displacements (n + 2, N) without noise in place of those measured."""
    return replace(
        motion,
        displacements=displacements,
        base=None if motion.base is None else displacements[-2],
        source_variance=np.zeros_like(motion.source_variance),
    )


_FORGOTTEN = 5.0  # time constants after which a state does not know where it began


def link_force(identified: Structure, number: int, equations: WeakEquations) -> Floats:
    """The force of a link along the smoothed motion.

    Parameters
    ----------
    identified : Structure
        The structure with its values.
    number : int
        The number of the link.
    equations : WeakEquations
        Its equations on the record.

    Returns
    -------
    array of shape (R,)
        The force in N; NaN while a state that was eliminated is not known.
    """
    link, d, v = identified.links[number], equations.d[number], equations.v[number]
    states = {
        name: equations.states[row]
        for row, (owner, name) in enumerate(identified.topology.states)
        if owner == number
    }
    elimination = equations.motion.elimination
    if elimination is not None and elimination.link == number:
        states[elimination.state] = _state(identified, elimination, equations)
    return np.asarray(link.force(d, v, states))


def _state(identified: Structure, elimination: Elimination, equations: WeakEquations) -> Floats:
    """(R,) the state that follows the smoothed motion, z' = g0 + a z, with g0 linear between samples."""
    motion, window, number = equations.motion, equations.window, elimination.link
    moved = smoothed_motion(bridged(motion), equations.context.rate_window)
    [d], [v] = (equations.structure_layout.elongations(x, [number]) for x in moved)
    values = identified.links[number].values
    given = {name: values[name] for name in elimination.drive.coefficients}
    driven = np.broadcast_to(np.asarray(elimination.drive.force(d, v, given)), d.shape)
    a, _ = elimination.relaxation_at(identified, {})
    if not a < 0.0:
        return np.full(equations.windows, np.nan)
    decay = np.exp(a * window.step)
    first = (decay - 1.0) / a
    second = (first / window.step - 1.0) / a
    forced = first * driven[:-1] + second * np.diff(driven)
    state = np.append(0.0, scipy.signal.lfilter([1.0], [1.0, -decay], forced))
    state[: min(len(d) // 2, int(_FORGOTTEN / (-a * window.step)))] = np.nan
    return np.asarray(state[window.half + window.stride * np.arange(equations.windows)])
