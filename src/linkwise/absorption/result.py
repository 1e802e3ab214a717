"""The result of `absorb`: masses, energy, crossings and harvesters of one structure with and without its sinks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.absorption.sinks import Sink
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.html import JudgedView
from linkwise.model.structure import Structure
from linkwise.text import as_text
from linkwise.verdict import Verdict, is_trusted

CLOSURE = 1e-6  # of the energy supplied: an energy balance with a larger error is not to be trusted


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
    rate : float or None
        Rate in 1/s of the exponential through the peaks; None if there are fewer than three.
    """

    rest: float
    peak: float
    rms: float
    settled: float | None
    rate: float | None


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
    """

    name: str
    level: float
    with_sinks: MassDecay
    without: MassDecay

    @property
    def peak_reduction(self) -> float | None:
        """The relative reduction of the peak by the sinks; None if the mass does not move without them."""
        return _reduction(self.with_sinks.peak, self.without.peak)

    @property
    def rms_reduction(self) -> float | None:
        """The relative reduction of the RMS by the sinks; None if the mass does not move without them."""
        return _reduction(self.with_sinks.rms, self.without.rms)


@dataclass(frozen=True, eq=False)
class AbsorptionRun:
    """One of the two runs, with N samples of n masses, P primary masses and L links.

    Energy is counted from the lowest wells of all links, so that supplied = stored + sum of dissipated.

    Attributes
    ----------
    structure : Structure
        The structure that was run.
    x, v : (N, n) ndarray
        Displacements in m and velocities in m/s of all masses.
    envelope : (N, P) ndarray
        Largest excursion in m of the primary masses from each sample on.
    supplied : (N,) ndarray
        Energy in J at the start and work done on the structure since.
    stored : (N,) ndarray
        Kinetic and potential energy in J.
    dissipated : (N, L) ndarray
        Energy in J that each link has dissipated.
    horizon : float or None
        Time in s past which a chaotic motion cannot be predicted; None if it can throughout.
    """

    structure: Structure
    x: Floats
    v: Floats
    envelope: Floats
    supplied: Floats
    stored: Floats
    dissipated: Floats
    horizon: float | None

    put_in = DeprecatedAttribute(Deprecated("supplied", since="0.2.0", until="0.4.0"))

    @property
    def total(self) -> float:
        """Energy in J supplied by the end."""
        return float(self.supplied[-1])

    @property
    def shares(self) -> Floats:
        """(N, L) parts of `total` that each link has dissipated."""
        return self.dissipated / self.total

    @property
    def remaining(self) -> Floats:
        """(N,) part of `total` that is still stored."""
        return self.stored / self.total

    @property
    def closure(self) -> float:
        """The largest error of the energy balance, as a part of the largest energy supplied."""
        error = self.supplied - self.stored - self.dissipated.sum(axis=1)
        return float(np.abs(error).max() / np.abs(self.supplied).max())

    def share(self, link: str) -> float:
        """The part of `total` that the link named `link` has dissipated by the end."""
        names = [link.name for link in self.structure.links]
        return float(self.dissipated[-1, names.index(link)] / self.total)


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
    """

    sink: Sink
    tops: tuple[float, ...]
    share: float
    elongation: Floats
    crossings: Floats
    before_horizon: int

    believed = DeprecatedAttribute(Deprecated("before_horizon", since="0.2.0", until="0.4.0"))

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
    damping : float
        Its damping in N s/m.
    energy, power : float
        Energy in J in all, and average power in W.
    share : float
        The part of the energy supplied.
    """

    link: str
    damping: float
    energy: float
    power: float
    share: float


@dataclass(frozen=True, eq=False)
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

    manner = DeprecatedAttribute(Deprecated("removal", since="0.2.0", until="0.4.0"))

    @property
    def sinks_share(self) -> float:
        """The part of the energy supplied that the `absorbing` links dissipated."""
        return float(sum(self.with_sinks.share(name) for name in self.absorbing))

    @property
    def rms_reduction(self) -> float | None:
        """The relative reduction of the RMS of all primary masses together; None if they do not move without sinks."""
        with_sinks = float(np.linalg.norm([mass.with_sinks.rms for mass in self.masses]))
        return _reduction(with_sinks, float(np.linalg.norm([mass.without.rms for mass in self.masses])))

    @property
    def settled(self) -> tuple[float | None, float | None]:
        """Times in s at which the last primary mass has settled, with and without sinks; None if one does not."""
        return (
            _last([mass.with_sinks.settled for mass in self.masses]),
            _last([mass.without.settled for mass in self.masses]),
        )

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balances of both runs close."""
        return (closure_verdict(max(self.with_sinks.closure, self.without.closure)),)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the two runs cannot show."""
        return _findings(self)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data, without the histories."""
        with_sinks, without = self.settled
        return {
            "method": "absorb",
            "without": self.removal,
            "duration": float(self.time[-1]),
            "rate": 1.0 / float(self.time[1] - self.time[0]),
            "settle": self.settle,
            "settled": {"with_sinks": with_sinks, "without": without},
            "rms_reduction": self.rms_reduction,
            "energy": {"with_sinks": _energy_dict(self.with_sinks), "without": _energy_dict(self.without)},
            "sinks_share": self.sinks_share,
            "horizon": self.with_sinks.horizon,
            "masses": {mass.name: _mass_dict(mass) for mass in self.masses},
            "sinks": {result.sink.link: _sink_dict(result) for result in self.sinks},
            "harvesters": {harvest.link: _harvest_dict(harvest) for harvest in self.harvests},
            "findings": list(self.findings),
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
        }

    def __str__(self) -> str:
        return as_text(self)


