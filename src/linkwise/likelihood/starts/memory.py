"""Starting values for structures whose links have memory.

The equation of every mass is integrated against test functions, so that no displacement is differentiated twice, and the force
of a load cell is compared with its law. Along the smoothed motion the states follow from the coefficients in their rates; the
rest of the coefficients, and unknown masses, are then a linear regression (variable projection). The cost may have several
valleys: it is searched from many starts of the sizes that the units of the coefficients and the motion imply.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.link_states import follow_states, forget_start, link_motion
from linkwise.likelihood.starts.states import measured_motion
from linkwise.likelihood.starts.trials import trial_values, unit_sizes
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import smoothed

MOST_SAMPLES = 8192  # of a record that the search uses
_ROUGH_SAMPLES, _ROUGH_TRIALS = 2000, 40  # of a search that only ranks structures
_TRIALS = 60  # random starts, of which ...
_REFINED = 6  # ... so many of the best are refined
_SEARCH = 40  # steps of a refinement, at most
_FLAT = 1e-5  # relative change of the cost at which it ends
_WINDOW = 0.2  # half width of a test function over the period of the motion
_DISTINCT = 0.05  # relative distance of the forces' coefficients beyond which two valleys are different
_MARGIN = 0.05  # of the room between two bounds, next to them
_SEED = 12


@dataclass(frozen=True, eq=False)
class Valley:
    """Parameters `values` (p,) at a minimum, and `misfit`, the part of the forces in power that is left there."""

    values: Floats
    misfit: float


def memory_starts(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float]
) -> tuple[Valley, ...]:
    """Starting values of all parameters, those that leave least of the forces first; `given` starts by name are kept near.

    Raises IdentificationError where a mass has no displacement or velocity channel, or nothing sets the scale of the forces.
    """
    return MemorySearch.of(records[0], structure, given).valleys()


def rough_memory_start(records: Sequence[Record], structure: Structure) -> Valley:
    """The best of random starts on the first samples of a record: quick, to rank structures before any is fitted.

    Raises IdentificationError as `memory_starts` does.
    """
    return MemorySearch.of(records[0][:_ROUGH_SAMPLES], structure, {}).rough()


def _distinct(valleys: Sequence[Valley]) -> tuple[Valley, ...]:
    distinct: list[Valley] = []
    for valley in valleys:
        sizes = np.maximum(np.abs(valley.values), 1e-300)
        if all(np.max(np.abs(valley.values - previous.values) / sizes) > _DISTINCT for previous in distinct):
            distinct.append(valley)
    return tuple(distinct)


@dataclass(frozen=True, eq=False)
class Balance:
    """The equation of motion of a mass: its displacement and the applied force (N,), and its links' ends on it (L,).

    The mass is in kg, 0 where it is unknown.
    """

    x: Floats
    applied: Floats
    incidence: Floats
    mass: float
    place: int


@dataclass(frozen=True, eq=False)
class MemorySearch:
    """The regression along a motion: elongations and rates (N, L), projected equations, and what is unknown.

    The equations are those of the `balances` of masses, and of the forces and states (N,) of links that are `shown`, by
    channel. What forces have of the first `slow` cosines over the record is left out, where elongations are known up to drift.
    """

    structure: Structure
    step: float
    d: Floats
    v: Floats
    balances: tuple[Balance, ...]
    shown: Mapping[str, Floats]
    given: Mapping[str, float]
    slow: int = 0

    @classmethod
    def of(cls, record: Record, structure: Structure, given: Mapping[str, float]) -> MemorySearch:
        """Along a record in which every mass has a sensor; raises IdentificationError where one has not."""
        record = record[:MOST_SAMPLES]
        sigma = channel_noise(record)
        x, v = measured_motion(record, structure, sigma)
        unseen = [name for name, row in zip(structure.mass_names, x, strict=True) if not row.any()]
        if unseen:
            raise IdentificationError(
                f"no starting values for links with memory: mass {unseen[0]} has no channel; record its motion, or "
                "state starts of all unknowns"
            )
        d, rate = link_motion(record, structure, x, v)
        of_links = (channel for channel in record.channels if channel.of_link)
        shown: dict[str, Floats] = {name: smoothed(record, name, sigma[name])[0] for name in of_links}
        return cls(structure, record.step, d, rate, _balances(record, structure, x), shown, given)

    def valleys(self) -> tuple[Valley, ...]:
        """The minima that are found, the lowest first."""
        if not self.curved:
            return (Valley(*self.solved(np.zeros(0))),)
        refined = self.refined(self.trials()[:_REFINED])
        lasting = self._forget_start(refined)
        refined = refined[lasting] if lasting.any() else refined
        valleys = [Valley(*self.solved(curved)) for curved in refined]
        return _distinct(sorted(valleys, key=lambda valley: valley.misfit))

    def rough(self) -> Valley:
        """The best of random starts: quick, to rank structures or motions before any search."""
        if not self.curved:
            return Valley(*self.solved(np.zeros(0)))
        return Valley(*self.solved(self.trials(_ROUGH_TRIALS)[0]))

    def trials(self, count: int = _TRIALS) -> Floats:
        """Starts (B, q) of the curved parameters, the best first, last those whose states amplify their start."""
        rng = np.random.default_rng(_SEED)
        trials = np.stack([self.trial(rng, first=number == 0) for number in range(count)])
        costs = [float(np.mean(left**2)) for _, left in self.regressed(trials)]
        return np.asarray(trials[np.lexsort(np.stack([costs, ~self._forget_start(trials)]))])

    def _forget_start(self, curved: Floats) -> Bools:
        """Whether the states of all links forget where they began, for each of B values (B, q)."""
        forget = np.ones(len(curved), dtype=bool)
        for number, link in enumerate(self.structure.links):
            values = {key: value[:, None] for key, value in self._numbers(number, curved).items()}
            d, v = self.d[:, number], self.v[:, number]
            forget &= forget_start(link.law, values, d, v, self.step, len(curved))
        return forget

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
        inertia = [np.gradient(np.gradient(b.x)) / self.step**2 * b.mass for b in self.balances]
        applied = np.stack([balance.applied for balance in self.balances])
        return float(max(np.std(applied), np.median(np.abs(inertia)))) or 1.0

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Bounds of the curved parameters; those between two stay off both, where a state may run away."""
        low, high = np.array([[p.lower, p.upper] for p in self.curved]).T
        margin = np.where(np.isfinite(high - low), _MARGIN * (high - low), 0.0)
        return low + margin, high - margin

    def trial(self, rng: np.random.Generator, *, first: bool) -> Floats:
        """Values of the curved parameters to start from."""
        return trial_values(self.curved, self.given, self.sizes, rng, first=first)

    def solved(self, curved: Floats) -> tuple[Floats, float]:
        """Values (p,) of all parameters, and the part in power that is left."""
        ((linear, left),) = self.regressed(curved[None])
        values_by_name = dict(zip((p.name for p in self.curved), curved, strict=True))
        values_by_name |= dict(zip((p.name for p in self.straight), linear, strict=True))
        values = np.array([values_by_name[p.name] for p in self.structure.parameters])
        return values, float(np.mean(left**2))

    def refined(self, trials: Floats) -> Floats:
        """Minima (B, q) near trials (B, q), by the method of Levenberg and Marquardt, all side by side."""
        best, damping = trials.copy(), np.full(len(trials), 1e-2)
        low, high = self.bounds
        sizes = np.array([self.sizes[p.name] for p in self.curved])
        left = [rows for _, rows in self.regressed(best)]
        slopes: list[Floats] = [np.empty(0)] * len(best)  # (R, q) of each, in units of `scales`
        scales, moved = np.empty_like(best), np.ones(len(best), dtype=bool)
        for _ in range(_SEARCH):
            nudge = 1e-6 * (np.abs(best) + 1e-3 * sizes)
            nudge = np.where(best + nudge > high, -nudge, nudge)
            nudged = (best[:, None, :] + nudge[:, None, :] * np.eye(best.shape[1]))[moved]
            around = [rows for _, rows in self.regressed(nudged.reshape(-1, best.shape[1]))]
            for number, k in enumerate(np.flatnonzero(moved).tolist()):
                own = np.stack(around[number * len(sizes) : (number + 1) * len(sizes)], axis=1)
                own = (own - left[k][:, None]) / nudge[k]
                scales[k] = np.maximum(np.sqrt(np.einsum("ij,ij->j", own, own)), 1e-300)
                slopes[k] = own / scales[k]
            proposed = best.copy()
            for k, rows in enumerate(left):
                damped = np.vstack([slopes[k], np.sqrt(damping[k]) * np.eye(len(sizes))])
                right = np.concatenate([rows, np.zeros(len(sizes))])
                proposed[k] -= np.linalg.lstsq(damped, right, rcond=None)[0] / scales[k]
            proposed = np.clip(proposed, low, high)
            tried = [rows for _, rows in self.regressed(proposed)]
            gains = []
            for k, rows in enumerate(tried):
                gains.append(1.0 - float(np.sum(rows**2)) / max(float(np.sum(left[k] ** 2)), 1e-300))
                moved[k] = gains[-1] > 0.0
                damping[k] *= 0.2 if moved[k] else 5.0
                if moved[k]:
                    best[k], left[k] = proposed[k], rows
            if max(np.abs(gains)) < _FLAT:
                break
        return best

    @np.errstate(all="ignore")  # values that are far off may leave the numbers; such a trial is the worst
    def regressed(self, curved: Floats) -> list[tuple[Floats, Floats]]:
        """For each of B values (B, q) the linear parameters, and the rows that are left, relative to the forces."""
        if not len(curved):
            return []
        numbers = [self._numbers(number, curved) for number in range(len(self.structure.links))]
        states = [
            follow_states(
                link.law, {key: value[:, None] for key, value in values.items()},
                self.d[:, number], self.v[:, number], self.step, len(curved),
            )
            for number, (link, values) in enumerate(zip(self.structure.links, numbers, strict=True))
        ]  # fmt: skip
        return [
            self._regressed([{key: float(value[k]) for key, value in link.items()} for link in numbers],
                            [inside[:, k] for inside in states])
            for k in range(len(curved))
        ]  # fmt: skip

    def _numbers(self, number: int, curved: Floats) -> dict[str, Floats]:
        """Values (B,) of the coefficients of a link, 0 for those that the regression finds."""
        values = {
            key: np.full(len(curved), coefficient.value or 0.0)
            for key, coefficient in self.structure.links[number].coefficients.items()
        }
        for column, parameter in enumerate(self.curved):
            values |= {key: curved[:, column] for index, key in parameter.members if index == number}
        for parameter in self.straight:
            values |= {key: np.zeros(len(curved)) for index, key in parameter.members if index == number}
        return values

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
        return {
            name: float(
                np.std(self._projected_force(values) if name.startswith("f:") else self.project(values, 0))
            )
            for name, values in self.shown.items()
        }

    @cached_property
    def _slow_part(self) -> Floats:
        """Orthonormal columns: the slow cosines, projected."""
        time = (np.arange(len(self.d)) + 0.5) / len(self.d)
        cosines = np.cos(np.pi * time[:, None] * np.arange(self.slow))
        return np.asarray(np.linalg.qr(self.project(cosines, 0))[0])

    def _projected_force(self, force: Floats) -> Floats:
        """Integrals of a force (N, ...) against test functions, without its slow part."""
        projected = self.project(force, 0)
        return projected - self._slow_part @ (self._slow_part.T @ projected) if self.slow else projected

    @cached_property
    def _inertia(self) -> list[tuple[Floats, float, float]]:
        """Of each mass the acceleration, projected, the mass in kg as far as it is known, and the size of its equations."""
        unknown = {member for p in (*self.curved, *self.straight) for member in p.members}
        out = []
        for balance in self.balances:
            inertia = self.project(balance.x, 2)
            value = 0.0 if (-1 - balance.place, "mass") in unknown else balance.mass
            pushed = np.std(self.project(balance.applied, 0))
            out.append((inertia, value, max(float(pushed), value * float(np.std(inertia))) or 1.0))
        return out

    def _equations(
        self, numbers: Sequence[Mapping[str, float]], states: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        """Rows (R,) with the linear parameters at 0, and their columns (R, q)."""
        structure = self.structure
        place = {member: number for number, p in enumerate(self.straight) for member in p.members}
        count, links = self.d.shape
        force, slopes = np.zeros((count, links)), np.zeros((count, len(self.straight), links))
        blocks, sides = [], []
        for number, link in enumerate(structure.links):
            if not self.balances and f"f:{link.name}" not in self.shown:
                continue
            d, v = self.d[:, number], self.v[:, number]
            inside = dict(zip(link.law.states, states[number], strict=True))
            for name, state in inside.items():
                channel = f"state:{link.name}.{name}"
                if channel in self.shown:
                    shown, scale = self.shown[channel], self._sizes_of_shown[channel]
                    row = self.project(state - shown, 0) / scale
                    blocks.append(row)
                    sides.append(np.zeros((len(row), len(self.straight))))
                    inside[name] = shown
            partials = link.law.partials(d, v, {**numbers[number], **inside})
            force[:, number] = partials.force
            for key, slope in partials.by_coefficient.items():
                if (number, key) in place:
                    slopes[:, place[number, key], number] += slope
            channel = f"f:{link.name}"
            if channel in self.shown:
                shown, scale = self.shown[channel], self._sizes_of_shown[channel]
                blocks.append(self._projected_force(force[:, number] - shown) / scale)
                sides.append(self._projected_force(slopes[:, :, number].copy()) / scale)
        for balance, (inertia, value, scale) in zip(self.balances, self._inertia, strict=True):
            block = self.project(force @ balance.incidence - balance.applied, 0) + value * inertia
            side = self.project(np.tensordot(slopes, balance.incidence, 1), 0)
            if (-1 - balance.place, "mass") in place:
                side[:, place[-1 - balance.place, "mass"]] += inertia
            blocks.append(block / scale)
            sides.append(side / scale)
        return np.concatenate(blocks), np.concatenate(sides)


def _balances(record: Record, structure: Structure, x: Floats) -> tuple[Balance, ...]:
    """The equations of motion of the masses, whose smoothed displacements (n, N) are replaced by measured ones."""
    incidence, balances = structure.incidence.toarray(), []
    for number, mass in enumerate(structure.masses):
        measured = x[number]
        if f"x:{mass.name}" in record.channels:
            raw = record.channel(f"x:{mass.name}")
            measured = np.where(np.isfinite(raw), raw, measured)
        pushed = f"force:{mass.name}"
        applied = record.channel(pushed) if pushed in record.channels else np.zeros(len(record))
        balances.append(Balance(measured, applied, incidence[number], mass.mass.value or 0.0, number))
    return tuple(balances)


def _projection(d: Floats, v: Floats, step: float) -> Callable[[Floats, int], Floats]:
    """Integrals of signals (N, ...) against test functions, or against their second derivatives (order 2)."""
    period = 2.0 * np.pi * np.std(d) / (np.std(v) or 1.0) / step
    half = int(np.clip(_WINDOW * period, 4, max(len(d) // 20, 4)))
    s = np.arange(-half, half + 1) / (half + 1)
    q = 1.0 - s**2
    plain = q**4
    second = (48.0 * s**2 * q**2 - 8.0 * q**3) / ((half + 1) * step) ** 2

    def project(signal: Floats, order: int) -> Floats:
        kernel = second if order else plain
        windows = np.lib.stride_tricks.sliding_window_view(signal, 2 * half + 1, axis=0)[:: max(half // 2, 1)]
        projected: Floats = windows @ kernel / plain.sum()
        return projected

    return project
