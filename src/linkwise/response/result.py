"""What `respond` returns: branches of steady motion at each level, with their stability and bifurcations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats
from linkwise.display import JudgedView, align_columns
from linkwise.errors import expect
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.response.measured_points import MeasuredPoints, steady_points
from linkwise.response.options import Drive
from linkwise.verdict import UNGRADED, Basis, Verdict

FOLD = "fold"
_SHOWN_BIFURCATIONS = 6
_OFF_CENTRE = 0.01  # of the amplitude: a mean beyond it is told
_MIRRORED = 1e-3  # to which ends and peaks of two curves that are one line are equal


@dataclass(frozen=True, eq=False)
class Branch:
    """A curve of steady motions, P points in order.

    Attributes
    ----------
    hz : array of shape (P,)
        Frequencies of the excitation in Hz.
    amplitude : array of shape (P, C)
        Half of peak to peak over the period, of each channel.
    first_harmonic : complex array of shape (P, C)
        The part of each channel at the frequency of the excitation: a modulus in its unit, and a phase relative to it.
    multipliers : complex array of shape (P, N)
        Floquet multipliers.
    bifurcations : tuple of str
        At each point "", "fold", "period doubling", "Neimark-Sacker" or "branch point".
    starts : array of shape (P, N)
        Displacements, velocities and states of links at the phase 0 of the excitation.
    turns : int
        The number of periods of the excitation in a period of the motion.
    outside : tuple of str
        At each point the link whose elongation leaves most the range that the record visited, "" where none does.
    lower, upper : array of shape (P, C) or None
        95 % band of the amplitudes; NaN where too few draws have such a motion.
    mean : array of shape (P, C) or None
        Mean of each channel over the period: about which rest position the motion is.

    Examples
    --------
    >>> import linkwise as lw
    >>> spring = lw.Link("spring", ("m1", "ground"), lw.Law.parse("k*d + c*v"), {"k": 400.0, "c": 2.0})
    >>> oscillator = lw.Structure("oscillator", (lw.Mass("m1", 1.0),), (spring,))
    >>> [branch] = lw.respond(oscillator, force={"m1": 1.0}, hz=(1.0, 5.0)).levels[0].branches
    >>> branch.stable.all(), branch.largest_multiplier.round(3)[0].item()
    (np.True_, 0.368)
    """

    hz: Floats
    amplitude: Floats
    first_harmonic: NDArray[np.complex128]
    multipliers: NDArray[np.complex128]
    bifurcations: tuple[str, ...]
    starts: Floats
    turns: int = 1
    outside: tuple[str, ...] = ()
    lower: Floats | None = None
    upper: Floats | None = None
    mean: Floats | None = None

    @cached_property
    def largest_multiplier(self) -> Floats:
        """Modulus of the largest Floquet multiplier, shape (P,)."""
        return np.asarray(np.abs(self.multipliers).max(axis=1))

    @cached_property
    def stable(self) -> Bools:
        """Whether a small disturbance decays, shape (P,)."""
        return self.largest_multiplier < 1.0

    @property
    def folds_hz(self) -> list[float]:
        """Frequencies in Hz at which the curve turns back, in its order."""
        return [float(hz) for hz, name in zip(self.hz, self.bifurcations, strict=True) if name == FOLD]


@dataclass(frozen=True, eq=False)
class Irregular:
    """A motion that does not repeat, at one frequency.

    Attributes
    ----------
    hz : float
        Frequency of the excitation in Hz.
    kind : {"chaotic", "quasi-periodic"}
        Which, by the exponent.
    exponent : float
        Largest exponent in 1/s: the rate at which a small difference grows.
    lower, upper : array of shape (C,)
        Range of each channel in a simulation.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.response.Irregular(3.0, "chaotic", 0.4, lower=[-0.1], upper=[0.1])
    >>> found.kind
    'chaotic'
    """

    hz: float
    kind: str
    exponent: float
    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class ResponseLevel:
    """The steady motions at one level of the excitation.

    Attributes
    ----------
    size : float
        Amplitude of the excitation, in its unit.
    branches : tuple of Branch
        The curves of periodic motions.
    irregular : tuple of Irregular
        Chaotic and quasi-periodic motions that simulations ended in.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.response.ResponseLevel(0.5, ()).folds_hz
    []
    """

    size: float
    branches: tuple[Branch, ...]
    irregular: tuple[Irregular, ...] = ()

    @property
    def folds_hz(self) -> list[float]:
        """Frequencies in Hz at which a branch turns back."""
        return [hz for branch in self.branches for hz in branch.folds_hz]


@dataclass(frozen=True, eq=False, repr=False)
class Response(JudgedView):
    """The result of `respond`; printed, the peaks and bifurcations of every level.

    Attributes
    ----------
    structure : Structure
        The structure.
    drive : Drive
        What is harmonic.
    channels : tuple of str
        The C channels of amplitudes, such as "x:m1".
    levels : tuple of ResponseLevel
        The steady motions at each level.
    draws : int
        The number of draws from the posterior behind `lower` and `upper`; 0 without bands.
    seconds : float
        The time that it took.
    measured : MeasuredPoints or None
        Points of a record beside the curves.
    basis : Basis
        The answer that the structure comes from.
    remark : str
        What the method does not look for; empty for shooting.

    Examples
    --------
    >>> import linkwise as lw
    >>> coefficients = {"k": 400.0, "k3": 1e5, "c": 1.0}
    >>> spring = lw.Link("spring", ("m1", "ground"), lw.Law.parse("k*d + k3*d**3 + c*v"), coefficients)
    >>> response = lw.respond(lw.Structure("duffing", (lw.Mass("m1", 1.0),), (spring,)), force={"m1": 1.0}, hz=(2.0, 6.0))
    >>> len(response.levels[0].folds_hz)
    2
    """

    structure: Structure
    drive: Drive
    channels: tuple[Channel, ...]
    levels: tuple[ResponseLevel, ...]
    draws: int = 0
    seconds: float = 0.0
    measured: MeasuredPoints | None = None
    basis: Basis = UNGRADED
    remark: str = ""

    def beside(self, record: Record) -> Response:
        """The same with the points of a stepped or slowly swept sine.

        Parameters
        ----------
        record : Record
            It holds the excitation and a motion of a place that is shown.

        Returns
        -------
        Response
            The response with `measured`.

        Raises
        ------
        RecordError
            If the record holds no such motion.
        """
        expect("beside(record): record", record, Record)
        return replace(self, measured=steady_points(record, self.drive, self.channels))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """That motions were followed through the frequencies; the structure may be less sure."""
        return (Verdict.MOTIONS_FOLLOWED,)

    @property
    def findings(self) -> tuple[str, ...]:
        """Where the curves leave the range of the record, where motion is not periodic, and what was not looked for."""
        findings = (sentence for level in self.levels for sentence in _level_findings(self, level))
        return (*findings, *([self.remark] if self.remark else []))

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "levels" with "branches" of "points", "folds_hz" and "irregular", and "seconds".
        """
        size = "force" if self.drive.kind == "force" else "base"
        return {
            "method": "respond",
            "structure": self.structure.name,
            "excitation": {"kind": self.drive.kind, "place": self.drive.place, "unit": self.drive.unit},
            **self._judgement(),
            "units": {channel: unit_in(self.structure, channel) for channel in self.channels},
            "draws": self.draws,
            "findings": list(self.findings),
            "levels": [{size: level.size, **self._level_document(level)} for level in self.levels],
            **({} if self.measured is None else {"measured": self.measured.to_list(self.channels, size)}),
            "seconds": self.seconds,
        }

    def _level_document(self, level: ResponseLevel) -> dict[str, Any]:
        branches = [
            {"turns": branch.turns, "points": [self._point(branch, k) for k in range(len(branch.hz))]}
            for branch in level.branches
        ]
        irregular = [
            {**vars(motion), "lower": self._by_channel(motion.lower), "upper": self._by_channel(motion.upper)}
            for motion in level.irregular
        ]
        return {"branches": branches, "folds_hz": level.folds_hz, "irregular": irregular}

    def _by_channel(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.channels, np.asarray(values).tolist(), strict=True))

    def _point(self, branch: Branch, number: int) -> dict[str, Any]:
        harmonic = branch.first_harmonic[number]
        point: dict[str, Any] = {
            "hz": float(branch.hz[number]),
            "amplitude": self._by_channel(branch.amplitude[number]),
            "first_harmonic": self._by_channel(np.abs(harmonic)),
            "phase_deg": self._by_channel(np.degrees(np.angle(harmonic))),
            "stable": bool(branch.stable[number]),
            "largest_multiplier": float(branch.largest_multiplier[number]),
        }
        if branch.mean is not None:
            point["mean"] = self._by_channel(branch.mean[number])
        if branch.bifurcations[number]:
            point["bifurcation"] = branch.bifurcations[number]
        if branch.outside:
            point["outside_range"] = branch.outside[number]
        if branch.lower is not None and branch.upper is not None:
            point["lower"] = self._by_channel(branch.lower[number])
            point["upper"] = self._by_channel(branch.upper[number])
        return point

    def __str__(self) -> str:
        return "\n".join([*headline(self), *align_columns(peak_rows(self)), *self.findings])


