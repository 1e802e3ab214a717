"""The result of `absorb` as rows of text, for print and for the page."""

from __future__ import annotations

from linkwise.absorption.harvesters import damping_unit
from linkwise.absorption.result import Absorption
from linkwise.absorption.result_parts import AbsorptionRun, MassChange, SinkResult
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
