"""Results of `absorb`, `absorption_intervals` and `absorption_map` as rows of text, for print and for the page."""

from __future__ import annotations

import numpy as np

from linkwise.absorption.ensemble import AbsorptionQuantity
from linkwise.absorption.harvesters import damping_unit
from linkwise.absorption.intervals import AbsorptionIntervals, QuantityInterval
from linkwise.absorption.map import AbsorptionMap, SweepAxis
from linkwise.absorption.result import Absorption, AbsorptionRun, MassChange, SinkResult
from linkwise.display import align_columns, as_text, paragraph, remark_lines

Rows = list[tuple[str, ...]]

_MANY = 12  # masses, links or sinks that are printed


@as_text.register
def absorption_text(absorption: Absorption) -> str:
    """The whole result as text."""
    blocks = ["\n".join(paragraph(sentence) for sentence in headline(absorption))]
    tables = [
        (mass_rows(absorption), "masses"),
        (energy_rows(absorption), "links"),
        (crossing_rows(absorption), "sinks"),
    ]
    if absorption.harvests:
        tables.append((harvest_rows(absorption), "harvesters"))
    blocks += [_table(rows, contents) for rows, contents in tables]
    if absorption.findings:
        blocks.append("\n".join(map(remark_lines, absorption.findings)))
    return "\n\n".join(blocks)


def percent(part: float | None) -> str:
    """A part of 1 in %."""
    return "-" if part is None else f"{100.0 * part:.3g} %"


def smaller(reduction: float | None) -> str:
    """A relative reduction in words: so much smaller, or larger."""
    if reduction is None:
        return "-"
    return f"{percent(abs(reduction))} {'smaller' if reduction >= 0.0 else 'larger'}"


def seconds(time: float | None) -> str:
    """A time in s, "never" for None."""
    return "never" if time is None else f"{time:.4g} s"


def headline(absorption: Absorption) -> tuple[str, ...]:
    """The result in three sentences."""
    names = ", ".join(result.sink.link for result in absorption.sinks[:_MANY])
    more = f" and {len(absorption.sinks) - _MANY} more" if len(absorption.sinks) > _MANY else ""
    with_sinks, without = absorption.settled
    return (
        f"With its sinks the RMS of the {primary(absorption)} is {smaller(absorption.rms_reduction)} over "
        f"{absorption.time[-1]:g} s.",
        f"The sinks ({names}{more}) took {percent(absorption.sinks_share)} of the energy; for comparison they are "
        f"{absorption.removal}.",
        f"All {primary(absorption)} below {100 * absorption.settle:g} % of their peak: {seconds(with_sinks)} with sinks, "
        f"{seconds(without)} without.",
    )


def primary(absorption: Absorption) -> str:
    """What is to come to rest: primary masses, points of hosts, or both."""
    points = set(absorption.with_sinks.structure.points)
    ours = [mass.name in points for mass in absorption.masses]
    return "points" if all(ours) else "primary masses and points" if any(ours) else "primary masses"


def mass_rows(absorption: Absorption) -> Rows:
    """Peak, RMS, settling time and rate of decay of each primary mass, with and without sinks."""
    first = "point" if primary(absorption) == "points" else "mass"
    titles = (first, "peak", "without", "RMS", "without", "settled", "without", "decay", "without")
    return [titles, *(_mass_row(mass, absorption.unit(mass.name)) for mass in absorption.masses)]


def _mass_row(mass: MassChange, unit: str) -> tuple[str, ...]:
    both = mass.with_sinks, mass.without
    rates = ["-" if decay.rate is None else f"{decay.rate:.3g}/s" for decay in both]
    peaks = [f"{decay.peak:.4g} {unit}" for decay in both]
    rms = [f"{decay.rms:.3g} {unit}" for decay in both]
    settled = [seconds(decay.settled) for decay in both]
    return mass.name, *peaks, *rms, *settled, *rates


def energy_rows(absorption: Absorption) -> Rows:
    """The energy supplied, and the parts of it that each link dissipated and that are left."""
    with_sinks, without = absorption.with_sinks, absorption.without
    rows: Rows = [
        ("energy", "with sinks", "without"),
        ("supplied", f"{with_sinks.total:.4g} J", f"{without.total:.4g} J"),
        ("left at the end", percent(_remaining(with_sinks)), percent(_remaining(without))),
        ("all sinks", percent(absorption.sinks_share), ""),
    ]
    for name in with_sinks.dissipated_by:
        share = percent(without.share(name)) if name in without.dissipated_by else "-"
        rows.append((name, percent(with_sinks.share(name)), share))
    for host in with_sinks.structure.hosts:
        mean = [f"{run.host_energy(host.name).mean():.4g} J" for run in (with_sinks, without)]
        rows.append((f"mean energy in {host.name}", *mean))
    return rows


def _remaining(run: AbsorptionRun) -> float:
    part = float(run.remaining[-1])
    return 0.0 if abs(part) < 1e-12 else part


