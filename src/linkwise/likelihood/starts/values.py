"""Starting values of the parameters for a likelihood fit: by the weak form, from forces of links, or beside hosts.

Where elongations are known up to drift, a law is fitted to the forces of all windows together, while a line may be added to
the elongation in each window. A first guess comes from high-pass filtered elongations, for which the law is linear in its
coefficients. Then each window finds its best line under the law by grid search, and the law is corrected with the lines
eliminated (variable projection), by windows that leave no more than others. Where the best about d = 0 leaves more than noise,
as springs of two wells in one of which the link moves, one about a place of rest far from there competes.

The linear part of a structure with hosts is a known filter, the forces of its links are inputs. Modes and links whose law is
linear with numbers for its coefficients make a linear system. The other links exert forces that are random walks, once
integrated; a Kalman smoother finds the motion and these forces together. Laws follow from forces and elongations; an
elongation that no sensor determines is known up to drift, as in `drift`; rigid motions that nothing holds, and whose place no
sensor tells, are refused.

References
----------
G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.likelihood.starts.drift import (
    DriftWindows,
    LinkSignals,
    drift_candidates,
    elongations_from_forces,
    lacks_displacements,
    link_signals,
    needs_integration,
)
from linkwise.likelihood.starts.kalman import (
    LinearPart,
    inputs_of,
    is_linear,
    likeliest_change,
    samples_of,
    smooth,
    stable_starts,
    tuned_modes,
    with_starts,
)
from linkwise.model.coefficient import MASS
from linkwise.model.host import is_between_modes
from linkwise.model.link import GROUND, Link
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.record import Record, common_samples
from linkwise.records.sample_checks import require_complete
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.signals.noise import channel_noise, noise_sigma
from linkwise.signals.states import highpass
from linkwise.weak.displacements import read_densely, with_displacements
from linkwise.weak.estimate import weak_search
from linkwise.weak.fit import WeakFit

_PERIODS = 1.5  # length of a window: long enough to separate the coefficients
_CUTOFFS = (2.0, 5.0, 10.0)  # Hz, below which a first guess treats motion as drift
# deviations of the motion: about a place of rest so far from d = 0, as a well is, a law is a spring that bends to one side ...
_FAR = 32.0
_BEYOND = 1.5  # ... from where windows find places nearer to it, and a little further
_EXPLAINED = (
    3.0  # times the noise of the forces, in power: a start that leaves more is looked for there as well
)
_ROUNDS = 12
_TOLERANCE = 1e-3  # of the cost


def link_start(
    signals: LinkSignals,
    number: int,
    link: Link,
    values: Mapping[str, float],
    free: tuple[str, ...],
    *,
    smooth: bool = False,
) -> dict[str, float]:
    """Starting values of coefficients in which the law of a link is jointly linear.

    Parameters
    ----------
    signals : LinkSignals
        Signals of all links.
    number : int
        Index of the link.
    link : Link
        The link.
    values : mapping of str to float
        Values of the other coefficients.
    free : tuple of str
        Names of the coefficients.
    smooth : bool
        Whether the motion is smoothed by a model, and no window is worse than others by its integration.

    Returns
    -------
    dict of str to float
        Starting values by name.
    """
    windows = DriftWindows.of(signals, number, periods=_PERIODS)
    force = signals.force[number]
    noise = windows.force.shape[1] * float(np.nan_to_num(noise_sigma(force))[0]) ** 2

    def trial(cutoff: float, deviations: float = 0.0) -> tuple[float, dict[str, float]]:
        d, v = (highpass(signal[number], 1.0 / signals.step, cutoff) for signal in (signals.d, signals.v))
        place = deviations * float(d.std())
        guess, left = regressed(link, d + place, v, force, values, free)
        if place and not np.isfinite(left):
            return np.inf, guess
        usual = np.inf if smooth else noise
        return _improved(windows, link, {**values, **guess}, free, usual, reach=_BEYOND * place)

    trials = [trial(cutoff) for cutoff in _CUTOFFS]
    has_wells = windows.integration_order > 0 and not is_linear(link.law)
    if has_wells and min(left for left, _ in trials) > _EXPLAINED * noise * len(windows.force):
        trials.append(trial(_CUTOFFS[0], _FAR))
    return min(trials, key=lambda trial: trial[0])[1]


def regressed(
    link: Link, d: Floats, v: Floats, force: Floats, values: Mapping[str, float], free: Iterable[str]
) -> tuple[dict[str, float], float]:
    """The free coefficients in which a law is linear, by least squares on forces (N,), others at their values, and the squares
    that are left; infinite where the law has no force.
    """
    linear = [name for name in free if name in link.law.linear]
    partials = link.law.partials(d, v, {**values, **dict.fromkeys(linear, 0.0)}, by=tuple(linear))
    parts = (partials.force, *(partials.by_coefficient[name] for name in linear))
    columns = np.stack([np.broadcast_to(part, d.shape) for part in parts], axis=1)
    if not np.isfinite(columns).all():
        return dict.fromkeys(linear, 0.0), np.inf
    right, columns = force - columns[:, 0], columns[:, 1:]
    solved = _least_squares(columns, right)
    left = right - columns @ solved
    return dict(zip(linear, solved.tolist(), strict=True)), float(left @ left)


def _least_squares(columns: Floats, right: Floats) -> Floats:
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), np.finfo(float).tiny)
    return np.asarray(np.linalg.lstsq(columns / size, right, rcond=None)[0] / size)


def _improved(
    windows: DriftWindows,
    link: Link,
    values: dict[str, float],
    free: tuple[str, ...],
    noise: float,
    reach: float = 0.0,
) -> tuple[float, dict[str, float]]:
    """Squared force error and free coefficients after alternating between lines and coefficients.

    Windows that leave more than half of all, and than `noise`, count less and less (S. Geman and D. E. McClure, Bull. Int.
    Stat. Inst. 52, 5 (1987)): where a motion is too fast for its samples, no line mends what integration makes of it.
    """
    best, best_values, usual = np.inf, values, np.inf
    for _ in range(_ROUNDS):
        candidates = drift_candidates(windows, link, values, reach=reach)
        left = candidates.cost.min(axis=0)
        usual = min(usual, max(float(np.median(left)), noise))
        weight = 1.0 / (1.0 + left / max(usual, np.finfo(float).tiny))
        cost = 2.0 * float(left @ weight)
        if not cost < best:
            break
        converged = cost > (1.0 - _TOLERANCE) * best
        best, best_values = cost, values
        if converged:
            break
        lowest = candidates.cost.argmin(axis=0)
        lines = candidates.lines[:, lowest, np.arange(len(lowest))]
        step = _projected_step(windows, link, values, free, lines, weight)
        values = values | {name: values[name] + change for name, change in zip(free, step, strict=True)}
    return best, {name: best_values[name] for name in free}


def _projected_step(
    windows: DriftWindows,
    link: Link,
    values: dict[str, float],
    free: tuple[str, ...],
    lines: Floats,
    weight: Floats,
) -> Floats:
    """The Gauss-Newton step (p,) of the coefficients with the lines (2, K) of all windows eliminated.

    Errors count by `weight` (K,), their squares by its square.
    """
    d, v = windows.motion(lines)
    partials = link.law.partials(d, v, values)
    error = windows.force - partials.force
    columns = np.stack([np.broadcast_to(partials.by_coefficient[name], d.shape) for name in free], axis=2)
    by_line = [np.broadcast_to(partials.by_d, d.shape)]
    if windows.integration_order > 1:
        by_line.append(by_line[0] * windows.time + partials.by_v)
    if windows.integration_order:
        q, _ = np.linalg.qr(np.stack(by_line, axis=2))
        columns = columns - q @ (q.transpose(0, 2, 1) @ columns)
        error = error - (q @ (q.transpose(0, 2, 1) @ error[..., None]))[..., 0]
    counted = weight[:, None] * error
    return _least_squares((weight[:, None, None] * columns).reshape(-1, len(free)), counted.ravel())


def start_of_links(
    signals: LinkSignals, structure: Structure, given: Mapping[str, float], numbers: Iterable[int]
) -> dict[str, float]:
    """Starting values of the parameters of some links of a structure, from their signals.

    Parameters
    ----------
    signals : LinkSignals
        Signals of the links.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.
    numbers : iterable of int
        The links.

    Returns
    -------
    dict of str to float
        Starting values by name of the parameter.

    Raises
    ------
    IdentificationError
        If a coefficient that enters its law nonlinearly has no starting value.
    """
    by_parameter: dict[str, list[float]] = {}
    names = {member: parameter.name for parameter in structure.parameters for member in parameter.members}
    for number in numbers:
        link = structure.links[number]
        free = tuple(name for name in link.law.coefficients if (number, name) in names)
        if not free:
            continue
        values = {name: float(c.value) for name, c in link.coefficients.items() if c.value is not None}
        values |= {name: given[names[number, name]] for name in free if names[number, name] in given}
        missing = [name for name in free if name not in values and name not in link.law.linear]
        if missing:
            raise IdentificationError(
                f'link "{link.name}": the law {link.law} is not linear in {", ".join(missing)}, which needs a start: write '
                f"{missing[0]} = {{ start = ... }} among its coefficients"
            )
        for name, value in link_start(
            signals, number, link, values, free, smooth=bool(structure.hosts)
        ).items():
            by_parameter.setdefault(names[number, name], []).append(value)
    return {name: float(np.mean(values)) for name, values in by_parameter.items()}


def require_placed(record: Record, structure: Structure) -> None:
    """Raise IdentificationError if rigid motions have a place that neither a link to the ground nor a displacement tells.

    Accelerations and velocities, and forces between points that move alike, are the same wherever a free structure is.
    """
    modes = [(number, name) for number, name in enumerate(structure.mass_names) if name in structure.modes]
    frequencies = [(number, structure.link(name).coefficients["frequency"]) for number, name in modes]
    rigid = [number for number, frequency in frequencies if frequency.known and frequency.value == 0.0]
    if not rigid:
        return
    rows = [structure.topology.row(channel.place) for channel in record.responses if channel.kind == "x"]
    rows += [
        structure.incidence[:, [number]].toarray().ravel()
        for number, link in enumerate(structure.links)
        if GROUND in link.between
        and link.name not in structure.modes
        # that of a damper does not depend on the elongation
        and (link.law.states or "d" in symbols(link.law.expression))
    ]
    placed = np.array(rows)[:, rigid] if rows else np.zeros((1, len(rigid)))
    if np.linalg.matrix_rank(placed) == len(rigid):
        return
    names = ", ".join(structure.mass_names[number] for number in rigid)
    raise IdentificationError(
        f"nothing tells the place of rigid motions at 0 Hz ({names}), neither a link to the ground nor a channel: record a "
        "displacement (x:HOST.POINT) for each, or state the frequency at which a suspension holds the structure, such as "
        "frequency = 0.5"
    )


_FEWEST = 50  # samples that a smoother needs to forget its start
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
        d, v = elongations_from_forces(self.signals, structure.links)
        return replace(
            self,
            x=self.x + self.coupling @ (d - self.signals.d),
            v=self.v + self.coupling @ (v - self.signals.v),
            signals=replace(self.signals, d=d, v=v),
        )


def smoothed_motion(record: Record, linear: LinearPart, sigma: Mapping[str, float]) -> HostMotion:
    """The motion by a smoother. Raises IdentificationError where the record does not determine it."""
    try:
        _, change = likeliest_change(record, linear, sigma)
        model = linear.model(record, sigma, change)
        states, smoothed = smooth(model, samples_of(record, linear), inputs_of(record))
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    structure, open_links = linear.structure, list(linear.open)
    n, u = structure.size, len(open_links)
    x, v, inside = np.split(states[:, : 2 * n + u].T, [n, 2 * n])
    d, rate = structure.elongations(x.T).T, structure.elongations(v.T).T
    force, walk = np.zeros_like(d), np.zeros(len(d))
    force[open_links] = inside
    incidence, deviation = structure.incidence.toarray(), np.sqrt(smoothed.diagonal()[: 2 * n + u])
    covariance = smoothed[:n, :n]
    variance = np.einsum("il,ij,jl->l", incidence, covariance, incidence)
    drifts = variance > (_DETERMINED**2) * np.mean(d**2, axis=1)
    remembers = np.array([bool(link.law.states) for link in structure.links])
    walk[open_links] = deviation[2 * n :] / linear.masses
    order = np.where(np.isin(np.arange(len(d)), open_links) & drifts & ~remembers, 2, 0)
    coupling = (covariance @ incidence) / np.where(variance > 0.0, variance, 1.0)
    signals = LinkSignals(d, rate, force, order, walk, record.step)
    return HostMotion(x, v, deviation[: 2 * n], signals, linear.open, coupling)


def host_start(record: Record, structure: Structure, given: Mapping[str, float]) -> dict[str, float]:
    """Starting values of all parameters of a structure with hosts, by the forces of its links.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
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
    require_supported(record, structure)
    stated = with_starts(structure, {name: v for name, v in given.items() if not name.endswith(".mass")})
    shapes = [p for p in structure.parameters if p.name.is_shape or is_between_modes(p.name)]
    known = {p.name: p.start for p in shapes if p.start is not None} | dict(given)
    try:
        motion, tuned = motion_by_tuned_modes(record, stated)
        values = start_of_links(motion.signals, stated, given, motion.open) | known | tuned
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    missing = [p.name for p in structure.parameters if p.name not in values]
    if missing:
        raise IdentificationError(
            f"no starting value for {', '.join(missing)}: state {{ start = ... }} for it in the structure"
        )
    of_modes = {p.name for p in structure.parameters if p.name.owner in structure.mass_names}
    valued = with_starts(structure, {name: values[name] for name in of_modes if not name.is_shape})
    return stable_starts(LinearPart.of(valued), values, given, record.rate)


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
        if channel.at_place and channel.place not in structure.topology.index:
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


