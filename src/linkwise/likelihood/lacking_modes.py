"""Hosts that lack a mode in the band.

The modes of a host move alone under the forces on its points: those that are applied, and those of the links along the fitted
motion. A sensor on the host shows a sum of these motions and of free decays, in which a host that is stated as it should be
has only its own frequencies. A mode that is not stated leaves a peak, and one more frequency explains it. Amplitudes are free
at every sensor, so that no shape has to be known, nor any to be right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.fitted_motion import motion_of_links
from linkwise.modal.oscillators import SampledForce
from linkwise.model.host import Host
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.record import Record

_SAMPLES = 20_000  # of a record, from its start
_MOST = 60  # modes of a host, and samples for each of its columns, that can be told apart
_DAMPING = (0.003, 0.01, 0.03)  # of a mode that is not stated
_PEAKS = 4  # of what is left that are tried
_APART = 0.08  # relative distance from a stated frequency, below which that is rather off
_NYQUIST = 0.45  # of the rate: frequencies up to which a mode is in the band
_EXPLAINED = (
    0.5  # of what is left in the sensors of the host: one more mode beside other causes explains less
)
_CONVINCING = 50.0  # of -2 log likelihood for each column that is added
_SEEN = 100.0  # of the noise in power: a mode that should be seen in the sensors
_NEEDED = 0.05  # of what a mode that should be seen takes off: less, and it is elsewhere
_TRIALS = 8  # frequencies about a peak
_RANK = 1e-8  # of a column of unit length that others explain
_OFF = 4  # frequencies a little off the stated ones that may leave more than a mode that is lacking


def lacking_modes(fit: LikelihoodFit, identified: Structure, records: Sequence[Record]) -> tuple[Cause, ...]:
    """Modes that hosts lack, by what the forces on them leave in their sensors.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit whose laws do not explain the records.
    identified : Structure
        The structure with its values.
    records : sequence of Record
        The records, of which the first is looked at.

    Returns
    -------
    tuple of Cause
        For each host at most one; none on a moving base, and where a model error stands for what the laws lack.
    """
    record = records[0]
    if not fit.chi_square_off or any(channel.place == BASE for channel in record.channels):
        return ()
    start = record[: min(len(record), _SAMPLES)]
    forces = _forces_on_points(fit, identified, records, len(start))
    causes = []
    for host in identified.hosts:
        shown = _Shown.of(host, start, forces, fit.noise)
        cause = None if shown is None else shown.cause()
        if cause is not None:
            causes.append(cause)
    return tuple(causes)


def _forces_on_points(
    fit: LikelihoodFit, identified: Structure, records: Sequence[Record], samples: int
) -> dict[str, Floats]:
    """(N,) the force on each point of a host along the fitted motion, from the start of the first record."""
    record, motion = records[0], motion_of_links(fit, identified, records)
    points = {point for host in identified.hosts for point in host.points}
    totals: dict[str, Floats] = {}
    for number, link in enumerate(identified.links):
        if link.name in identified.modes or not points.intersection(link.between):
            continue
        force = None if motion.identified_force is None else motion.identified_force[:samples, number]
        if force is None or np.isnan(force).any():
            force = link.force(motion.d[:samples, number], motion.v[:samples, number], {})
        for point, sign in zip(link.between, (-1.0, 1.0), strict=True):
            if point in points:
                totals[point] = totals.get(point, 0.0) + sign * np.nan_to_num(force)
    for channel in record.forces:
        if (point := channel.place) in points:
            totals[point] = totals.get(point, 0.0) + np.nan_to_num(record.channel(channel)[:samples])
    return totals


@dataclass(frozen=True, eq=False)
class _Shown:
    """What the sensors of a host show, in units of their noise, and the forces on its points."""

    host: Host
    step: float
    forces: Mapping[str, SampledForce]
    kinds: tuple[int, ...]  # derivative that each of c sensors shows
    points: tuple[str, ...]
    units: tuple[float, ...]  # standard deviation of the noise of each sensor
    values: Floats  # (N, c)
    present: Bools  # (N,)

    @classmethod
    def of(
        cls, host: Host, record: Record, forces: Mapping[str, Floats], noise: Mapping[str, float]
    ) -> _Shown | None:
        """None where no sensor is on the host, no force acts, or there are too many modes for the samples."""
        sensors = [
            (channel, channel.order, channel.place)
            for channel in record.motions
            if channel.place in host.points
        ]
        acting = {point: SampledForce(force, record.step) for point, force in forces.items() if force.any()}
        acting = {point: force for point, force in acting.items() if point in host.points}
        values = [mode.frequency.value for mode in host.modes]
        columns = (len(values) + 1) * (len(acting) + 2)
        if not sensors or not acting or None in values or len(values) > _MOST:
            return None
        units = tuple(noise.get(name) or 1.0 for name, _, _ in sensors)
        stack = np.stack([record.channel(name) for name, _, _ in sensors], axis=1) / np.array(units)
        present = np.isfinite(stack).all(axis=1)
        if present.sum() < _MOST * columns / 10:
            return None
        kinds, points = zip(*((kind, point) for _, kind, point in sensors), strict=True)
        return cls(host, record.step, acting, kinds, points, units, np.nan_to_num(stack), present)

    def cause(self) -> Cause | None:
        """The mode that explains most of what is left, if it explains what no other cause does."""
        stated = [
            (float(mode.frequency.value or 0.0), float(mode.damping.value or 0.0)) for mode in self.host.modes
        ]
        columns = [self._columns(*mode) for mode in stated]
        first = float(np.sum(_Explained.by(self, columns).left ** 2))
        for _ in range(_OFF):
            explained = _Explained.by(self, columns)
            trials = [self._refined(explained, frequency) for frequency in self._peaks(explained.left)]
            if not trials:
                return None
            power, frequency, added = min(trials, key=lambda trial: trial[0])
            if not any(abs(frequency / f - 1.0) < _APART for f, _ in stated if f > 0.0):
                break
            columns.append(added)  # what a stated frequency that is a little off leaves
        else:
            return None
        count, before = len(self.kinds) * added.shape[2], float(np.sum(explained.left**2))
        gain = float(explained.left.size * np.log(before / max(power, 1.0)))
        share = (before - power) / first
        if share < _EXPLAINED or gain < _CONVINCING * count or self._moved(columns, len(stated), added):
            return None
        return Cause("mode", self.host.name, frequency, "Hz", gain, standard_error=0.0, share=share)

    def _columns(self, frequency: float, damping: float) -> Floats:
        """(3, N, f + 2) displacement, velocity and acceleration of a mode under each force, and of its free decay."""
        if frequency > _NYQUIST / self.step:
            return self._static()
        time = self.step * np.arange(len(self.values))
        if frequency == 0.0:  # a rigid motion
            ones, zeros = np.ones_like(time), np.zeros_like(time)
            free = [np.stack([ones, zeros, zeros]), np.stack([time, ones, zeros])]
            return np.stack([*map(self._rigid, self.forces.values()), *free], axis=2)
        w = 2.0 * np.pi * frequency
        pole = w * complex(-damping, np.sqrt(max(1.0 - damping**2, 1e-6)))
        decay = np.stack([pole**order * np.exp(pole * time) for order in range(3)]) / w
        moved = [force.motion(frequency, min(damping, 0.99)) for force in self.forces.values()]
        return np.stack([*moved, decay.real, decay.imag], axis=2)

    def _rigid(self, force: SampledForce) -> Floats:
        integrate = scipy.integrate.cumulative_trapezoid
        velocity = integrate(force.samples, dx=self.step, initial=0.0)
        return np.stack([integrate(velocity, dx=self.step, initial=0.0), velocity, force.samples])

    def _static(self) -> Floats:
        """(3, N, f) what follows the forces at once, as a mode above the band does, and its derivatives."""
        time = self.step * np.arange(len(self.values))
        splines = [scipy.interpolate.make_interp_spline(time, f.samples, 5) for f in self.forces.values()]
        return np.stack([[spline(time, order) for order in range(3)] for spline in splines], axis=2)

    def _peaks(self, left: Floats) -> list[float]:
        """Frequencies in Hz at which most is left, apart from each other."""
        spectrum = np.sum(np.abs(scipy.fft.rfft(left, axis=0)) ** 2, axis=1)
        frequencies = scipy.fft.rfftfreq(len(left), self.step)
        spectrum[(frequencies < 2.0 * frequencies[1]) | (frequencies > _NYQUIST / self.step)] = 0.0
        peaks: list[float] = []
        for _ in range(_PEAKS):
            peak = float(frequencies[int(np.argmax(spectrum))])
            if peak == 0.0:
                break
            peaks.append(peak)
            spectrum[np.abs(frequencies - peak) < max(_APART * peak, 3.0 * frequencies[1])] = 0.0
        return peaks

    def _refined(self, explained: _Explained, near: float) -> tuple[float, float, Floats]:
        """The power that one more mode near a frequency leaves, its frequency, and its columns."""
        width = max(0.03 * near, 1.5 / (self.step * len(self.values)))
        best = (np.inf, near, np.zeros((3, len(self.values), 0)))
        for damping in _DAMPING:
            solved = scipy.optimize.minimize_scalar(
                lambda frequency, damping=damping: explained.power_with(self._columns(frequency, damping)),
                bounds=(max(near - width, 0.1 * near), near + width),
                method="bounded",
                options={"maxiter": _TRIALS},
            )
            if solved.fun < best[0]:
                best = (float(solved.fun), float(solved.x), self._columns(float(solved.x), damping))
        return best

    def _moved(self, columns: Sequence[Floats], stated: int, added: Floats) -> bool:
        """Whether the sensors do not show a stated mode that they should: then it is another one, and none is lacking."""
        for number in range(stated):
            if columns[number].shape[2] == len(self.forces):  # above the band
                continue
            name = self.host.coordinates[number]
            shapes = np.array([self.host.shape(point)[name] for point in self.forces])
            driven = columns[number][:, :, : len(shapes)] @ shapes
            expected = np.stack(
                [
                    self.host.shape(point)[name] * driven[kind] / unit
                    for kind, point, unit in zip(self.kinds, self.points, self.units, strict=True)
                ],
                axis=1,
            )
            others = _Explained.by(self, [*columns[:number], *columns[number + 1 :], added])
            alone = float(np.sum(others.left_of(expected[self.present]) ** 2))
            needed = float(np.sum(others.left**2)) - others.power_with(columns[number])
            if alone > _SEEN * len(self.kinds) and needed < _NEEDED * alone:
                return True
        return False


@dataclass(frozen=True, eq=False)
class _Explained:
    """What columns of a host's motion leave of its sensors: orthonormal bases (N, q) by kind of sensor, and `left` (N, c)."""

    kinds: tuple[int, ...]
    present: Bools
    bases: dict[int, Floats]
    left: Floats

    @classmethod
    def by(cls, shown: _Shown, columns: Sequence[Floats]) -> _Explained:
        bases = {}
        for kind in sorted(set(shown.kinds)):
            parts = [part[kind] for part in columns] + [np.ones((len(shown.values), 1))]
            bases[kind] = _orthonormal(np.concatenate(parts, axis=1)[shown.present])
        own = cls(shown.kinds, shown.present, bases, shown.values[shown.present])
        return replace(own, left=own.left_of(own.left))

    def left_of(self, values: Floats) -> Floats:
        """(N, c) what the columns leave of other values of the sensors."""
        left = values.copy()
        for kind, basis in self.bases.items():
            own = np.equal(self.kinds, kind)
            left[:, own] -= basis @ (basis.T @ left[:, own])
        return left

    def power_with(self, added: Floats) -> float:
        """The power that is left where columns (3, N, p) are added."""
        power = float(np.sum(self.left**2))
        for kind, basis in self.bases.items():
            more = added[kind][self.present]
            more = more / np.maximum(np.linalg.norm(more, axis=0), np.finfo(float).tiny)
            more = _orthonormal(more - basis @ (basis.T @ more))
            power -= float(np.sum((more.T @ self.left[:, np.equal(self.kinds, kind)]) ** 2))
        return power


def _orthonormal(columns: Floats) -> Floats:
    """(N, q) a basis of columns (N, p), without those that the others leave nothing of."""
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    basis, root, _ = scipy.linalg.qr(columns / size, mode="economic", pivoting=True)
    return np.asarray(basis[:, np.abs(root.diagonal()) > _RANK])
