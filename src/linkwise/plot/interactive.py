"""The same pictures to look into: plotly figures for a page, where a reader zooms and reads values off."""

from __future__ import annotations

import numpy as np
from plotly.graph_objects import Figure, Scatter
from plotly.subplots import make_subplots

from linkwise.plot.downsample import envelope
from linkwise.plot.force import cloud_label, curve_label, force_scales
from linkwise.plot.force_view import ForceView
from linkwise.plot.histories import shown_channels
from linkwise.plot.palette import IDENTIFIED, SEEN, SERIES, TRUE, VISITED, WELL, scale
from linkwise.records.record import Record

_BAND = "rgba(0, 114, 178, 0.25)"  # IDENTIFIED, seen through
_LAYOUT = {
    "template": "none",
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "margin": {"l": 70, "r": 15, "t": 15, "b": 50},
    "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    "hoverlabel": {"namelength": -1},
}


def force_page(view: ForceView) -> Figure:
    """The elastic force of a link over its elongation, as `force_figure` draws it."""
    to_d, unit_d, to_f, unit_f = force_scales(view)
    d, force = view.d * to_d, view.force * to_f
    figure = Figure(layout={**_LAYOUT, "height": 420})
    figure.add_vrect(
        *(end * to_d for end in view.visited),
        fillcolor=VISITED,
        line_width=0,
        layer="below",
        name="range visited",
    )
    if len(view.cloud):
        figure.add_scatter(
            x=view.cloud_d * to_d, y=view.cloud * to_f, mode="markers", name=cloud_label(view),
            marker={"color": SEEN, "size": 3}, hoverinfo="skip",
        )  # fmt: skip
    if view.true is not None:
        figure.add_scatter(
            x=d, y=view.true * to_f, name="true", opacity=0.45, line={"color": TRUE, "width": 4}
        )
    if view.has_band:
        around, edge = np.concatenate([d, d[::-1]]), np.concatenate([view.upper, view.lower[::-1]]) * to_f
        figure.add_scatter(
            x=around, y=edge, fill="toself", fillcolor=_BAND, line={"width": 0}, mode="lines", name="95 % band",
            hoverinfo="skip",
        )  # fmt: skip
    figure.add_scatter(x=d, y=force, name=curve_label(view), line={"color": IDENTIFIED, "width": 2})
    if view.wells:
        figure.add_scatter(
            x=[well * to_d for well in view.wells], y=[0.0] * len(view.wells), mode="markers", name="wells",
            marker={"color": WELL, "size": 9},
        )  # fmt: skip
    figure.update_xaxes(title_text=f"elongation d, {unit_d}", range=[d[0], d[-1]], zeroline=False)
    figure.update_yaxes(
        title_text=f"force at v = 0, {unit_f}", range=[end * to_f for end in view.frame], zeroline=False
    )
    return figure


def histories_page(record: Record) -> Figure:
    """Each channel over time in strips that zoom together."""
    names = shown_channels(record)
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.15 / len(names))
    for row, name in enumerate(names, start=1):
        values = record.channel(name)
        factor, unit = scale(float(np.nanmax(np.abs(values), initial=0.0)), record.unit(name))
        time, drawn = envelope(record.time, values * factor)
        line = {"color": SERIES[(row - 1) % len(SERIES)], "width": 1}
        figure.add_trace(Scatter(x=time, y=drawn, name=name, line=line, showlegend=False), row=row, col=1)
        figure.update_yaxes(title_text=f"{name}<br>{unit}", zeroline=False, nticks=5, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=len(names), col=1)
    figure.update_layout({**_LAYOUT, "height": 90 + 130 * len(names)})
    return figure
