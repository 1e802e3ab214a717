"""What `absorb` returns: masses, energy, crossings and harvesters of one structure with and without its sinks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.absorption.sinks import Sink
from linkwise.arrays import Floats
from linkwise.model.structure import Structure
from linkwise.text import as_text
from linkwise.verdict import Verdict, is_trusted

CLOSURE = 1e-6  # of the energy put in: a worse balance is not to be trusted


@dataclass(frozen=True)
class MassDecay:
    """One primary mass in one run: `rest` m is where it comes to rest, `peak` and `rms` m are of its excursion from there.

    `settled` s is when it comes below the level to stay there, None where it does not; `rate` 1/s that of the exponential
    through its peaks, None where they are too few.
    """

    rest: float
    peak: float
    rms: float
    settled: float | None
    rate: float | None


@dataclass(frozen=True)
class MassChange:
    """A primary mass with sinks and without; reductions are parts of 1, None where it does not move without sinks."""

    name: str
    level: float
    with_sinks: MassDecay
    without: MassDecay

    @property
    def peak_reduction(self) -> float | None:
        """By what part its peak is smaller with the sinks."""
        return _reduction(self.with_sinks.peak, self.without.peak)

    @property
    def rms_reduction(self) -> float | None:
        """By what part its RMS is smaller with the sinks."""
        return _reduction(self.with_sinks.rms, self.without.rms)


@dataclass(frozen=True, eq=False)
class AbsorptionRun:
    """One of the two runs, N samples: `x` (N, n) and `v` (N, n) of all masses, `envelope` (N, P) m of the primary ones.

    `put_in` (N,), `stored` (N,) and `dissipated` (N, L) in J; energy is counted from the lowest wells of all links, so that
    put_in = stored + sum of dissipated. `horizon` s is where chaos ends prediction, None where it does not.
    """

    structure: Structure
    x: Floats
    v: Floats
    envelope: Floats
    put_in: Floats
    stored: Floats
    dissipated: Floats
    horizon: float | None

    @property
    def total(self) -> float:
        """Energy in J that was put in by the end."""
        return float(self.put_in[-1])

    @property
    def shares(self) -> Floats:
        """(N, L) parts of `total` that each link has dissipated."""
        return self.dissipated / self.total

    @property
    def remaining(self) -> Floats:
        """(N,) part of `total` that is still stored, or moves."""
        return self.stored / self.total

    @property
    def closure(self) -> float:
        """The largest error of the balance, as a part of the largest energy put in."""
        apart = self.put_in - self.stored - self.dissipated.sum(axis=1)
        return float(np.abs(apart).max() / np.abs(self.put_in).max())

    def share(self, link: str) -> float:
        """The part of `total` that a link has dissipated by the end."""
        names = [each.name for each in self.structure.links]
        return float(self.dissipated[-1, names.index(link)] / self.total)


@dataclass(frozen=True, eq=False)
class SinkResult:
    """What one sink did: `share` is the part of the energy put in that it dissipated.

    `elongation` (N,) m is that of its link; `crossings` (C,) s are its passages between wells over one of its `tops` m, of
    which the first `before_horizon` are before the horizon of prediction.
    """

    sink: Sink
    tops: tuple[float, ...]
    share: float
    elongation: Floats
    crossings: Floats
    before_horizon: int

    @property
    def last(self) -> float | None:
        """Time in s of the last crossing."""
        return float(self.crossings[-1]) if len(self.crossings) else None


@dataclass(frozen=True)
class Harvest:
    """What a harvester of `damping` N s/m on `link` takes: `energy` J in all, `power` W on average, a `share` of all."""

    link: str
    damping: float
    energy: float
    power: float
    share: float


@dataclass(frozen=True, eq=False)
class Absorption:
    """A structure with its sinks and without ("removed" or "locked") under one excitation, at `time` (N,) in s.

    `settle` is the part of its peak without sinks below which a mass counts as settled, from when it stays there.
    """

    manner: str
    settle: float
    time: Floats
    masses: tuple[MassChange, ...]
    sinks: tuple[SinkResult, ...]
    harvests: tuple[Harvest, ...]
    absorbing: tuple[str, ...]
    with_sinks: AbsorptionRun
    without: AbsorptionRun

    @property
    def sinks_share(self) -> float:
        """The part of the energy put in that sinks, harvesters on them and other links on their masses dissipated."""
        return float(sum(self.with_sinks.share(name) for name in self.absorbing))

    @property
    def rms_reduction(self) -> float | None:
        """By what part the RMS of all primary masses together is smaller with the sinks."""
        sides = [[each.with_sinks.rms for each in self.masses], [each.without.rms for each in self.masses]]
        return _reduction(*(float(np.linalg.norm(side)) for side in sides))

    @property
    def settled(self) -> tuple[float | None, float | None]:
        """Times in s at which the last primary mass has settled, with sinks and without; None where one does not."""
        return (
            _last([each.with_sinks.settled for each in self.masses]),
            _last([each.without.settled for each in self.masses]),
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
        """Sentences on what these runs cannot tell."""
        return _findings(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, without the histories."""
        with_sinks, without = self.settled
        return {
            "method": "absorb",
            "without": self.manner,
            "duration": float(self.time[-1]),
            "rate": 1.0 / float(self.time[1] - self.time[0]),
            "settle": self.settle,
            "settled": {"with_sinks": with_sinks, "without": without},
            "rms_reduction": self.rms_reduction,
            "energy": {"with_sinks": _energy(self.with_sinks), "without": _energy(self.without)},
            "sinks_share": self.sinks_share,
            "horizon": self.with_sinks.horizon,
            "masses": {each.name: _mass(each) for each in self.masses},
            "sinks": {each.sink.link: _sink(each) for each in self.sinks},
            "harvesters": {
                each.link: {
                    "damping": each.damping, "energy": each.energy, "average_power": each.power, "share": each.share,
                }
                for each in self.harvests
            },
            "findings": list(self.findings),
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
        }  # fmt: skip

    def __str__(self) -> str:
        return as_text(self)


