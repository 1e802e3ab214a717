"""What a search for a structure starts from: candidates that the records show, displacements, and a first subset.

What can be said of a discovery before any time is spent.

Masses at rest or moving together, records that are too short, no motion at all, candidate terms that were never active.

Where a search starts without measured displacements: the tree of links that the accelerations tell, from its leaves on.

All that acts on a leaf is the force of its link, which the acceleration gives, and that is a function of elongation and rate
of this link and of no other. Without displacements the elongation is known up to a constant, or a line, in each short window;
a power series about its mean there has coefficients of its own, so that no constant is needed. The link that explains its
force best is taken first; its force acts on the mass at its other end, whose links are tested anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.screen import ScreenResult, most_significant_tree, screen, screen_links, weak_start
from linkwise.discovery.term_parameters import first_values
from linkwise.errors import IdentificationError
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.structure import Structure
from linkwise.progress import Progress, silent
from linkwise.records.channel_units import in_units_of
from linkwise.records.joining import common_samples
from linkwise.records.record import Record
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import channel_motion
from linkwise.weak.displacements import MeasuredDisplacements, read_densely, with_displacements
from linkwise.weak.estimate import weak_search

_AT_REST = 0.1  # of the noise power (-10 dB): a motion below it cannot be seen
_FAINT = 3.0  # times the noise power (5 dB): a motion below it determines little
_SEPARATE = 30.0  # times the noise power (15 dB) that the difference of two motions should have
# times the noise power (5 dB) by which one motion should differ from all multiples of another
_IN_PROPORTION = 3.0
_STIFF = 0.05  # of the power of the smaller motion: two masses on a stiff link differ by less
_LEAST_SAMPLES = 4  # per candidate, over all masses: below it a regression on all candidates fits noise
_ENOUGH_SAMPLES = 20
# samples in which a term is not zero: noise alone gives a few beyond the range of the motion
_LEAST_ACTIVE = 8
_NAMED = 6  # terms that a remark names
_NO_MOTION = (
    "there is no motion above the noise in any channel, so no structure can be found; excite the structure more strongly, or "
    "check the range and the units of the sensors. In a record of about three samples a period motion looks like noise: "
    "sample faster, or state the noise of the sensors"
)


@dataclass(frozen=True)
class DataChecks:
    """What the records cannot show, as sentences in `remarks`, and the masses concerned.

    Masses `at_rest` did not move. Masses that are `collinear` moved so much like another one that links to either can be
    exchanged; those `in_proportion` to it rather than by as much as it.
    """

    remarks: tuple[str, ...]
    at_rest: tuple[str, ...]
    collinear: tuple[str, ...]
    in_proportion: tuple[str, ...]


def check_data(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What these records cannot show of the candidates.

    Raises IdentificationError if nothing can be discovered: a mass without a sensor, no motion above the noise, fewer samples
    than a regression on all candidates needs.
    """
    if candidates.hosts:  # whose motion follows from fewer sensors than places
        return _check_hosted(records, candidates)
    names = [mass.name for mass in candidates.masses]
    _require_sensors(records, names)
    ratios = np.max([_signal_to_noise(record, names) for record in records], axis=0)
    at_rest = [name for name, ratio in zip(names, ratios, strict=True) if ratio < _AT_REST]
    if len(at_rest) == len(names):
        raise IdentificationError(_NO_MOTION)
    remarks = []
    if at_rest:
        pronoun = _pronoun(at_rest)
        remarks.append(
            f"{_enumerate(at_rest)} did not move above the noise and {_is(at_rest)} left out: a link to {pronoun} looks like "
            f"one to the ground. Excite the structure nearer to {pronoun}."
        )
    faint = [name for name, ratio in zip(names, ratios, strict=True) if _AT_REST <= ratio < _FAINT]
    if faint:
        remarks.append(
            f"{_enumerate(faint)} hardly moved above the noise: weak terms of links there will be missed."
        )
    remarks += _check_length(records, candidates)
    moving = [name for name in names if name not in at_rest]
    motions = [_displacements(record, moving) for record in records]
    together = _groups(motions, moving, _difference_to_noise, _SEPARATE)
    for group, ratio in together:
        remarks.append(
            f"{_enumerate(group)} moved together, with differences {_level(ratio)}: a link to one of them may be found as a "
            "link to another. Excite them one at a time."
        )
    equal = [set(group) for group, _ in together]
    in_proportion = _groups(motions, moving, _deviation_to_noise, _IN_PROPORTION)
    in_proportion = [
        (group, ratio)
        for group, ratio in in_proportion
        if not any(set(group) <= members for members in equal)
    ]
    for group, ratio in in_proportion:
        remarks.append(
            f"{_enumerate(group)} moved in proportion, as in one mode, with deviations {_level(ratio)}: other links may "
            "explain such motions as well. Excite more than one mode."
        )
    collinear = dict.fromkeys(name for group, _ in (*together, *in_proportion) for name in group)
    proportional = dict.fromkeys(name for group, _ in in_proportion for name in group)
    return DataChecks(tuple(remarks), tuple(at_rest), tuple(collinear), tuple(proportional))


