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

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import VARIABLES, Law
from linkwise.weak.equations import WeakEquations
from linkwise.weak.patch import Patch
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2

FLOOR = 1e-24  # of the terms' power: residuals below are rounding
_MEETING = ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI))


@dataclass(frozen=True, eq=False)
class SlopeStatistics:
    """Slopes of a patch's laws by d (N/m) and by v (N s/m), `mean` (2, l, P) and, summed over the links of a mass, `own`
    (2, m, P), at the windows `places` (P,) of `Window.adjoint_windows`, of which the first `inside` are those that were kept.

    They are means over one deviation of noise over sqrt(2) to both sides, and `square` (2, l, P) the means of their squares:
    what noise makes of a curved law, right to its fourth power. `masses` (m,) are in kg.
    """

    places: Indices
    inside: int
    masses: Floats
    mean: Floats
    square: Floats
    own: Floats

    @classmethod
    def along(cls, patch: Patch, system: WeakEquations, values: Floats) -> SlopeStatistics:
        """Along the smoothed motion, at the parameters (p,)."""
        layout, places = patch.layout, system.adjoint_windows
        deviation = np.sqrt(0.5 * system.motion.floored_variance[system.ends[layout.links]].sum(axis=1))
        mean, square = np.empty((2, 2, len(layout.links), len(places)))
        for group in layout.groups:
            program, constant = _slopes(group.weak_law.law)
            at, links, here = group.positions, group.links[:, None], places[:1] if constant else places
            aside = deviation[at, None, None] * np.array([[-1.0], [1.0]])
            coefficients = [each.at(values)[:, None, None] for each in group.coefficients.values()]
            slopes = program(
                system.d[links, here][:, None] + aside, system.v[links, here][:, None], *coefficients
            )
            for by, (low, high) in enumerate(slope.transpose(1, 0, 2) for slope in slopes):
                mean[by, at] = 0.5 * (low + high)
                square[by, at] = 0.5 * (low**2 + high**2)
        inside = len(places) - 2 * system.window.half
        masses = layout.inertia.at(values)
        return cls(places, inside, masses, mean, square, np.abs(layout.link_incidence) @ mean)


@lru_cache(maxsize=512)
def _slopes(law: Law) -> tuple[Program, bool]:
    """What evaluates the slopes of a law by d and by v, and whether they are constant."""
    slopes = [differentiate(law.expression, name) for name in VARIABLES]
    constant = not any(name in symbols(slope) for name in VARIABLES for slope in slopes)
    return Program(slopes, (*VARIABLES, *law.coefficients), wide=VARIABLES), constant


def residual_excess(
    noisy: Sequence[tuple[Patch, SlopeStatistics]], values: Floats, system: WeakEquations
) -> float:
    """Power of the residuals at the parameters (p,) over the power that the noise gives them."""
    gram = system.window.kernels @ system.window.kernels.T
    by_slope, doubt = gram[[PHI, PHI_1], [PHI, PHI_1]], system.motion.floored_variance
    total = count = 0.0
    for patch, here in noisy:
        mean, square, own = (
            here.mean[..., : here.inside],
            here.square[..., : here.inside],
            here.own[..., : here.inside],
        )
        masses, holds = here.masses[:, None], np.abs(patch.layout.link_incidence)
        passed = by_slope[0] * square[0] + by_slope[1] * square[1]
        curved = passed - by_slope[0] * mean[0] ** 2 - by_slope[1] * mean[1] ** 2
        near = by_slope[0] * own[0] ** 2 + by_slope[1] * own[1] ** 2
        near += masses * (masses * gram[PHI_2, PHI_2] + 2.0 * gram[PHI, PHI_2] * own[0])
        near += holds @ curved
        expected = doubt[patch.masses, None] * near + (holds * doubt[patch.layout.far_ends]) @ passed
        expected += FLOOR * patch.largest()[:, None] / system.windows + np.finfo(float).tiny
        kept = here.places[: here.inside]
        residual = patch.residual(values)[:, kept]
        valid = patch.valid[kept]
        total += float((residual**2 / expected).sum(axis=0) @ valid)
        count += len(patch.masses) * float(valid.sum())
    return total / max(count, 1.0)


