"""What the result of `absorb` consists of: masses, runs, sinks and harvesters, and their plain data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from linkwise.absorption.places import dissipators, host_energy, place_motion
from linkwise.absorption.sinks import Sink
from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.model.names import index_of
from linkwise.model.structure import Structure


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
        return relative_reduction(self.with_sinks.peak, self.without.peak)

    @property
    def rms_reduction(self) -> float | None:
        """The relative reduction of the RMS by the sinks; None if the mass does not move without them."""
        return relative_reduction(self.with_sinks.rms, self.without.rms)


@dataclass(frozen=True, eq=False)
class AbsorptionRun:
    """One of the two runs, with N samples of n masses, P primary masses and L links.

    Energy is counted from the lowest wells of all links, so that supplied = stored + sum of dissipated.

    Attributes
    ----------
    structure : Structure
        The structure that was run.
    x, v : (N, n) ndarray
        Displacements in m and velocities in m/s of all masses; of a mode its coordinate.
    envelope : (N, P) ndarray
        Largest excursion in m of the primary masses and points from each sample on.
    supplied : (N,) ndarray
        Energy in J at the start and work done on the structure since.
    stored : (N,) ndarray
        Kinetic and potential energy in J.
    dissipated : (N, L) ndarray
        Energy in J that each link has dissipated.
    horizon : float or None
        Time in s past which a chaotic motion cannot be predicted; None if it can throughout.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> run = result.with_sinks
    >>> run.closure < 1e-9
    True
    >>> round(float(run.shares[-1].sum() + run.remaining[-1]), 9)
    1.0
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

    @cached_property
    def dissipated_by(self) -> dict[str, Floats]:
        """(N,) energy in J that each host, by all its modes, and each other link has dissipated."""
        return {
            name: self.dissipated[:, numbers].sum(axis=1)
            for name, numbers in dissipators(self.structure).items()
        }

    @checked
    def share(self, link: str) -> float:
        """The part of the energy supplied that a link or a host has dissipated by the end.

        Parameters
        ----------
        link : str
            Name of the link or the host.

        Returns
        -------
        float
            The part of `total`, from 0 to 1.

        Raises
        ------
        ValueError
            If there is no such link.
        """
        if link in self.dissipated_by:
            return float(self.dissipated_by[link][-1] / self.total)
        names = [link.name for link in self.structure.links]
        return float(self.dissipated[-1, names.index(link)] / self.total)

    @checked
    def displacement(self, place: str) -> Floats:
        """Displacement of a mass or of a point of a host.

        Parameters
        ----------
        place : str
            Its name.

        Returns
        -------
        (N,) ndarray
            Displacement in m.
        """
        return place_motion([self.structure], self.x[..., None], [place])[:, 0, 0]

    @checked
    def host_energy(self, host: str) -> Floats:
        """Kinetic and potential energy of the modes of a host.

        Parameters
        ----------
        host : str
            Name of the host.

        Returns
        -------
        (N,) ndarray
            Energy in J.

        Raises
        ------
        StructureError
            If there is no such host.
        """
        hosts = {own.name: own for own in self.structure.hosts}
        return host_energy(self.structure, index_of(hosts, host, "host", "hosts"), self.x, self.v)


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
    damping : float or None
        Its damping in N s/m; None where the link itself delivers the power.
    energy, power : float
        Energy in J in all, and average power in W.
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
    >>> harvest.link, abs(harvest.power * 2.0 / harvest.energy - 1.0) < 1e-9
    ('nes1', True)
    """

    link: str
    damping: float | None
    energy: float
    power: float
    share: float
    expression: str | None = None


def relative_reduction(with_sinks: float, without: float) -> float | None:
    """By how much sinks reduce a quantity, as a part of it without them; None where it is 0 without them."""
    return 1.0 - with_sinks / without if without > 0.0 else None


def mass_document(mass: MassChange) -> dict[str, Any]:
    """A mass as plain data."""
    return {
        "level": mass.level,
        "with_sinks": _decay_document(mass.with_sinks),
        "without": _decay_document(mass.without),
        "peak_reduction": mass.peak_reduction,
        "rms_reduction": mass.rms_reduction,
    }


def _decay_document(decay: MassDecay) -> dict[str, float | None]:
    return {
        "rest": decay.rest,
        "peak": decay.peak,
        "rms": decay.rms,
        "settled": decay.settled,
        "decay_rate": decay.rate,
    }


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


def harvest_document(harvest: Harvest) -> dict[str, float | str | None]:
    """A harvester as plain data."""
    return {
        "damping": harvest.damping,
        "expression": harvest.expression,
        "energy": harvest.energy,
        "average_power": harvest.power,
        "share": harvest.share,
    }