def crossing_rows(absorption: Absorption) -> Rows:
    """How often each sink crossed its barrier, how often before the predictability horizon, and when last."""
    return [
        ("sink", "mass", "host", "crossings", "predictable", "last"),
        *(_sink_row(result) for result in absorption.sinks),
    ]


def _sink_row(result: SinkResult) -> tuple[str, ...]:
    sink = (result.sink.link, result.sink.mass or "-", result.sink.host)
    if not result.tops:
        return *sink, "one well", "-", "-"
    last = "-" if result.last is None else seconds(result.last)
    return *sink, f"{len(result.crossings)}", f"{result.before_horizon}", last


def harvest_rows(absorption: Absorption) -> Rows:
    """The energy and the power of each harvester."""
    rows: Rows = [("harvester on", "load", "energy", "average power", "share")]
    for harvest in absorption.harvests:
        damping = damping_unit(absorption.with_sinks.structure.link(harvest.link))
        load = harvest.expression or f"{harvest.damping:.4g} {damping}"
        numbers = (load, f"{harvest.energy:.4g} J", f"{harvest.power:.4g} W")
        rows.append((harvest.link, *numbers, percent(harvest.share)))
    return rows


def _table(rows: Rows, contents: str) -> str:
    """Rows in columns; only the first of very many."""
    shown = [(*row, "") for row in rows[: _MANY + 4]]
    hidden = len(rows) - len(shown)
    lines = align_columns(shown)
    return "\n".join([*lines, *([f"  ... and {hidden} more {contents}"] if hidden else [])])


@as_text.register
def map_text(map_: AbsorptionMap) -> str:
    """The map in a few lines: the grid, and where each quantity is best."""
    rows: Rows = [(*row, "") for row in map_rows(map_)]
    headline = paragraph(" ".join(map_headline(map_)))
    return "\n\n".join([headline, "\n".join(align_columns(rows)), *map(remark_lines, map_.findings)])


def map_headline(map_: AbsorptionMap) -> tuple[str, ...]:
    """The grid and the comparison, in sentences."""
    ranges = " and ".join(map(_axis_range, map_.axes))
    diverged = int(np.sum(~map_.completed))
    ended = f"{diverged} diverged" if diverged else "all came to their end"
    return (
        f"{map_.completed.size} runs of {map_.duration:g} s over {ranges}: {ended}.",
        f"Reductions compare with the sinks {map_.removal}.",
    )


def _axis_range(axis: SweepAxis) -> str:
    unit = "" if axis.unit in ("", "?") else f" {axis.unit}"
    return f"{axis.name} from {axis.values[0]:g} to {axis.values[-1]:g}{unit}"


def map_rows(map_: AbsorptionMap) -> Rows:
    """Least and largest value of each quantity, and the parameters at which it is best."""
    rows: Rows = [("quantity", "least", "largest", "without value", "best at")]
    for quantity in map_.quantities:
        if quantity.name == "closure":
            continue
        grid = map_[quantity.name]
        finite = grid[np.isfinite(grid)]
        ends = (
            [value_text(quantity, float(end)) for end in (finite.min(), finite.max())]
            if finite.size
            else ["-", "-"]
        )
        best = map_.best(quantity.name)
        point = "-" if best is None else ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
        rows.append((quantity.title, *ends, f"{grid.size - finite.size}", point))
    return rows


def value_text(quantity: AbsorptionQuantity, value: float) -> str:
    """A value with its unit; parts of 1 in %."""
    if quantity.name.startswith("crossings"):
        return f"{value:.4g}"
    return percent(value) if not quantity.unit else f"{value:.4g} {quantity.unit}"


@as_text.register
def intervals_text(intervals: AbsorptionIntervals) -> str:
    """The whole result as text."""
    rows: Rows = [(*row, "") for row in interval_rows(intervals)]
    table = "\n".join([interval_headline(intervals), *align_columns(rows)])
    return f"{intervals.absorption}\n\n{table}"


def interval_headline(intervals: AbsorptionIntervals) -> str:
    """What the intervals are, in a sentence."""
    diverged = f", of which {intervals.diverged} diverged" if intervals.diverged else ""
    return f"95 % of {intervals.draws} draws of the identified structure (seed {intervals.seed}){diverged} lie within:"


def interval_rows(intervals: AbsorptionIntervals) -> Rows:
    """Each quantity at the identified values, and its interval."""
    return [
        ("quantity", "identified", "95 % interval"),
        *(
            (interval.quantity.title, _text(interval, interval.value), _interval_range(interval))
            for interval in intervals.quantities
        ),
    ]


def _interval_range(interval: QuantityInterval) -> str:
    if interval.lower is None:
        return _text(interval, None)
    return f"{_text(interval, interval.lower)} to {_text(interval, interval.upper)}"


def _text(interval: QuantityInterval, value: float | None) -> str:
    if value is None:
        return "never" if interval.quantity.name.startswith("settled") else "-"
    return value_text(interval.quantity, value)
