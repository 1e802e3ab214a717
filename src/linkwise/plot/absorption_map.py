"""Maps of what sinks do over one or two parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from linkwise.absorption.map_result import AbsorptionMap, SweepAxis
from linkwise.absorption.quantities import AbsorptionQuantity
from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.plot.palette import IDENTIFIED, MEASURED, WELL
from linkwise.plot.style import axes_for, literal, log_scale, place_legend, sheet

SHOWN = ("settled", "sinks_share", "rms_reduction", "crossings")
_WIDE = 50.0  # largest over smallest from which colours go by ratio
_NEVER, _DIVERGED = "#D9D9D9", "#F2B8A0"


@checked
def map(
    result: AbsorptionMap, quantity: str = "settled", *, legend: bool = True, ax: Axes | None = None
) -> Axes:
    """Draw a quantity over the swept parameters: colours over two, a curve over one.

    Parameters
    ----------
    result : AbsorptionMap
        An answer of `linkwise.absorption_map`.
    quantity : str, default "settled"
        Name of one of ``result.quantities``, such as ``"sinks_share"``, ``"rms_reduction"`` or ``"crossings"``.
    legend : bool, default True
        Add a legend to the axes where there are cells without a number.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a colour bar is put beside them. By default those of a new figure, which is ``ax.figure`` of the
        returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: the swept parameters in their SI units, parts of 1 in %.

    Raises
    ------
    LinkwiseError
        If there is no such quantity.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption_map(lw.bnes_chain(2), over, duration=0.5, rate=500.0, release={"v:m1": 1.0})
    >>> lw.plot.map(swept, "sinks_share").get_ylabel()
    '%'
    """
    values, unit = _shown(result, quantity)
    with axes_for(ax, width=4.6, height=3.4, colorbars=len(result.axes) == 2) as axes:
        if len(result.axes) == 2:
            _draw_map(axes, result, values, unit)
        else:
            _draw_curve(axes, result, values, unit)
        axes.set_title(literal(_quantity(result, quantity).title))
        handles = _missing(result, [quantity])
        if legend and handles:
            axes.legend(handles=handles)
    return axes


@checked
def map_figure(result: AbsorptionMap, names: Sequence[str] = SHOWN) -> Figure:
    """One panel a quantity.

    Parameters
    ----------
    result : AbsorptionMap
        What `linkwise.absorption_map` returned.
    names : sequence of str
        Names of the quantities, a panel each.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    LinkwiseError
        If there is no such quantity, or none is named.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption_map(lw.bnes_chain(2), over, duration=0.5, rate=500.0, release={"v:m1": 1.0})
    >>> len(lw.plot.map_figure(swept, ["sinks_share", "rms_reduction"]).axes)
    2
    """
    if not names:
        raise LinkwiseError("names must hold at least one quantity, got none")
    rows = -(-len(names) // 2)
    with sheet(rows, 2, width=7.4, height=0.7 + 2.7 * rows, colorbars=True) as (figure, panels):
        for axes, name in zip(panels, names, strict=False):
            map(result, name, legend=False, ax=axes)
        for axes in panels[len(names) :]:
            axes.remove()
        handles = _missing(result, names)
        if handles:
            place_legend(figure, handles, [str(handle.get_label()) for handle in handles], 2)
    return figure


def _quantity(result: AbsorptionMap, name: str) -> AbsorptionQuantity:
    return next(candidate for candidate in result.quantities if candidate.name == name)


def _shown(result: AbsorptionMap, name: str) -> tuple[Floats, str]:
    """Values as they are read: parts of 1 in %."""
    values, unit = result[name], _quantity(result, name).unit
    part = unit == "" and not name.startswith("crossings")
    return (100.0 * values, "%") if part else (values, unit)


def _draw_map(axes: Axes, result: AbsorptionMap, values: Floats, unit: str) -> None:
    across, up = result.axes
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    positive = finite[finite > 0.0]
    by_ratio = unit != "%" and positive.size == finite.size > 0 and high > _WIDE * low
    norm = LogNorm(low, high) if by_ratio else Normalize(low, high if high > low else low + 1.0)
    axes.set_facecolor(_NEVER)
    edges = _edges(across), _edges(up)
    mesh = axes.pcolormesh(*edges, values.T, norm=norm, cmap="viridis", rasterized=True)
    if not result.completed.all():
        diverged = np.where(result.completed, np.nan, 0.0)
        axes.pcolormesh(*edges, diverged.T, cmap=ListedColormap([_DIVERGED]), rasterized=True)
    _scale_axes(axes, across, up)
    axes.grid(False)
    if finite.size:  # a bar would show numbers that nothing has
        axes.figure.colorbar(mesh, ax=axes, label=unit or None)


def _draw_curve(axes: Axes, result: AbsorptionMap, values: Floats, unit: str) -> None:
    (across,) = result.axes
    axes.plot(across.values, values, ".-" if len(values) <= 60 else "-", color=IDENTIFIED, markersize=4)
    for missing, color in ((~result.completed, WELL), (np.isnan(values) & result.completed, MEASURED)):
        if missing.any():
            axes.plot(
                across.values[missing],
                np.zeros(int(missing.sum())),
                "x",
                color=color,
                markersize=5,
                clip_on=False,
                transform=axes.get_xaxis_transform(),
            )
    _scale_axes(axes, across, None)
    edges = _edges(across)
    axes.set_xlim(min(edges), max(edges))
    axes.set_ylabel(unit or "number")


def _scale_axes(axes: Axes, across: SweepAxis, up: SweepAxis | None) -> None:
    axes.set_xlabel(_axis_label(across))
    if across.logarithmic and across.values[0] > 0.0:
        log_scale(axes, "x")
    if up is not None:
        axes.set_ylabel(_axis_label(up))
        if up.logarithmic and up.values[0] > 0.0:
            log_scale(axes, "y")


def _axis_label(axis: SweepAxis) -> str:
    return literal(f"{axis.name}, {axis.unit}" if axis.unit not in ("", "?") else axis.name)


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


def _missing(result: AbsorptionMap, names: Sequence[str]) -> list[Patch]:
    """What the colours of cells without a number mean, where there are such."""
    handles = []
    over_two = len(result.axes) == 2
    if any(np.any(np.isnan(result[name]) & result.completed) for name in names):
        color = _NEVER if over_two else MEASURED
        handles.append(Patch(color=color, label=f"did not settle within {result.duration:g} s"))
    if not result.completed.all():
        handles.append(Patch(color=_DIVERGED if over_two else WELL, label="the motion diverges"))
    return handles
