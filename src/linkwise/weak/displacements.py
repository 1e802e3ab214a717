"""Displacements of a record as the weak form uses them, with their noise.

What acts in weak equations: the laws of links, and of links with memory their parts.

A link without memory is one element: its law, a function of its elongation, acts on the masses that it joins. Where states of
a link are measured and enter law and rates linearly,

    f = f0(d, v) + sum_k p_k s_k,    s_j' = g0(d, v) + sum_k q_k s_k,

each summand is an element: f0 and g0 are functions of the elongation, the others of a state as if it were one. A state has an
equation of its own, that of a node without mass, s_j' - g0 - sum_k q_k s_k = 0, in which s_j' is the element with the law v.

A single state that is not measured is eliminated where it is linear with constant coefficients, z' = g0(d, v) + a z: D - a,
applied to the equations, makes p g0 of p z, an element under phi where all others are under -phi' - a phi (`Window`).

Modal coordinates of hosts from displacements of their points: y = S q, by weighted least squares (METHODS section 11).

Records as the weak screen needs them: with a displacement of every mass, integrated where it was not measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError, StructureError
from linkwise.expression import (
    Expression,
    Number,
    Program,
    Symbol,
    differentiate,
    multiply,
    substitute,
    symbols,
    to_text,
)
from linkwise.model.host import Host
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link, Mass
from linkwise.model.structure import Structure
from linkwise.model.topology import Weights
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.gaps import denser, highest_frequency
from linkwise.signals.noise import bandwidth, channel_noise, noise_and_bandwidth
from linkwise.signals.states import drift_frequency, highpass, integral, smoothed

_RATE = Law.parse("v")


@dataclass(frozen=True)
class Element:
    """A function of the motion of some nodes that acts in some equations.

    Attributes
    ----------
    link : int
        The number of the link whose coefficients it has.
    law : Law
        The function, of what it reads as d and of the rate of that as v.
    reading : tuple of (int, float)
        Nodes, and their weights in what it reads: masses and modes, after them states of links, and the base.
    action : tuple of (int, float)
        Nodes in whose equations it acts, and its weights there.
    inner : bool, optional
        Whether it is p g0 of an eliminated state.
    """

    link: int
    law: Law
    reading: Weights
    action: Weights
    inner: bool = False


@dataclass(frozen=True)
class Elimination:
    """A state z' = g0(d, v) + a z of a link that the equations do not contain.

    Attributes
    ----------
    link : int
        The number of the link.
    state : str
        The name of the state.
    relaxation : Law
        a in 1/s, of coefficients of the link alone.
    drive : Law
        g0.
    """

    link: int
    state: str
    relaxation: Law
    drive: Law

    def relaxation_at(
        self, structure: Structure, unknown: Mapping[str, float]
    ) -> tuple[float, dict[str, float]]:
        """The value of a.

        Parameters
        ----------
        structure : Structure
            The structure of the link.
        unknown : mapping of str to float
            Values of the unknown coefficients in a; NaN where there is none.

        Returns
        -------
        value : float
            a in 1/s.
        slopes : dict of str to float
            Its derivatives with respect to the coefficients in it.

        Raises
        ------
        IdentificationError
            If one of these has no value.
        """
        link, expression = structure.links[self.link], self.relaxation.expression
        names = self.relaxation.coefficients
        given = {name: coefficient.value for name, coefficient in link.coefficients.items()} | dict(unknown)
        values = [np.nan if (value := given[name]) is None else value for name in names]
        for name, value in zip(names, values, strict=True):
            if np.isnan(value):
                raise IdentificationError(
                    f'link "{link.name}": {name} enters the rate of {self.state}, which is not measured, and needs a start: '
                    f"write {name} = {{ start = ... }} among its coefficients"
                )
        program = Program([expression, *(differentiate(expression, name) for name in names)], names)
        a, *slopes = (float(np.asarray(number)) for number in program(*values))
        return a, dict(zip(names, slopes, strict=True))


def elimination_of(structure: Structure, hidden: Sequence[str]) -> Elimination | None:
    """What eliminates the state that a record does not show.

    Parameters
    ----------
    structure : Structure
        The structure.
    hidden : sequence of str
        The channels of states that the record does not have.

    Returns
    -------
    Elimination or None
        None where all states are measured.

    Raises
    ------
    StructureError
        If a state does not enter its law and the rates linearly.
    IdentificationError
        If there are several.
    """
    if not hidden:
        return None
    elements_of(structure)  # refuses states that are not linear, which measuring them would not change
    states = structure.topology.states
    if len(states) > 1:
        raise IdentificationError(
            f"the record has no {', '.join(hidden)}: the weak form eliminates the single state of a structure, and this one "
            f'has {len(states)}; measure all of them, or use method "ml", which finds states',
            arguments=("channels",),
        )
    [(number, name)] = states
    link = structure.links[number]
    rate = dict(link.law.named_rates)[name]
    drive = substitute(rate, {name: Number(0.0)})
    return Elimination(number, name, _law(link, differentiate(rate, name)), _law(link, drive))


def elements_of(structure: Structure, elimination: Elimination | None = None) -> tuple[Element, ...]:
    """What acts in the weak equations of a structure.

    Parameters
    ----------
    structure : Structure
        The structure.
    elimination : Elimination, optional
        The state that the record does not show.

    Returns
    -------
    tuple of Element
        One for each link, in their order, and after them those of states.

    Raises
    ------
    StructureError
        If a state does not enter its law and the rates linearly.
    """
    topology = structure.topology
    node_of_state = {state: structure.size + number for number, state in enumerate(topology.states)}
    base = structure.size + len(topology.states)
    elements, of_states = [], []
    for number, (link, column, based) in enumerate(
        zip(structure.links, topology.columns, structure.base_incidence.tolist(), strict=True)
    ):
        reading = (*column, (base, based)) if based else column
        if not link.law.states:
            elements.append(Element(number, link.law, reading, column))
            continue
        if elimination is not None:
            of_state = differentiate(link.law.expression, elimination.state)
            at_zero = substitute(link.law.expression, {elimination.state: Number(0.0)})
            driven = _law(link, multiply(of_state, elimination.drive.expression))
            elements.append(Element(number, _law(link, at_zero), reading, column))
            of_states.append(Element(number, driven, reading, column, inner=True))
            continue
        nodes = {name: node_of_state[number, name] for name in link.law.states}
        whole, *others = _linear_parts(link, number, link.law.expression, reading, column, nodes)
        elements.append(whole)
        of_states += others
        for name, rate in link.law.named_rates:
            own = nodes[name]
            of_states.append(Element(number, _RATE, ((own, 1.0),), ((own, 1.0),)))
            of_states += _linear_parts(link, number, rate, reading, ((own, -1.0),), nodes)
    return (*elements, *of_states)


def _linear_parts(
    link: Link, number: int, expression: Expression, reading: Weights, action: Weights, nodes: dict[str, int]
) -> Iterator[Element]:
    """What an expression in d, v and states of a link adds: the part without states, and that of each state."""
    at_zero = substitute(expression, dict.fromkeys(nodes, Number(0.0)))
    yield Element(number, _law(link, at_zero), reading, action)
    for name, node in nodes.items():
        slope = differentiate(expression, name)
        if set(symbols(slope)) & {*VARIABLES, *nodes}:
            raise StructureError(
                f"the law has memory (state {name}), which is not supported in the weak form where a state does not enter "
                "its law and the rates linearly; maximum likelihood takes it",
                f'link "{link.name}"',
            )
        if slope != Number(0.0):
            yield Element(number, _law(link, multiply(slope, Symbol("d"))), ((node, 1.0),), action)


def _law(link: Link, expression: Expression) -> Law:
    """A law with those coefficients of a link that are in an expression."""
    names = set(symbols(expression))
    return Law(
        to_text(expression), expression, tuple(name for name in link.law.coefficients if name in names)
    )


_INDEPENDENT = 1e-4  # of the largest singular value of shapes of unit length: sensors that tell less of a mode tell noise


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """What channels tell of masses and modes.

    Attributes
    ----------
    weights : array of shape (n + 2, C)
        Weights of the channels in the displacements of masses and modes, the base and the ground.
    surplus_rows : tuple of array of shape (k, C)
        For each host with more channels than modes: sums of its channels in which no mode is seen, and that are white noise
        of unit variance.
    """

    weights: Floats
    surplus_rows: tuple[Floats, ...]

    def surplus(self, displacements: Floats, missing: Bools | None) -> float:
        """Mean square of what channels show beyond the modes over that expected from noise, of the worst host.

        Parameters
        ----------
        displacements : array of shape (C, N)
            What the channels show.
        missing : array of bool, shape (C - 2, N), or None
            Samples that are missing.

        Returns
        -------
        float
            The ratio; 1 where no host has more channels than modes.
        """
        whole = slice(None) if missing is None else ~missing.any(axis=0)
        shown = [np.mean((rows @ displacements[:, whole]) ** 2) for rows in self.surplus_rows]
        return float(np.nan_to_num(max(shown, default=1.0), nan=1.0))


def measured_modes(structure: Structure, has_channel: Bools, variance: Floats) -> MeasuredModes:
    """What displacement channels tell of masses and of modes of hosts.

    Parameters
    ----------
    structure : Structure
        The structure, with hosts.
    has_channel : array of bool, shape (C,)
        Whether there is a channel, for each of its `places`, the base and the ground.
    variance : array of shape (C,)
        Variances of the noise of the channels in m^2.

    Returns
    -------
    MeasuredModes
        The weights of the channels.

    Raises
    ------
    IdentificationError
        If the channels of a host do not tell its modes, or a shape is not known.
    """
    _require_known_shapes(structure)
    topology, places = structure.topology, structure.places
    states = len(topology.states)
    weights, surplus = np.zeros((structure.size + states + 2, len(has_channel))), []
    weights[-2 - states :, -2 - states :] = np.eye(states + 2)
    for column, place in enumerate(places[len(structure.points) :], start=len(structure.points)):
        weights[topology.index[place], column] = float(has_channel[column])
    firsts = np.cumsum([0, *(len(host.points) for host in structure.hosts)]).tolist()
    for host, (first, last) in zip(structure.hosts, pairwise(firsts), strict=True):
        columns = first + np.flatnonzero(has_channel[first:last])
        modes = [topology.index[name] for name in host.coordinates]
        shapes = np.array([topology.row(places[column])[modes] for column in columns]).reshape(-1, len(modes))
        _require_told(host, shapes, [places[column] for column in columns])
        deviation = np.sqrt(np.maximum(variance[columns], np.finfo(float).tiny))
        left, values, right = np.linalg.svd(shapes / deviation[:, None])
        own = left[:, : len(modes)]
        weights[np.ix_(modes, columns)] = (right.T / values) @ own.T / deviation
        if len(columns) > len(modes):
            rows = np.zeros((len(columns) - len(modes), len(has_channel)))
            rows[:, columns] = left[:, len(modes) :].T / deviation
            surplus.append(rows)
    return MeasuredModes(weights, tuple(surplus))


def _require_told(host: Host, shapes: Floats, places: list[str]) -> None:
    """IdentificationError where the shapes (c, r) of r modes at c measured places are not independent."""
    length = np.linalg.norm(shapes, axis=0)
    values = np.linalg.svd(shapes / np.where(length > 0.0, length, 1.0), compute_uv=False)
    independent = int(np.sum(values > _INDEPENDENT * values.max(initial=0.0)))
    lacking = shapes.shape[1] - independent
    if lacking:
        raise IdentificationError(
            f'the weak form needs the modal coordinates of host "{host.name}": its {shapes.shape[1]} modes take as many '
            f"displacements of points at which they differ, and the record has {independent} "
            f"({', '.join(f'x:{place}' for place in places) or 'no x:POINT'}), so {lacking} more "
            f'{"is" if lacking == 1 else "are"} needed; keep fewer modes, or use method "ml", which takes fewer sensors'
        )


def _require_known_shapes(structure: Structure) -> None:
    """IdentificationError where a shape is unknown, or known to within: the coordinates would depend on it."""
    for host in structure.hosts:
        for name, mode in zip(host.coordinates, host.modes, strict=True):
            if mode.shape_sigma:
                raise IdentificationError(
                    f"the shape of {name} is not known exactly at {', '.join(mode.shape_sigma)}, and the weak form takes "
                    'modal coordinates from shapes: use method "ml", or state shapes as numbers'
                )


def with_displacements(record: Record, masses: Sequence[Mass]) -> Record:
    """`record` itself if it has the displacement of every mass, else with displacements integrated from what it has.

    The integration constant is lost, so that a spring away from d = 0 appears as other powers of d. The result therefore only
    suggests candidates; the likelihood, which uses the measured channels, decides.
    """
    missing = [mass.name for mass in masses if f"x:{mass.name}" not in record.channels]
    if not missing:
        return record
    sigma = channel_noise(record)
    names, columns, noise = list(record.channels), [record.values], dict(record.noise)
    for name in missing:
        channel = record.motions_of(name)[0]
        value = smoothed(record, channel, sigma[channel])[0]
        x = integral(value, record.step)
        if channel.kind == "a":
            cutoff = drift_frequency(value, record.rate)
            velocity = highpass(x, record.rate, cutoff)
            x = highpass(integral(velocity, record.step), record.rate, cutoff)
        names.append(Channel("x", name))
        columns.append(x[:, None])
        relative = sigma[channel] / float(np.sqrt(np.nanmean(record.channel(channel) ** 2)))
        noise[f"x:{name}"] = relative * float(np.sqrt(np.mean(x**2)))
    return replace(record, channels=tuple(names), values=np.hstack(columns), noise=noise, uncertainty={})


_QUADRATURE_ERROR = 1e-5  # of the motion: error of the sums that approximate integrals of a smooth motion
_NOISE_FREE = 1e-3  # of the motion (60 dB): smaller noise is neglected when a window is chosen


@dataclass(frozen=True, eq=False)
class MeasuredDisplacements:
    """Displacements of the nodes of a structure (its n masses and modes, base and ground), with their noise.

    Attributes
    ----------
    displacements : array of shape (n + 2, N)
        Displacements in m of the masses and modes, the base and the ground; 0 where not measured.
    base : array of shape (N,) or None
        Displacement of the base in m; None without a channel.
    source_variance, source_power : array of shape (C,)
        Variances of the noise of the channels in m^2, and their mean squares over the samples measured: of the masses and
        points of hosts, the base and the ground; 0 without a channel.
    has_channel : array of bool, shape (C,)
        Which of these the record has.
    source_weights : array of shape (n + 2, C) or None
        Weights of the channels in the displacements of the nodes; None where each node has its own.
    measured : array of bool, shape (n,)
        The masses and modes whose displacement the channels tell.
    missing : array of bool, shape (n, N), or None
        Samples that are missing; None without any.
    samples : int
        Number of displacement samples measured, of the base not counted.
    bandwidth : float
        Frequency in Hz up to which the motion is above the noise.
    surplus : float
        Mean square of what channels show beyond the modes of a host over that expected from noise, of the worst host; 1 where
        no host has more channels than modes.
    elimination : Elimination or None
        The state of a link that is not measured and is eliminated.
    density : int
        How many samples there are for each that was measured: interpolated ones share the noise of their neighbours.
    """

    displacements: Floats
    base: Floats | None
    source_variance: Floats
    source_power: Floats
    has_channel: Bools
    source_weights: Floats | None
    measured: Bools
    missing: Bools | None
    samples: int
    bandwidth: float
    surplus: float = 1.0
    elimination: Elimination | None = None
    density: int = 1

    @property
    def noise_free(self) -> bool:
        """Whether the noise of every channel is negligible."""
        small = self.source_variance < _NOISE_FREE**2 * self.source_power
        return bool(np.all(small[:-2][self.has_channel[:-2]]))

    @cached_property
    def floored_variance(self) -> Floats:
        """(C,) variances of the noise of the channels, at least those of the quadrature error of sums over samples.

        The floor keeps records without noise from being weighted by their rounding.
        """
        return np.maximum(self.source_variance, _QUADRATURE_ERROR**2 * self.source_power)

    def covariance(self, nodes: Indices, *, floored: bool = False) -> Floats:
        """(c, c) covariance of the noise in the displacements of c nodes."""
        variance = self.floored_variance if floored else self.source_variance
        if self.source_weights is None:
            return np.diag(variance[nodes])
        weights = self.source_weights[nodes]
        return np.asarray((weights * variance) @ weights.T)


def source_names(structure: Structure) -> list[str]:
    """The channels that tell the motion of nodes: of masses and points of hosts, of states of links, and of the base."""
    states = (f"state:{structure.links[link].name}.{name}" for link, name in structure.topology.states)
    return [*(f"x:{place}" for place in structure.places), *states, "x:base"]


def read_displacements(
    record: Record, structure: Structure, *, eliminate: bool = False
) -> MeasuredDisplacements:
    """Displacements of the masses of a structure in a record.

    Parameters
    ----------
    record : Record
        The record. Noise that it states is used; the rest is estimated.
    structure : Structure
        The structure.
    eliminate : bool, optional
        Whether a state that the record does not show is eliminated.

    Returns
    -------
    MeasuredDisplacements
        The displacements and their noise.

    Raises
    ------
    IdentificationError
        If no mass has a displacement channel, those of a host do not tell its modes, or a state that is not measured cannot
        be eliminated.
    """
    names = source_names(structure)
    has_channel = np.array([name in record.channels for name in names])
    measured = has_channel[:-1]
    if not measured[: len(structure.places)].any():
        raise IdentificationError(
            f"the weak form needs displacements, and the record has {', '.join(record.channels)}: give a channel x:MASS, "
            "or map a column of the file to one (`channels`)",
            arguments=("channels",),
        )
    unmeasured = [name for name in names[len(structure.places) : -1] if name not in record.channels]
    elimination = elimination_of(structure, unmeasured) if eliminate else None
    if unmeasured and elimination is None:
        raise IdentificationError(
            f"the weak form needs the states of links with memory, and the record has no {', '.join(unmeasured)}: measure "
            'it, or use method "ml", which finds states',
            arguments=("channels",),
        )
    ends = np.zeros((len(names) + 1, len(record)))
    for row in np.flatnonzero(has_channel):
        ends[row] = record.channel(names[row])
    values = ends[: has_channel.sum()] if has_channel[: has_channel.sum()].all() else ends[:-1][has_channel]
    stated = [
        record.noise.get(name, np.nan) for name, present in zip(names, has_channel, strict=True) if present
    ]
    sigma, bands = noise_and_bandwidth(values.T, record.rate, stated)
    sigma = np.nan_to_num(sigma)
    highest = float(np.max(bands[: measured.sum()]))
    if np.isnan(highest):
        highest = _bridged_bandwidth(values[: measured.sum()], record.rate, sigma[: measured.sum()])
    missing = np.isnan(ends)
    gaps = bool(missing.any())
    if gaps:
        ends[missing] = 0.0
    lacking = missing[:-2] | missing[-2]
    complete = np.maximum(len(record) - missing.sum(axis=1), 1) if gaps else len(record)
    variance = np.zeros(len(names))
    variance[has_channel] = sigma**2
    shown = MeasuredDisplacements(
        displacements=ends,
        base=ends[-2] if has_channel[-1] else None,
        source_variance=np.append(variance, 0.0),
        source_power=np.einsum("ij,ij->i", ends, ends) / complete,
        has_channel=np.append(has_channel, False),
        source_weights=None,
        measured=measured,
        missing=lacking if gaps else None,
        samples=int(np.sum(measured) * ends.shape[1] - np.sum(lacking[measured])),
        bandwidth=highest,
        elimination=elimination,
    )
    return _of_modes(shown, structure) if structure.hosts else shown


def read_densely(record: Record, structure: Structure) -> tuple[Record, MeasuredDisplacements]:
    """Displacements of masses, with samples between those of a record that has few in a period of the fastest motion.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.

    Returns
    -------
    record : Record
        The record, made denser where it must be.
    motion : MeasuredDisplacements
        Its displacements and their noise.

    Raises
    ------
    IdentificationError
        As `read_displacements`.
    """
    dense, density = denser(record)
    motion = read_displacements(dense, structure)
    if density == 1:
        return record, motion
    return dense, replace(motion, bandwidth=highest_frequency(record), density=density)


def _of_modes(shown: MeasuredDisplacements, structure: Structure) -> MeasuredDisplacements:
    """Displacements of masses and modes from those `shown` of masses and points."""
    modes = measured_modes(structure, shown.has_channel, shown.floored_variance)
    shows = modes.weights != 0.0
    missing = None if shown.missing is None else np.any(shows[:-2, :-2, None] & shown.missing, axis=1)
    return replace(
        shown,
        displacements=modes.weights @ shown.displacements,
        source_weights=modes.weights,
        measured=shows[:-2].any(axis=1),
        missing=missing,
        surplus=modes.surplus(shown.displacements, shown.missing),
    )


def _bridged_bandwidth(values: Floats, rate: float, sigma: Floats) -> float:
    """Bandwidth in Hz of channels (C, N) without a long complete piece: gaps are bridged by linear interpolation."""
    index = np.arange(values.shape[1])
    finite = np.isfinite(values)
    bridged = [
        np.interp(index, index[present], row[present])
        for row, present in zip(values, finite, strict=True)
        if present.any()
    ]
    if not bridged:
        return 0.5 * rate
    return float(np.max(bandwidth(np.stack(bridged, axis=1), rate, sigma[finite.any(axis=1)])))
