"""One question about a structure and its sinks, made ready: with them, without them, under the same excitation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.absorption.harvesters import SUFFIX, with_harvesters
from linkwise.absorption.options import AbsorptionOptions
from linkwise.absorption.sinks import Sink, find_sinks, primary_masses
from linkwise.absorption.without_sinks import WithoutSinks, without_sinks
from linkwise.analysis.modes import modes
from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError
from linkwise.model.excitation import Excitation
from linkwise.model.structure import Structure
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.simulate import check_excitation, output_times

_PER_PERIOD = 20  # samples of the fastest mode, without a rate: cubics between them are right to 3e-5
_FEWEST = 1000  # samples, without a rate
_MOST = 2_000_000  # samples, without a rate


@dataclass(frozen=True, eq=False)
class Comparison:
    """A `structure` with its harvesters, its `sinks`, the `baseline` structure that it is compared with, the `times` (N,) s
    of the output, and the `options` that ask for it.
    """

    structure: Structure
    sinks: tuple[Sink, ...]
    baseline: WithoutSinks
    times: Floats
    options: AbsorptionOptions

    @classmethod
    def of(cls, structure: Structure, options: AbsorptionOptions) -> Comparison:
        """Raises StructureError and SimulationError for what cannot be asked, as `absorb` says."""
        _ = [link.values for link in structure.links], structure.mass_values  # says what has no number
        sinks, excitation = find_sinks(structure, options.sinks), options.excitation
        equipped = with_harvesters(structure, options.harvesters or {})
        rate = _rate(structure, options.duration) if options.rate is None else options.rate
        times = output_times(options.duration, rate)
        check_excitation(equipped, excitation, float(times[-1]))
        if not (any(excitation.release.values()) or excitation.impulses or excitation.drives):
            raise SimulationError(
                "nothing sets the structure in motion: give a release, an impulse, a force or a motion of the base"
            )
        return cls(
            equipped, sinks, without_sinks(equipped, sinks, excitation, options.without), times, options
        )

    def varied(
        self, structure: Structure, excitation: Excitation, baseline: WithoutSinks | None = None
    ) -> Comparison:
        """The same question about another structure of this shape, harvesters included; `baseline` where it is known."""
        return replace(
            self,
            structure=structure,
            baseline=baseline or without_sinks(structure, self.sinks, excitation, self.options.without),
            options=replace(self.options, excitation=excitation),
        )

    @property
    def schedule(self) -> RunSchedule:
        """The run with sinks."""
        return RunSchedule(self.structure, self.options.excitation, self.times)

    @property
    def baseline_schedule(self) -> RunSchedule:
        """The run without them."""
        return RunSchedule(self.baseline.structure, self.baseline.excitation, self.times)

    @cached_property
    def primaries(self) -> tuple[str, ...]:
        """The masses that no sink carries and that both structures have."""
        return primary_masses(self.structure, self.sinks)

    @cached_property
    def absorbing(self) -> tuple[str, ...]:
        """The links by which sinks absorb: the sinks, their harvesters, and whatever else hangs on their masses."""
        carried = {sink.mass for sink in self.sinks}
        names = {sink.link for sink in self.sinks} | {f"{sink.link}{SUFFIX}" for sink in self.sinks}
        return tuple(
            link.name for link in self.structure.links if link.name in names or carried & set(link.between)
        )

    @property
    def resting_structure(self) -> Structure:
        """The one whose equilibria tell where the primary masses rest.

        A sink on whose mass nothing else hangs exerts no force at rest, so its host rests where it would without the sink.
        """
        alone = all(sink.mass is not None and self._hangs_alone(sink) for sink in self.sinks)
        return self.baseline.structure if alone else self.structure

    def _hangs_alone(self, sink: Sink) -> bool:
        joined = (set(link.between) for link in self.structure.links if sink.mass in link.between)
        return all(ends == {sink.mass, sink.host} for ends in joined)


def _rate(structure: Structure, duration: float) -> float:
    """Samples per second that show the fastest mode: 1, 2 or 5 times a power of ten."""
    try:
        fastest = float(np.nanmax(modes(structure).frequencies))
    except (StructureError, ValueError):
        fastest = 0.0
    least = max(_PER_PERIOD * fastest, _FEWEST / duration)
    if least * duration > _MOST:
        raise SimulationError(
            f"to show the fastest mode, {fastest:.3g} Hz, over {duration:g} s takes {least * duration:.1e} samples; say how "
            "many a second are enough (rate, --rate): the primary masses may be slower"
        )
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9)))