def headline(response: Response) -> tuple[str, ...]:
    """What was computed, in a sentence or two."""
    drive = response.drive
    what = f"a force on {drive.place}" if drive.kind == "force" else f"{drive.kind}:base"
    sizes = ", ".join(f"{level.size:g}" for level in response.levels)
    sentences = [f"Steady motion of {response.structure.name} under {what} of {sizes} {drive.unit}."]
    if response.draws:
        sentences.append(f"95 % bands are those of {response.draws} draws of the identified structure.")
    return tuple(sentences)


def peak_rows(response: Response) -> list[tuple[str, ...]]:
    """For each branch its frequencies, largest amplitude of each channel and what it moves about, and bifurcations."""
    largest = (f"largest {channel}" for channel in response.channels)
    rows = [("level", "branch", "Hz", *largest, "bifurcations (Hz)")]
    for level in response.levels:
        size, twins = f"{level.size:g} {response.drive.unit}", mirrored(level)
        for number, branch in enumerate(level.branches, start=1):
            # unstable motion, which no test shows, counts where there is no other
            shown = branch.stable | ~branch.stable.any()
            peaks = np.where(shown[:, None], branch.amplitude, -1.0).argmax(axis=0)
            cells = []
            for column, (channel, at) in enumerate(zip(response.channels, peaks, strict=True)):
                unit = unit_in(response.structure, channel)
                peak = f"{branch.amplitude[at, column]:.4g} {unit} at {branch.hz[at]:.5g} Hz"
                cells.append(f"{peak}{_mean_text(branch, column, unit)}")
            name = f"{number}" + (f" ({branch.turns} turns)" if branch.turns > 1 else "")
            name += f" (mirror of {twins[number]})" if number in twins else ""
            span = f"{branch.hz.min():.4g} to {branch.hz.max():.4g}"
            rows.append((size, name, span, *cells, _bifurcation_text(branch) or "-"))
    return rows


