"""Every public picture is drawn on the Axes of the caller, says so where it cannot be, and prints names as they are; of
panels nothing is cut, and nothing lies on something else.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import pytest
from commands import python
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from present import some
from problems import chain_record
from reach_rows import reach_maps
from structures import beam_of_one_mode

import linkwise as lw
from linkwise.plot import absorptions, discoveries
from linkwise.plot.absorptions import crossings_figure, decay_figure, energy_figure, map_figure
from linkwise.plot.discoveries import evidence_figure, path_figure
from linkwise.plot.discovery_graph import graph_figure
from linkwise.plot.links import force_comparison_figure, force_figure
from linkwise.plot.records import histories_figure

Draw = Callable[..., Axes]
PICTURES = (
    "absorption", "acceleration_surface", "backbone", "coherence", "crossings", "departures", "designs", "displacement",
    "distortion", "energy", "evidence", "force", "force_comparison", "force_errors", "graph", "histories", "level_modes",
    "level_response", "loop", "map", "path", "prediction", "prediction_error", "prediction_profile",
    "prediction_spectrum", "residuals", "response", "ring_down", "runners_up", "shapes", "spectrogram", "spectrum", "study",
    "success_map", "surface", "trade_off",
)  # fmt: skip
UNLISTED = {"runners_up": discoveries, "trade_off": absorptions}  # pictures of pages alone
WITHOUT_LEGEND = {"prediction_profile", "runners_up", "spectrogram", "success_map"}
ODD = "a$b$_c"  # between two dollar signs matplotlib sets mathematics


def rows(method: str = "ml") -> list[lw.study.Row]:
    """Rows of a study: two structures at two noise levels."""
    return [
        lw.study.Row(
            f"bnes-{n}", n, level, method, 1, status="converged", links={"nes1": n / level}, seconds=n
        )
        for n in (2, 4)
        for level in (40.0, 20.0)
    ]


def compared(force: str) -> lw.inspection.LevelComparison:
    """A mode at two levels of a force."""
    runs = [
        lw.simulate(beam_of_one_mode(), forces={"beam.tip": f"{size}*{force}"}, duration=2.0, rate=320.0)
        for size in (1.0, 2.0)
    ]
    return lw.inspection.compare_levels([run.with_noise(40.0, seed=1) for run in runs], modes=1)


@pytest.fixture(scope="module")
def drawings(fitted: lw.Estimate, discovered: lw.Discovery) -> dict[str, Draw]:
    """Each public picture with a result to draw."""
    drive: dict[str, Any] = {"duration": 0.2, "rate": 500.0, "release": {"v:m1": 1.0}}
    absorbed = lw.absorb(lw.bnes_chain(2), **drive)
    swept = lw.absorption.absorption_map(
        lw.bnes_chain(2), {"nes1.alpha": [-150.0, -100.0], "nes1.beta": [5e5, 1e6]}, **drive
    )
    few = lw.absorption.DesignOptions(evaluations=20)
    bounds = {"m2.mass": (0.002, 0.05), "nes1.beta": (1e5, 1e7)}
    designed = lw.design(lw.bnes_chain(2), bounds, "rms", few, **drive)
    record = chain_record(2, duration=1.0, rate=500.0, speed=0.1).with_noise(40.0, seed=1)
    validated = lw.validate(record, lw.bnes_chain(2))
    periodic, tapped = compared("sin(2*pi*16*t)"), compared("exp(-((t - 0.1)/0.01)**2)")
    sinks = (lw.bnes_chain(2).link("nes1"), {ODD: lw.bnes_chain(2, beta=1.1e6).link("nes1")}, (-0.02, 0.02))
    spring = lw.rig(
        masses={"m1": 1.0},
        links={"spring": "m1 - ground: k*d + c*v"},
        known={"spring.k": 400.0, "spring.c": 2.0},
    )
    driven = lw.respond(spring, force={"m1": 1.0}, hz=(1.0, 5.0), starts=0)
    results = {
        "distortion": (periodic,), "level_modes": (tapped,), "level_response": (tapped,), "ring_down": (tapped,),
        "acceleration_surface": (tapped,),
        "absorption": (absorbed,), "crossings": (absorbed,), "energy": (absorbed,), "evidence": (discovered,),
        "departures": (discovered, "m2-m1"),
        "displacement": (lw.analysis.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=0.5, rate=500.0), "m1"),
        "force_comparison": sinks, "force_errors": sinks,
        "force": (fitted, "nes1"), "graph": (discovered,), "histories": (fitted,), "loop": (fitted, "nes1"),
        "surface": (fitted, "nes1"),
        "map": (swept, "sinks_share"), "designs": (designed,), "trade_off": (designed,),
        "prediction": (validated, "x:m1"), "prediction_error": (validated, "x:m1"),
        "prediction_profile": (validated, "d of nes1"), "prediction_spectrum": (validated, "x:m2"),
        "coherence": (fitted.record, "x:m1", "x:m2"), "spectrogram": (fitted.record, "x:m1"),
        "residuals": (discovered.estimate, "x:m1", "frequency"),
        "backbone": (lw.backbone(spring, 1, to_energy=1e-3), "x:m1"), "response": (driven, "x:m1"),
        "path": (discovered,), "runners_up": (discovered,), "shapes": (beam_of_one_mode().hosts[0],),
        "spectrum": (fitted.record, "x:m1", 1e-4), "study": (rows(),),
        "success_map": (reach_maps()[0],),
    }  # fmt: skip
    assert set(results) == set(PICTURES)

    def drawing(name: str) -> Draw:
        draw = getattr(UNLISTED.get(name, lw.plot), name)
        return lambda **options: draw(*results[name], **options)

    return {name: drawing(name) for name in results}


def drawn(axes: Axes) -> int:
    """How many things show data."""
    return len(axes.lines) + len(axes.collections) + len(axes.patches)


def test_pictures_are_all_that_is_public_beside_saving_them() -> None:
    assert set(lw.plot.__all__) == {*PICTURES, "save"} - set(UNLISTED)
    with pytest.raises(AttributeError, match=r"module 'linkwise\.plot' has no attribute 'forces'"):
        lw.plot.forces  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_drawn_on_axes_of_the_caller_or_its_own(name: str, drawings: dict[str, Draw]) -> None:
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert drawings[name](ax=left) is left
    assert drawn(left) > 0 and drawn(right) == 0
    figure.savefig("/dev/null", format="png", dpi=30)
    axes = drawings[name]()
    assert isinstance(axes.figure, Figure) and axes in axes.figure.axes and drawn(axes) > 0
    if name not in WITHOUT_LEGEND:
        without = drawings[name](legend=False)
        assert without.get_legend() is None and without.figure is not axes.figure
        assert name == "map" or axes.get_legend() is not None


@pytest.mark.slow
def test_the_style_of_the_caller_stays(drawings: dict[str, Draw]) -> None:
    """The look of the figures that commands write is not forced upon other people's axes."""
    with rc_context({"font.size": 17.0, "axes.grid": False}):
        axes = Figure().subplots()
        drawings["force"](ax=axes)
        assert axes.spines["top"].get_visible() and axes.xaxis.label.get_fontsize() == 17.0
        assert not any(line.get_visible() for line in some(axes.get_xgridlines()))
        assert not drawings["force"]().spines["top"].get_visible()
        assert rcParams["font.size"] == 17.0


