"""Starting states and values of structures with hosts: the linear part is a known filter, the forces of links its inputs.

Modes and links whose law is linear with numbers for its coefficients make a linear system. The other links exert forces that
are random walks, once integrated; a Kalman smoother finds the motion and these forces together. Laws follow from forces and
elongations; an elongation that no sensor determines is known up to drift, as in `inverse_dynamics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.coefficients import start_of_links
from linkwise.likelihood.starts.drift_tracking import elongations_from_forces
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals
from linkwise.likelihood.starts.kalman import Smoothed, innovations, log_likelihood, smooth
from linkwise.likelihood.starts.linear_part import LinearPart, inputs_of, samples_of
from linkwise.model.parameters import is_shape
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.checks import require_complete
from linkwise.records.record import Record

_TRIED = 2000  # samples that decide how fast the forces of links change
_FEWEST = 50  # samples that a smoother needs to forget its start
_TUNED = 4000  # samples that the frequencies of modes are tuned to
_ROUGH = 0.05  # relative size of a change of a frequency or damping without a prior
_DIFFERENCE, _STEPS = 1e-3, 12  # of the search for them
_CHANGES = 10.0 ** np.arange(
    -4.0, 3.0
)  # of a force over a sample, relative to its size: tried one after the other
_ELONGATIONS = (
    0.1,
    0.03,
    0.3,
)  # of the size of the measured motion: bounds on what drifts, of which the best is kept
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
            error = force - structure.links[number].force(self.signals.d[number], self.signals.v[number])
            left.append(np.mean(error**2) / max(float(np.mean(force**2)), np.finfo(float).tiny))
        return float(np.sum(left))


def host_motion(record: Record, structure: Structure, sigma: Mapping[str, float]) -> HostMotion:
    """The motion that a record tells of a structure with hosts, whose laws are known.

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
        tracked = [motion.with_drift_tracked(structure) for motion in _motions(record, structure, sigma)]
    except np.linalg.LinAlgError:
        raise IdentificationError(_TOO_LITTLE) from None
    return min(tracked, key=lambda motion: motion.misfit(structure))


def _motions(record: Record, structure: Structure, sigma: Mapping[str, float]) -> Iterator[HostMotion]:
    """The motion for several bounds on elongations; for one alone where none drifts."""
    linear = LinearPart.of(structure)
    samples, inputs = samples_of(record, linear), inputs_of(record)
    change = _likeliest_change(record, linear, sigma)
    for reach in _ELONGATIONS:
        smoothed = smooth(linear.model(record, sigma, change, reach), samples, inputs)
        motion = _motion(structure, linear, smoothed, record)
        yield motion
        if not motion.signals.integration_order.any():
            return


def _likeliest_change(record: Record, linear: LinearPart, sigma: Mapping[str, float]) -> float:
    """By how much the forces of open links change in a sample, relative to their size."""
    first = slice(None, min(_TRIED, len(record)))
    samples, inputs = samples_of(record, linear)[first], inputs_of(record)[first]
    fits = [
        (log_likelihood(linear.model(record, sigma, change), samples, inputs), float(change))
        for change in _CHANGES
    ]
    return max(fits)[1]


def tuned_modes(record: Record, structure: Structure, sigma: Mapping[str, float]) -> dict[str, float]:
    """Frequencies and damping of modes that are unknown, from what a filter with random forces of links predicts.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure; frequencies and damping of modes have numbers or starts.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    dict of str to float
        Values by name of the parameter; empty where all modes are known.
    """
    free = [p for p in structure.parameters if p.name.rpartition(".")[0] in structure.modes]  # not shapes
    if not free:
        return {}
    start = np.array([float(p.start or 0.0) for p in free])
    unit = np.array(
        [min(p.sigma, _ROUGH * abs(value) or _ROUGH) for p, value in zip(free, start, strict=True)]
    )
    stated = np.array([p.sigma < np.inf for p in free])
    first = slice(None, min(_TUNED, len(record)))
    linear = LinearPart.of(structure)
    change = _likeliest_change(record, linear, sigma)
    samples, inputs = samples_of(record, linear)[first], inputs_of(record)[first]

    def residual(moved: Floats) -> Floats:
        values = dict(zip((p.name for p in free), map(float, start + unit * moved), strict=True))
        model = LinearPart.of(_with_starts(structure, values)).model(record, sigma, change)
        return np.append(innovations(model, samples, inputs).ravel(), moved[stated])

    lower, upper = (
        np.array(
            [(getattr(p, side) - value) / size for p, value, size in zip(free, start, unit, strict=True)]
        )
        for side in ("lower", "upper")
    )
    optimum = scipy.optimize.least_squares(
        residual, np.zeros(len(free)), bounds=(lower, upper), diff_step=_DIFFERENCE, max_nfev=_STEPS
    )
    return dict(zip((p.name for p in free), map(float, start + unit * optimum.x), strict=True))


