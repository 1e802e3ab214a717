"""Forces of links along the smoothed motion, also where they have states that are measured or eliminated."""

from __future__ import annotations

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.model.structure import Structure
from linkwise.weak.displacements import Elimination, MeasuredDisplacements
from linkwise.weak.equations import WeakEquations
from linkwise.weak.window import smoothed_motion

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
    moved = smoothed_motion(_bridged(motion), equations.context.rate_window)
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


def _bridged(motion: MeasuredDisplacements) -> Floats:
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
