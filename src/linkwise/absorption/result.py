"""The result of `absorb`: masses, runs, energy, crossings and harvesters of one structure with and without its sinks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from linkwise.absorption.runs import AbsorptionRun, comparable, reduction
from linkwise.absorption.sinks import Sink, damping_unit
from linkwise.analysis.rest_positions import hilltop_finding
from linkwise.arrays import Floats, finite
from linkwise.display import JudgedView, paragraph, remark_lines, table, text_of
from linkwise.records.channel_units import unit_in
from linkwise.verdict import UNGRADED, Basis, Verdict

Rows = list[tuple[str, ...]]


@dataclass(frozen=True)
class MassDecay:
    """The vibration of one primary mass in one run.

    Attributes
    ----------
    rest : float
        Where the mass comes to rest, in m.
    peak, rms : float
        Largest and root mean square excursion from there, in m.
    settled : float or None
        Time in s after which the excursion stays below the level; None if it does not.
    decay_rate : float or None
        Rate in 1/s of the exponential through the peaks; None if there are fewer than three.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> decay = result.masses[0].with_sinks
    >>> 0.0 < decay.rms < decay.peak
    True
    """

    rest: float
    peak: float
    rms: float
    settled: float | None
    decay_rate: float | None


@dataclass(frozen=True)
class MassChange:
    """A primary mass with and without sinks.

    Attributes
    ----------
    name : str
        The name of the mass.
    level : float
        Excursion in m below which the mass has settled.
    with_sinks, without : MassDecay
        Its vibration in both runs.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> change = result.masses[0]
    >>> change.name, change.with_sinks.rms < change.without.rms
    ('m1', True)
    """

    name: str
    level: float
    with_sinks: MassDecay
    without: MassDecay

    @property
    def peak_reduction(self) -> float | None:
        """The relative reduction of the peak by the sinks; None if the mass does not move without them."""
        return finite(float(reduction(self.with_sinks.peak, self.without.peak)))

    @property
    def rms_reduction(self) -> float | None:
        """The relative reduction of the RMS by the sinks; None if the mass does not move without them."""
        return finite(float(reduction(self.with_sinks.rms, self.without.rms)))


@dataclass(frozen=True, eq=False)
class SinkResult:
    """What one sink did.

    Attributes
    ----------
    sink : Sink
        The link, its mass and its host.
    tops : tuple of float
        Elongations in m at the tops of the barriers between its wells.
    share : float
        The part of the energy supplied that it dissipated.
    elongation : (N,) ndarray
        Its elongation in m.
    crossings : (C,) ndarray
        Times in s at which it crossed from one well to another.
    before_horizon : int
        How many of the crossings are before the predictability horizon.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> nes = result.sinks[0]
    >>> nes.sink.link, len(nes.crossings) > 0, 0.0 < nes.share < 1.0
    ('nes1', True, True)
    """

    sink: Sink
    tops: tuple[float, ...]
    share: float
    elongation: Floats
    crossings: Floats
    before_horizon: int

    @property
    def last(self) -> float | None:
        """Time in s of the last crossing; None without one."""
        return float(self.crossings[-1]) if len(self.crossings) else None


@dataclass(frozen=True)
class Harvest:
    """What a harvester takes.

    Attributes
    ----------
    link : str
        The link that it is in parallel to.
    damping : float or None
        Its damping in N s/m; None where the link itself delivers the power.
    energy, average_power : float
        Energy in J in all, and power in W.
    share : float
        The part of the energy supplied.
    expression : str or None
        The power that the link delivers, such as "V**2/R".

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(
    ...     lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0}, harvesters={"nes1": 0.01}
    ... )
    >>> harvest = result.harvests[0]
    >>> harvest.link, abs(harvest.average_power * 2.0 / harvest.energy - 1.0) < 1e-9
    ('nes1', True)
    """

    link: str
    damping: float | None
    energy: float
    average_power: float
    share: float
    expression: str | None = None


def energy_document(run: AbsorptionRun) -> dict[str, Any]:
    """The energies of a run as plain data."""
    return {
        "put_in": run.total,
        "remaining": float(run.remaining[-1]),
        "shares": {name: run.share(name) for name in run.dissipated_by},
        "closure": run.closure,
    }


def sink_document(result: SinkResult) -> dict[str, Any]:
    """A sink as plain data."""
    return {
        "mass": result.sink.mass,
        "host": result.sink.host,
        "share": result.share,
        "crossings": len(result.crossings),
        "crossings_before_horizon": result.before_horizon,
        "last_crossing": result.last,
        "crossing_times": result.crossings.tolist(),
    }


CLOSURE = 1e-6  # of the energy supplied: an energy balance with a larger error is not to be trusted


# of what a link takes: the trapezoidal rule over 20 samples a period is right to (2 pi/20)^2/12
_INTEGRATED = 0.01


@dataclass(frozen=True, eq=False, repr=False)
class Absorption(JudgedView):
    """The result of `absorb`: a structure with and without its sinks under one excitation; printed, tables of both.

    Attributes
    ----------
    removal : str
        How the sinks are taken out for comparison, "removed" or "locked".
    settle : float
        The part of its peak without sinks below which a mass has settled.
    time : (N,) ndarray
        Time in s.
    masses : tuple of MassChange
        The primary masses.
    sinks : tuple of SinkResult
        The sinks.
    harvests : tuple of Harvest
        The harvesters.
    absorbing : tuple of str
        The links by which sinks absorb: the sinks, their harvesters and other links to their masses.
    with_sinks, without : AbsorptionRun
        The two runs.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> result.trusted, result.sinks_share > 0.5
    (True, True)
    >>> [mass.name for mass in result.masses], [sink.sink.link for sink in result.sinks]
    (['m1'], ['nes1'])
    """

    removal: str
    settle: float
    time: Floats
    masses: tuple[MassChange, ...]
    sinks: tuple[SinkResult, ...]
    harvests: tuple[Harvest, ...]
    absorbing: tuple[str, ...]
    with_sinks: AbsorptionRun
    without: AbsorptionRun
    basis: Basis = UNGRADED

    @property
    def sinks_share(self) -> float:
        """The part of the energy supplied that the `absorbing` links dissipated."""
        return float(sum(self.with_sinks.share(name) for name in self.absorbing))

    @property
    def rms_reduction(self) -> float | None:
        """The relative reduction of the RMS of all primary masses together; None if they do not move without sinks.

        Where some of them turn, each counts by its RMS over that without sinks.
        """
        both = np.array([(mass.with_sinks.rms, mass.without.rms) for mass in self.masses])
        factors = comparable(both[:, 1], [self.unit(mass.name) for mass in self.masses])
        return finite(float(reduction(*np.linalg.norm(factors[:, None] * both, axis=0))))

    def unit(self, mass: str) -> str:
        """The SI unit of the displacement of a mass or point.

        Parameters
        ----------
        mass : str
            Its name.

        Returns
        -------
        str
            ``"m"``, or ``"rad"`` where it turns.
        """
        return unit_in(self.with_sinks.structure, f"x:{mass}")

    @property
    def settled(self) -> tuple[float | None, float | None]:
        """Times in s at which the last primary mass has settled, with and without sinks; None if one does not."""
        with_sinks = [mass.with_sinks.settled for mass in self.masses]
        return _last_time(with_sinks), _last_time([mass.without.settled for mass in self.masses])

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balances of both runs close, and links deliver no more than they take."""
        if any(_exceeds(self, harvest) for harvest in self.harvests):
            return (Verdict.ENERGY_BALANCE_OPEN,)
        return (closure_verdict(max(self.with_sinks.closure, self.without.closure)),)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the two runs cannot show."""
        findings = []
        if (horizon := self.with_sinks.horizon) is not None:
            findings.append(
                f"Past {horizon:.3g} s the motion with sinks is chaotic: this run is one of many that the same start could "
                "have, and crossings, settling times and shares after it would differ on another computer."
            )
        for run, name in ((self.with_sinks, "with sinks"), (self.without, "without sinks")):
            if run.closure > CLOSURE:
                findings.append(
                    f"The energy balance {name} has an error of {run.closure:.0e} of the energy supplied: do not trust its "
                    "shares."
                )
        for harvest in self.harvests:
            if _exceeds(self, harvest):
                work = self.with_sinks.share(harvest.link) * self.with_sinks.total
                findings.append(
                    f"{harvest.expression} would deliver {harvest.energy:.3g} J, but {harvest.link} takes only {work:.3g} J: "
                    "this link cannot deliver that power."
                )
        if unknown := [parameter.name for parameter in self.with_sinks.structure.parameters]:
            are = "is" if len(unknown) == 1 else "are"
            findings.append(f"{', '.join(unknown)} {are} unknown: this result is for the start values.")
        unsettled = [mass.name for mass in self.masses if mass.with_sinks.settled is None]
        if unsettled:
            findings.append(
                f"{', '.join(unsettled)} did not settle below {100 * self.settle:g} % of the peak without sinks within "
                f"{float(self.time[-1]):g} s; simulate longer, or give a higher settling level."
            )
            if memory := ", ".join(link.name for link in self.with_sinks.structure.links if link.law.states):
                rest = f"Rest positions are those with states of 0 of {memory}"
                findings.append(f"{rest}; after slip a mass may rest elsewhere.")
        inactive = [result.sink.link for result in self.sinks if result.tops and not len(result.crossings)]
        if inactive:
            findings.append(f"{', '.join(inactive)} never crossed from one well to another.")
        if hilltop := hilltop_finding(self.with_sinks.structure, self.with_sinks.x[0]):
            findings.append(hilltop)
        return tuple(findings)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data, without the histories.

        Returns
        -------
        dict
            The content of absorption.json: settings, energies, masses, sinks, harvesters, findings and verdicts; SI units.
        """
        with_sinks, without = self.settled
        return {
            "method": "absorb",
            "without": self.removal,
            "duration": float(self.time[-1]),
            "rate": 1.0 / float(self.time[1] - self.time[0]),
            "settle": self.settle,
            "settled": {"with_sinks": with_sinks, "without": without},
            "rms_reduction": self.rms_reduction,
            "energy": {key: energy_document(getattr(self, key)) for key in ("with_sinks", "without")},
            "sinks_share": self.sinks_share,
            "horizon": self.with_sinks.horizon,
            "masses": {mass.name: self._mass_document(mass) for mass in self.masses},
            "sinks": {result.sink.link: sink_document(result) for result in self.sinks},
            "harvesters": {document.pop("link"): document for document in map(asdict, self.harvests)},
            "findings": list(self.findings),
            **self._judgement(),
        }

    @staticmethod
    def _mass_document(mass: MassChange) -> dict[str, Any]:
        """A mass as plain data."""
        own = {key: value for key, value in asdict(mass).items() if key != "name"}
        return {**own, "peak_reduction": mass.peak_reduction, "rms_reduction": mass.rms_reduction}

    def __str__(self) -> str:
        tables = {
            "masses": mass_rows,
            "links": energy_rows,
            "sinks": crossing_rows,
            "harvesters": harvest_rows,
        }
        shown = (
            table([(*row, "") for row in rows(self)], most=_MANY + 3, more=f"more {contents}")
            for contents, rows in tables.items()
        )
        return text_of(map(paragraph, headline(self)), *shown, map(remark_lines, self.findings))


def closure_verdict(closure: float) -> Verdict:
    """The verdict on a simulation by the error of its energy balance, a part of the energy supplied."""
    return Verdict.ENERGY_BALANCE_CLOSED if closure <= CLOSURE else Verdict.ENERGY_BALANCE_OPEN


def _exceeds(absorption: Absorption, harvest: Harvest) -> bool:
    """Whether a link delivers more than it takes, or less than nothing."""
    if harvest.expression is None:
        return False
    share = absorption.with_sinks.share(harvest.link)
    return not -_INTEGRATED * abs(share) <= harvest.share <= (1.0 + _INTEGRATED) * abs(share)


def _last_time(times: list[float | None]) -> float | None:
    return None if None in times else max(time for time in times if time is not None)


_MANY = 12  # masses, links or sinks that are printed


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
    rates = ["-" if decay.decay_rate is None else f"{decay.decay_rate:.3g}/s" for decay in both]
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
    titles = ("sink", "mass", "host", "crossings", "predictable", "last")
    return [titles, *map(_sink_row, absorption.sinks)]


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
        numbers = (load, f"{harvest.energy:.4g} J", f"{harvest.average_power:.4g} W")
        rows.append((harvest.link, *numbers, percent(harvest.share)))
    return rows