def _with_starts(structure: Structure, values: Mapping[str, float]) -> Structure:
    """A structure with other starts of unknown coefficients."""
    links = []
    for link in structure.links:
        own = {
            name: replace(coefficient, value=values[f"{link.name}.{name}"])
            for name, coefficient in link.coefficients.items()
            if f"{link.name}.{name}" in values
        }
        links.append(replace(link, coefficients={**link.coefficients, **own}) if own else link)
    return replace(structure, links=tuple(links))


def _motion(structure: Structure, linear: LinearPart, smoothed: Smoothed, record: Record) -> HostMotion:
    n, open_links = structure.size, linear.open
    x, v = smoothed.states[:, :n].T, smoothed.states[:, n : 2 * n].T
    d, rate = structure.elongations(x.T).T, structure.elongations(v.T).T
    force = np.zeros_like(d)
    force[list(open_links)] = smoothed.states[:, 2 * n : 2 * n + len(open_links)].T
    incidence = structure.incidence.toarray()
    covariance = smoothed.covariance[:n, :n]
    variance = np.einsum("il,ij,jl->l", incidence, covariance, incidence)
    drifts = variance > (_DETERMINED**2) * np.mean(d**2, axis=1)
    is_open = np.isin(np.arange(len(structure.links)), open_links)
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
            integration_order=np.where(is_open & drifts, 2, 0),
            random_walk_intensity=walk,
            step=record.step,
        ),
        open=open_links,
        coupling=(covariance @ incidence) / np.where(variance > 0.0, variance, 1.0),
    )


def host_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Starting values of all parameters of a structure with hosts.

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
        If an unknown has no starting value, and the forces of the links do not tell one.
    """
    require_supported(record, structure)
    given = dict(given)
    own = {name: value for name, value in given.items() if not name.endswith(".mass")}
    structure = _with_starts(structure, own)
    try:
        return _best_start(record, structure, sigma, given)
    except np.linalg.LinAlgError:
        raise IdentificationError(_TOO_LITTLE) from None


_TOO_LITTLE = (
    "no starting values can be found: the record is too short, has too few samples, or its sensors do not show the modes of "
    "the host; give a longer record, or more sensors"
)


def require_supported(record: Record, structure: Structure) -> None:
    """Raise IdentificationError for what a start of a structure with hosts does not take."""
    if np.any(structure.base_incidence) or any(Channel.parse(name).relative for name in record.channels):
        raise IdentificationError(
            "a moving base beside a host is not supported in identification and validation"
        )
    states = [link.name for link in structure.links if link.law.states]
    if states:
        raise IdentificationError(
            f'link "{states[0]}" has memory, which is not supported beside a host in identification and validation'
        )
    for name in record.channels:
        channel = Channel.parse(name)
        if not channel.of_link and channel.mass not in structure.topology.index:
            raise IdentificationError(
                f"channel {name} belongs to no mass or point of the structure, which are {', '.join(structure.places)}"
            )
        if channel.is_input:
            require_complete(name, record.channel(name), record.start, record.rate)
    if len(record) < _FEWEST:
        raise IdentificationError(
            f"the record has {len(record)} samples, too few to determine the motion of a host; it needs at least {_FEWEST}"
        )
    if not any(Channel.parse(name).kind in "xva" for name in record.responses):
        raise IdentificationError("the record shows no motion: give a channel x:PLACE, v:PLACE or a:PLACE")


def _best_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    tuned = tuned_modes(record, structure, sigma)
    shapes = {p.name: p.start for p in structure.parameters if is_shape(p.name) and p.start is not None}
    trials: list[tuple[float, int, dict[str, float]]] = []
    for motion in _motions(record, _with_starts(structure, tuned), sigma):
        start = start_of_links(motion.signals, structure, given, motion.open) | shapes | dict(given) | tuned
        valued = structure.with_values(
            {p.name: start[p.name] for p in structure.parameters if p.name in start}
        )
        trials.append((motion.with_drift_tracked(valued).misfit(valued), len(trials), start))
    start = min(trials)[-1]
    missing = [p.name for p in structure.parameters if p.name not in start]
    if missing:
        raise IdentificationError(
            f"no starting value for {', '.join(missing)}: state {{ start = ... }} for it in the structure"
        )
    return {p.name: start[p.name] for p in structure.parameters}
