"""Maps of what sinks do over one or two parameters."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from linkwise.absorption.quantities import Quantity
from linkwise.absorption.sweep import AbsorptionMap, SweepAxis
from linkwise.arrays import Floats
from linkwise.plot.palette import IDENTIFIED, SEEN, WELL
from linkwise.plot.style import sheet

SHOWN = ("settled", "sinks_share", "rms_reduction", "crossings")
_WIDE = 50.0  # largest over smallest from which colours go by ratio
_NEVER, _LOST = "#D9D9D9", "#F2B8A0"


def map_figure(found: AbsorptionMap, names: tuple[str, ...] = SHOWN) -> Figure:
    """One panel a quantity: colours over two parameters, a curve over one."""
    by_name = {each.name: each for each in found.quantities}
    rows = -(-len(names) // 2)
    with sheet(rows, 2, width=7.4, height=0.7 + 2.7 * rows) as (figure, panels):
        for axes, name in zip(panels, names, strict=False):
            values, unit = _shown(found, by_name[name])
            if len(found.axes) == 2:
                _draw_map(figure, axes, found, values, unit)
            else:
                _draw_curve(axes, found, values, unit)
            axes.set_title(by_name[name].title)
        for axes in panels[len(names) :]:
            axes.remove()
        handles = _missing(found, names)
        if handles:
            figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _shown(found: AbsorptionMap, quantity: Quantity) -> tuple[Floats, str]:
    """Values as they are read: parts of 1 in %."""
    values = found[quantity.name]
    part = quantity.unit == "" and not quantity.name.startswith("crossings")
    return (100.0 * values, "%") if part else (values, quantity.unit)


def _draw_map(figure: Figure, axes: Axes, found: AbsorptionMap, values: Floats, unit: str) -> None:
    across, up = found.axes
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    positive = finite[finite > 0.0]
    by_ratio = unit != "%" and positive.size == finite.size > 0 and high > _WIDE * low
    norm = LogNorm(low, high) if by_ratio else Normalize(low, high if high > low else low + 1.0)
    axes.set_facecolor(_NEVER)
    edges = _edges(across), _edges(up)
    mesh = axes.pcolormesh(*edges, values.T, norm=norm, cmap="viridis", rasterized=True)
    lost = np.where(found.alive, np.nan, 0.0)
    if not found.alive.all():
        axes.pcolormesh(*edges, lost.T, cmap=ListedColormap([_LOST]), rasterized=True)
    _scale(axes, across, up)
    axes.grid(False)
    if finite.size:  # a bar would show numbers that nothing has
        figure.colorbar(mesh, ax=axes, label=unit or None)


def _draw_curve(axes: Axes, found: AbsorptionMap, values: Floats, unit: str) -> None:
    (across,) = found.axes
    axes.plot(across.values, values, ".-" if len(values) <= 60 else "-", color=IDENTIFIED, markersize=4)
    for which, color in ((~found.alive, WELL), (np.isnan(values) & found.alive, SEEN)):
        if which.any():
            places = across.values[which]
            axes.plot(
                places, np.zeros(len(places)), "x", color=color, markersize=5, clip_on=False,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip
    _scale(axes, across, None)
    edges = _edges(across)
    axes.set_xlim(min(edges), max(edges))
    axes.set_ylabel(unit or "number")


def _scale(axes: Axes, across: SweepAxis, up: SweepAxis | None) -> None:
    axes.set_xlabel(_title(across))
    if across.logarithmic and across.values[0] > 0.0:
        axes.set_xscale("log")
    if up is not None:
        axes.set_ylabel(_title(up))
        if up.logarithmic and up.values[0] > 0.0:
            axes.set_yscale("log")


def _title(axis: SweepAxis) -> str:
    return f"{axis.name}, {axis.unit}" if axis.unit not in ("", "?") else axis.name


def _edges(axis: SweepAxis) -> Floats:
    """(K + 1,) edges of cells around the values."""
    values = axis.values
    if len(values) == 1:
        half = 0.5 * abs(values[0]) or 0.5
        return np.array([values[0] - half, values[0] + half])
    if axis.logarithmic and values[0] > 0.0:
        return np.asarray(np.exp(_middles(np.log(values))))
    return _middles(values)


def _middles(values: Floats) -> Floats:
    inner = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - inner[0]], inner, [2.0 * values[-1] - inner[-1]]])


def _missing(found: AbsorptionMap, names: tuple[str, ...]) -> list[Patch]:
    """What the colours of cells without a number mean, where there are such."""
    handles = []
    over_two = len(found.axes) == 2
    if any(np.any(np.isnan(found[name]) & found.alive) for name in names):
        handles.append(
            Patch(color=_NEVER if over_two else SEEN, label=f"did not settle within {found.duration:g} s")
        )
    if not found.alive.all():
        handles.append(Patch(color=_LOST if over_two else WELL, label="the motion diverges"))
    return handles