def closure_verdict(closure: float) -> Verdict:
    """The verdict on a simulation by the error of its energy balance, a part of the energy supplied."""
    return Verdict.CONVERGED if closure <= CLOSURE else Verdict.ENERGY_BALANCE_OPEN


def _reduction(with_sinks: float, without: float) -> float | None:
    return 1.0 - with_sinks / without if without > 0.0 else None


def _last(times: list[float | None]) -> float | None:
    return None if None in times else max(time for time in times if time is not None)


def _mass_dict(mass: MassChange) -> dict[str, Any]:
    return {
        "level": mass.level,
        "with_sinks": _decay_dict(mass.with_sinks),
        "without": _decay_dict(mass.without),
        "peak_reduction": mass.peak_reduction,
        "rms_reduction": mass.rms_reduction,
    }


def _decay_dict(decay: MassDecay) -> dict[str, float | None]:
    return {
        "rest": decay.rest,
        "peak": decay.peak,
        "rms": decay.rms,
        "settled": decay.settled,
        "decay_rate": decay.rate,
    }


def _energy_dict(run: AbsorptionRun) -> dict[str, Any]:
    return {
        "put_in": run.total,
        "remaining": float(run.remaining[-1]),
        "shares": {link.name: run.share(link.name) for link in run.structure.links},
        "closure": run.closure,
    }


def _sink_dict(result: SinkResult) -> dict[str, Any]:
    return {
        "mass": result.sink.mass,
        "host": result.sink.host,
        "share": result.share,
        "crossings": len(result.crossings),
        "crossings_before_horizon": result.before_horizon,
        "last_crossing": result.last,
        "crossing_times": result.crossings.tolist(),
    }


def _harvest_dict(harvest: Harvest) -> dict[str, float]:
    return {
        "damping": harvest.damping,
        "energy": harvest.energy,
        "average_power": harvest.power,
        "share": harvest.share,
    }


def _findings(absorption: Absorption) -> tuple[str, ...]:
    findings = []
    horizon = absorption.with_sinks.horizon
    if horizon is not None:
        findings.append(
            f"Past {horizon:.3g} s the motion with sinks is chaotic: this run is one of many that the same start could have, "
            "and crossings, settling times and shares after it would differ on another computer."
        )
    for run, name in ((absorption.with_sinks, "with sinks"), (absorption.without, "without sinks")):
        if run.closure > CLOSURE:
            findings.append(
                f"The energy balance {name} has an error of {run.closure:.0e} of the energy supplied: do not trust its shares."
            )
    unknown = [parameter.name for parameter in absorption.with_sinks.structure.parameters]
    if unknown:
        findings.append(
            f"{', '.join(unknown)} {'is' if len(unknown) == 1 else 'are'} unknown: this result is for the start values."
        )
    unsettled = [mass.name for mass in absorption.masses if mass.with_sinks.settled is None]
    if unsettled:
        findings.append(
            f"{', '.join(unsettled)} did not settle below {100 * absorption.settle:g} % of the peak without sinks within "
            f"{float(absorption.time[-1]):g} s; simulate longer, or let masses settle at a larger part of the peak."
        )
    inactive = [result.sink.link for result in absorption.sinks if result.tops and not len(result.crossings)]
    if inactive:
        findings.append(f"{', '.join(inactive)} never crossed from one well to another.")
    return tuple(findings)
