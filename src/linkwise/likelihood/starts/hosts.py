"""Starting states and values of structures with hosts: the linear part is a known filter, the forces of links its inputs.

Modes and links whose law is linear with numbers for its coefficients make a linear system. The other links exert forces that
are random walks, once integrated; a Kalman smoother finds the motion and these forces together. Laws follow from forces and
elongations; an elongation that no sensor determines is known up to drift, as in `inverse_dynamics`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.coefficients import start_of_links
from linkwise.likelihood.starts.drift_tracking import elongations_from_forces
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals
from linkwise.likelihood.starts.kalman import Smoothed, smooth
from linkwise.likelihood.starts.linear_part import LinearPart, inputs_of, samples_of
from linkwise.likelihood.starts.link_states import follow_states
from linkwise.likelihood.starts.mode_tuning import likeliest_change, tuned_modes, tuned_part, with_starts
from linkwise.likelihood.starts.rigid_motions import require_placed
from linkwise.likelihood.starts.stable_starts import stable_starts
from linkwise.model.host import is_between_modes
from linkwise.model.structure import Structure
from linkwise.records.channel import require_complete
from linkwise.records.record import Record

_FEWEST = 50  # samples that a smoother needs to forget its start
_ELONGATIONS = (0.1, 0.03, 0.3)  # of the size of the motion: bounds on what drifts, of which the best is kept
_DETERMINED = 0.1  # deviation of an elongation relative to its size, up to which it counts as measured


@dataclass(frozen=True, eq=False)
class HostMotion:
    """Motion of a structure with hosts.

    Attributes
    ----------
    x, v : array of shape (n, N)
        Displacements in m and velocities in m/s of modes and masses.
    deviation : array of shape (2 n,)
        Standard deviations of both.
    signals : LinkSignals
        Signals of the L links; forces of those in `open` alone.
    open : tuple of int
        Links whose law is not known, or not linear.
    coupling : array of shape (n, L)
        How displacements follow from a change of an elongation.
    """

    x: Floats
    v: Floats
    deviation: Floats
    signals: LinkSignals
    open: tuple[int, ...]
    coupling: Floats

    def with_drift_tracked(self, structure: Structure) -> HostMotion:
        """The motion with elongations that are known up to drift taken from the forces, all laws being known."""
        if not self.signals.integration_order.any():
            return self
        d, v = elongations_from_forces(self.signals, structure.links)
        return replace(
            self,
            x=self.x + self.coupling @ (d - self.signals.d),
            v=self.v + self.coupling @ (v - self.signals.v),
            signals=replace(self.signals, d=d, v=v),
        )

    def misfit(self, structure: Structure) -> float:
        """What the laws of a structure leave of the forces of open links, relative, by mean squares."""
        left = []
        for number in self.open:
            force = self.signals.force[number]
            link, d, v = structure.links[number], self.signals.d[number], self.signals.v[number]
            inside = follow_states(link.law, link.values, d, v, self.signals.step)[:, 0]
            error = force - link.force(d, v, dict(zip(link.law.states, inside, strict=True)))
            left.append(np.mean(error**2) / max(float(np.mean(force**2)), np.finfo(float).tiny))
        return float(np.sum(left))


def host_motion(record: Record, structure: Structure, sigma: Mapping[str, float]) -> HostMotion:
    """The motion of a structure with hosts and known laws, estimated from a record.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure, all coefficients numbers.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    HostMotion
        The motion; where elongations drift, that which fits the forces best.
    """
    require_supported(record, structure)
    try:
        linear = LinearPart.of(structure)
        tracked = [motion.with_drift_tracked(structure) for motion in host_motions(record, linear, sigma)]
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    return min(tracked, key=lambda motion: motion.misfit(structure))


def host_motions(record: Record, linear: LinearPart, sigma: Mapping[str, float]) -> Iterator[HostMotion]:
    """The motion for several bounds on elongations; for one alone where none drifts."""
    samples, inputs = samples_of(record, linear), inputs_of(record)
    _, change = likeliest_change(record, linear, sigma)
    for reach in _ELONGATIONS:
        smoothed = smooth(linear.model(record, sigma, change, reach), samples, inputs)
        motion = _motion(linear, smoothed, record)
        yield motion
        if not motion.signals.integration_order.any():
            return


def _motion(linear: LinearPart, smoothed: Smoothed, record: Record) -> HostMotion:
    structure, open_links = linear.structure, linear.open
    n = structure.size
    x, v = smoothed.states[:, :n].T, smoothed.states[:, n : 2 * n].T
    d, rate = structure.elongations(x.T).T, structure.elongations(v.T).T
    force = np.zeros_like(d)
    force[list(open_links)] = smoothed.states[:, 2 * n : 2 * n + len(open_links)].T
    for number, (spring, damper) in zip(open_links, linear.equivalent, strict=True):
        force[number] += spring * d[number] + damper * rate[number]
    incidence = structure.incidence.toarray()
    covariance = smoothed.covariance[:n, :n]
    variance = np.einsum("il,ij,jl->l", incidence, covariance, incidence)
    drifts = variance > (_DETERMINED**2) * np.mean(d**2, axis=1)
    is_open = np.isin(np.arange(len(structure.links)), open_links)
    remembers = np.array([bool(link.law.states) for link in structure.links])
    of_force = smoothed.covariance.diagonal()[2 * n : 2 * n + len(open_links)]
    walk = np.zeros(len(d))
    gain = np.abs(incidence.T @ (incidence / structure.mass_values[:, None]))
    walk[list(open_links)] = np.sqrt(of_force) * gain.diagonal()[list(open_links)]
    return HostMotion(
        x=x,
        v=v,
        deviation=np.sqrt(smoothed.covariance.diagonal()[: 2 * n]),
        signals=LinkSignals(
            d=d,
            v=rate,
            force=force,
            integration_order=np.where(is_open & drifts & ~remembers, 2, 0),
            random_walk_intensity=walk,
            step=record.step,
        ),
        open=open_links,
        coupling=(covariance @ incidence) / np.where(variance > 0.0, variance, 1.0),
    )


def host_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Starting values of all parameters of a structure with hosts, by the forces of its links.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    dict of str to float
        Starting values by name of the parameter.

    Raises
    ------
    IdentificationError
        If an unknown has no starting value, and the forces of the links do not give one.
    """
    return _started(_best_start, record, structure, sigma, given)