def motion_by_tuned_modes(record: Record, structure: Structure) -> tuple[HostMotion, dict[str, float]]:
    """The motion of a structure whose modes have numbers or starts, and the values of unknown modes that explain it best."""
    sigma = channel_noise(record)
    tuned = tuned_modes(record, structure, sigma)
    return smoothed_motion(record, LinearPart.of(with_starts(structure, tuned)), sigma), tuned


_NAMED = 6  # parameters that a message names
_LARGE = 0.3  # of the largest force
_FIRM = 0.1  # relative deviation of a prior up to which its mean is a better start than what the record alone says


def starting_values(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float] | None = None,
) -> tuple[Floats, Floats | None]:
    """Starting values of the parameters.

    Given values come first, then the means of narrow priors.
    The others come from inverse dynamics where displacements were not measured and accelerations
    determine the forces, else from the weak form, else from the structure.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    given : mapping of str to float, optional
        Starting values by name of the parameter.

    Returns
    -------
    values : array of shape (p,)
        Starting values.
    deviations : array of shape (p,) or None
        Their standard deviations, where known.

    Raises
    ------
    IdentificationError
        If a parameter has no starting value, or a mass none above zero.
    """
    records = framed_records(records, structure, integrated=True)
    given = dict(given or {})
    priors: dict[str, tuple[float, float]] = {
        p.name: (p.start or 0.0, p.sigma)
        for p in structure.parameters
        if p.sigma < np.inf and p.name not in given
    }
    firm = {name: prior for name, prior in priors.items() if prior[1] <= _FIRM * abs(prior[0])}
    try:
        found = _beside(records, structure, given, firm)
    except IdentificationError:
        if len(firm) == len(priors):
            raise
        found = _beside(records, structure, given, priors)
    values, deviations = np.array([found[p.name] for p in structure.parameters]).reshape(-1, 2).T
    return values, None if np.isnan(deviations).any() else deviations


