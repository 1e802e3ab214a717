"""Starting values for structures whose links have memory, or laws that name signals.

The equation of every mass is integrated against test functions, so that no displacement is differentiated twice, and the force
of a load cell is compared with its law. Along the smoothed motion the states follow from the coefficients in their rates; the
rest of the coefficients, and unknown masses, are then a linear regression (variable projection). The cost may have several
minima: it is searched from many starts of the sizes that the units of the coefficients and the motion imply.

Where inverse dynamics gives the force of each link, one link is searched after another. Elongations are known up to drift only
where velocities or accelerations were measured. A filter that takes the drift away takes slow motion with it, which a state
may need. The force of a link tells which filter is best: each link is searched as if it stood on a rig, with several filters
of its motion, and those that leave least of the force are kept. Slow parts of the forces, which the filtered motion lacks, are
left out.

Beside hosts the smoother of `kalman` gives the elongation and the force of every link whose law is not known. Along these the
links are identified as if they stood on a rig, together. Of several records the one that moves most is used: at a
low level a joint hardly slips.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.expression import Number, substitute, to_text
from linkwise.likelihood.starts.drift import LinkSignals, link_signals
from linkwise.likelihood.starts.kalman import with_starts
from linkwise.likelihood.starts.link_states import LinkRuns, link_motion
from linkwise.likelihood.starts.states import measured_motion
from linkwise.likelihood.starts.values import TOO_LITTLE, motion_by_tuned_modes, require_supported
from linkwise.model.coefficient import MASS
from linkwise.model.law import Law, unit_dimension
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import drift_frequency, highpass, integral, smoothed

_AROUND = -1.5, 1.5  # decades about the size that units imply
# decades of friction that yields within a small part of the motion, as that of dampers on rigs
_SHARP = -4.0, -1.0


def unit_sizes(
    parameters: Sequence[Parameter], d: Floats, v: Floats, force: float, voltage: float | None = None
) -> dict[str, float]:
    """A size for each parameter by name, from its unit.

    `d` and `v` are elongations in m and rates in m/s, `force` in N is the size of the forces, and `voltage` in V that of a
    voltage that goes with them.
    """
    length = float(np.std(d)) or 1.0
    speed = float(np.std(v)) or 1.0
    time = length / speed
    mass = force * time**2 / length
    current = 1.0 if voltage is None else force * speed / (voltage or 1.0)
    sizes: dict[str, float] = {}
    for parameter in parameters:
        unit = unit_dimension(parameter.unit if parameter.unit != "?" else "")
        powers = (unit.kilogram, unit.metre, unit.second, unit.ampere)
        bases = (mass, length, time, current)
        sizes[parameter.name] = float(np.prod([b ** float(p) for b, p in zip(bases, powers, strict=True)]))
    return sizes


MOST_SAMPLES = 8192  # of a record that the search uses
_ROUGH_SAMPLES, _ROUGH_TRIALS = 2000, 40  # of a search that only ranks structures
_TRIALS = 60  # random starts, of which ...
_REFINED = 6  # ... so many of the best are refined
_SEARCH = 40  # steps of a refinement, at most
_FLAT = 1e-5  # relative change of the cost at which it ends
_WINDOW = 0.2  # half width of a test function over the period of the motion
_DISTINCT = 0.05  # relative distance of the forces' coefficients beyond which two minima are different
_MARGIN = 0.05  # of the room between two bounds, next to them
# of the power of a force: a constant, of which no more is left without its slow part, says nothing
_ROUNDING = 1e-20
_SEED = 12


@dataclass(frozen=True, eq=False)
class Start:
    """Parameters `values` (p,) at a minimum, and `misfit`, the part of the forces in power that is left there."""

    values: Floats
    misfit: float

    @classmethod
    def of(cls, structure: Structure, values: Mapping[str, float], misfit: float) -> Start:
        """That of a structure, from values by name."""
        return cls(np.array([values[p.name] for p in structure.parameters]), misfit)

    def by_name(self, structure: Structure) -> dict[str, float]:
        """The values by the names of the parameters of its structure."""
        return {p.name: value for p, value in zip(structure.parameters, self.values.tolist(), strict=True)}


FindStarts: TypeAlias = Callable[[Sequence[Record], Structure, Mapping[str, float]], tuple[Start, ...]]
"""Gives starts from records, the best first; the values given by name are kept, or kept near."""


def memory_starts(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float]
) -> tuple[Start, ...]:
    """Starting values of all parameters, those that leave least of the forces first; `given` starts by name are kept near.

    Raises IdentificationError where a mass has no displacement or velocity channel, or nothing sets the scale of the forces.
    """
    return MemorySearch.of(records[0], structure, given).minima()


def rough_memory_start(records: Sequence[Record], structure: Structure) -> Start:
    """The best of random starts on the first samples of a record: quick, to rank structures before any is fitted.

    Raises IdentificationError as `memory_starts` does.
    """
    return MemorySearch.of(records[0][:_ROUGH_SAMPLES], structure, {}).rough()


@dataclass(frozen=True, eq=False)
class MemorySearch:
    """The regression along a motion: elongations and rates (N, L), projected equations, and what is unknown.

    The equations are those of the masses that are `balanced` (2, n, N), by displacements and applied forces, and of the forces
    and states (N,) of links that are `shown`, by channel; `signals` (N,) are those that laws name. What forces have of the
    first `slow` cosines over the record is left out, where elongations are known up to drift. Laws that are `sharp` change
    within a small part of the motion.
    """

    structure: Structure
    step: float
    d: Floats
    v: Floats
    shown: Mapping[str, Floats]
    given: Mapping[str, float]
    signals: Mapping[str, Floats]
    slow: int = 0
    sharp: bool = False
    balanced: Floats = field(default_factory=partial(np.zeros, (2, 0, 0)))

    @classmethod
    def of(cls, record: Record, structure: Structure, given: Mapping[str, float]) -> MemorySearch:
        """Along a record in which every mass has a sensor; raises IdentificationError where one has not."""
        record = record[:MOST_SAMPLES]
        sigma = channel_noise(record)
        x, v = measured_motion(record, structure, sigma)
        unseen = [name for name, row in zip(structure.mass_names, x, strict=True) if not row.any()]
        if unseen:
            raise IdentificationError(
                f"no starting values for links with memory or signals: mass {unseen[0]} has no channel; record its motion, or "
                "state starts of all unknowns"
            )
        d, rate = link_motion(record, structure, x, v)
        signals = {name: record.channel(f"signal:{name}") for name in structure.signals}
        balanced, shown = _balanced(record, structure, x), _shown(record, {})
        return cls(structure, record.step, d, rate, shown, given, signals, balanced=balanced)

    def minima(self) -> tuple[Start, ...]:
        """The minima that are found, the lowest first."""
        refined = self.refined(self.trials()[:_REFINED])
        lasting = self._forget_start(refined)
        refined = refined[lasting] if lasting.any() else refined
        distinct: list[Start] = []
        for start in sorted(map(self.solved, refined), key=lambda start: start.misfit):
            if all(_are_apart(start.values, other.values) for other in distinct):
                distinct.append(start)
        return tuple(distinct)

    def rough(self) -> Start:
        """The best of random starts: quick, to rank structures or motions before any search."""
        return self.solved(self.trials(_ROUGH_TRIALS)[0])

    def trials(self, count: int = _TRIALS) -> Floats:
        """Starts (B, q) of the curved parameters, the best first, last those whose states amplify their start."""
        if not self.curved:
            return np.zeros((1, 0))
        rng = np.random.default_rng(_SEED)
        trials = np.stack([self._drawn(rng, first=k == 0) for k in range(count)])
        if self.sharp:
            sharp = [self._drawn(rng, first=False, decades=_SHARP) for _ in range(count)]
            trials = np.concatenate([trials, sharp])
        costs = np.mean(self.regressed(trials)[1] ** 2, axis=1)
        return np.asarray(trials[np.lexsort(np.stack([costs, ~self._forget_start(trials)]))])

    def _drawn(self, rng: np.random.Generator, first: bool, decades: tuple[float, float] = _AROUND) -> Floats:
        """Values (q,) of the curved parameters to start from; the `first` trial takes starts as they are given or stated.

        Others are within so many `decades` of their sizes.
        """
        values = []
        for parameter in self.curved:
            start = self.given.get(parameter.name, parameter.start)
            low, high = parameter.lower, parameter.upper
            if start is not None:
                value = start * (1.0 if first else 10.0 ** rng.normal(0.0, 0.2))
            elif np.isfinite(low) and np.isfinite(high):
                value = low + (high - low) * rng.uniform(0.05, 0.95)
            else:
                value = self.sizes[parameter.name] * 10.0 ** rng.uniform(*decades)
                value *= -1.0 if high <= 0.0 or (low < 0.0 and rng.random() < 0.3) else 1.0
            margin = 1e-9 * (abs(value) + self.sizes[parameter.name])
            values.append(np.clip(value, low + margin, high - margin))
        return np.array(values, dtype=float)

    def _forget_start(self, curved: Floats) -> Bools:
        """Whether the states of all links forget where they began, for each of B values (B, q)."""
        forget = [link.forget_start() for link in self._links(curved)]
        return np.asarray(np.all(forget, axis=0))

    def _links(self, curved: Floats) -> Iterator[LinkRuns]:
        """Each link, with coefficients for each of B values (B, q), 0 where the regression finds them."""
        for number, link in enumerate(self.structure.links):
            own = {key: coefficient.value or 0.0 for key, coefficient in link.coefficients.items()}
            own |= {key: 0.0 for p in self.straight for index, key in p.members if index == number}
            values = {key: np.full((len(curved), 1), value) for key, value in own.items()}
            for column, parameter in enumerate(self.curved):
                values |= {key: curved[:, [column]] for index, key in parameter.members if index == number}
            signals = [self.signals[name] for name in link.law.signals]
            motion = np.stack([self.d[:, number], self.v[:, number], *signals])
            yield LinkRuns(link.law, values, motion, self.step, len(curved))

    @cached_property
    def project(self) -> Callable[[Floats, int], Floats]:
        """Integrals against test functions."""
        return _projection(self.d, self.v, self.step)

    @cached_property
    def curved(self) -> tuple[Parameter, ...]:
        """Parameters in which a force is not linear once the states are known, or that the states depend on."""
        return tuple(p for p in self.structure.parameters if not self._is_linear(p))

    def _is_linear(self, parameter: Parameter) -> bool:
        return all(
            index < 0 or key in self.structure.links[index].law.linear for index, key in parameter.members
        )

    @cached_property
    def straight(self) -> tuple[Parameter, ...]:
        """The others."""
        return tuple(p for p in self.structure.parameters if self._is_linear(p))

    @cached_property
    def sizes(self) -> dict[str, float]:
        """A size for each curved parameter, from its unit and the sizes of motion and forces."""
        volts = [values for name, values in self.shown.items() if name.startswith("state:")]
        shown = float(np.std(volts[0])) if volts else None
        modes = self.structure.modes  # whose coordinates are larger than a motion in m
        links = [number for number, link in enumerate(self.structure.links) if link.name not in modes]
        return unit_sizes(self.curved, self.d[:, links], self.v[:, links], self._force_size(), shown)

    def _force_size(self) -> float:
        cells = [values for name, values in self.shown.items() if name.startswith("f:")]
        if cells:
            return float(np.std(cells[0])) or 1.0
        x, applied = self.balanced
        masses = np.array([mass.mass.value or 0.0 for mass in self.structure.masses])
        inertia = masses[:, None] * np.gradient(np.gradient(x, axis=1), axis=1) / self.step**2
        return float(max(np.std(applied), np.median(np.abs(inertia)))) or 1.0

    def solved(self, curved: Floats) -> Start:
        """All parameters, and the part in power that is left."""
        (linear,), (left,) = self.regressed(curved[None])
        values: dict[str, float] = {p.name: value for p, value in zip(self.curved, curved, strict=True)}
        values |= {p.name: value for p, value in zip(self.straight, linear, strict=True)}
        return Start.of(self.structure, values, float(np.mean(left**2)))

    def refined(self, trials: Floats) -> Floats:
        """Minima (B, q) near trials (B, q), by the method of Levenberg and Marquardt, all side by side."""
        if not self.curved:
            return trials
        best, damping = trials.copy(), np.full(len(trials), 1e-2)
        # those between two bounds stay off both, where a state may run away
        low, high = np.array([[p.lower, p.upper] for p in self.curved]).T
        margin = np.where(np.isfinite(high - low), _MARGIN * (high - low), 0.0)
        low, high = low + margin, high - margin
        sizes = np.array([self.sizes[p.name] for p in self.curved])
        count, left = len(sizes), self.regressed(best)[1]
        slopes, moved = np.empty((len(best), count, left.shape[1])), np.ones(len(best), dtype=bool)
        for _ in range(_SEARCH):
            nudge = 1e-6 * (np.abs(best) + 1e-3 * sizes)
            nudge = np.where(best + nudge > high, -nudge, nudge)[moved, :, None]
            if moved.any():
                around = self.regressed((best[moved, None] + nudge * np.eye(count)).reshape(-1, count))[1]
                slopes[moved] = (around.reshape(*nudge.shape[:2], -1) - left[moved, None]) / nudge
            scales = np.maximum(np.linalg.norm(slopes, axis=2), 1e-300)
            proposed = best.copy()
            for k, rows in enumerate(left):
                damped = np.vstack([slopes[k].T / scales[k], np.sqrt(damping[k]) * np.eye(count)])
                right = np.concatenate([rows, np.zeros(count)])
                proposed[k] -= np.linalg.lstsq(damped, right, rcond=None)[0] / scales[k]
            proposed = np.clip(proposed, low, high)
            tried = self.regressed(proposed)[1]
            gains = 1.0 - np.sum(tried**2, axis=1) / np.maximum(np.sum(left**2, axis=1), 1e-300)
            moved = gains > 0.0
            damping *= np.where(moved, 0.2, 5.0)
            best[moved], left[moved] = proposed[moved], tried[moved]
            if np.abs(gains).max() < _FLAT:
                break
        return best

    @np.errstate(all="ignore")  # values that are far off may leave the numbers; such a trial is the worst
    def regressed(self, curved: Floats) -> tuple[Floats, Floats]:
        """For each of B values (B, q) the linear parameters, and the rows that are left, relative to the forces."""
        links = list(self._links(curved))
        states = [link.states() for link in links]
        solved = [
            self._regressed(
                [{key: float(np.ravel(value)[k]) for key, value in link.values.items()} for link in links],
                [inside[:, k] for inside in states],
            )
            for k in range(len(curved))
        ]
        return np.stack([linear for linear, _ in solved]), np.stack([left for _, left in solved])

    def _regressed(
        self, numbers: Sequence[Mapping[str, float]], states: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        rows, columns = self._equations(numbers, states)
        wild = ~(np.isfinite(rows).all() and np.isfinite(columns).all())
        if wild or np.abs(rows).max() > 1e12:
            return np.zeros(len(self.straight)), np.full(len(rows), 1e6)
        size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), 1e-300)
        linear = np.linalg.lstsq(columns / size, -rows, rcond=1e-10)[0] / size
        low, high = (np.array([getattr(p, side) for p in self.straight]) for side in ("lower", "upper"))
        linear = np.clip(linear, low, high)
        return linear, rows + columns @ linear

    @cached_property
    def _sizes_of_shown(self) -> dict[str, float]:
        """The size of what each channel of a link shows among the equations."""
        sizes = {}
        for name, values in self.shown.items():
            shown = self._projected_force(values) if name.startswith("f:") else self.project(values, 0)
            sizes[name] = float(np.std(shown))
        return sizes

    @cached_property
    def _slow_part(self) -> Floats:
        """Orthonormal columns: the slow cosines, projected."""
        time = (np.arange(len(self.d)) + 0.5) / len(self.d)
        cosines = np.cos(np.pi * time[:, None] * np.arange(self.slow))
        return np.asarray(np.linalg.qr(self.project(cosines, 0))[0])

    def _projected_force(self, force: Floats) -> Floats:
        """Integrals of a force (N, ...) against test functions, without its slow part: 0 where only rounding is left of it."""
        projected = self.project(force, 0)
        if not self.slow:
            return projected
        left = projected - self._slow_part @ (self._slow_part.T @ projected)
        rounding = _ROUNDING * np.sum(projected**2, axis=0)
        return np.asarray(np.where(np.sum(left**2, axis=0) <= rounding, 0.0, left))

    @cached_property
    def _inertia(self) -> list[tuple[Floats, float, float]]:
        """Of each mass the acceleration, projected, the mass in kg as far as it is known, and the size of its equations."""
        unknown = {member for p in (*self.curved, *self.straight) for member in p.members}
        out = []
        for number, (x, applied) in enumerate(self.balanced.swapaxes(0, 1)):
            inertia, mass = self.project(x, 2), self.structure.masses[number].mass.value or 0.0
            value = 0.0 if (-1 - number, MASS) in unknown else mass
            pushed = np.std(self.project(applied, 0))
            out.append((inertia, value, max(float(pushed), value * float(np.std(inertia))) or 1.0))
        return out

    def _equations(
        self, numbers: Sequence[Mapping[str, float]], states: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        """Rows (R,) with the linear parameters at 0, and their columns (R, q)."""
        structure, incidence = self.structure, self.structure.incidence.toarray()
        place = {member: number for number, p in enumerate(self.straight) for member in p.members}
        count, links = self.d.shape
        force, slopes = np.zeros((count, links)), np.zeros((count, len(self.straight), links))
        blocks = []
        for number, link in enumerate(structure.links):
            cell = f"f:{link.name}"
            if not self.balanced.shape[1] and cell not in self.shown:
                continue
            inside = dict(zip(link.law.states, states[number], strict=True))
            for name, state in inside.items():
                channel = f"state:{link.name}.{name}"
                if channel in self.shown:
                    row = self.project(state - self.shown[channel], 0)
                    none = np.zeros((len(row), len(self.straight)))
                    blocks.append((row, none, self._sizes_of_shown[channel]))
                    inside[name] = self.shown[channel]
            along = {**numbers[number], **self.signals, **inside}
            partials = link.law.partials(self.d[:, number], self.v[:, number], along)
            force[:, number] = partials.force
            for key, slope in partials.by_coefficient.items():
                if (number, key) in place:
                    slopes[:, place[number, key], number] += slope
            if cell in self.shown:
                row = self._projected_force(force[:, number] - self.shown[cell])
                side = self._projected_force(slopes[:, :, number].copy())
                blocks.append((row, side, self._sizes_of_shown[cell]))
        for number, (inertia, value, scale) in enumerate(self._inertia):
            ends, applied = incidence[number], self.balanced[1, number]
            row = self.project(force @ ends - applied, 0) + value * inertia
            side = self.project(np.tensordot(slopes, ends, 1), 0)
            if (-1 - number, MASS) in place:
                side[:, place[-1 - number, MASS]] += inertia
            blocks.append((row, side, scale))
        rows, sides = zip(*((row / scale, side / scale) for row, side, scale in blocks), strict=True)
        return np.concatenate(rows), np.concatenate(sides)


def _balanced(record: Record, structure: Structure, x: Floats) -> Floats:
    """(2, n, N) displacements of the masses, measured ones in place of those smoothed (n, N), and applied forces."""
    balanced = np.stack([x, np.zeros_like(x)])
    for number, name in enumerate(structure.mass_names):
        if f"x:{name}" in record.channels:
            raw = record.channel(f"x:{name}")
            balanced[0, number] = np.where(np.isfinite(raw), raw, x[number])
        if f"force:{name}" in record.channels:
            balanced[1, number] = record.channel(f"force:{name}")
    return balanced


def _shown(record: Record, inferred: Mapping[str, Floats]) -> dict[str, Floats]:
    """Forces and states (N,) of links, by channel: those measured, smoothed, before what is inferred."""
    sigma, of_links = channel_noise(record), (channel for channel in record.channels if channel.of_link)
    return {**inferred, **{name: smoothed(record, name, sigma[name])[0] for name in of_links}}


def _projection(d: Floats, v: Floats, step: float) -> Callable[[Floats, int], Floats]:
    """Integrals of signals (N, ...) against test functions, or against their second derivatives (order 2)."""
    period = 2.0 * np.pi * np.std(d) / (np.std(v) or 1.0) / step
    half = int(np.clip(_WINDOW * period, 4, max(len(d) // 20, 4)))
    s = np.arange(-half, half + 1) / (half + 1)
    q = 1.0 - s**2
    kernels = {0: q**4, 2: (48.0 * s**2 * q**2 - 8.0 * q**3) / ((half + 1) * step) ** 2}

    def project(signal: Floats, order: int) -> Floats:
        windows = np.lib.stride_tricks.sliding_window_view(signal, 2 * half + 1, axis=0)[:: max(half // 2, 1)]
        return np.asarray(windows @ kernels[order] / kernels[0].sum())

    return project


# times the frequency below which all is drift elsewhere
_CUTOFFS = tuple(2.0 ** (-0.5 * k) for k in range(10))
_WORTHWHILE = 0.8  # of the misfit of a rough start: what a search leaves that did not merely follow the drift
_MOST = 3  # minima of a link whose elongation was measured


def memory_starts_by_links(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float]
) -> tuple[Start, ...]:
    """Starting values of all parameters of a structure whose masses are known and move as `needs_integration` says.

    Parameters
    ----------
    records : sequence of Record
        The records, of which the first is taken.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    tuple of Start
        Minima of what the laws leave of the forces of the links, the lowest of every link together first.
    """
    record = records[0][:MOST_SAMPLES]
    sigma = channel_noise(record)
    signals = link_signals(record, structure, sigma)
    inferred = {f"f:{link.name}": force for link, force in zip(structure.links, signals.force, strict=True)}
    shown = _shown(record, inferred)
    shown |= {f"signal:{name}": record.channel(f"signal:{name}") for name in structure.signals}
    groups = _groups(structure)
    minima = [_group_starts(*group, signals, shown, given) for group in groups]
    starts = []
    for rank in range(max(map(len, minima))):
        chosen, values = [own[min(rank, len(own) - 1)] for own in minima], dict[str, float]()
        for own, (alone, _) in zip(chosen, groups, strict=True):
            values |= own.by_name(alone)
        starts.append(Start.of(structure, values, float(np.mean([own.misfit for own in chosen]))))
    return tuple(starts)


def _groups(structure: Structure) -> list[tuple[Structure, list[int]]]:
    """The links that have unknowns as if they stood on a rig, those that share one together, and their numbers."""
    groups: list[set[int]] = []
    for parameter in structure.parameters:
        numbers = {link for link, _ in parameter.members}
        together = [group for group in groups if group & numbers]
        groups = [group for group in groups if not group & numbers] + [numbers.union(*together)]
    rigged = [replace(link, between=("base", "ground")) for link in structure.links]
    return [
        (replace(structure, masses=(), links=tuple(rigged[number] for number in group)), group)
        for group in map(sorted, groups)
    ]


def _group_starts(
    alone: Structure,
    group: list[int],
    signals: LinkSignals,
    shown: Mapping[str, Floats],
    given: Mapping[str, float],
) -> tuple[Start, ...]:
    """Starts for the links of a group, with the filters that leave least of their forces."""
    links = [link.name for link in alone.links]
    own = {name: values for name, values in shown.items() if Channel.parse(name).link in links}
    named = {name: shown[f"signal:{name}"] for name in alone.signals}

    def search(cutoff: float) -> MemorySearch:
        d, v = signals.d[group], signals.v[group]
        d, v = _without_drift(d, v, signals.step, cutoff) if cutoff else (d, v)
        cosines = int(2.0 * cutoff * signals.step * len(d.T)) + bool(cutoff)
        return MemorySearch(alone, signals.step, d.T, v.T, own, given, named, slow=cosines)

    if not signals.integration_order[group].any():
        return search(0.0).minima()[:_MOST]
    highest = min(
        drift_frequency(np.gradient(signals.v[number], signals.step), 1.0 / signals.step) for number in group
    )
    searches = [search(part * highest) for part in _CUTOFFS]
    tried = sorted(((own.rough(), own) for own in searches), key=lambda one: one[0].misfit)
    (rough, best), (second, _), *_ = tried
    refined = best.minima()[0]
    first = (refined, rough) if refined.misfit < _WORTHWHILE * rough.misfit else (rough, refined)
    return *first, second


def _without_drift(d: Floats, v: Floats, step: float, cutoff: float) -> tuple[Floats, Floats]:
    """Elongations and rates (L, N) above a frequency; each integral is filtered, as that of a drift grows."""
    rates = np.stack([highpass(row, 1.0 / step, cutoff) for row in v])
    return np.stack([highpass(integral(row, step), 1.0 / step, cutoff) for row in rates]), rates


def held_at_zero(structure: Structure) -> Structure | None:
    """The structure with what its laws are while all states of its links are 0; None where a law is nothing then."""
    links = []
    for link in structure.links:
        zero = dict.fromkeys(link.law.states, Number(0.0))
        left = substitute(link.law.expression, zero)
        if isinstance(left, Number):
            return None
        law = Law.parse(to_text(left), signals=dict(link.law.signal_units))
        own = {name: link.coefficients[name] for name in law.coefficients}
        links.append(replace(link, law=law, coefficients=own) if zero else link)
    held = replace(structure, links=tuple(links))
    return held if held.parameters else None


def host_memory_starts(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float]
) -> tuple[Start, ...]:
    """Starting values of all parameters of a structure with hosts.

    Parameters
    ----------
    records : sequence of Record
        The records, with the same channels.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    tuple of Start
        The minima of what the laws leave of the forces of links, the lowest first.

    Raises
    ------
    IdentificationError
        If the record does not determine the motion.
    """
    record = _liveliest(records)
    require_supported(record, structure)
    record, structure = record[:MOST_SAMPLES], with_starts(structure, dict(given))
    try:
        motion, tuned = motion_by_tuned_modes(record, structure)
        given = {**given, **tuned}
        fixed = {  # of modes and masses, of which the smoother needs numbers
            p.name: given.get(p.name, p.start) or 0.0
            for p in structure.parameters
            if not any(link in motion.open for link, _ in p.members)
        }
        inferred = {f"f:{structure.links[k].name}": motion.signals.force[k] for k in motion.open}
        d, v, shown = motion.signals.d.T, motion.signals.v.T, _shown(record, inferred)
        search = MemorySearch(structure.with_values(fixed), record.step, d, v, shown, given, {})
        minima = search.minima()
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    return tuple(Start.of(structure, fixed | own.by_name(search.structure), own.misfit) for own in minima)


def _liveliest(records: Sequence[Record]) -> Record:
    """The record that moves most: by the power of its responses, each relative to that in all records."""
    powers = np.array([[np.nanvar(record.channel(name)) for name in record.responses] for record in records])
    return records[
        int(np.argmax((powers / np.maximum(powers.max(axis=0), np.finfo(float).tiny)).sum(axis=1)))
    ]


def _are_apart(first: Floats, second: Floats) -> bool:
    """Whether a parameter of one start differs from that of another."""
    sizes = np.maximum(np.maximum(np.abs(first), np.abs(second)), np.finfo(float).tiny)
    return bool(np.max(np.abs(first - second) / sizes) > _DISTINCT)