@pytest.mark.slow
def test_pyplot_axes_work_and_nothing_here_imports_pyplot() -> None:
    """In a process of its own: pyplot keeps global state."""
    code = (
        "import sys, linkwise as lw\n"
        "assert 'matplotlib' not in sys.modules\n"
        "record = lw.simulate(lw.bnes_chain(2), release={'v:m1': 1.0}, duration=0.2, rate=500.0)\n"
        "lw.plot.histories(record)\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "import matplotlib; matplotlib.use('agg')\n"
        "import matplotlib.pyplot as plt\n"
        "figure, ax = plt.subplots()\n"
        "assert lw.plot.histories(record, ax=ax) is ax and len(ax.lines) == 2\n"
    )
    result = python("-W", "error", "-c", code)
    assert result.returncode == 0, result.stderr


def test_names_with_dollar_signs_are_printed_as_they_are(fitted: lw.Estimate) -> None:
    links = (replace(each, name=ODD if each.name == "nes1" else each.name) for each in fitted.structure.links)
    motion = replace(fitted.motion, structure=replace(fitted.structure, links=tuple(links)))
    record = replace(fitted.record, simulated=None, source=f"{ODD}.csv")
    odd = replace(fitted, compute_motion=lambda: motion, record=record)
    sink = lw.bnes_chain(2).link("nes1")
    compared_figure = force_comparison_figure(sink, {ODD: sink}, (-0.02, 0.02), title=ODD)
    for figure in (force_figure(odd, ODD), histories_figure(odd.record), compared_figure):
        texts = [text for text in figure.findobj(Text) if "$" in text.get_text()]
        assert texts
        assert all(text.get_text().count("$") == text.get_text().count(r"\$") for text in some(texts))
    legend = lw.plot.study(rows("_mine")).get_legend()  # which matplotlib would leave out
    assert legend is not None and [text.get_text() for text in legend.get_texts()] == ["\u200b_mine"]


