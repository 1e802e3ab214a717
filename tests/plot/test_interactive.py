"""The interactive form of a figure shows what the figure shows, and is safe to stand in a page."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import linkwise as lw
from linkwise.estimates.curves import force_curve
from linkwise.plot.interactive import interactive_html, to_plotly
from linkwise.plot.links import force_figure
from linkwise.plot.records import histories_figure


def three_sines() -> lw.Record:
    """Three masses that swing, the first with a gap."""
    time = np.arange(500) / 100.0
    channels = {f"x:m{k}": 0.01 * np.sin((k + 1) * time) for k in (1, 2, 3)}
    channels["x:m1"][100:200] = np.nan
    return lw.Record.from_arrays(time, channels, source="waves.csv")


def test_force_shows_what_the_figure_shows(fitted: lw.Estimate) -> None:
    content, curve = to_plotly(force_figure(fitted, "nes1")), force_curve(fitted, "nes1")
    wide = {trace["name"]: trace for trace in content["data"] if trace["xaxis"] == "x"}
    assert {"true", "95 % band", "identified", "wells", "true minus damping", ""} == set(wide)
    inside = (curve.d >= curve.visited[0]) & (curve.d <= curve.visited[1])
    np.testing.assert_allclose(wide["identified"]["x"], 1e3 * curve.d[inside], rtol=1e-6)  # seven digits
    # seven digits
    np.testing.assert_allclose(wide["identified"]["y"], curve.force[inside], rtol=1e-6, atol=1e-12)
    assert content["layout"]["xaxis"]["title"]["text"] == "elongation d, mm"
    [span, _] = content["layout"]["shapes"]
    assert (span["name"], span["yref"]) == ("range visited", "y domain")
    assert [span["x0"], span["x1"]] == pytest.approx([1e3 * end for end in curve.visited], rel=1e-12)


def test_every_label_stands_once_in_the_legend(fitted: lw.Estimate) -> None:
    content = to_plotly(force_figure(fitted, "nes1"))
    parts = [*content["data"], *content["layout"]["shapes"]]
    shown = [part["name"] for part in parts if part["showlegend"]]
    assert sorted(shown) == sorted({part["name"] for part in parts} - {""}) and len(shown) == 6
    assert {part["legendgroup"] for part in parts if part["name"] == "identified"} == {"identified"}


def test_histories_zoom_together_and_keep_their_gaps() -> None:
    record = three_sines()
    content = to_plotly(histories_figure(record))
    layout = content["layout"]
    assert [trace["name"] for trace in content["data"]] == list(record.channels)
    assert (
        "matches" not in layout["xaxis"] and layout["xaxis2"]["matches"] == layout["xaxis3"]["matches"] == "x"
    )
    assert [layout[f"xaxis{n}"]["showticklabels"] for n in ("", 2, 3)] == [False, False, True]
    assert content["data"][0]["y"][100:200] == [None] * 100 and None not in content["data"][1]["y"]


def test_panels_stand_where_the_figure_has_them() -> None:
    figure = Figure()
    for axes in figure.subplots(2, 2).flat:
        axes.plot([0.0, 1.0], [1.0, 2.0])
    layout = to_plotly(figure)["layout"]
    across = [layout[f"xaxis{n}"]["domain"] for n in ("", 2, 3, 4)]
    up = [layout[f"yaxis{n}"]["domain"] for n in ("", 2, 3, 4)]
    assert across[0] == across[2] and across[1] == across[3] and across[0][1] < across[1][0]
    assert up[0] == up[1] and up[2] == up[3] and up[2][1] < up[0][0]


def test_lines_across_the_axes_and_logarithms_are_kept() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.semilogy([1.0, 2.0], [1.0, 100.0], "o--", color="#D55E00", label="curve")
    axes.axhline(10.0, color="k")
    axes.axvline(1.5, linestyle=":")
    axes.set_ylim(1.0, 100.0)
    content = to_plotly(figure)
    [trace] = content["data"]
    assert trace["mode"] == "lines+markers" and trace["line"]["dash"] == "dash"
    assert trace["line"]["color"] == "rgba(213,94,0,1)"
    assert content["layout"]["yaxis"]["range"] == [0.0, 2.0]
    level, moment = content["layout"]["shapes"]
    assert (level["y0"], level["y1"], level["xref"]) == (10.0, 10.0, "x domain")
    assert (moment["x0"], moment["x1"], moment["line"]["dash"]) == (1.5, 1.5, "dot")


def test_what_has_no_interactive_form_is_refused(fitted: lw.Estimate) -> None:
    figure = Figure()
    figure.subplots().imshow(np.eye(3))
    with pytest.raises(TypeError, match=r"^an? AxesImage has no interactive form$"):
        to_plotly(figure)
    figure = Figure()
    figure.subplots().set_yscale("symlog")
    with pytest.raises(TypeError, match=r"^a symlog axis has no interactive form$"):
        to_plotly(figure)
    figure = Figure()
    figure.subplots().plot([1.0], [1.0], "|")
    with pytest.raises(TypeError, match=r"marker '\|' has no interactive form"):
        to_plotly(figure)


def test_markup_in_names_is_harmless() -> None:
    record = replace(three_sines(), source="</script><b>$x$</b>.csv")
    html = interactive_html(histories_figure(record), 'a"><b>')
    assert html.count("</script>") == 1 and html.endswith("</script>") and "<b>" not in html
    script = re.search(r"Plotly\.newPlot\((.*)\)</script>", html)
    assert script is not None
    identifier, data, layout, config = json.loads(f"[{script[1]}]")
    assert identifier == 'a"><b>' and len(data) == 3 and config["responsive"] is True
    assert [heading["text"] for heading in layout["annotations"]] == [
        "&lt;/script&gt;&lt;b&gt;$x$&lt;/b&gt;.csv"
    ]


def test_legend_headings_and_titles_of_axes_do_not_cover_each_other() -> None:
    """In a browser the legend lay on the heading of the first panel, and titles on labels of four characters and more."""
    record = three_sines()
    headed, plain = histories_figure(record), histories_figure(record)
    for axes, name in zip(headed.axes, ("above", "", ""), strict=True):
        axes.set_title(name, loc="left")
    for axes in plain.axes:
        axes.set_title("", loc="left")
    with_heading, without = to_plotly(headed)["layout"], to_plotly(plain)["layout"]
    [heading] = with_heading["annotations"]
    assert heading["y"] == without["legend"]["y"] == 1.0 < with_heading["legend"]["y"]
    vertical = [with_heading[name] for name in ("yaxis", "yaxis2")]
    assert all(axis["automargin"] and axis["title"]["standoff"] > 0 for axis in vertical)