_Values: TypeAlias = dict[
    str, tuple[float, float]
]  # and their standard deviations, NaN where not known, by name


def _beside(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float], held: _Values
) -> _Values:
    """Starting values beside some that are held, with which the forces of others are known.

    Raises IdentificationError where a mass has none above zero.
    """
    reduced = structure.with_values({name: value for name, (value, _) in held.items()})
    found = held | (_values(records, reduced, given) if reduced.parameters else {})
    for parameter in filter(_is_mass, structure.parameters):
        value, _ = found[parameter.name]
        if not value > 0.0:
            raise IdentificationError(
                f"no starting value for {parameter.name}: what the record gives first is {value:.3g} {parameter.unit}, as "
                "noise can make it. State { start = ... } for it in the structure"
            )
    return found


def _is_mass(parameter: Parameter) -> bool:
    return any(key == MASS for _, key in parameter.members)


def _values(records: Sequence[Record], structure: Structure, given: Mapping[str, float]) -> _Values:
    names: list[str] = [p.name for p in structure.parameters]
    known: dict[str, float] = {p.name: p.start for p in structure.parameters if p.start is not None}
    known |= given

    def of(values: Mapping[str, float], names: Iterable[str] = names) -> _Values:
        return {name: (values[name], np.nan) for name in names}

    if given.keys() >= set(names):
        return of(given)
    if structure.hosts:
        return of(host_start(records[0], structure, known))
    if needs_integration(records[0], structure):
        signals = link_signals(records[0], structure, channel_noise(records[0]))
        return of(known | start_of_links(signals, structure, known, range(len(structure.links))))
    deviations, missing = list[float](), list[str]()
    integrated = lacks_displacements(records[0], structure)
    displaced = (
        [with_displacements(record, structure.masses) for record in records] if integrated else records
    )
    try:
        with one_blas_thread():
            fit = _best_weak_fit(displaced, structure, known)
        deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0)).tolist()
        known |= {**dict(zip(names, fit.values.tolist(), strict=True)), **given}
    except IdentificationError as error:
        failure = error
        missing = [name for name in names if name not in known]
        if not missing:
            return of(known)
    guessed = _guessed_masses(records[0], structure, [n for n in names if not known.get(n, 0.0) > 0.0])
    if guessed and len(guessed) < len(missing or names):
        return _beside(records, structure, given, of(guessed, guessed))
    weighed: dict[str, float] = {p.name: known.get(p.name, 0.0) for p in structure.parameters if _is_mass(p)}
    # with which the forces of links are known, while elongations drift
    if integrated and weighed and needs_integration(records[0], structure.with_values(weighed)):
        return _beside(records, structure, given, of(weighed, weighed))
    if not missing:  # integration takes more than noise from deviations
        spread = np.full(len(names), np.nan) if integrated else deviations
        return {name: (known[name], own) for name, own in zip(names, spread, strict=True)}
    if len(missing) < len(names):  # a hidden mass hides its own links, not those of others
        return _beside(records, structure, given, of(known, [name for name in names if name in known]))
    more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
    raise IdentificationError(
        f"no starting value for {', '.join(missing[:_NAMED])}{more}: the weak form, which would estimate one, fails "
        f"because {failure}. State {{ start = ... }} for it in the structure"
    ) from failure