def _check_hosted(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What records cannot show of candidates between points of hosts; which of them are alike, the fit says."""
    measured = [name for name in candidates.places if any(record.motions_of(name) for record in records)]
    if not measured:
        raise IdentificationError(
            f"no channel measures the motion of a mass or point, which are {_enumerate(candidates.places)}; add a channel "
            f"a:{candidates.places[0]}",
            arguments=("channels",),
        )
    ratios = [
        _signal_to_noise(record, [name for name in measured if record.motions_of(name)]) for record in records
    ]
    if all(ratio < _AT_REST for record_ratios in ratios for ratio in record_ratios):
        raise IdentificationError(_NO_MOTION)
    remarks = []
    missed = [name for name in candidates.places if name not in measured]
    if missed:
        remarks.append(
            f"No channel measures the motion of {_enumerate(missed)}: it follows from the modes and the other channels, and "
            "links there are determined less well."
        )
    return DataChecks(tuple(remarks), (), (), ())


def _level(ratio: float) -> str:
    return f"down to {10.0 * np.log10(ratio):.0f} dB above the noise" if ratio > 1.0 else "below the noise"


def inactive_terms(
    motions: Sequence[MeasuredDisplacements], rates: Sequence[float], candidates: Candidates
) -> tuple[str, ...]:
    """The names of candidates that were zero throughout `motions`, sampled at `rates` in Hz, but for a few samples.

    A stop that no motion reached is such a term; no record of these determines it.
    """
    names = (*(mass.name for mass in candidates.masses), BASE, GROUND)
    row = {name: number for number, name in enumerate(names)}
    inactive = []
    for entry in candidates.entries:
        # a smooth term is zero at isolated points only
        if not entry.term.law.kinks or entry.term.law.signals:
            continue
        first, second = (row[end] for end in candidates.pairs[entry.pair].between)
        active = 0
        for motion, rate in zip(motions, rates, strict=True):
            d = motion.displacements[first] - motion.displacements[second]
            present = np.ones(len(d), dtype=bool)
            if motion.missing is not None:
                for end in {first, second} & set(range(len(motion.missing))):
                    present &= ~motion.missing[end]
            force = entry.term.law.force(d, np.gradient(d) * rate, {})
            active += int(np.count_nonzero(np.broadcast_to(force, d.shape)[present]))
        if active < _LEAST_ACTIVE:
            inactive.append(entry.name)
    return tuple(inactive)


def inactive_remark(names: Sequence[str]) -> tuple[str, ...]:
    """A sentence on the candidates `names` that were inactive, if there are any."""
    if not names:
        return ()
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (
        f"{', '.join(names[:_NAMED])}{more} were never active in this record and are left out; record a motion that "
        "reaches them.",
    )


def _require_sensors(records: Sequence[Record], names: Sequence[str]) -> None:
    for record in records:
        unseen = [name for name in names if not record.motions_of(name)]
        if unseen:
            raise IdentificationError(
                f"no channel measures the motion of {_enumerate(unseen)}, and links to a mass that is not measured cannot be "
                f"discovered; add a channel x:{unseen[0]}, or identify a structure of known links",
                arguments=("channels",),
            )


def _check_length(records: Sequence[Record], candidates: Candidates) -> list[str]:
    """A remark on a short record; IdentificationError for one that is too short."""
    masses, needed = len(candidates.masses), len(candidates.entries)
    samples = sum(len(record) for record in records) * masses
    if samples < _LEAST_SAMPLES * needed:
        raise IdentificationError(
            f"the record is too short: {samples} samples over {masses} masses for {needed} candidates, which need at least "
            f"{_LEAST_SAMPLES} each; record {-(-_LEAST_SAMPLES * needed // masses)} samples or more, or offer fewer terms"
        )
    if samples < _ENOUGH_SAMPLES * needed:
        return [
            f"{samples} samples for {needed} candidates are few: weak terms will be missed; record for longer."
        ]
    return []


def _signal_to_noise(record: Record, names: Sequence[str]) -> list[float]:
    """The power of the motion of each mass over that of the noise, in its best channel."""
    noise = channel_noise(record)
    best = []
    for name in names:
        channels = record.motions_of(name)
        ratios = [
            _power(record.channel(channel)) / noise[channel] ** 2 - 1.0 if noise[channel] > 0.0 else 0.0
            for channel in channels
        ]
        best.append(max(ratios, default=0.0))
    return best


class _Displacement(NamedTuple):
    """The samples (N,) of a displacement in m, their power in m2, and the deviation of the noise in m."""

    samples: Floats
    power: float
    noise: float


def _displacements(record: Record, names: Sequence[str]) -> dict[str, _Displacement]:
    """The displacements of those of the masses `names` that have a channel of it."""
    noise = channel_noise(record)
    measured = [(name, f"x:{name}") for name in names if f"x:{name}" in record.channels]
    return {
        name: _Displacement(samples := record.channel(channel), _power(samples), noise[channel])
        for name, channel in measured
    }


def _groups(
    motions: Sequence[Mapping[str, _Displacement]],
    names: Sequence[str],
    ratio: Callable[[_Displacement, _Displacement], float],
    separate: float,
) -> list[tuple[list[str], float]]:
    """Groups of masses whose displacements differ by little more than noise in all records, by the `ratio` of two of them.

    A ratio of power to that of the noise from `separate` on distinguishes two masses. With each group the least of its ratios.
    """
    ratios = np.full((len(names), len(names)), np.inf)
    for row, first in enumerate(names):
        for column, second in enumerate(names[:row]):
            if all({first, second} <= motion.keys() for motion in motions):
                ratios[row, column] = max(ratio(motion[first], motion[second]) for motion in motions)
    count, label = connected_components(ratios < separate, directed=False)
    groups = [np.flatnonzero(label == number).tolist() for number in range(count)]
    return [
        ([names[member] for member in group], float(ratios[np.ix_(group, group)].min()))
        for group in groups
        if len(group) > 1
    ]


def _difference_to_noise(first: _Displacement, second: _Displacement) -> float:
    """The power of the difference of two motions over that of its noise; infinite if they clearly differ."""
    variance = first.noise**2 + second.noise**2
    difference = _power(first.samples - second.samples) - variance
    smaller = min(motion.power - motion.noise**2 for motion in (first, second))
    return float(difference / variance) if difference < _STIFF * smaller and variance > 0.0 else np.inf


def _deviation_to_noise(first: _Displacement, second: _Displacement) -> float:
    """The power by which a motion differs from the nearest multiple of the other, over that of its noise.

    The smaller one of both ways round; infinite if they clearly differ.
    """
    return min(_off_multiple(first, second), _off_multiple(second, first))


def _off_multiple(motion: _Displacement, reference: _Displacement) -> float:
    both = np.isfinite(motion.samples) & np.isfinite(reference.samples)
    x, y = motion.samples[both], reference.samples[both]
    x, y = x - x.mean(), y - y.mean()
    moved = float(np.mean(y**2)) - reference.noise**2
    power = float(np.mean(x**2)) - motion.noise**2
    if not (power > 0.0 and moved > 0.0):
        return np.inf
    product = float(np.mean(x * y))
    variance = motion.noise**2 + (product / moved * reference.noise) ** 2
    deviation = power - product**2 / moved
    return deviation / variance if deviation < _STIFF * power and variance > 0.0 else np.inf


def _power(values: Floats) -> float:
    return float(np.nanmean((values - np.nanmean(values)) ** 2))


def _enumerate(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _pronoun(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"


def in_units(records: Sequence[Record], candidates: Candidates) -> list[Record]:
    """The records with the units of points that turn; RecordError for a channel that is stated in others."""
    if not candidates.hosts and not any(record.units for record in records):
        return [*records]
    structure = candidates.full_structure
    return [in_units_of(record, structure) for record in records]


# of a force in a window, so that its samples are more than the series can follow whatever it is of
_PERIODS = 4.0
_SHORTEST = 16  # samples of a window
_LINE = (
    0,
    0,
    1,
)  # by number of integrations, the degree of what is taken from an elongation before its powers
_DRIFT = (0, 0, 2)  # the degree of what a force may have of the drift: noise that is integrated twice bends
_POWERS = 3  # of the elongation, as in the laws of most links


def tree_of_forces(records: Sequence[Record], candidates: Candidates) -> frozenset[str]:
    """All candidates on the links of a tree that joins every mass to a support, each of which explains its force best.

    Empty where a mass is unknown or has no sensor, or links are stated: forces of links do not follow from accelerations then.
    """
    if any(mass.mass.value is None for mass in candidates.masses):
        return frozenset()
    if candidates.hosts or any(pair.stated for pair in candidates.pairs):
        return frozenset()
    names = [mass.name for mass in candidates.masses]
    if not all(record.motions_of(name) for record in records for name in names):
        return frozenset()
    supports = [end for end in (GROUND, BASE) if any(end in pair.between for pair in candidates.pairs)]
    motions = [_Motions.of(record, candidates, supports) for record in records]
    number = {end: place for place, end in enumerate([*names, *supports])}
    pairs = {
        frozenset(number[end] for end in pair.between): place for place, pair in enumerate(candidates.pairs)
    }
    parents = _parents(motions, len(names), frozenset(pairs))
    chosen = {pairs[frozenset(ends)] for ends in parents.items()}
    return frozenset(entry.name for entry in candidates.entries if entry.pair in chosen)


@dataclass(frozen=True, eq=False)
class _Motions:
    """Of n masses and, after them, supports: `x` and `v` (n + s, N), integrated `order` (n + s,) times, and `force` (n, N).

    The latter is what all links of a mass must give.
    """

    x: Floats
    v: Floats
    force: Floats
    order: Indices
    rate: float

    @classmethod
    def of(cls, record: Record, candidates: Candidates, supports: Sequence[str]) -> _Motions:
        sigma = channel_noise(record)
        orders, motions, forces = [], [], []
        for mass in candidates.masses:
            channel = record.motions_of(mass.name)[0]
            motion = channel_motion(record, channel, sigma[channel])
            applied = f"force:{mass.name}"
            acting = record.channel(applied) if applied in record.channels else 0.0
            orders.append(channel.order)
            motions.append(motion[:2])
            forces.append((mass.mass.value or 0.0) * motion[2] - acting)
        for support in supports:
            moves = support == BASE and f"x:{BASE}" in record.channels
            x = record.channel(f"x:{BASE}") if moves else np.zeros(len(record))
            orders.append(0)
            motions.append(np.stack([x, np.gradient(x, record.step)]))
        x, v = np.stack(motions, axis=1)
        return cls(x, v, np.stack(forces), np.array(orders), record.rate)

    def unexplained(self, mass: int, end: int, forces: Floats) -> tuple[float, float]:
        """The power of the force of a mass that no link to another place explains, and all of it."""
        force = forces[mass]
        length = _window(force, self.rate)
        count = len(force) // length
        d, v, force = (
            signal[: count * length].reshape(count, length)
            for signal in (self.x[mass] - self.x[end], self.v[mass] - self.v[end], force)
        )
        time = np.linspace(-1.0, 1.0, length)
        order = int(max(self.order[mass], self.order[end]))
        drift = np.polynomial.legendre.legvander(time, _DRIFT[order])
        drift /= np.linalg.norm(drift, axis=0)
        known = drift[:, : _LINE[order] + 1]
        d = d - d @ known @ known.T
        series = [d**power for power in range(1, _POWERS + 1)]
        columns = [*series, v, *(np.broadcast_to(part, d.shape) for part in drift.T)]
        basis = np.stack(columns, axis=2)
        size = np.sqrt(np.einsum("ktc,ktc->kc", basis, basis))
        q, _ = np.linalg.qr(basis / np.where(size > 0.0, size, 1.0)[:, None])
        left = force - np.einsum("ktc,kc->kt", q, np.einsum("ktc,kt->kc", q, force))
        return float(np.sum(left**2)), float(np.sum(force**2))


def _window(force: Floats, rate: float) -> int:
    """Samples of a window over some periods of a force, at the frequency below which half of its power lies."""
    power = np.cumsum(np.abs(np.fft.rfft(force - force.mean())) ** 2)
    median = max(int(np.searchsorted(power, 0.5 * power[-1])), 1)  # periods in the record
    return int(np.clip(round(_PERIODS * len(force) / median), min(_SHORTEST, len(force)), len(force)))


def _parents(motions: Sequence[_Motions], masses: int, allowed: frozenset[frozenset[int]]) -> dict[int, int]:
    """For each of n masses the place that its link leads to, on its way to a support; supports are numbered from n on.

    Empty where no link is `allowed` to a mass.
    """
    places = len(motions[0].x)
    forces = [motion.force.copy() for motion in motions]
    ratios = np.full((masses, places), np.inf)

    def test(mass: int) -> None:
        for end in range(places):
            if frozenset((mass, end)) in allowed and mass != end:
                parts = [
                    motion.unexplained(mass, end, force)
                    for motion, force in zip(motions, forces, strict=True)
                ]
                left, whole = np.sum(parts, axis=0)
                ratios[mass, end] = left / max(whole, np.finfo(float).tiny)

    for mass in range(masses):
        test(mass)
    parents: dict[int, int] = {}
    while len(parents) < masses:
        open_ones = ratios.copy()
        open_ones[list(parents)] = np.inf
        for mass in range(masses):
            open_ones[mass, [end for end in range(masses) if mass in _way(end, parents)]] = np.inf
        if not np.isfinite(open_ones).any():
            return {}
        mass, end = (int(number) for number in np.unravel_index(np.argmin(open_ones), open_ones.shape))
        parents[mass] = end
        for below in _way(end, parents):
            if below < masses:
                for force in forces:
                    force[below] += force[mass]
                if below not in parents:
                    test(below)
    return parents


def _way(place: int, parents: dict[int, int]) -> list[int]:
    """The place and all that follow on its way to a support, as far as it is known."""
    way = [place]
    while way[-1] in parents:
        way.append(parents[way[-1]])
    return way


@dataclass(frozen=True, eq=False)
class ScreenedRecords:
    """The screen of some `records`, which have displacements of all masses, and the subset that a search starts from.

    Beside hosts there are no displacements, and the screen is that of `host_screen`. `integrated` says whether some
    displacement was not measured; `remarks` are sentences on candidates that are not tested by likelihood, and `untested` the
    names of those that the screen dropped.
    """

    records: Sequence[Record]
    motions: Sequence[MeasuredDisplacements]
    candidates: Candidates
    integrated: bool
    result: ScreenResult
    first: frozenset[str]
    remarks: tuple[str, ...]
    untested: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, records: Sequence[Record], candidates: Candidates, progress: Progress = silent
    ) -> ScreenedRecords:
        """Screen what the records show of the candidates, less those that were never active.

        Short gaps are bridged where there are not enough windows without one.
        """
        if candidates.hosts:
            first = screen_links(records[0], candidates)
            result = ScreenResult(first, frozenset(candidates.by_name))
            return cls(records, (), candidates, False, result, first, ())
        records = [common_samples(record) or record for record in records]
        try:
            return cls._of_masses(records, candidates, progress)
        except IdentificationError:
            bridged = [short_gaps_bridged(record) for record in records]
            if not any(bridged):
                raise
        filled = [ours or given for ours, given in zip(bridged, records, strict=True)]
        return cls._of_masses(filled, candidates, progress)

    @classmethod
    def _of_masses(
        cls, records: Sequence[Record], candidates: Candidates, progress: Progress
    ) -> ScreenedRecords:
        """The screen without hosts, of records at one rate."""
        whole, candidates = candidates, candidates.without_signals
        displaced = [with_displacements(record, candidates.masses) for record in records]
        integrated = any(ours is not given for ours, given in zip(displaced, records, strict=True))
        read = [read_densely(record, candidates.full_structure) for record in displaced]
        displaced, motions = [record for record, _ in read], [motion for _, motion in read]
        rates = [record.rate for record in displaced]
        candidates = first_values(motions, rates, candidates)
        inactive = inactive_terms(motions, rates, candidates)
        candidates = replace(candidates, inactive=frozenset(inactive))
        result = screen(displaced, motions, candidates, progress)
        result = replace(result, tested=result.tested | candidates.always_tested)
        first = result.significant
        if integrated:
            first = (
                tree_of_forces(records, candidates)
                or most_significant_tree(displaced, motions, candidates)
                or result.significant
            )
            # a constant force may only shift elongations that were not measured, so that the equations are singular
            first -= {entry.name for entry in candidates.entries if entry.term.is_constant}
        untested = tuple(entry.name for entry in candidates.entries if entry.name not in result.tested)
        remarks = (*inactive_remark(inactive), *_untested_remark(len(untested)))
        if len(whole.terms) > len(candidates.terms):  # whose signals the weak form does not take
            candidates = replace(candidates, terms=whole.terms)
            driven = {entry.name for entry in candidates.entries if entry.term.law.signals}
            result = replace(result, tested=result.tested | driven)
        return cls(displaced, motions, candidates, integrated, result, first, remarks, untested)


def _untested_remark(count: int) -> tuple[str, ...]:
    """A sentence on the candidates that the screen dropped, if there are any."""
    if not count:
        return ()
    return (
        f"{count} candidates that were significant in the equation of neither of their masses were dropped without a test by "
        "likelihood. The result folder lists them as untested; one or all of these links can be asked for.",
    )


def weak_values(
    screened: ScreenedRecords, structure: Structure, known: Mapping[str, float]
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` by the weak form, and their standard deviations (p,).

    By its search, from the `known` values, if a stated law is nonlinear in an unknown.
    """
    if not any(set(link.law.nonlinear) & set(_unknowns(link)) for link in structure.links):
        return weak_start(screened.records, screened.motions, structure)
    fit = weak_search(screened.records[0], structure, screened.motions[0], known)[1]
    return fit.values, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))


def _unknowns(link: Link) -> list[str]:
    return [name for name, coefficient in link.coefficients.items() if not coefficient.known]
