"""How noise in the displacements reaches what weak least squares solves.

The residual r_k of window k of mass i is, to first order, the noise of every displacement it sees under

    m phi'' + k phi - c phi'      for its own, k and c the sums of the slopes of its links,
    -(k_l phi - c_l phi')         for the mass at the other end of link l.

The estimate solves sum_k a_k r_k = 0, a_k the columns of window k. Noise at time t enters that sum by G(t) = sum_k a_k
kernel(t - t_k) and adds sigma^2 G G' to its covariance for every sample. Since a_k is noisy too, G brings along
sigma^4 tr(Q Q'), Q the quadratic form of the noise in the sum; the covariance of a quadratic form is that plus
sigma^4 tr(Q Q).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.structure import Structure
from linkwise.weak import MassEquations, WeakEquations
from linkwise.weakform import PHI, PHI_1, PHI_2

Floats = NDArray[np.float64]

_FLOOR = 1e-24  # of the terms' power: residuals below are rounding
_ENOUGH = 400  # windows: G(t) is smooth, so one window may stand for its neighbours in sums over time
_THINNEST = 2
_SMOOTHER = 4  # the slopes are smoother still


@dataclass(frozen=True, eq=False)
class Share:
    """What one mass adds: its terms `matrix` (q, R), sums of their `products` (q, q), the same without bias as `moments`.

    The numbers that multiply the terms are `by_parameter` (q, s) times parameters `which` (s,), plus `fixed` (q,).
    """

    equations: MassEquations
    matrix: Floats
    products: Floats
    moments: Floats
    which: NDArray[np.intp]
    by_parameter: Floats
    fixed: Floats

    @classmethod
    def of(cls, equations: MassEquations, system: WeakEquations) -> Share | None:
        """The share of one mass, or None where its equation holds no parameter."""
        which, by_parameter, fixed = system.numbers_of(equations)
        if not len(which):
            return None
        matrix = equations.matrix(system.rows)
        products = matrix @ matrix.T
        moments = products - equations.biases.total(equations.valid, matrix.shape[1])
        return cls(equations, matrix, products, moments, which, by_parameter, fixed)

    def numbers(self, values: Floats) -> Floats:
        """(q,) what multiplies the terms at the parameters (p,)."""
        return np.asarray(self.by_parameter @ values[self.which] + self.fixed)

    def residual(self, values: Floats, thin: int = 1) -> Floats:
        """(R',) the sum of all terms at the parameters (p,), in every `thin`-th window."""
        return np.asarray(self.numbers(values) @ self.matrix[:, ::thin])

    def power(self, values: Floats) -> float:
        """Mean square of the residual, floored at rounding."""
        numbers = self.numbers(values)
        largest = float(np.max(self.products.diagonal() * numbers**2))
        count = self.matrix.shape[1] if self.equations.valid is None else max(self.equations.valid.sum(), 1.0)
        return float((max(numbers @ self.products @ numbers, 0.0) + _FLOOR * largest) / count) or 1.0


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of the laws by d (N/m) and by v (N s/m) at every `thin`-th window: `stiffness` and `damping` (L, R').

    They are means over one deviation of noise over sqrt(2) to both sides, and `square` (2, L, R') are the means of their
    squares: what noise makes of a curved law, right to its fourth power. `own` (2, n, R') are sums over the links of a mass.
    """

    masses: Floats
    stiffness: Floats
    damping: Floats
    square: Floats
    own: Floats
    thin: int

    @classmethod
    def along(cls, system: WeakEquations, identified: Structure) -> Slopes:
        """Along the smoothed motion."""
        thin = min(max(1, system.d.shape[1] // _ENOUGH), _THINNEST)
        aside = np.sqrt(0.5 * system.variances[system.ends].sum(axis=1))[:, None]
        d = np.stack([system.d[:, ::thin] - aside, system.d[:, ::thin] + aside], axis=1)
        both = np.empty((2, *d.shape))
        for i, link in enumerate(identified.links):
            both[0, i], both[1, i] = link.tangent(d[i], system.v[i, ::thin])
        mean = 0.5 * (both[:, :, 0] + both[:, :, 1])
        square = 0.5 * (both[:, :, 0] ** 2 + both[:, :, 1] ** 2)
        holds = abs(identified.incidence)
        own = np.stack([holds @ mean[0], holds @ mean[1]])
        return cls(identified.mass_values, mean[0], mean[1], square, own, thin)

    def extended(self, half: int) -> tuple[Floats, Floats, Floats]:
        """`own`, `stiffness` and `damping`, then as at the first place and as at the last `half` times each."""
        last = self.stiffness.shape[1] - 1
        at = np.concatenate([np.arange(last + 1), np.zeros(half, dtype=int), np.full(half, last)])
        return self.own[:, :, at], self.stiffness[:, at], self.damping[:, at]


def residual_excess(shares: list[Share], values: Floats, system: WeakEquations, slopes: Slopes) -> float:
    """Power of the residuals over the power that the noise gives them."""
    gram = system.window.kernels @ system.window.kernels.T
    own, masses = slopes.own, slopes.masses[:, None]
    scatter = slopes.square - np.stack([slopes.stiffness, slopes.damping]) ** 2
    passed = gram[0, 0] * slopes.square[0] + gram[1, 1] * slopes.square[1]
    curved = gram[0, 0] * scatter[0] + gram[1, 1] * scatter[1]
    near = (
        masses**2 * gram[2, 2]
        + 2.0 * masses * own[0] * gram[0, 2]
        + own[0] ** 2 * gram[0, 0]
        + own[1] ** 2 * gram[1, 1]
    )
    total = count = 0.0
    for share in shares:
        i = share.equations.mass
        links, others = system.neighbours(i)
        expected = (
            system.variances[i] * (near[i] + curved[links].sum(axis=0))
            + system.variances[others] @ passed[links]
        )
        floor = _FLOOR * np.max(share.products.diagonal()) / share.matrix.shape[1] + np.finfo(float).tiny
        ratio = share.residual(values, slopes.thin) ** 2 / (expected + floor)
        valid = share.equations.valid
        total += float(ratio.sum() if valid is None else ratio @ valid[:: slopes.thin])
        count += float(len(ratio) if valid is None else valid[:: slopes.thin].sum())
    return total / max(count, 1.0)


def score_blocks(
    shares: list[Share], weights: list[float], system: WeakEquations, slopes: Slopes
) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """The covariance of the sum that is solved, in blocks: parameters (q,), some perhaps twice, and their (q, q)."""
    columns = [
        weight * (share.by_parameter.T @ share.matrix) for share, weight in zip(shares, weights, strict=True)
    ]
    gathered = np.concatenate(columns)
    inside = system.window.spread(gathered, slopes.thin)
    step = slopes.thin * system.window.stride  # samples for which a place inside stands; at the edges it is one
    spread = np.concatenate([np.sqrt(step) * inside, system.window.edges(gathered)], axis=2)
    own, stiffness, damping = slopes.extended(system.window.half)
    seen_by: dict[int, list[tuple[NDArray[np.intp], Floats]]] = {}
    first = 0
    for share, weight in zip(shares, weights, strict=True):
        i = share.equations.mass
        phi, phi_1, phi_2 = spread[:, first : first + len(share.which)]
        first += len(share.which)
        near = own[0, i] * phi - own[1, i] * phi_1 + slopes.masses[i] * phi_2
        seen_by.setdefault(i, []).append((share.which, near))
        for link, other in zip(*system.neighbours(i), strict=True):
            if system.variances[other] > 0.0:
                far = damping[link] * phi_1 - stiffness[link] * phi
                seen_by.setdefault(int(other), []).append((share.which, far))
        yield share.which, (weight * system.variances[i]) ** 2 * _twice_noisy(share, system, slopes)
    for channel, parts in seen_by.items():
        seen = np.concatenate([part for _, part in parts])
        yield np.concatenate([which for which, _ in parts]), system.variances[channel] * (seen @ seen.T)


def _twice_noisy(share: Share, system: WeakEquations, slopes: Slopes) -> Floats:
    """(s, s): tr(Q Q) over sigma^4 for the noise in the mass's own displacement.

    Columns under phi see the noise of windows before and after alike, those under phi' with opposite signs.
    """
    i, window = share.equations.mass, system.window
    thin = slopes.thin * _SMOOTHER
    stiffness, damping = slopes.own[0, i, ::_SMOOTHER], slopes.own[1, i, ::_SMOOTHER]
    kernels = np.stack([stiffness, -damping, np.full(stiffness.shape, slopes.masses[i])], axis=1)
    shared = kernels @ window.overlaps
    centres = window.half + window.stride * thin * np.arange(len(kernels))
    by_d = np.zeros((3, len(share.which), len(kernels)))
    for row, column in zip(*np.nonzero(share.by_parameter), strict=True):
        term = share.equations.terms[row]
        if term < len(system.atoms):
            atom = system.atoms[term]
            by_d[atom.kernel, column] += atom.sign * (
                atom.slope if isinstance(atom.slope, float) else atom.slope[centres]
            )
        else:
            by_d[PHI_2, column] += 1.0
    total = np.zeros((len(share.which), len(share.which)))
    for one, two in ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI)):
        if by_d[one].any() and by_d[two].any():
            both = np.einsum("kj,kj->k", shared[one], shared[two, :, ::-1])
            total += (by_d[one] * both) @ by_d[two].T
    return thin * total