def equivalent_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """As `host_start`, with the laws that come closest to equivalent springs and dampers of the links."""
    return _started(_equivalent_start, record, structure, sigma, given)


def _started(
    start: Callable[[Record, Structure, Mapping[str, float], Mapping[str, float]], dict[str, float]],
    record: Record,
    structure: Structure,
    sigma: Mapping[str, float],
    given: Mapping[str, float],
) -> dict[str, float]:
    """Values by a kind of start; raises IdentificationError for those that are missing."""
    require_supported(record, structure)
    own = {name: value for name, value in given.items() if not name.endswith(".mass")}
    try:
        values = start(record, with_starts(structure, own), sigma, dict(given))
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    missing = [p.name for p in structure.parameters if p.name not in values]
    if missing:
        raise IdentificationError(
            f"no starting value for {', '.join(missing)}: state {{ start = ... }} for it in the structure"
        )
    valued = LinearPart.of(with_starts(structure, {name: values[name] for name in _modal(structure)}))
    values = stable_starts(valued, values, given, record.rate)
    return {p.name: values[p.name] for p in structure.parameters}


def _modal(structure: Structure) -> list[str]:
    """Unknown frequencies and damping of modes."""
    return [
        p.name for p in structure.parameters if p.name.owner in structure.mass_names and not p.name.is_shape
    ]


TOO_LITTLE = (
    "no starting values can be found: the record is too short, has too few samples, or its sensors do not show the modes of "
    "the host; give a longer record, or more sensors"
)


def require_supported(record: Record, structure: Structure) -> None:
    """Raise IdentificationError for what a start of a structure with hosts does not take."""
    if np.any(structure.base_incidence) or any(channel.relative for channel in record.channels):
        raise IdentificationError(
            "a moving base beside a host is not supported in identification and validation"
        )
    for channel in record.channels:
        if not channel.of_link and channel.place not in structure.topology.index:
            raise IdentificationError(
                f"channel {channel} belongs to no mass or point of the structure, which are {', '.join(structure.places)}"
            )
        if channel.is_input:
            require_complete(channel, record.channel(channel), record.start, record.rate)
    if len(record) < _FEWEST:
        raise IdentificationError(
            f"the record has {len(record)} samples, too few to determine the motion of a host; it needs at least {_FEWEST}"
        )
    if not record.motions:
        raise IdentificationError("the record shows no motion: give a channel x:PLACE, v:PLACE or a:PLACE")
    require_placed(record, structure)


def _best_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    tuned = tuned_modes(record, structure, sigma)
    known = _shapes(structure) | dict(given) | tuned
    trials: list[tuple[float, int, dict[str, float]]] = []
    for motion in host_motions(record, LinearPart.of(with_starts(structure, tuned)), sigma):
        start = start_of_links(motion.signals, structure, given, motion.open) | known
        valued = structure.with_values(
            {p.name: start[p.name] for p in structure.parameters if p.name in start}
        )
        trials.append((motion.with_drift_tracked(valued).misfit(valued), len(trials), start))
    return min(trials)[-1]


def _equivalent_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    tuned, linear = tuned_part(record, structure, sigma)
    motion = next(host_motions(record, linear, sigma))
    start = start_of_links(_equivalent(motion.signals, linear), structure, given, linear.open)
    return start | _shapes(structure) | dict(given) | tuned


def _shapes(structure: Structure) -> dict[str, float]:
    """Starts of the shapes of hosts that are known to within, and of damping between their modes."""
    return {
        p.name: p.start
        for p in structure.parameters
        if p.start is not None and (p.name.is_shape or is_between_modes(p.name))
    }


def _equivalent(signals: LinkSignals, linear: LinearPart) -> LinkSignals:
    """The motion of links with the forces of equivalent springs and dampers in the open ones."""
    force = np.zeros_like(signals.d)
    for number, (spring, damper) in zip(linear.open, linear.equivalent, strict=True):
        force[number] = spring * signals.d[number] + damper * signals.v[number]
    return replace(signals, force=force, integration_order=np.zeros_like(signals.integration_order))
