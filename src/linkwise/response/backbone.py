"""Nonlinear modes from a linear mode to large amplitudes, of the undamped structure or as phase resonance of the damped."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from linkwise.analysis.linear_modes import Modes, modes
from linkwise.arrays import Floats
from linkwise.display import JudgedView, align_columns
from linkwise.errors import SimulationError, expect
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Answer, KnownAnswer, Posterior
from linkwise.model.structure import Structure, refuse_rig
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.response.bands import drawn_structures, spread
from linkwise.response.continuation import Point, follow, locate, solve, turned
from linkwise.response.measured_points import MeasuredPoints, decay_points
from linkwise.response.modal_motion import FreeMotion, ModalMotion, PhaseResonance
from linkwise.response.options import FORCE, Drive, shown_channels
from linkwise.response.shooting import SAMPLES, amplitudes, channel_rows
from linkwise.verdict import UNGRADED, Basis, Verdict

_SMALL = 1e-3  # of the amplitude asked for, of the rest position, or m: where a mode should be linear
_REACHED = 1e-6  # of what is to be reached
_LINEAR = 1e-4  # change of a frequency that a linear mode has at most
_TRIALS = 10  # of a tenth of the amplitude before
_VANISHED = 1e-6  # of the largest force along a curve: none
_ROUNDING = 1e-12  # of the largest energy: less is that of no motion
_CHANGE = 1.0 / 3.0  # of the frequency, at which a curve ends where no end is asked for
_DRAWS = 60  # of an answer
_STATIONS, _FEWEST = 12, 3  # points of a curve, and of a piece, near which draws have motions


@dataclass(frozen=True, eq=False, repr=False)
class Backbone(JudgedView):
    """The result of `backbone`; printed, the frequency over energy.

    Attributes
    ----------
    structure : Structure
        The structure.
    mode : int
        The number of the linear mode, from 1.
    channels : tuple of str
        The C channels of amplitudes.
    hz : array of shape (P,)
        Frequencies in Hz; the first is that of the linear mode, but for its small amplitude.
    energy : array of shape (P,)
        Energy in J above rest; in phase resonance the largest kinetic one.
    damping : array of shape (P,)
        Damping ratio: what the motion loses in a period, over 4 pi times its energy.
    amplitude : array of shape (P, C)
        Half of peak to peak of each channel.
    starts : array of shape (P, n)
        Displacements in m from which the motions are released; in phase resonance those a quarter of a period after the
        largest force.
    lower, upper : array of shape (P,) or None
        Of an answer, ends in Hz of the 95 % band of the frequency at each energy; NaN where few draws have such a motion.
    lower_damping, upper_damping : array of shape (P,) or None
        The same of the damping ratio.
    place, force : str, array of shape (P,) or None
        In phase resonance, where the force acts, and its amplitude in N.
    reached : bool
        Whether the curve reached the end that was asked for.
    outside : tuple of str
        At each point the link whose elongation leaves most the range that the record visited, "" where none does.
    measured : MeasuredPoints or None
        Points of a decay beside the curve.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> coefficients = {"k": 400.0, "k3": 1e5}
    >>> spring = lw.Link("spring", ("m1", "ground"), lw.Law.parse("k*d + k3*d**3"), coefficients)
    >>> curve = lw.backbone(lw.Structure("duffing", (lw.Mass("m1", 1.0),), (spring,)), 1, to_amplitude={"x:m1": 0.05})
    >>> curve.hz[[0, -1]].round(3).tolist(), curve.energy[-1].round(6).item()
    ([3.183, 3.849], 0.65625)
    """

    structure: Structure
    mode: int
    channels: tuple[Channel, ...]
    hz: Floats
    energy: Floats
    amplitude: Floats
    damping: Floats
    starts: Floats
    lower: Floats | None = None
    upper: Floats | None = None
    lower_damping: Floats | None = None
    upper_damping: Floats | None = None
    place: str = ""
    force: Floats | None = None
    reached: bool = True
    outside: tuple[str, ...] = ()
    measured: MeasuredPoints | None = None
    basis: Basis = UNGRADED

    def beside(self, record: Record) -> Backbone:
        """The same with the frequencies of a measured decay over its amplitude.

        Parameters
        ----------
        record : Record
            It holds the decay of a motion that is shown.

        Returns
        -------
        Backbone
            The backbone with `measured`.

        Raises
        ------
        RecordError
            If no mode rings down in it.
        """
        expect("beside(record): record", record, Record)
        return replace(self, measured=decay_points(record, float(self.hz[0]), self.channels))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the curve reached the end that was asked for."""
        return (Verdict.MOTIONS_FOLLOWED if self.reached else Verdict.MOTIONS_CUT_SHORT,)

    @property
    def findings(self) -> tuple[str, ...]:
        """Whether the curve ends too soon, and where a link leaves the range of the record, in sentences."""
        sentences = []
        if not self.reached:
            holds = self.force is None or abs(self.force[-1]) > _VANISHED * np.abs(self.force).max()
            reason = (
                "it came back to a small vibration, as in another well, or bends too sharply to be followed"
                if holds
                else "the structure holds this motion by itself, without the force, as a limit cycle"
            )
            end = f"The curve ends at {self.hz[-1]:.5g} Hz before the end that was asked for"
            sentences.append(f"{end}: {reason}.")
        first = next((number for number, link in enumerate(self.outside) if link), None)
        if first is not None:
            sentences.append(
                f"From {self.energy[first]:.3g} J on, link {self.outside[first]} moves farther than the record did: its law "
                "is extrapolated there."
            )
        return tuple(sentences)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "mode" and "points".
        """
        columns = {"hz": self.hz, "energy": self.energy, "damping": self.damping, "force": self.force}
        columns |= {"lower_hz": self.lower, "upper_hz": self.upper}
        columns |= {"lower_damping": self.lower_damping, "upper_damping": self.upper_damping}
        return {
            "method": "backbone",
            "structure": self.structure.name,
            **self._judgement(),
            "units": {channel: unit_in(self.structure, channel) for channel in self.channels},
            "findings": list(self.findings),
            "mode": self.mode,
            "points": [
                {name: float(column[number]) for name, column in columns.items() if column is not None}
                | {"amplitude": dict(zip(self.channels, values, strict=True))}
                for number, values in enumerate(self.amplitude.tolist())
            ],
            **({} if self.measured is None else {"measured": self.measured.to_list(self.channels)}),
        }

    def __str__(self) -> str:
        return "\n".join([*backbone_headline(self), *align_columns(backbone_rows(self)), *self.findings])


def backbone_headline(result: Backbone) -> tuple[str, ...]:
    """What was computed up to the largest amplitude, from which a curve may come back, in a sentence."""
    largest = int(result.amplitude.max(axis=1).argmax())
    end = f"{result.hz[0]:.5g} to {result.hz[largest]:.5g} Hz at {result.energy[largest]:.3g} J"
    ratios = " to ".join(f"{100.0 * result.damping[at]:.3g}" for at in (0, largest))
    damping = f"Its damping goes from {ratios} % of the critical one."
    name, mode = result.structure.name, result.mode
    if result.force is None:
        return f"Mode {mode} of {name} without its damping goes from {end}.", damping
    where = f"Phase resonance of {name} in mode {mode}, under a force on {result.place}"
    unit = unit_in(result.structure, f"force:{result.place}")
    return f"{where}, goes from {end} and {result.force[largest]:.3g} {unit}.", damping


def backbone_rows(result: Backbone, count: int = 12) -> list[tuple[str, ...]]:
    """Some points: frequency, energy and amplitudes."""
    which = np.unique(np.linspace(0, len(result.hz) - 1, count).round().astype(int))
    title, damping = "damping, %", [f"{ratio:.3g}" for ratio in 100.0 * result.damping[which]]
    bands = []
    if result.lower is not None and result.upper is not None:
        bands = [
            (
                "95 % band",
                *(_band_cell(band, 5) for band in zip(result.lower[which], result.upper[which], strict=True)),
            )
        ]
    if result.lower_damping is not None and result.upper_damping is not None:
        ends = zip(100.0 * result.lower_damping[which], 100.0 * result.upper_damping[which], strict=True)
        title += " (95 % band)"
        damping = [f"{text} ({_band_cell(band, 3)})" for text, band in zip(damping, ends, strict=True)]
    columns = [
        ("Hz", *(f"{hz:.5g}" for hz in result.hz[which])),
        *bands,
        (title, *damping),
        ("energy, J", *(f"{energy:.3g}" for energy in result.energy[which])),
    ]
    if result.force is not None:
        unit = unit_in(result.structure, f"force:{result.place}")
        columns.append((f"force, {unit}", *(f"{force:.3g}" for force in result.force[which])))
    for name, values in zip(result.channels, result.amplitude[which].T, strict=True):
        columns.append((f"{name}, {unit_in(result.structure, name)}", *(f"{value:.4g}" for value in values)))
    return list(zip(*columns, strict=True))


def _band_cell(ends: tuple[float, float], digits: int) -> str:
    """The ends of a band in a cell."""
    return f"{ends[0]:.{digits}g} to {ends[1]:.{digits}g}" if np.isfinite(ends).all() else "-"


def backbone(
    answer: Answer,
    mode: int,
    *,
    to_amplitude: Mapping[str, float] | None = None,
    to_energy: float | None = None,
    force: str | None = None,
    show: Sequence[str] = (),
) -> Backbone:
    """Follow free vibration of a structure without its damping from a linear mode to large amplitudes, or a phase resonance.

    The motions go from rest to rest and back the same way; the curve is followed by pseudo-arclength. Rest is the stable
    equilibrium of least energy. With `force` the structure keeps its damping, and the motions are those that a harmonic force
    there sustains which they follow by a quarter of a period; laws may then have kinks and memory.

    Parameters
    ----------
    answer : Structure, Estimate, Posterior, str or Path
        The structure, every coefficient a number or a start, or an answer of `identify` or its folder.
    mode : int
        The number of the linear mode by ascending frequency, from 1.
    to_amplitude : mapping of str to float, optional
        The channel and the amplitude, half of peak to peak, at which to end, such as ``{"x:m1": 0.01}``.
    to_energy : float, optional
        The energy in J at which to end. With neither, the curve ends where the frequency has changed by a third.
    force : str, optional
        The mass, or point of a host, on which a harmonic force acts: its phase resonance is followed.
    show : sequence of str
        Displacements and velocities whose amplitude is shown. By default the displacements of all masses and points.

    Returns
    -------
    Backbone
        Frequency, damping, energy and amplitudes along the curve; of an answer frequency and damping have bands.

    Raises
    ------
    SimulationError
        If there is no such mode, or the end is not what it must be.
    StructureError
        If a coefficient has no value, or without `force` a law has memory or is not smooth.
    TypeError
        If `answer` has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3).energy[-1].round(9).item()
    0.001
    """
    expect("backbone(answer, mode): answer", answer, Structure, Estimate, Posterior, str, Path)
    expect("backbone(answer, mode): mode", mode, int)
    asked = KnownAnswer.of(answer)
    structure = asked.structure
    refuse_rig(structure, "backbones")
    channels = shown_channels(structure, show)
    motion, count = _modal_motion(structure, force), structure.size
    linear = modes(structure)
    if not (1 <= mode <= count and linear.frequencies[mode - 1] > 0.0):
        raise SimulationError(
            f"there is no vibration in mode {mode}; the frequencies of modes 1 to {count} are "
            f"{', '.join(f'{hz:.4g}' for hz in linear.frequencies)} Hz",
        )
    end = _end_of_curve(motion, to_amplitude, to_energy)
    points = _followed_curve(motion, _linear_start(motion, linear, mode, to_amplitude or {}), end)
    if end is None and np.ptp([point.parameter for point in points]) < _LINEAR * points[0].parameter:
        raise SimulationError(
            f"the frequency of mode {mode} is {linear.frequencies[mode - 1]:.5g} Hz at any amplitude, so that nothing ends "
            "the curve: give an amplitude or an energy at which to end",
            arguments=("end",),
        )
    motions = [motion.motion(point.unknowns) for point in points]
    zero = np.zeros(SAMPLES + 1)
    outside = tuple(asked.farthest(structure.elongations(states[:, :count], zero)) for states in motions)
    rows, along = channel_rows(structure, channels), _values_along(motion, points)
    bands = {} if asked.posterior is None else _bands_of_draws(asked.posterior, motion, points, along)
    return Backbone(
        structure=structure,
        mode=mode,
        channels=channels,
        hz=along[:, 0] / (2.0 * np.pi),
        energy=along[:, 2],
        damping=along[:, 1],
        amplitude=np.array([amplitudes(states, rows, 1)[0] for states in motions]),
        starts=np.array([states[0, :count] for states in motions]),
        place=force or "",
        force=np.array([point.unknowns[-2] for point in points]) if force else None,
        reached=end is None or abs(end(points[-1])) <= _REACHED * abs(end(points[0])),
        outside=outside if asked.ranges else (),
        basis=asked.basis,
        **bands,
    )


def _modal_motion(structure: Structure, force: str | None) -> ModalMotion:
    """Motions of a mode without damping, or under a force on a place."""
    expect("backbone: force", force, str, type(None))
    if force is None:
        return FreeMotion.of_undamped(structure)
    Drive(FORCE, force).check(structure)
    return PhaseResonance(structure, force)


def _values_along(motion: ModalMotion, points: Sequence[Point]) -> Floats:
    """(P, 3) angular frequency, damping ratio and energy of motions."""
    return np.array([[point.parameter, motion.damping(point), motion.energy(point)] for point in points])


def _bands_of_draws(
    posterior: Posterior, motion: ModalMotion, points: Sequence[Point], along: Floats
) -> dict[str, Any]:
    """The ends (P,) of the bands of frequency in Hz and of the damping ratio that draws of an answer have at the energies of
    its curve, which has angular frequencies, damping ratios and energies `along` it (P, 3); None where shapes of hosts are
    uncertain, on which the equations depend.

    Each draw has a motion across the curve near some of its points. What counts is the logarithm of the ratio of its frequency
    to that of the curve at the same energy, and the difference of damping, which may have either sign, by interpolation,
    between two extremes of the energy along the curve.
    """
    energy = along[:, 2]
    drawn = drawn_structures(posterior, _DRAWS, seed=0)
    if any(structure.shape_key != posterior.structure.shape_key for structure in drawn):
        return {}
    extremes = np.flatnonzero(np.diff(np.sign(np.diff(energy)))) + 1
    off = np.full((_DRAWS, len(points), 2), np.nan)
    for table, structure in zip(off, drawn, strict=True):
        drawn_motion = motion.of(structure)
        for first, last in pairwise([0, *extremes.tolist(), len(points) - 1]):
            piece = slice(first, last + 1)
            share = max(round(_STATIONS * (last - first) / (len(points) - 1)), _FEWEST)
            stations = np.unique(np.linspace(first, last, share).round().astype(int))
            moved = [solve(drawn_motion, points[k].unknowns, points[k].tangent) for k in stations]
            solved = [point for point in moved if point is not None]
            if len(solved) > 1:
                values = _values_along(drawn_motion, solved)
                rising, order = np.argsort(energy[piece]), np.argsort(values[:, 2])
                curve = energy[piece][rising], along[piece][rising]
                omega, ratio = (np.interp(values[:, 2], curve[0], column) for column in curve[1].T[:2])
                own_off = np.stack([np.log(values[:, 0] / omega), values[:, 1] - ratio], axis=1)
                own_off[values[:, 2] < _ROUNDING * energy.max()] = np.nan
                for column in range(2):
                    table[piece, column] = np.interp(energy[piece], values[order, 2], own_off[order, column])
    lower, upper = spread(off)
    hz = along[:, 0] / (2.0 * np.pi)
    return {
        "lower": hz * np.exp(lower[:, 0]),
        "upper": hz * np.exp(upper[:, 0]),
        "lower_damping": along[:, 1] + lower[:, 1],
        "upper_damping": along[:, 1] + upper[:, 1],
    }


def _linear_start(motion: ModalMotion, linear: Modes, mode: int, to_amplitude: Mapping[str, float]) -> Point:
    """The motion of so small an amplitude that its frequency is that of the linear mode, the curve going on to larger ones."""
    small = _SMALL * (max(to_amplitude.values(), default=0.0) or float(np.abs(linear.at).max()) or 1.0)
    for _ in range(_TRIALS):
        guess, along = motion.small(linear, mode, small)
        start = solve(motion, guess, along)
        if start is not None and abs(start.parameter / guess[-1] - 1.0) < motion.near_linear:
            return turned(start, along)
        small *= 0.1
    raise SimulationError(motion.without_small.format(mode))


def _end_of_curve(
    motion: ModalMotion, to_amplitude: Mapping[str, float] | None, to_energy: float | None
) -> Callable[[Point], float] | None:
    """What is negative before the end of the curve; None where no end is asked for."""
    expect("backbone: to_amplitude", to_amplitude, Mapping, type(None))
    expect("backbone: to_energy", to_energy, float, type(None))
    if to_amplitude and to_energy is not None:
        raise SimulationError("a backbone ends at an amplitude or at an energy; give one of the two")
    if to_energy is not None:
        most = _positive_end(to_energy, "the energy")
        return lambda point: motion.energy(point) - most
    for name, size in (to_amplitude or {}).items():
        goal = _positive_end(size, "the amplitude")
        shown = shown_channels(motion.structure, (name,), "the end of a backbone", ())
        row = channel_rows(motion.structure, shown)
        return lambda point: motion.amplitude(point, row) - goal
    return None


def _positive_end(size: float, what: str) -> float:
    if not 0.0 < size < np.inf:
        message = f"{what} at which a backbone ends must be positive, in SI units, got {size!r}"
        raise SimulationError(message, arguments=("end",))
    return size


def _followed_curve(motion: ModalMotion, start: Point, end: Callable[[Point], float] | None) -> list[Point]:
    """The points from `start` to the `end`."""
    omega = start.parameter
    factor = 1.0 + _CHANGE if end is None else 1e3

    def reached(point: Point) -> bool:
        """Whether the end is reached, or rest: a curve may come back to a linear mode, that of another well."""
        return (end is not None and end(point) >= 0.0) or float(point.sizes[0]) < float(start.sizes[0])

    points = [start, *follow(motion, start, (omega / factor, omega * factor), reached)[0]]
    if end is not None and len(points) > 1 and end(points[-1]) > 0.0 > end(points[-2]):
        points[-1] = locate(motion, points[-2], points[-1], end) or points[-1]
    return points
