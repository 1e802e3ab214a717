"""The printed answer of `absorb`."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from linkwise.table import columns

if TYPE_CHECKING:
    from linkwise.absorption.result import Absorption, MassChange, Side, SinkWork

Rows = list[tuple[str, ...]]

_MANY = 12  # masses, links or sinks that are shown
_WIDTH = 100  # at which sentences are broken


def text_table(found: Absorption) -> str:
    """The whole answer as text."""
    blocks = [_head(found), _masses(found), _energy(found), _crossings(found)]
    if found.harvests:
        blocks.append(_harvests(found))
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


def _head(found: Absorption) -> str:
    structure = found.with_sinks.structure
    names = ", ".join(each.sink.link for each in found.sinks[:_MANY])
    more = f" and {len(found.sinks) - _MANY} more" if len(found.sinks) > _MANY else ""
    settled = " against ".join(seconds(each) for each in found.settled)
    return (
        f"{structure.name or 'structure'}, {found.time[-1]:g} s, with its sinks ({names}{more}) and with them {found.manner}\n"
        f"RMS of the primary masses: {smaller(found.rms_reduction)} with sinks; settled below "
        f"{100 * found.settle:g} %: {settled}"
    )


def _masses(found: Absorption) -> str:
    rows: Rows = [("mass", "peak", "without", "RMS", "without", "settled", "without", "decay", "without", "")]
    rows += [_mass(each) for each in found.masses[:_MANY]]
    return "\n".join([*columns(rows), *_rest(len(found.masses), "masses")])


def _mass(each: MassChange) -> tuple[str, ...]:
    one, other = each.with_sinks, each.without
    rates = ("-" if rate is None else f"{rate:.3g}/s" for rate in (one.rate, other.rate))
    pairs = (
        (f"{one.peak:.4g} m", f"{other.peak:.4g} m"),
        (f"{one.rms:.3g} m", f"{other.rms:.3g} m"),
        (seconds(one.settled), seconds(other.settled)),
        tuple(rates),
    )
    return each.name, *(text for pair in pairs for text in pair), ""


def _energy(found: Absorption) -> str:
    one, other = found.with_sinks, found.without
    names = [link.name for link in one.structure.links]
    there = {link.name for link in other.structure.links}
    rows: Rows = [("energy", "with sinks", "without", "")]
    rows.append(("put in", f"{one.total:.4g} J", f"{other.total:.4g} J", ""))
    rows += [
        (name, percent(one.share(name)), percent(other.share(name) if name in there else None), "dissipated")
        for name in names[:_MANY]
    ]
    rows.append(("left", percent(_left(one)), percent(_left(other)), f"at {found.time[-1]:g} s"))
    told = f"  all sinks {percent(found.sinks_share)}; the balance closes to {max(one.closure, other.closure):.0e}"
    return "\n".join([*columns(rows), *_rest(len(names), "links"), told])


def _left(side: Side) -> float:
    part = float(side.remaining[-1])
    return 0.0 if abs(part) < 1e-12 else part


def _crossings(found: Absorption) -> str:
    rows: Rows = [("sink", "mass", "on", "crossings", "believable", "last", "")]
    rows += [_sink(each) for each in found.sinks[:_MANY]]
    return "\n".join([*columns(rows), *_rest(len(found.sinks), "sinks")])


def _sink(each: SinkWork) -> tuple[str, ...]:
    place = (each.sink.link, each.sink.mass or "-", each.sink.host)
    if not each.tops:
        return *place, "one well", "", "", ""
    last = "-" if each.last is None else seconds(each.last)
    return *place, f"{len(each.crossings)}", f"{each.believed}", last, ""


def _harvests(found: Absorption) -> str:
    rows: Rows = [("harvester on", "damping", "energy", "average power", "share", "")]
    rows += [
        (each.link, f"{each.damping:.4g} N s/m", f"{each.energy:.4g} J", f"{each.power:.4g} W", percent(each.share), "")
        for each in found.harvests
    ]  # fmt: skip
    return "\n".join(columns(rows))


def _rest(count: int, what: str) -> list[str]:
    return [f"  ... and {count - _MANY} more {what}; --json prints all"] if count > _MANY else []
