"""The answer of `absorb` as rows of text, for print and for the page."""

from __future__ import annotations

from textwrap import fill

from linkwise.absorption.result import Absorption, AbsorptionRun, MassChange, SinkResult
from linkwise.text import align_columns, as_text

Rows = list[tuple[str, ...]]

_MANY = 12  # masses, links or sinks that are printed
_WIDTH = 100  # at which sentences are broken


@as_text.register
def text_table(found: Absorption) -> str:
    """The whole answer as text."""
    blocks = ["\n".join(fill(line, _WIDTH) for line in headline(found))]
    tables = [
        (mass_rows(found), "masses"),
        (energy_rows(found), "links"),
        (crossing_rows(found), "sinks"),
    ]
    if found.harvests:
        tables.append((harvest_rows(found), "harvesters"))
    blocks += [_printed(rows, what) for rows, what in tables]
    if found.findings:
        blocks.append("\n".join(fill(f"! {each}", _WIDTH, subsequent_indent="  ") for each in found.findings))
    return "\n\n".join(blocks)


def percent(part: float | None) -> str:
    """A part of 1 in %."""
    return "-" if part is None else f"{100.0 * part:.3g} %"


def smaller(part: float | None) -> str:
    """By what part something is smaller, or larger."""
    return "-" if part is None else f"{percent(abs(part))} {'smaller' if part >= 0.0 else 'larger'}"


def seconds(time: float | None) -> str:
    """A time in s, or that there is none."""
    return "never" if time is None else f"{time:.4g} s"


def headline(found: Absorption) -> tuple[str, ...]:
    """The answer in three sentences."""
    names = ", ".join(each.sink.link for each in found.sinks[:_MANY])
    more = f" and {len(found.sinks) - _MANY} more" if len(found.sinks) > _MANY else ""
    one, other = found.settled
    return (
        f"With its sinks the primary masses' RMS is {smaller(found.rms_reduction)} over {found.time[-1]:g} s.",
        f"The sinks ({names}{more}) took {percent(found.sinks_share)} of the energy; for comparison they are "
        f"{found.manner}.",
        f"All primary masses below {100 * found.settle:g} % of their peak: {seconds(one)} with sinks, "
        f"{seconds(other)} without.",
    )


def mass_rows(found: Absorption) -> Rows:
    """Peak, RMS, settling time and decay of each primary mass, with sinks and without."""
    titles = ("mass", "peak", "without", "RMS", "without", "settled", "without", "decay", "without")
    return [titles, *(_mass(each) for each in found.masses)]


def _mass(each: MassChange) -> tuple[str, ...]:
    one, other = each.with_sinks, each.without
    rates = ["-" if rate is None else f"{rate:.3g}/s" for rate in (one.rate, other.rate)]
    peaks = [f"{peak:.4g} m" for peak in (one.peak, other.peak)]
    rms = [f"{value:.3g} m" for value in (one.rms, other.rms)]
    return each.name, *peaks, *rms, seconds(one.settled), seconds(other.settled), *rates


def energy_rows(found: Absorption) -> Rows:
    """What was put in, and the shares of it that each link dissipated and that is left."""
    one, other = found.with_sinks, found.without
    there = {link.name for link in other.structure.links}
    rows: Rows = [
        ("energy", "with sinks", "without"),
        ("put in", f"{one.total:.4g} J", f"{other.total:.4g} J"),
        ("left at the end", percent(_left(one)), percent(_left(other))),
        ("all sinks", percent(found.sinks_share), ""),
    ]
    for link in one.structure.links:
        name = link.name
        rows.append((name, percent(one.share(name)), percent(other.share(name)) if name in there else "-"))
    return rows


def _left(side: AbsorptionRun) -> float:
    part = float(side.remaining[-1])
    return 0.0 if abs(part) < 1e-12 else part


def crossing_rows(found: Absorption) -> Rows:
    """How often each sink went from well to well, how often before chaos ends prediction, and when last."""
    return [
        ("sink", "mass", "on", "crossings", "believable", "last"),
        *(_sink(each) for each in found.sinks),
    ]


def _sink(each: SinkResult) -> tuple[str, ...]:
    place = (each.sink.link, each.sink.mass or "-", each.sink.host)
    if not each.tops:
        return *place, "one well", "-", "-"
    last = "-" if each.last is None else seconds(each.last)
    return *place, f"{len(each.crossings)}", f"{each.before_horizon}", last


def harvest_rows(found: Absorption) -> Rows:
    """What each harvester takes."""
    rows: Rows = [("harvester on", "damping", "energy", "average power", "share")]
    for each in found.harvests:
        numbers = (f"{each.damping:.4g} N s/m", f"{each.energy:.4g} J", f"{each.power:.4g} W")
        rows.append((each.link, *numbers, percent(each.share)))
    return rows


def _printed(rows: Rows, what: str) -> str:
    """Rows in columns, the rest of very many left to the file."""
    cut = [(*row, "") for row in rows[: _MANY + 4]]
    hidden = len(rows) - len(cut)
    lines = align_columns(cut)
    return "\n".join([*lines, *([f"  ... and {hidden} more {what}; --json prints all"] if hidden else [])])
