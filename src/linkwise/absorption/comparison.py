"""A comparison of a structure with and without its sinks under the same excitation, ready to be run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.absorption.harvesters import SUFFIX, delivered_powers, with_harvesters
from linkwise.absorption.options import AbsorptionOptions
from linkwise.absorption.sinks import Sink, find_sinks, primary_masses
from linkwise.absorption.without_sinks import WithoutSinks, without_sinks
from linkwise.analysis.modes import natural_frequencies
from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Expression
from linkwise.model.excitation import Excitation
from linkwise.model.memory_support import require_rest_at_zero
from linkwise.model.rig_support import refuse_rig
from linkwise.model.structure import Structure
from linkwise.simulation.checks import check_excitation, output_times
from linkwise.simulation.schedule import RunSchedule

_SAMPLES_PER_PERIOD = 20  # of the fastest mode, by default: cubics between them are right to 3e-5
_LEAST_SAMPLES = 1000  # by default
_MOST_SAMPLES = 2_000_000  # by default


@dataclass(frozen=True, eq=False)
class Comparison:
    """A `structure` with harvesters, its `sinks`, the `baseline` without them, and the `options` of the comparison.

    `times` (N,) s are those of the output.
    """

    structure: Structure
    sinks: tuple[Sink, ...]
    baseline: WithoutSinks
    times: Floats
    options: AbsorptionOptions

    @classmethod
    def of(cls, structure: Structure, options: AbsorptionOptions) -> Comparison:
        """The comparison that `absorb` makes; raises what `absorb` raises before it simulates."""
        refuse_rig(structure, "comparisons with and without sinks")
        require_rest_at_zero(structure.links, "comparisons with and without sinks")
        _ = (
            [link.values for link in structure.links],
            structure.mass_values,
        )  # StructureError if one is unknown
        sinks, excitation = find_sinks(structure, options.sinks), options.excitation
        equipped = with_harvesters(structure, options.harvesters or {})
        delivered_powers(structure, options.harvesters or {})  # StructureError if one is not a power
        rate = _default_rate(structure, options.duration) if options.rate is None else options.rate
        times = output_times(options.duration, rate)
        check_excitation(equipped, excitation, float(times[-1]))
        if not (any(excitation.release.values()) or excitation.impulses or excitation.drives):
            raise SimulationError(
                "nothing sets the structure in motion; give a release, an impulse, a force or a motion of the base"
            )
        baseline = without_sinks(equipped, sinks, excitation, options.without)
        return cls(equipped, sinks, baseline, times, options)

    def of_variant(
        self, structure: Structure, excitation: Excitation, baseline: WithoutSinks | None = None
    ) -> Comparison:
        """The same comparison of another structure of this shape, harvesters included; `baseline` if it is known."""
        return replace(
            self,
            structure=structure,
            baseline=baseline or without_sinks(structure, self.sinks, excitation, self.options.without),
            options=replace(self.options, excitation=excitation),
        )

    @cached_property
    def powers(self) -> Mapping[str, Expression]:
        """The power in W of each harvester that is given by an expression, by link."""
        return delivered_powers(self.structure, self.options.harvesters or {})

    @property
    def schedule(self) -> RunSchedule:
        """The run with sinks."""
        return RunSchedule(self.structure, self.options.excitation, self.times)

    @property
    def baseline_schedule(self) -> RunSchedule:
        """The run without sinks."""
        return RunSchedule(self.baseline.structure, self.baseline.excitation, self.times)

    @cached_property
    def primaries(self) -> tuple[str, ...]:
        """The points of hosts, and the masses that no sink carries, which both structures have."""
        return primary_masses(self.structure, self.sinks)

    @cached_property
    def absorbing(self) -> tuple[str, ...]:
        """The links by which sinks absorb: the sinks, their harvesters, and all other links to their masses."""
        carried = {sink.mass for sink in self.sinks}
        names = {sink.link for sink in self.sinks} | {f"{sink.link}{SUFFIX}" for sink in self.sinks}
        return tuple(
            link.name for link in self.structure.links if link.name in names or carried & set(link.between)
        )

    @property
    def resting_structure(self) -> Structure:
        """The structure in whose equilibria the primary masses come to rest.

        The link to a mass that has no other link exerts no force at rest, so that its host rests as it does without the sink.
        """
        leaves = all(sink.mass is not None and self._is_leaf(sink) for sink in self.sinks)
        return self.baseline.structure if leaves else self.structure

    def _is_leaf(self, sink: Sink) -> bool:
        """Whether the mass of a sink is linked to its host alone."""
        ends = (set(link.between) for link in self.structure.links if sink.mass in link.between)
        return all(pair == {sink.mass, sink.host} for pair in ends)


def _default_rate(structure: Structure, duration: float) -> float:
    """Samples per second that resolve the fastest mode: 1, 2 or 5 times a power of ten."""
    if not 0.0 < duration < np.inf:
        return 1.0  # output_times refuses the duration
    try:
        fastest = float(np.nanmax(natural_frequencies(structure)))
    except (StructureError, ValueError):
        fastest = 0.0
    least = max(_SAMPLES_PER_PERIOD * fastest, _LEAST_SAMPLES / duration)
    if least * duration > _MOST_SAMPLES:
        raise SimulationError(
            f"resolving the fastest mode, {fastest:.3g} Hz, over {duration:g} s takes {least * duration:.1e} samples; give a "
            "lower rate if the primary masses are slower",
            arguments=("rate",),
        )
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9)))
