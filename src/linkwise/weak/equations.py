"""Weak equations of a structure on a record, without the bias due to noise (METHODS section 4), and their residuals.

`patch` defines the equations; this module selects the masses that have one, places their windows, and keeps the smoothed
motion in the windows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.coefficient import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import BAND_LIMITED, at_samples
from linkwise.records.record import Record
from linkwise.signals.base_frame import frame_acceleration
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.layout import StructureLayout, structure_layout
from linkwise.weak.patch import Patch, PatchContext
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2
from linkwise.weak.window import Window

MIN_WINDOWS = 8  # windows
_PATCH = 12  # masses: their dense products are cheap, and the terms of most links are shared
_DENSE_WINDOWS = 400  # from twice as many, sums of smooth slopes over time use every second window
_MAX_THINNING = 2
_SLOPE_THINNING = 4  # the slopes in products of noise with itself vary more slowly


@dataclass(frozen=True, eq=False)
class WeakEquations:
    """All weak equations of one record, and the smoothed motion in their windows.

    Attributes
    ----------
    context : PatchContext
        What the patches share.
    structure_layout : StructureLayout
        Layout of the structure.
    window : Window
        The test functions.
    motion : MeasuredDisplacements
        Displacements and their noise.
    patches : tuple of Patch
        The equations.
    thinning : int
        Stride in windows of the sums that give the covariance.
    d, v : array of shape (E, R)
        Smoothed elongations in m and their rates in m/s, of links and then of what elements of states read, at R windows.
    states : array of shape (S, R)
        Smoothed states of links.
    signals : mapping of str to array of shape (R,)
        Smoothed signals that laws name.
    acceleration : array of shape (n + S, R)
        Smoothed accelerations in m/s^2 of masses and modes, and second derivatives of states.
    time : array of shape (R,)
        Centres of the windows in s.
    """

    context: PatchContext
    structure_layout: StructureLayout
    window: Window
    motion: MeasuredDisplacements
    patches: tuple[Patch, ...]
    thinning: int
    d: Floats
    v: Floats
    states: Floats
    signals: Mapping[str, Floats]
    acceleration: Floats
    time: Floats

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return self.structure_layout.names

    def by_name(self, values: Floats) -> dict[str, float]:
        """Values (p,) of the parameters by their names."""
        return dict(zip(self.parameters, map(float, values), strict=True))

    @property
    def windows(self) -> int:
        """Number of windows R."""
        return len(self.time)

    @cached_property
    def points(self) -> Indices:
        """(P,) the windows next to the points of `Window.adjoint`, over which sums over time go."""
        return self.window.adjoint_windows(self.windows, self.thinning)

    @property
    def inside(self) -> slice:
        """Where the points between the first and the last centre are."""
        return slice(0, len(self.points) - 2 * self.window.half)


def weak_equations(
    record: Record,
    structure: Structure,
    motion: MeasuredDisplacements,
    *,
    window: Window | None = None,
    rate_window: Window | None = None,
    values: dict[str, float] | None = None,
    only: Collection[int] | None = None,
) -> WeakEquations:
    """Weak equations of a structure on a record.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    motion : MeasuredDisplacements
        Displacements of the record, from `read_displacements`.
    window : Window, optional
        The test functions; chosen from the bandwidth by default.
    rate_window : Window, optional
        What smooths the rates that laws act by; then sums over time take every window. The test functions by default.
    values : dict of str to float, optional
        Present values of parameters that enter a law nonlinearly; their starts by default.
    only : collection of int, optional
        The numbers of the masses and modes whose equations are wanted; all by default.

    Returns
    -------
    WeakEquations
        The equations.

    Raises
    ------
    IdentificationError
        If the record is shorter than eight windows, too many samples are missing, or a parameter lacks a start.
    """
    layout = structure_layout(structure)
    window = window or Window.for_band(motion.bandwidth, record.rate, motion.noise_free)
    windows = window.rows(len(record))
    if windows < MIN_WINDOWS:
        raise IdentificationError(
            f"the record is too short: its {len(record)} samples give {windows} windows of {window.length} samples, and "
            f"{MIN_WINDOWS} are needed; record for longer"
        )
    thinning = min(max(1, windows // _DENSE_WINDOWS), _MAX_THINNING) if rate_window is None else 1
    applied = _applied(record, structure)
    smooth = window.filter(motion.displacements, window.kernels)
    signals = {name: _at_samples(record, f"signal:{name}") for name in structure.signals}
    total = _with_frame(smooth, applied, frame_acceleration(record), layout, window)
    context = PatchContext(
        structure_layout=layout,
        values=layout.values(values or {}),
        motion=motion,
        window=window,
        rate_window=rate_window or window,
        filtered=total,
        forces={
            mass: -window.filter(np.nan_to_num(force)[None], window.kernels[:1])[0, 0]
            for mass, force in applied.items()
        },
        slope_stride=_SLOPE_THINNING * thinning,
        signals=signals,
    )
    area, displaced = window.kernels[PHI].sum(), _displacements(smooth, window)
    return WeakEquations(
        context=context,
        structure_layout=layout,
        window=window,
        motion=motion,
        patches=_patches(context, applied, only),
        thinning=thinning,
        d=layout.elongations(displaced, range(len(layout.elements))),
        v=layout.elongations(-smooth[PHI_1] / area, range(len(layout.elements))),
        states=displaced[structure.size : layout.equations],
        signals={
            name: window.filter(np.nan_to_num(signal)[None], window.kernels[:1])[0, 0] / area
            for name, signal in signals.items()
        },
        acceleration=smooth[PHI_2, :-2] / area,
        time=record.start + (window.half + window.stride * np.arange(windows)) / record.rate,
    )


def _applied(record: Record, structure: Structure) -> dict[int, Floats]:
    """(N,) the applied force on each mass or mode that has one, by its number."""
    applied: dict[int, Floats] = {}
    for place in structure.places:
        channel = f"force:{place}"
        if channel in record.channels:
            force = _at_samples(record, channel)
            for mass, weight in structure.topology.weights(structure.topology.index[place]):
                applied[mass] = applied.get(mass, 0.0) + weight * force
    return dict(sorted(applied.items()))


def _at_samples(record: Record, channel: str) -> Floats:
    """(N,) what an input is around its samples."""
    return at_samples(record.channel(channel), record.interpolation.get(channel, BAND_LIMITED))


def _with_frame(
    smooth: Floats,
    applied: dict[int, Floats],
    acceleration: Floats | None,
    layout: StructureLayout,
    window: Window,
) -> Floats:
    """The sums (K, n + 2, R) with the acceleration (N,) of the coordinates in that of masses that are parameters.

    Their forces of inertia, which `applied` has by the values in the structure, leave it.
    """
    if acceleration is None:
        return smooth
    total, masses = smooth.copy(), layout.structure.masses
    for index in (index for index in range(len(masses)) if (-1 - index, MASS) in layout.parameter_index):
        total[PHI_2, index] += window.filter(acceleration[None], window.kernels[:1])[0, 0]
        applied[index] = applied[index] + (masses[index].mass.value or 0.0) * acceleration
        if not applied[index].any():
            del applied[index]
    return total


def _displacements(smooth: Floats, window: Window) -> Floats:
    """(n + 2, R) displacements from their sums (3, n + 2, R) under phi, phi', phi'': averages without
    bias to third order: that of a curve under phi is biased by half its curvature times the second moment of phi.
    """
    time = window.step * np.arange(-window.half, window.half + 1)
    phi = window.kernels[PHI]
    return np.asarray((smooth[PHI] - 0.5 * (phi @ time**2 / phi.sum()) * smooth[PHI_2]) / phi.sum())


def _patches(
    context: PatchContext, applied: dict[int, Floats], only: Collection[int] | None
) -> tuple[Patch, ...]:
    """Patches of the masses, `only` some, whose displacement and those of all their neighbours were measured.

    Masses in one patch lack the same windows, and either each of their equations has a parameter or none has.
    """
    layout = context.structure_layout
    measured = [*context.motion.measured.tolist(), bool(context.motion.has_channel[-2])]
    whole = np.ones(context.filtered.shape[2])
    by_windows: dict[tuple[bytes, bool], tuple[Floats, list[int]]] = {}
    for mass, nodes in enumerate(layout.neighbourhoods):
        if all(measured[node] for node in nodes):
            near = [node for node in nodes if node < layout.equations]
            laws = [layout.elements[number].law for number in layout.elements_at[mass]]
            known = [context.signals[name] for law in laws for name in law.signals]
            known += [applied[mass]] if mass in applied else []
            missing = _missing(context.motion, near, known)
            if mass in layout.masses_needing_rate:
                missing = _missing_rate(missing, context)
            valid = _valid(missing, context.window) if missing.any() else whole
            key = (valid.tobytes(), mass in layout.masses_with_parameters)
            by_windows.setdefault(key, (valid, []))[1].append(mass)
    _require_whole_windows([valid for valid, _ in by_windows.values()], context.window)
    patches: list[Patch] = []
    for valid, masses in by_windows.values():
        wanted = [mass for mass in masses if only is None or mass in only]
        firsts = range(0, len(wanted), _PATCH)
        patches += [context.patch(wanted[first : first + _PATCH], valid) for first in firsts]
    return tuple(patches)


def _missing(motion: MeasuredDisplacements, masses: list[int], known: Sequence[Floats]) -> Bools:
    """(N,) True where a sample of `masses`, or of a force or signal that is `known` (N,), is missing."""
    missing = np.zeros(motion.displacements.shape[1], dtype=bool)
    if motion.missing is not None:
        missing |= np.any(motion.missing[masses], axis=0)
    return np.asarray(np.any([missing, *map(np.isnan, known)], axis=0))


def _missing_rate(missing: Bools, context: PatchContext) -> Bools:
    """(N,) True where v is unknown: a window around the sample lacks one or extends past the record."""
    window_samples = np.lib.stride_tricks.sliding_window_view(
        np.pad(missing, context.rate_window.half, constant_values=True), context.rate_window.length
    )
    return np.asarray(window_samples.any(axis=1))


def _valid(missing: Bools, window: Window) -> Floats:
    """(R,) 1 for windows without a missing sample, 0 for others."""
    count = window.filter(missing[None].astype(float), np.ones((1, window.length)))[0, 0]
    return np.asarray(count < 0.5, dtype=float)


def _require_whole_windows(valid: list[Floats], window: Window) -> None:
    if valid and max(weights.sum() for weights in valid) < MIN_WINDOWS:
        raise IdentificationError(
            f"too many samples are missing: no mass has {MIN_WINDOWS} complete windows of {window.length} samples; fill "
            "single gaps first, keep the samples that all sensors have, or record again"
        )


def weak_residual(equations: WeakEquations, values: Floats) -> Floats:
    """(R, n) residuals in N of the weak equations with parameters `values` (p,).

    They are NaN for masses without an equation and windows with missing samples.
    """
    residual = np.full(equations.acceleration.T.shape, np.nan)
    area = np.abs(equations.window.kernels[PHI]).sum()
    for patch in equations.patches:
        total = np.where(patch.valid > 0.0, patch.residual(values) / area, np.nan)
        residual[:, patch.masses] = total.T
    return residual