def _guessed_masses(record: Record, structure: Structure, missing: Sequence[str]) -> dict[str, float]:
    """Masses without a start by name of their parameter: what an applied force accelerates where it is large, in which time
    springs do little, else the mean of the others; none where nothing tells one.
    """
    named = {mass.name: f"{mass.name}.{MASS}" for mass in structure.masses}
    known = [mass.mass.value for mass in structure.masses if mass.mass.value]
    guessed = {}
    for name in (name for name, parameter in named.items() if parameter in missing):
        force, acceleration = f"force:{name}", f"a:{name}"
        mass = float(np.exp(np.mean(np.log(known)))) if known else 0.0
        if force in record.channels and acceleration in record.channels and record.channel(force).any():
            acting, moved = (np.nan_to_num(record.channel(channel)) for channel in (force, acceleration))
            large = np.abs(acting) > _LARGE * np.abs(acting).max()
            mass = float(
                acting[large] @ moved[large] / max(moved[large] @ moved[large], np.finfo(float).tiny)
            )
        if mass > 0.0:
            guessed[named[name]] = mass
    return guessed


def _best_weak_fit(records: Sequence[Record], structure: Structure, known: Mapping[str, float]) -> WeakFit:
    """The weak fit with the smallest standard deviations, in the geometric mean, among those to each of the records.

    Short gaps are bridged where no record has enough windows without one.
    """
    sampled = [common_samples(record) or record for record in records]
    fits, failures, tiny = list[WeakFit](), list[IdentificationError](), np.finfo(float).tiny
    for some in (sampled, filter(None, map(short_gaps_bridged, sampled))):
        for record in some if not fits else ():
            try:
                dense, motion = read_densely(record, structure)
                fits.append(weak_search(dense, structure, motion, known)[1])
            except IdentificationError as error:
                failures.append(error)
    if not fits:
        raise failures[0]
    return min(fits, key=lambda fit: float(np.mean(np.log(np.maximum(fit.covariance.diagonal(), tiny)))))
