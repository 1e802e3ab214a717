"""The truth behind a simulated record: noise-free motion, energies and predictability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

from linkwise.arrays import Floats

if TYPE_CHECKING:
    from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """Energies in J of a simulated structure, counted from the start of the simulation.

    Attributes
    ----------
    supplied : array of shape (N,)
        Energy at the start, and all work done on the structure since.
    kinetic : array of shape (N,)
        Kinetic energy of the masses.
    potential : array of shape (N, L)
        Energy stored in each of the L links.
    dissipated : array of shape (N, L)
        Energy dissipated by each link since the start. What the states of a link store counts until they give it back.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> balance = record.simulated.energy
    >>> bool(abs(balance.residual).max() < 1e-12 * balance.supplied[0])
    True
    """

    supplied: Floats
    kinetic: Floats
    potential: Floats
    dissipated: Floats

    @property
    def work(self) -> Floats:
        """Work done on each link since the start, stored or dissipated, in J, shape (N, L)."""
        stored: Floats = self.potential - self.potential[:1]
        return stored + self.dissipated - self.dissipated[:1]

    @property
    def residual(self) -> Floats:
        """Energy stored and dissipated less energy supplied, in J, shape (N,): the error of the integration."""
        accounted: Floats = self.kinetic + self.potential.sum(axis=1) + self.dissipated.sum(axis=1)
        return accounted - self.supplied

    def rows(self, which: slice) -> EnergyBalance:
        """The balance at some of the samples; energies still count from the start of the simulation.

        Parameters
        ----------
        which : slice
            The samples, by index.

        Returns
        -------
        EnergyBalance
            Their energies in J.
        """
        return EnergyBalance(*(energies[which] for energies in vars(self).values()))


class MotionDiagnostics(Protocol):
    """Results of a simulation that cost more than the motion itself: computed on first use.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> diagnostics = record.simulated.diagnostics
    >>> diagnostics.energy.kinetic.shape, diagnostics.horizon
    ((501,), None)
    """

    @property
    def energy(self) -> EnergyBalance:
        """The energy balance at every sample of the simulation."""

    @property
    def horizon(self) -> float | None:
        """Time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""


@dataclass(frozen=True, eq=False)
class SimulationTruth:
    """The noise-free motion behind a simulated record, sample by sample.

    Attributes
    ----------
    structure : Structure
        The structure that was simulated.
    displacement, velocity : array of shape (N, n)
        Motion in m and m/s of the n masses, in the order of the structure, relative to the ground.
    base : array of shape (N,) or None
        Displacement of the base in m; None without a moving base.
    diagnostics : MotionDiagnostics
        Energies and predictability horizon of the whole simulation, computed on first use.
    noise : mapping of str to float
        Standard deviation of the noise added to each channel, in its SI unit.
    samples : range or None
        Indices of the samples of the simulation that are left in this record; None for all.
    states : mapping of str to array of shape (N,)
        States of links with memory by full name, such as ``"joint.z"``, in SI units.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> record.simulated.velocity.shape
    (501, 2)
    """

    structure: Structure
    displacement: Floats
    velocity: Floats
    base: Floats | None
    diagnostics: MotionDiagnostics
    noise: Mapping[str, float] = field(default_factory=dict)
    samples: range | None = None
    states: Mapping[str, Floats] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<SimulationTruth of {self.structure.name}: {len(self.displacement)} samples>"

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at these samples; the first access costs about as much as the simulation."""
        energy = self.diagnostics.energy
        if self.samples is None:
            return energy
        return energy.rows(slice(self.samples.start, self.samples.stop, self.samples.step))

    @property
    def horizon(self) -> float | None:
        """Time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""
        return self.diagnostics.horizon

    def rows(self, which: slice) -> SimulationTruth:
        """The truth at some of the samples.

        Parameters
        ----------
        which : slice
            The samples, by index.

        Returns
        -------
        SimulationTruth
            The motion at these samples.
        """
        all_samples = range(len(self.displacement)) if self.samples is None else self.samples
        return replace(
            self,
            displacement=self.displacement[which],
            velocity=self.velocity[which],
            base=None if self.base is None else self.base[which],
            samples=all_samples[which],
            states={name: values[which] for name, values in self.states.items()},
        )