def score_blocks(
    noisy: Sequence[tuple[Patch, SlopeStatistics]], weights: Sequence[Floats], system: WeakEquations
) -> Iterator[tuple[Indices, Floats]]:
    """The covariance of the sum that is solved, in blocks: parameters (s,), some perhaps twice, and their (s, s)."""
    doubt = system.motion.floored_variance
    awaited = Counter(channel for patch, _ in noisy for channel in _coupled_channels(patch, system))
    heard: dict[int, list[tuple[Indices, Floats, Floats]]] = {channel: [] for channel in awaited}
    for (patch, here), weight in zip(noisy, weights, strict=True):
        yield _quadratic_noise(patch, here, weight, system)
        for channel, part in _noise_contributions(patch, here, weight, system):
            heard[channel].append(part)
            awaited[channel] -= 1
            if not awaited[channel]:
                which, scale, sums = (
                    np.concatenate(pieces) for pieces in zip(*heard.pop(channel), strict=True)
                )
                yield which, doubt[channel] * np.outer(scale, scale) * (sums @ sums.T)


def _coupled_channels(patch: Patch, system: WeakEquations) -> Iterator[int]:
    """Whose noise the equations of a patch hear: of the masses, and over each link of what is at its other end."""
    for mass, ear in zip(patch.masses.tolist(), patch.layout.noise_couplings, strict=True):
        yield mass
        yield from (other for other in ear.far_ends if system.motion.floored_variance[other] > 0.0)


def _noise_contributions(
    patch: Patch, here: SlopeStatistics, weight: Floats, system: WeakEquations
) -> Iterator[tuple[int, tuple[Indices, Floats, Floats]]]:
    """For each of `_coupled_channels`: parameters (s,), and G (s, P), to be scaled by (s,)."""
    spread = system.window.adjoint(patch.rows[patch.layout.free_terms], system.thinning)
    doubt = system.motion.floored_variance
    for i, (mass, ear) in enumerate(zip(patch.masses.tolist(), patch.layout.noise_couplings, strict=True)):
        scale = weight[i] * ear.sign
        phi, phi_1, phi_2 = spread[ear.terms].transpose(1, 0, 2)
        stiffness, damping = here.mean[:, ear.links, None]
        far = damping * phi_1
        far -= stiffness * phi
        yield mass, (ear.parameter, scale, here.masses[i] * phi_2 - far.sum(axis=0))
        for link, other in enumerate(ear.far_ends):
            if doubt[other] > 0.0:
                yield other, (ear.parameter, scale, far[link])


def _quadratic_noise(
    patch: Patch, here: SlopeStatistics, weight: Floats, system: WeakEquations
) -> tuple[Indices, Floats]:
    """tr(Q Q) for the noise in each mass's own displacement, over all masses: parameters (s,) and (s, s).

    Columns under phi see the noise of windows before and after alike, those under phi' with opposite signs.
    """
    window = system.window
    at = np.flatnonzero(here.places[: here.inside] % system.slope_stride == 0)
    stiffness, damping = here.own[:, :, at]
    kernels = np.stack([stiffness, -damping, np.broadcast_to(here.masses[:, None], stiffness.shape)]).reshape(
        3, -1
    )
    amount = system.slope_stride * (weight * system.motion.floored_variance[patch.masses]) ** 2
    total = np.zeros(patch.products.shape)
    layout, terms = patch.layout, patch.layout.free_terms_by_kernel
    for one, two in _MEETING:
        first, second = terms[one], terms[two]
        if len(first) and len(second):
            both = (
                ((window.cross_correlations[one, two].T @ kernels) * kernels)
                .sum(axis=0)
                .reshape(stiffness.shape)
            )
            sums = (patch.slopes[first] * both[:, None]) @ patch.slopes[second].T
            holds = np.abs(patch.signs[:, first, None] * patch.signs[:, None, second])
            total[first[:, None], second] = (amount[:, None, None] * holds * sums).sum(axis=0)
    return layout.free_parameters, total[np.ix_(layout.free_terms, layout.free_terms)]