def closure_verdict(closure: float) -> Verdict:
    """What an error of the energy balance, as a part of the energy put in, says of a simulation."""
    return Verdict.CONVERGED if closure <= CLOSURE else Verdict.ENERGY_BALANCE_OPEN


def _reduction(with_sinks: float, without: float) -> float | None:
    return 1.0 - with_sinks / without if without > 0.0 else None


def _last(times: list[float | None]) -> float | None:
    return None if None in times else max(time for time in times if time is not None)


def _mass(each: MassChange) -> dict[str, Any]:
    both = {"with_sinks": each.with_sinks, "without": each.without}
    told = {
        side: {"rest": m.rest, "peak": m.peak, "rms": m.rms, "settled": m.settled, "decay_rate": m.rate}
        for side, m in both.items()
    }
    return {
        "level": each.level,
        **told,
        "peak_reduction": each.peak_reduction,
        "rms_reduction": each.rms_reduction,
    }


def _energy(side: AbsorptionRun) -> dict[str, Any]:
    return {
        "put_in": side.total,
        "remaining": float(side.remaining[-1]),
        "shares": {link.name: side.share(link.name) for link in side.structure.links},
        "closure": side.closure,
    }


def _sink(work: SinkResult) -> dict[str, Any]:
    return {
        "mass": work.sink.mass,
        "host": work.sink.host,
        "share": work.share,
        "crossings": len(work.crossings),
        "crossings_before_horizon": work.before_horizon,
        "last_crossing": work.last,
        "crossing_times": work.crossings.tolist(),
    }


def _findings(absorption: Absorption) -> tuple[str, ...]:
    found = []
    end = float(absorption.time[-1])
    horizon = absorption.with_sinks.horizon
    if horizon is not None:
        found.append(
            f"Past {horizon:.3g} s the motion with sinks is chaotic: this run is one of many that the same start could have, "
            "and crossings, settling times and shares after it would come out otherwise on another computer."
        )
    for side, name in ((absorption.with_sinks, "with sinks"), (absorption.without, "without sinks")):
        if side.closure > CLOSURE:
            found.append(
                f"The energy balance {name} closes to {side.closure:.0e} of what was put in only: do not trust its shares."
            )
    guessed = [parameter.name for parameter in absorption.with_sinks.structure.parameters]
    if guessed:
        found.append(
            f"{', '.join(guessed)} {'is' if len(guessed) == 1 else 'are'} not known yet: this is what their starts would do."
        )
    late = [each.name for each in absorption.masses if each.with_sinks.settled is None]
    if late:
        found.append(
            f"{', '.join(late)} did not settle below {100 * absorption.settle:g} % of the peak without sinks within "
            f"{end:g} s; simulate longer, or ask for a larger part (--settle)."
        )
    idle = [each.sink.link for each in absorption.sinks if each.tops and not len(each.crossings)]
    if idle:
        found.append(f"{', '.join(idle)} never crossed from one well to another.")
    return tuple(found)
