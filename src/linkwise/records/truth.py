"""What a simulation knows beside the record that a sensor would have made: the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, final

from linkwise.arrays import Floats

if TYPE_CHECKING:
    from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """Where the energy went, in J, counted from the start of the simulation; time on axis 0, L links in file
    order.

    `put_in` (N,) holds what was there at the start and all work done since; `kinetic` (N,) and `potential`
    (N, L) what is stored; `dissipated` (N, L) what each link has taken away.
    """

    put_in: Floats
    kinetic: Floats
    potential: Floats
    dissipated: Floats

    @property
    def residual(self) -> Floats:
        """(N,) J: stored and dissipated less put in; zero but for the integrator's error."""
        kept: Floats = self.kinetic + self.potential.sum(axis=1) + self.dissipated.sum(axis=1)
        return kept - self.put_in

    def rows(self, which: slice) -> EnergyBalance:
        """The balance at the samples of a slice; energies still count from the start of the simulation."""
        return EnergyBalance(
            self.put_in[which], self.kinetic[which], self.potential[which], self.dissipated[which]
        )


class MotionDiagnostics(Protocol):
    """What a simulation can tell but that costs more than the motion itself: worked out when somebody asks."""

    @property
    def energy(self) -> EnergyBalance:
        """The energy balance at every sample of the simulation."""

    @property
    def horizon(self) -> float | None:
        """The time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""


@final
@dataclass(frozen=True, eq=False)
class Settled:
    """An account that is known."""

    energy: EnergyBalance
    horizon: float | None = None


@dataclass(frozen=True, eq=False)
class SimulationTruth:
    """The motion behind a simulated record, sample by sample, free of noise.

    `displacement` and `velocity` (N, n) in m and m/s in the structure's order of masses, relative to the
    ground; `base` (N,) the base displacement in m, None without one; `noise` the standard deviation that was
    added to each channel. `account` gives energies and horizon of the whole simulation; `samples` are the
    numbers of those of its samples that are left here, None for all.
    """

    structure: Structure
    displacement: Floats
    velocity: Floats
    base: Floats | None
    account: MotionDiagnostics
    noise: Mapping[str, float] = field(default_factory=dict)
    samples: range | None = None

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at these samples; the first look at it costs about as much as the simulation."""
        energy = self.account.energy
        if self.samples is None:
            return energy
        return energy.rows(slice(self.samples.start, self.samples.stop, self.samples.step))

    @property
    def horizon(self) -> float | None:
        """The time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""
        return self.account.horizon

    def rows(self, which: slice) -> SimulationTruth:
        """The truth at the samples of a slice."""
        all_samples = range(len(self.displacement)) if self.samples is None else self.samples
        return replace(
            self,
            displacement=self.displacement[which],
            velocity=self.velocity[which],
            base=None if self.base is None else self.base[which],
            samples=all_samples[which],
        )
