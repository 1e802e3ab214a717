"""How noise of the channels enters the weak equations of masses and modes.

The noise of a mass is that of its own channel. That of a mode comes from all channels of its host, so that one channel is in
the inertia of several equations, and in all links between points.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.equations import WeakEquations
from linkwise.weak.patch import Patch
from linkwise.weak.patch_layout import NoiseCoupling, NoisePaths
from linkwise.weak.weak_form import INNER, PHI_2


def noise_couplings(patch: Patch, system: WeakEquations) -> tuple[NoiseCoupling, ...]:
    """How the noise of channels enters the equations of a patch, one for each mass or mode."""
    weights = system.motion.source_weights
    couplings = patch.layout.noise_couplings
    return couplings if weights is None else tuple(coupling.through(weights) for coupling in couplings)


def noise_paths(patch: Patch, system: WeakEquations) -> NoisePaths:
    """The ways by which noise of channels enters the equations of a patch."""
    if system.motion.source_weights is None:
        return patch.layout.noise_paths
    return NoisePaths.of(noise_couplings(patch, system), len(patch.layout.links))


def channel_weights(
    patch: Patch,
    system: WeakEquations,
    masses: Floats,
    acting: Floats,
    slopes: Floats,
    channels: Indices | None = None,
) -> tuple[list[Floats], Indices, Indices]:
    """What noise of channels, of variance 1, is weighted by in sums over windows.

    The weights are the same for all terms of one kind, which act in the same equations with the same signs.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    masses : array of shape (m,)
        The masses in kg.
    acting : array of shape (k, m)
        Signs in the equations times the weights of these, of k kinds of terms.
    slopes : array of shape (2, l, P)
        Mean slopes of the links with respect to d (N/m) and v (N s/m).
    channels : array of int, optional
        The channels, in order; all by default.

    Returns
    -------
    weights : list of array of shape (c, P)
        Under each kernel, but for the last of an eliminated state, those of pairs of a kind and a channel with noise in it.
    kind, channel : array of int, shape (c,)
        The pairs, those of a channel one after the other.
    """
    paths, variance = noise_paths(patch, system), system.motion.floored_variance
    if channels is None:
        channels = np.unique(paths.source)
    else:
        paths = paths.chosen(np.isin(paths.source, channels))
    by_path = acting[:, paths.equation] * np.sqrt(variance[paths.source])
    by_channel = np.zeros((len(channels), len(acting), len(paths.source)))
    by_channel[np.searchsorted(channels, paths.source), :, np.arange(len(paths.source))] = by_path.T
    place, kind = np.nonzero(by_channel.any(axis=2))
    through = by_channel[place, kind]
    passed, inner = through @ paths.passed, patch.layout.inner
    stiffness, damping = (passed * ~inner) @ slopes
    inertia = through @ (paths.inertia * masses[paths.equation])
    weights = [stiffness, -damping, np.broadcast_to(inertia[:, None], stiffness.shape)]
    if len(system.window.kernels) > INNER:
        stiffness, damping = (passed * inner) @ slopes
        weights += [stiffness, -damping]
    return weights, kind, channels[place]


def own_noise(patch: Patch, system: WeakEquations, signs: Floats, incidence: Floats) -> Floats:
    """How the noise in the displacement of each mass or mode itself acts in its equation through terms.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    signs : array of shape (m, k)
        Signs of the terms in the equations.
    incidence : array of shape (k, c)
        Weights of the nodes in what the terms are functions of.

    Returns
    -------
    array of shape (m, k)
        The sign times the share of each term's noise that follows that of the mode; 1 for each term in the equation of a mass.
    """
    if system.structure_layout.between_masses:
        return np.abs(signs)
    own = np.searchsorted(patch.layout.nodes, patch.masses)
    covariance = system.motion.covariance(patch.layout.nodes, floored=True)
    return np.asarray(signs * (incidence @ covariance[:, own] / covariance[own, own]).T)


def own_kernels(patch: Patch, system: WeakEquations, slopes: Floats, masses: Floats) -> Floats:
    """Weights of the kernels in the noise that the displacement of each mass or mode itself leaves in its equation.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    slopes : array of shape (2, l, P)
        Slopes of the links with respect to d and v.
    masses : array of shape (m,)
        The masses in kg.

    Returns
    -------
    array of shape (K, m, P)
        The weights.
    """
    own, inner = own_noise_of_links(patch, system), patch.layout.inner
    stiffness, damping = (own * ~inner) @ slopes
    kernels = [stiffness, -damping, np.broadcast_to(masses[:, None], stiffness.shape)]
    if len(system.window.kernels) > INNER:
        stiffness, damping = (own * inner) @ slopes
        kernels += [stiffness, -damping, np.zeros_like(stiffness)]
    return np.stack(kernels)


def own_noise_of_links(patch: Patch, system: WeakEquations) -> Floats:
    """(m, l) `own_noise` through the elongations of the links."""
    return own_noise(patch, system, patch.layout.link_incidence, patch.layout.readings)


def joint_sums(
    coupling: NoiseCoupling, slopes: Floats, kernels: Floats, system: WeakEquations
) -> tuple[Floats, Floats]:
    """What the noise of several channels adds to an equation, as that of two channels of variance 1.

    The sums of every channel are s phi - d phi', s and d its stiffness and damping, so that all channels together have the
    products of two sums at each point: those of the Cholesky factor of the covariance of s and d. So many channels that pass
    through links, and not through inertia or eliminated states, cost as much as two.

    Parameters
    ----------
    coupling : NoiseCoupling
        How noise enters the equation.
    slopes : array of shape (2, k, P)
        Slopes of its links with respect to d and v.
    kernels : array of shape (K, s, P)
        Sums over windows under the kernels.
    system : WeakEquations
        All equations of the record.

    Returns
    -------
    tuple of array of shape (s, P)
        The sums.
    """
    variance = system.motion.floored_variance[coupling.sources]
    stiffness, damping = coupling.passed @ slopes
    first = np.sqrt(variance @ stiffness**2)
    shared = np.divide(variance @ (stiffness * damping), first, out=np.zeros_like(first), where=first > 0.0)
    second = np.sqrt(np.maximum(variance @ damping**2 - shared**2, 0.0))
    phi, phi_1 = kernels[:PHI_2]
    return first * phi - shared * phi_1, second * phi_1