PIXEL = 1.5  # what rounding of glyphs may add


def boxes(figure: Figure) -> Iterator[tuple[str, Bbox]]:
    """What each panel covers with its labels, what its legends and its title cover, in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    for number, axes in some(enumerate(figure.axes)):
        if axes.get_visible():
            covered = axes.get_tightbbox(renderer)
            assert covered is not None
            yield f"panel {number}", covered
    for legend in figure.legends:
        yield "legend", legend.get_window_extent(renderer)
    for text in figure.texts:
        yield text.get_text(), text.get_window_extent(renderer)


def faults(figure: Figure) -> list[str]:
    """What reaches beyond the figure, and pairs that lie on each other."""
    covered = list(boxes(figure))
    inside = figure.bbox.padded(PIXEL)
    cut = [
        name for name, box in covered
        if box.x0 < inside.x0 or box.y0 < inside.y0 or box.x1 > inside.x1 or box.y1 > inside.y1
    ]  # fmt: skip
    on = [
        f"{a} on {b}"
        for (a, first), (b, second) in combinations(covered, 2)
        if first.padded(-PIXEL).overlaps(second.padded(-PIXEL))
    ]
    return cut + on


@pytest.mark.slow
def test_figures_of_answers_have_no_faults(discovered: lw.Discovery, fitted: lw.Estimate) -> None:
    trial: dict[str, Any] = {"duration": 0.2, "rate": 500.0, "release": {"v:m1": 3.0}}
    over = {"nes1.alpha": [-150.0, -100.0], "nes1.beta": [5e5, 1e6]}
    figures = {
        "graph": graph_figure(discovered),
        "path": path_figure(discovered),
        "evidence": evidence_figure(discovered),
        "histories": histories_figure(fitted.record),
        "two panels": force_figure(fitted, "nes1"),
        "one panel": force_figure(fitted, "spring1"),
        "map": map_figure(lw.absorption.absorption_map(lw.bnes_chain(2), over, **trial)),
    }
    absorption = lw.absorb(lw.bnes_chain(8), **trial)
    for draw in (decay_figure, energy_figure, crossings_figure):
        figures[draw.__name__] = draw(absorption)
    assert {name: faults(figure) for name, figure in figures.items()} == {name: [] for name in figures}


def test_what_is_cut_or_covered_is_seen() -> None:
    """Beside the checks above, one that must find something."""
    figure = Figure()
    figure.subplots().set_ylabel("cut", labelpad=100.0)
    figure.suptitle("covered", y=0.5)
    assert faults(figure) == ["panel 0", "panel 0 on covered"]
