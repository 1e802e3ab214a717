"""From a record and a structure to weak equations, free of the bias that noise puts into them (METHODS section 4).

What the equations are stands in `patch`; here it is decided which masses have one, where their windows lie, and what the
windows saw of the motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements, differences
from linkwise.weak.layout import StructureLayout, structure_layout
from linkwise.weak.patch import Patch, PatchContext
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2
from linkwise.weak.window import Window

_FEWEST = 8  # windows
_PATCH = 12  # masses: their dense products are small change, and shared work is not yet lost
_ENOUGH = 400  # windows: slopes along the motion are smooth, so one window may stand for its neighbours in sums over time
_THINNEST = 2
_SMOOTHER = 4  # the slopes by which noise meets itself are smoother still


@dataclass(frozen=True, eq=False)
class WeakEquations:
    """All weak equations of one record, in `patches`; every `thinning`-th window tells their noise.

    Beside them what the windows saw: `d`, `v` (L, R) smoothed elongations in m and rates in m/s, `acceleration` (n, R) in
    m/s2, `force` (R, n) in N (None: no force), `time` (R,) in s.
    """

    structure_layout: StructureLayout
    window: Window
    motion: MeasuredDisplacements
    patches: tuple[Patch, ...]
    thinning: int
    d: Floats
    v: Floats
    acceleration: Floats
    force: Floats | None
    time: Floats

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return self.structure_layout.names

    @property
    def ends(self) -> Indices:
        """(L, 2) mass indices of the ends of the links, -1 for the ground and -2 for the base."""
        return self.structure_layout.ends

    @property
    def windows(self) -> int:
        """R."""
        return len(self.time)

    @cached_property
    def adjoint_windows(self) -> Indices:
        """The windows near the places of `Window.adjoint`."""
        return self.window.adjoint_windows(self.windows, self.thinning)

    @property
    def slope_stride(self) -> int:
        """Every so many windows `Patch.slopes` are known."""
        return _SMOOTHER * self.thinning


def weak_equations(
    record: Record,
    structure: Structure,
    motion: MeasuredDisplacements,
    *,
    window: Window | None = None,
    values: dict[str, float] | None = None,
    together: int = _PATCH,
) -> WeakEquations:
    """The weak equations of `structure` on `record` whose `motion` was read; the window is chosen where it is None.

    `values` are the present values of parameters that enter a law nonlinearly (else their starts);
    `together` is the most masses in a patch. Raises IdentificationError where the record is too short or too broken.
    """
    window = window or Window.for_band(motion.bandwidth, record.rate, motion.noise_free)
    windows = window.rows(len(record))
    if windows < _FEWEST:
        raise IdentificationError(
            f"the record is too short: its {len(record)} samples hold {windows} windows of {window.length} samples, and "
            f"{_FEWEST} are the least; record for longer"
        )
    thin = min(max(1, windows // _ENOUGH), _THINNEST)
    pushes = {
        mass: record.channel(f"force:{name}")
        for mass, name in enumerate(structure.mass_names)
        if f"force:{name}" in record.channels
    }
    smooth = window.filter(motion.displacements, window.kernels)
    layout = structure_layout(structure)
    context = PatchContext(
        structure_layout=layout,
        values=layout.values(values or {}),
        motion=motion,
        window=window,
        filtered=smooth,
        forces={
            mass: -window.filter(np.nan_to_num(push)[None], window.kernels[:1])[0, 0]
            for mass, push in pushes.items()
        },
        slope_stride=_SMOOTHER * thin,
    )
    area = window.kernels[PHI].sum()
    return WeakEquations(
        structure_layout=layout,
        window=window,
        motion=motion,
        patches=_patches(context, pushes, together),
        thinning=thin,
        d=differences(_sharpened(smooth, window), layout.ends),
        v=differences(-smooth[PHI_1] / area, layout.ends),
        acceleration=smooth[PHI_2, :-2] / area,
        force=_placed(context.forces, area, structure.size, windows) if pushes else None,
        time=record.start + (window.half + window.stride * np.arange(windows)) / record.rate,
    )


def _sharpened(smooth: Floats, window: Window) -> Floats:
    """(n + 2, R) displacements from their sums (3, n + 2, R) under phi, phi', phi'': means without bias to the third order.

    The mean of a curve under phi is off by half its curvature times the second moment of phi; phi'' tells the curvature.
    """
    at = window.step * np.arange(-window.half, window.half + 1)
    phi = window.kernels[PHI]
    return np.asarray((smooth[PHI] - 0.5 * (phi @ at**2 / phi.sum()) * smooth[PHI_2]) / phi.sum())


def _placed(pushes: Mapping[int, Floats], area: float, masses: int, windows: int) -> Floats:
    """(R, n) applied forces from those of the forced masses, negative under phi."""
    placed = np.zeros((windows, masses))
    for mass, push in pushes.items():
        placed[:, mass] = -push / area
    return placed


def _patches(context: PatchContext, pushes: dict[int, Floats], together: int) -> tuple[Patch, ...]:
    """The masses whose equation can be written: their displacement and those of all their neighbours were seen.

    Masses in one patch miss the same windows, and either each of their equations holds a parameter or none does.
    """
    layout = context.structure_layout
    seen = [*context.motion.measured.tolist(), context.motion.base is not None, True]
    whole = np.ones(context.filtered.shape[2])
    alike: dict[tuple[bytes, bool], tuple[Floats, list[int]]] = {}
    for mass, around in enumerate(layout.neighbourhoods):
        if all(seen[end] for end in around):
            lost = _lost(context.motion, [end for end in around if end >= 0], pushes.get(mass))
            if mass in layout.masses_needing_rate:
                lost = _without_rate(lost, context)
            valid = whole if lost is None else _valid(lost, context.window)
            key = (b"" if lost is None else valid.tobytes(), mass in layout.masses_with_parameters)
            alike.setdefault(key, (valid, []))[1].append(mass)
    patches = [
        context.patch(masses[first : first + together], valid)
        for valid, masses in alike.values()
        for first in range(0, len(masses), together)
    ]
    _require_whole_windows(patches, context.window)
    return tuple(patches)


def _lost(motion: MeasuredDisplacements, masses: list[int], push: Floats | None) -> Bools | None:
    """(N,) where a sample of `masses` or of the force `push` (N,) is missing, or None where none is."""
    if motion.missing is None and push is None:
        return None
    lost = np.zeros(motion.displacements.shape[1], dtype=bool)
    if motion.missing is not None:
        lost |= np.any(motion.missing[masses], axis=0)
    if push is not None:
        lost |= np.isnan(push)
    return lost if lost.any() else None


def _without_rate(lost: Bools | None, context: PatchContext) -> Bools:
    """(N,) where v cannot be told, since a window around the sample misses one or leaves the record."""
    if lost is None:
        lost = np.zeros(context.motion.displacements.shape[1], dtype=bool)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(lost, context.window.half, constant_values=True), context.window.length
    )
    return np.asarray(around.any(axis=1))


def _valid(lost: Bools, window: Window) -> Floats:
    """(R,) 1 for windows without a lost sample, 0 for others."""
    count = window.filter(lost[None].astype(float), np.ones((1, window.length)))[0, 0]
    return np.asarray(count < 0.5, dtype=float)


def _require_whole_windows(patches: list[Patch], window: Window) -> None:
    if patches and max(patch.windows for patch in patches) < _FEWEST:
        raise IdentificationError(
            f"too many samples are missing: no mass has {_FEWEST} windows of {window.length} samples without one; fill single "
            "gaps before, or record again"
        )
