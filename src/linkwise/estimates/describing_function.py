"""Describing function of a link: the linear spring and damper that are equivalent to its law at an amplitude.

For the force f(d, v) of a motion d = A sin(w t) it is the first harmonic of the force over that of the motion (Krylov and
Bogoliubov 1943):

    k(A) = 1/(pi A) int_0^{2 pi} f sin,   c(A) = 1/(pi A w) int_0^{2 pi} f cos
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.errors import StructureError
from linkwise.estimates.link_estimate import NORMAL_95, LinkEstimate
from linkwise.model.memory_support import refuse_memory

_POINTS = 512  # of a cycle: exact for polynomials, and 1e-5 for laws with kinks


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Equivalent linear spring and damper of a link at A amplitudes.

    Attributes
    ----------
    amplitude : array of shape (A,)
        Amplitudes in m.
    stiffness : array of shape (A,)
        Equivalent stiffness in N/m.
    stiffness_band : array of shape (A, 2)
        Ends of its 95 % band; NaN where no interval can be trusted.
    damping : array of shape (A,)
        Equivalent damping in N s/m.
    damping_band : array of shape (A, 2)
        Ends of its 95 % band.

    See Also
    --------
    equivalent : Compute it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> lw.equivalent(estimate.link("nes1"), [0.005], 5.0).stiffness_band.shape
    (1, 2)
    """

    amplitude: Floats
    stiffness: Floats
    stiffness_band: Floats
    damping: Floats
    damping_band: Floats


@deprecated_keyword("found", Deprecated("link", since="0.2.0", until="0.4.0"))
@checked
def equivalent(link: LinkEstimate, amplitude: ArrayLike, frequency: float) -> Equivalent:
    """Equivalent linear spring and damper of an identified link: its describing function.

    Parameters
    ----------
    link : LinkEstimate
        The link, from `Estimate.link`.
    amplitude : array_like of shape (A,)
        Amplitudes of the elongation in m.
    frequency : float
        Frequency in Hz.

    Returns
    -------
    Equivalent
        Stiffness and damping with their 95 % bands.

    Raises
    ------
    StructureError
        If the link has memory, amplitudes have more than one dimension, or the frequency is not positive.

    Notes
    -----
    For d = A sin(w t), k(A) = 1/(pi A) int_0^{2 pi} f sin and c(A) = 1/(pi A w) int_0^{2 pi} f cos over one cycle. The bands
    follow by the delta method.

    References
    ----------
    N. Krylov and N. Bogoliubov, Introduction to Non-linear Mechanics (1943).

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> lw.equivalent(estimate.link("nes1"), [0.005, 0.01], 5.0).stiffness.round()
    array([-81., -25.])
    """
    refuse_memory([link.link], "equivalent springs and dampers")
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    if a.ndim > 1:
        raise StructureError(f"amplitude must be a number or have the shape (A,), got the shape {a.shape}")
    if not frequency > 0.0:
        raise StructureError(f"frequency must be positive, got {frequency} Hz")
    omega = 2.0 * np.pi * frequency
    phase = 2.0 * np.pi * np.arange(_POINTS) / _POINTS
    d, v = np.outer(a, np.sin(phase)), omega * np.outer(a, np.cos(phase))
    partials = link.link.law.partials(d, v, link.link.values)
    slopes = [np.broadcast_to(partials.by_coefficient[name], d.shape) for name in link.free]
    results = []
    for harmonic, unit in ((np.sin(phase), a), (np.cos(phase), a * omega)):
        weight = 2.0 * harmonic / _POINTS
        value = partials.force @ weight / unit
        gradient = (
            np.stack([slope @ weight / unit for slope in slopes], axis=1) if slopes else np.zeros((len(a), 0))
        )
        results += [value, _band(value, gradient, link)]
    return Equivalent(a, *results)


def _band(value: Floats, gradient: Floats, link: LinkEstimate) -> Floats:
    """(A, 2) ends of the 95 % band by the delta method."""
    if link.covariance is None and link.free:
        return np.full((len(value), 2), np.nan)
    covariance = np.zeros((0, 0)) if link.covariance is None else link.covariance
    half = NORMAL_95 * np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", gradient, covariance, gradient), 0.0))
    return np.stack([value - half, value + half], axis=1)
