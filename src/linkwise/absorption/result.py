"""The result of `absorb`: masses, energy, crossings and harvesters of one structure with and without its sinks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.absorption.result_parts import (
    AbsorptionRun,
    Harvest,
    MassChange,
    SinkResult,
    energy_document,
    harvest_document,
    mass_document,
    relative_reduction,
    sink_document,
)
from linkwise.absorption.vibration import comparable
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.display import JudgedView, as_text
from linkwise.records.channel_units import unit_in
from linkwise.verdict import Verdict

CLOSURE = 1e-6  # of the energy supplied: an energy balance with a larger error is not to be trusted


# of what a link takes: the trapezoidal rule over 20 samples a period is right to (2 pi/20)^2/12
_INTEGRATED = 0.01


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

    manner = DeprecatedAttribute(Deprecated("removal", since="0.2.0", until="0.4.0"))

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
        with_sinks, without = np.linalg.norm(factors[:, None] * both, axis=0).tolist()
        return relative_reduction(with_sinks, without)

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
        return (
            _last([mass.with_sinks.settled for mass in self.masses]),
            _last([mass.without.settled for mass in self.masses]),
        )

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balances of both runs close, and links deliver no more than they take."""
        if any(_exceeds(self, harvest) for harvest in self.harvests):
            return (Verdict.ENERGY_BALANCE_OPEN,)
        return (closure_verdict(max(self.with_sinks.closure, self.without.closure)),)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the two runs cannot show."""
        return _findings(self)

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
            "energy": {
                "with_sinks": energy_document(self.with_sinks),
                "without": energy_document(self.without),
            },
            "sinks_share": self.sinks_share,
            "horizon": self.with_sinks.horizon,
            "masses": {mass.name: mass_document(mass) for mass in self.masses},
            "sinks": {result.sink.link: sink_document(result) for result in self.sinks},
            "harvesters": {harvest.link: harvest_document(harvest) for harvest in self.harvests},
            "findings": list(self.findings),
            **self._judgement(),
        }

    def __str__(self) -> str:
        return as_text(self)


def closure_verdict(closure: float) -> Verdict:
    """The verdict on a simulation by the error of its energy balance, a part of the energy supplied."""
    return Verdict.ENERGY_BALANCE_CLOSED if closure <= CLOSURE else Verdict.ENERGY_BALANCE_OPEN


def _exceeds(absorption: Absorption, harvest: Harvest) -> bool:
    """Whether a link delivers more than it takes, or less than nothing."""
    if harvest.expression is None:
        return False
    share = absorption.with_sinks.share(harvest.link)
    return not -_INTEGRATED * abs(share) <= harvest.share <= (1.0 + _INTEGRATED) * abs(share)


def _last(times: list[float | None]) -> float | None:
    return None if None in times else max(time for time in times if time is not None)


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
    for harvest in absorption.harvests:
        if _exceeds(absorption, harvest):
            work = absorption.with_sinks.share(harvest.link) * absorption.with_sinks.total
            findings.append(
                f"{harvest.expression} would deliver {harvest.energy:.3g} J, but {harvest.link} takes only {work:.3g} J: "
                "this link cannot deliver that power."
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
            f"{float(absorption.time[-1]):g} s; simulate longer, or give a higher settling level."
        )
        memory = [link.name for link in absorption.with_sinks.structure.links if link.law.states]
        if memory:
            findings.append(
                f"Rest positions are those with states of 0 of {', '.join(memory)}; after slip a mass may rest elsewhere."
            )
    inactive = [result.sink.link for result in absorption.sinks if result.tops and not len(result.crossings)]
    if inactive:
        findings.append(f"{', '.join(inactive)} never crossed from one well to another.")
    return tuple(findings)
