"""Steady motion under a harmonic excitation over its frequency: all branches, their stability, and where they jump."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError, expect, options_given
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Answer, KnownAnswer, Posterior
from linkwise.model.structure import Structure, refuse_rig
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.channel import Channel
from linkwise.response.bands import banded
from linkwise.response.continuation import Point
from linkwise.response.harmonic_balance import HarmonicBalance
from linkwise.response.options import (
    ResponseKeywords,
    ResponseOptions,
    shown_channels,
)
from linkwise.response.result import Branch, Irregular, Response, ResponseLevel
from linkwise.response.search import (
    Curve,
    IrregularMotion,
    LevelSearch,
    random_starts,
    with_extremes,
)
from linkwise.response.shooting import PeriodicEquations, Shooting, amplitudes, channel_rows, driven_phase

_FREQUENCIES = 12  # at which motions are looked for
_HARMONICS = 25  # of harmonic balance, where laws have kinks, or heyoka is missing
_BALANCED = (
    "Harmonic balance follows motions from rest: branches that do not pass there, as isolated ones, and motion that does not "
    "repeat were not looked for."
)
_GROWN = 4  # frequencies at which harmonic balance follows motions from a small excitation on
_MOST_WELLS = 6  # in which motions begin


def respond(
    answer: Answer,
    options: ResponseOptions | None = None,
    *,
    progress: Progress = silent,
    **keywords: Unpack[ResponseKeywords],
) -> Response:
    """Compute the steady motion of a structure under a harmonic force, or a harmonic motion of its base, over frequency.

    Periodic motions are found by shooting and followed by pseudo-arclength, so that unstable ones between folds are there too,
    and branches that split off where stable motion loses its symmetry or doubles its period.
    Further branches, such as isolated ones and those of other wells, are looked for from rest in every well, from states at
    random and from the motions of the level before. That finds what attracts; that nothing else exists is not proven.

    Parameters
    ----------
    answer : Structure, Estimate, Posterior, str or Path
        The structure, every coefficient a number or a start, or an answer of `identify` or its folder; the amplitudes of an
        answer have bands.
    options : ResponseOptions, optional
        What to compute.
    progress : Progress
        Called with a `ProgressReport` as frequencies are done.
    **keywords
        In place of `options`: its fields `hz` (required), `force` or `base` (one is required), `levels`, `show`, `starts`,
        `seed` and `draws`.

    Returns
    -------
    Response
        Branches at each level, with amplitude, phase, stability and bifurcations.

    Raises
    ------
    SimulationError
        If the options do not fit the structure, or no periodic motion is found.
    StructureError
        If a coefficient has no value, or a law is not smooth.
    TypeError
        If `answer` has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> response = lw.respond(lw.bnes_chain(2), force={"m1": 1.0}, hz=(20.0, 30.0), starts=0)
    >>> response.channels
    ('x:m1', 'x:m2')
    """
    expect("respond(answer): answer", answer, Structure, Estimate, Posterior, str, Path)
    started = time.perf_counter()
    asked = KnownAnswer.of(answer)
    structure, chosen = asked.structure, options_given(ResponseOptions.of, options, keywords)
    refuse_rig(structure, "steady motion")
    chosen.drive.check(structure)
    shown = _Shown(asked, shown_channels(structure, chosen.show))
    integrator = None if chosen.harmonics else driven_phase(structure, chosen.drive)
    low, high = (2.0 * np.pi * hz for hz in chosen.hz)
    levels: list[ResponseLevel] = []
    before: Sequence[Curve] = ()
    for number, size in enumerate(chosen.sizes):
        driven = (structure, chosen.drive, size, (low, high))
        within = part(progress, number / len(chosen.sizes), (number + 1) / len(chosen.sizes))
        if integrator is None:
            search = _by_balance(HarmonicBalance(*driven, chosen.harmonics or _HARMONICS), before, within)
        else:
            search = _by_shooting(Shooting(*driven, integrator), chosen, before, within)
        before = [shown.with_extremes(curve) for curve in search.curves]
        branches = [shown.branch(curve) for curve in before]
        if asked.posterior is not None:
            branches = banded(asked.posterior, before, branches, shown.rows, chosen)
        levels.append(ResponseLevel(size, tuple(branches), shown.irregular(search.irregular)))
    if not any(level.branches or level.irregular for level in levels):
        raise SimulationError(
            "no steady motion was found: every motion from rest diverges; a link with negative stiffness or damping needs a "
            "term that limits the motion, or its sign is wrong"
        )
    draws = 0 if asked.posterior is None else chosen.draws
    seconds, remark = time.perf_counter() - started, "" if integrator else _BALANCED
    about = structure, chosen.drive, shown.channels, tuple(levels), draws, seconds
    return Response(*about, basis=asked.basis, remark=remark)


@np.errstate(over="ignore", invalid="ignore")  # of motions from states at random that diverge
def _by_shooting(
    shooting: Shooting, options: ResponseOptions, before: Sequence[Curve], progress: Progress
) -> LevelSearch:
    """All curves at one level; `before` are those of the level before."""
    search, rng = LevelSearch(shooting), np.random.default_rng(options.seed)
    wells = _rest_positions(shooting.structure)
    omegas = np.geomspace(*shooting.bounds, _FREQUENCIES)
    dimension = shooting.structure.topology.dimension
    at_rest = [np.concatenate([well, np.zeros(dimension - len(well))]) for well in wells]
    for omega in (omegas[0], omegas[-1]):  # forced vibration far from resonance
        for start in at_rest:
            search.take(np.append(start, omega))
    for number, omega in enumerate(omegas):
        progress(ProgressReport(number / len(omegas), f"looking for motions at {omega / (2 * np.pi):.4g} Hz"))
        for curve in before:
            for guess in curve.at(omega):
                search.take(guess, curve.equations.turns)
        for start in at_rest:
            search.settle(shooting, start, omega)
        reach = _reach_of_starts(search, wells)
        states = dimension - 2 * len(wells[0])
        for start in random_starts(wells, reach, omega, states, rng, options.starts):
            search.take(np.append(start, omega))
            search.settle(shooting, start, omega)
    search.settle_between_tori(shooting)
    return search


def _by_balance(balance: HarmonicBalance, before: Sequence[Curve], progress: Progress) -> LevelSearch:
    """All curves at one level by harmonic balance, from rest in every well and from those of the level before."""
    search, wells = LevelSearch(balance), _rest_positions(balance.structure)
    omegas = np.geomspace(*balance.bounds, _GROWN)
    for number, omega in enumerate(omegas):
        progress(ProgressReport(number / len(omegas), f"looking for motions at {omega / (2 * np.pi):.4g} Hz"))
        for well in wells:
            search.take(balance.grown(well, omega))
        for guess in (guess for curve in before for guess in curve.at(omega)):
            search.take(guess)
    return search


def _rest_positions(structure: Structure) -> Floats:
    """(W, n) the rest positions in which motions begin, or 0 where none is stable."""
    try:
        points = equilibria(structure).stable[:_MOST_WELLS]
    except StructureError:  # states that do not rest at zero
        points = ()
    return np.array([point.x for point in points]) if points else np.zeros((1, structure.size))


def _reach_of_starts(search: LevelSearch, wells: Floats) -> float:
    """How far in m random starts are from rest: as far as motions that were found, or other wells."""
    sizes = [point.sizes[0] for curve in search.curves for point, _ in curve.points]
    return max(float(np.ptp(wells, axis=0).max()), max(sizes, default=0.0))


class _ShownMotion(NamedTuple):
    """Amplitudes, first harmonics and means (C,) of a motion, its start (N,), and the link that leaves its range, or ""."""

    point: Point
    amplitude: Floats
    harmonic: NDArray[np.complex128]
    mean: Floats
    start: Floats
    outside: str


@dataclass(frozen=True, eq=False)
class _Shown:
    """Motions as the channels that are shown."""

    asked: KnownAnswer
    channels: tuple[Channel, ...]
    _kept: dict[int, _ShownMotion] = field(default_factory=dict)

    @cached_property
    def rows(self) -> Floats:
        """(C, N) the channels as combinations of states."""
        return channel_rows(self.asked.structure, self.channels)

    def branch(self, curve: Curve) -> Branch:
        """The branch of a curve."""
        equations, points = curve.equations, [point for point, _ in curve.points]
        shown = [self._motion_at(equations, point) for point in points]
        return Branch(
            hz=np.array([point.parameter for point in points]) / (2.0 * np.pi),
            amplitude=np.array([motion.amplitude for motion in shown]),
            first_harmonic=np.array([motion.harmonic for motion in shown]),
            multipliers=np.array([equations.multipliers(point) for point in points]),
            bifurcations=tuple(name for _, name in curve.points),
            starts=np.array([motion.start for motion in shown]),
            turns=equations.turns,
            outside=tuple(motion.outside for motion in shown) if self.asked.ranges else (),
            mean=np.array([motion.mean for motion in shown]),
        )

    def _motion_at(self, equations: PeriodicEquations, point: Point) -> _ShownMotion:
        """The motion at a point of a curve, which is kept: peaks are looked for in it, channel by channel."""
        if id(point) not in self._kept:
            motion, structure = equations.motion(point.unknowns), self.asked.structure
            phases: Floats = np.linspace(0.0, 2.0 * np.pi * equations.turns, len(motion))
            base, _ = equations.base(point.parameter, phases)
            outside = self.asked.farthest(structure.elongations(motion[:, : structure.size], base))
            shown = amplitudes(motion, self.rows, equations.turns)
            mean = self.rows @ motion[:-1].mean(axis=0)
            self._kept[id(point)] = _ShownMotion(point, *shown, mean, motion[0], outside)
        return self._kept[id(point)]

    def with_extremes(self, curve: Curve) -> Curve:
        """The curve with points at the peak and the antiresonances of each channel."""
        for column in range(len(self.rows)):
            curve = with_extremes(curve, partial(self._amplitude, curve.equations, column))
        return curve

    def _amplitude(self, equations: PeriodicEquations, column: int, point: Point) -> float:
        return float(self._motion_at(equations, point).amplitude[column])

    def irregular(self, motions: Sequence[IrregularMotion]) -> tuple[Irregular, ...]:
        """Irregular motions in the channels, those of a kind at one frequency together."""
        gathered: dict[tuple[float, bool], list[IrregularMotion]] = {}
        for motion in motions:
            gathered.setdefault((motion.omega, motion.chaotic), []).append(motion)
        return tuple(
            Irregular(
                omega / (2.0 * np.pi),
                "chaotic" if chaotic else "quasi-periodic",
                max(motion.exponent for motion in alike),
                np.min([(motion.states @ self.rows.T).min(axis=0) for motion in alike], axis=0),
                np.max([(motion.states @ self.rows.T).max(axis=0) for motion in alike], axis=0),
            )
            for (omega, chaotic), alike in gathered.items()
        )