def _mean_text(branch: Branch, column: int, unit: str) -> str:
    """The mean of a channel that is not symmetric, where it is so least: near a rest position, if in a well."""
    if branch.mean is None:
        return ""
    parts = np.abs(branch.mean[:, column]) / branch.amplitude[:, column]
    at = int(parts.argmax())
    return f" about {branch.mean[at, column]:.4g} {unit}" if parts[at] > _OFF_CENTRE else ""


def _bifurcation_text(branch: Branch) -> str:
    marked = [(name, hz) for name, hz in zip(branch.bifurcations, branch.hz, strict=True) if name]
    shown = [f"{name} {hz:.5g}" for name, hz in marked[:_SHOWN_BIFURCATIONS]]
    return ", ".join([*shown, *(["..."] if len(marked) > len(shown) else [])])


def mirrored(level: ResponseLevel) -> dict[int, int]:
    """The numbers of branches, from 1, that are others about the opposite mean, over the same frequencies and as large."""
    mirrors = {}
    outlines = [_branch_outline(branch) for branch in level.branches]
    for (first, one), (second, other) in combinations(enumerate(outlines, start=1), 2):
        ends, means = (np.array([outline[part] for outline in (one, other)]) for part in range(2))
        off = np.abs(means).max()
        alike = np.allclose(ends[0], ends[1], rtol=_MIRRORED) and off > _OFF_CENTRE * ends[0, 3:].max()
        if alike and np.abs(means.sum(axis=0)).max() < _OFF_CENTRE * off:
            mirrors[second] = first
    return mirrors


def _branch_outline(branch: Branch) -> tuple[Floats, Floats]:
    """Turns, lowest and highest frequency and peaks (3 + C,) of a branch, and what is farthest from 0 of its means (C,)."""
    ends = np.concatenate([[branch.turns, branch.hz.min(), branch.hz.max()], branch.amplitude.max(axis=0)])
    mean = np.zeros_like(branch.amplitude) if branch.mean is None else branch.mean
    return ends, np.take_along_axis(mean, np.abs(mean).argmax(axis=0)[None], axis=0)[0]


def _level_findings(response: Response, level: ResponseLevel) -> list[str]:
    at, sentences = f"At {level.size:g} {response.drive.unit}", []
    leaving: dict[str, list[float]] = {}
    for branch in level.branches:
        for hz, link in zip(branch.hz.tolist(), branch.outside, strict=False):
            leaving.setdefault(link, []).append(hz)
    for link, places in leaving.items():
        if link:
            sentences.append(
                f"{at}, from {min(places):.4g} to {max(places):.4g} Hz, link {link} moves farther than the record did: its "
                "law is extrapolated there."
            )
    for kind in ("chaotic", "quasi-periodic"):
        if places := sorted({motion.hz for motion in level.irregular if motion.kind == kind}):
            listed = ", ".join(f"{hz:.4g}" for hz in places)
            sentences.append(f"{at}, some motions are {kind} at {listed} Hz.")
    return sentences
