"""A structure with and without its sinks under the same excitation, ready to be run.

Removed: the masses of the sinks and all links to them are taken away, as in the paper's Figs. 3 and 5. Locked: each sink
is held rigid at its initial elongation, so that its mass moves with its host.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.absorption.options import AbsorptionOptions
from linkwise.absorption.sinks import (
    SUFFIX,
    Sink,
    delivered_powers,
    find_sinks,
    primary_masses,
    with_harvesters,
)
from linkwise.analysis.linear_modes import modes, natural_frequencies
from linkwise.arrays import Floats
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Expression, Number, Symbol, add, substitute, to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.excitation import Excitation, InputSignal, TimeFunction
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass, require_rest_at_zero
from linkwise.model.structure import Structure, refuse_rig
from linkwise.simulation.run import RunSchedule, check_excitation, output_times


@dataclass(frozen=True, eq=False)
class WithoutSinks:
    """A structure without its sinks and the excitation that is left for it."""

    structure: Structure
    excitation: Excitation


def without_sinks(
    structure: Structure, sinks: Sequence[Sink], excitation: Excitation, removal: str
) -> WithoutSinks:
    """The structure with its sinks "removed" or "locked".

    Excitation of a sink's mass is dropped with a removed sink, and acts on the host of a locked one; a release then keeps the
    momentum of both. Raises StructureError if no valid structure is left, SimulationError if no excitation is left.
    """
    baseline = (_removed if removal == "removed" else _locked)(structure, sinks, excitation)
    if baseline.excitation.is_empty:
        problem = f"with the sinks {removal} nothing sets the structure in motion, so there is nothing to compare with"
        if removal == "removed":
            remedy = "excite a primary mass, or compare with the sinks locked"
            raise SimulationError(f"{problem}; {remedy}", arguments=("without",))
        raise SimulationError(f"{problem}; give a release, an impulse, a force or a motion of the base")
    return baseline


def _removed(structure: Structure, sinks: Sequence[Sink], excitation: Excitation) -> WithoutSinks:
    removed = {sink.mass for sink in sinks if sink.mass is not None}
    names = {sink.link for sink in sinks}
    gone = [link for link in structure.links if link.name in names or removed & set(link.between)]
    states = {f"{link.name}.{state}" for link in gone for state in link.law.states}
    links = tuple(link for link in structure.links if link not in gone)
    masses = tuple(mass for mass in structure.masses if mass.name not in removed)
    left, absent = _structure(structure, masses, links, "removed"), removed | states
    release = {key: value for key, value in excitation.release.items() if key.partition(":")[2] not in absent}
    impulses = tuple(impulse for impulse in excitation.impulses if impulse.mass not in removed)
    forces = {mass: force for mass, force in excitation.forces.items() if mass not in removed}
    base = excitation.base if left.base_incidence.any() else None
    return WithoutSinks(left, Excitation(release, impulses, forces, base))


def _locked(structure: Structure, sinks: Sequence[Sink], excitation: Excitation) -> WithoutSinks:
    hosted = next((sink for sink in sinks if {sink.host, sink.mass} & set(structure.points)), None)
    if hosted is not None:
        raise StructureError(
            f"the sink is linked to the point {hosted.host}: locked, it would change the modes of the host; compare with the "
            "sinks removed",
            f'link "{hosted.link}"',
            arguments=("without",),
        )
    fixed = next((sink for sink in sinks if sink.mass is None or sink.host in (GROUND, BASE)), None)
    if fixed is not None:
        raise StructureError(
            f"the sink is linked to the {fixed.host}: locked, it would hold its mass still; compare with the sinks removed",
            f'link "{fixed.link}"',
            arguments=("without",),
        )
    host = {sink.mass: sink.host for sink in sinks if sink.mass is not None}
    root = {name: _root(name, host) for name in structure.mass_names}
    x = {name: excitation.release.get(f"x:{name}", 0.0) for name in structure.mass_names}
    offset = {name: x[name] - x[root[name]] for name in root}  # from its root, as long as it is locked
    kilograms = dict(zip(structure.mass_names, structure.mass_values.tolist(), strict=True))
    joined = dict.fromkeys((name for name in structure.mass_names if name not in host), 0.0)
    for rider, name in root.items():
        joined[name] += kilograms[rider]
    changed = {name: Coefficient.number(total) for name, total in joined.items() if total != kilograms[name]}
    stay = (mass for mass in structure.masses if mass.name in joined)
    masses = tuple(replace(mass, mass=changed.get(mass.name, mass.mass)) for mass in stay)
    links = tuple(moved for link in structure.links if (moved := _reattached(link, root, offset)) is not None)
    left = _structure(structure, masses, links, "locked")
    impulses = tuple(replace(impulse, mass=root[impulse.mass]) for impulse in excitation.impulses)
    release = {f"x:{name}": x[name] for name in joined if x[name]}
    release |= _joint_velocities(excitation.release, root, kilograms, joined)
    forces = _combined_forces(excitation.forces, root)
    return WithoutSinks(left, Excitation(release, impulses, forces, excitation.base))


def _root(name: str, host: Mapping[str, str]) -> str:
    """The mass that a mass ends up locked to, over a chain of sinks."""
    path = [name]
    while path[-1] in host:
        path.append(host[path[-1]])
        if path[-1] in path[:-1]:
            circle = ", ".join(path)
            raise StructureError(f"the sinks carry one another in a circle ({circle}); name fewer sinks")
    return path[-1]


def _joint_velocities(
    release: Mapping[str, float],
    root: Mapping[str, str],
    kilograms: Mapping[str, float],
    joined: Mapping[str, float],
) -> dict[str, float]:
    """The velocities of masses locked together that keep their momentum, as channels of a release."""
    momenta = dict.fromkeys(joined, 0.0)
    for rider, name in root.items():
        momenta[name] += kilograms[rider] * release.get(f"v:{rider}", 0.0)
    return {f"v:{name}": momentum / joined[name] for name, momentum in momenta.items() if momentum}


def _reattached(link: Link, root: Mapping[str, str], offset: Mapping[str, float]) -> Link | None:
    """A link with its ends on the masses that are left; None if both ends are now one mass."""
    first, second = (root.get(end, end) for end in link.between)
    if first == second:
        return None
    shift = offset.get(link.between[0], 0.0) - offset.get(link.between[1], 0.0)
    shifted = substitute(link.law.expression, {"d": add(Symbol("d"), Number(shift))})
    law = Law.parse(to_text(shifted), link.states) if shift else link.law
    return replace(link, between=(first, second), law=law)


def _combined_forces(forces: Mapping[str, InputSignal], root: Mapping[str, str]) -> dict[str, InputSignal]:
    """The forces on the masses that are left; forces on one mass are added."""
    combined: dict[str, InputSignal] = {}
    for mass, force in forces.items():
        target = root[mass]
        if target not in combined:
            combined[target] = force
            continue
        present = combined[target]
        if not (isinstance(present, TimeFunction) and isinstance(force, TimeFunction)):
            raise SimulationError(
                f"a sampled force and another force act on {target} and a sink locked to it, and cannot be added; add them "
                "yourself, or compare with the sinks removed",
                mass=target,
                arguments=("without",),
            )
        combined[target] = TimeFunction(f"({present.text}) + ({force.text})")
    return combined


def _structure(
    structure: Structure, masses: tuple[Mass, ...], links: tuple[Link, ...], removal: str
) -> Structure:
    """The structure of some masses and links; coefficients that were shared keep their values."""
    own = [{name: replace(c, same_as=None) for name, c in link.coefficients.items()} for link in links]
    independent = tuple(replace(link, coefficients=c) for link, c in zip(links, own, strict=True))
    bodies = tuple(replace(mass, mass=replace(mass.mass, same_as=None)) for mass in masses)
    try:
        return Structure(f"{structure.name}, sinks {removal}", bodies, independent, structure.hosts)
    except StructureError as error:
        message = f"no valid structure is left with the sinks {removal}: {error.message}"
        raise StructureError(message, error.where) from None


# of the least damped mode without sinks, which are simulated by default
_DECAY_TIMES, _MOST_PERIODS = (3.0, 300.0)
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
        # StructureError if one is unknown
        _ = ([link.values for link in structure.links], structure.mass_values)
        sinks, excitation = find_sinks(structure, options.sinks), options.excitation
        equipped = with_harvesters(structure, options.harvesters or {})
        delivered_powers(structure, options.harvesters or {})  # StructureError if one is not a power
        if excitation.is_empty:
            remedy = "give a release, an impulse, a force or a motion of the base"
            raise SimulationError(f"nothing sets the structure in motion; {remedy}")
        baseline = without_sinks(equipped, sinks, excitation, options.without)
        duration = _default_duration(baseline.structure) if options.duration is None else options.duration
        rate = _default_rate(structure, duration) if options.rate is None else options.rate
        times = output_times(duration, rate)
        check_excitation(equipped, excitation, float(times[-1]))
        return cls(equipped, sinks, baseline, times, options)

    def of_variant(
        self, structure: Structure, excitation: Excitation, baseline: WithoutSinks | None = None
    ) -> Comparison:
        """The same comparison of another structure of this shape, harvesters included; `baseline` if it is known."""
        without = baseline or without_sinks(structure, self.sinks, excitation, self.options.without)
        options = replace(self.options, excitation=excitation)
        return replace(self, structure=structure, baseline=without, options=options)

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
        links = self.structure.links
        return tuple(link.name for link in links if link.name in names or carried & set(link.between))

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


def _default_duration(baseline: Structure) -> float:
    """Seconds in which the least damped mode of a structure decays to a twentieth, at most `_MOST_PERIODS`."""
    linear = modes(baseline)
    omega = 2.0 * np.pi * linear.frequencies
    moving = omega > 0.0
    if not moving.any():
        message = "no mode of the structure vibrates about its rest; give a duration"
        raise SimulationError(message, arguments=("duration",))
    slowest = int(np.argmin(np.where(moving, linear.damping * omega, np.inf)))
    longest = _MOST_PERIODS / float(linear.frequencies[slowest])
    rate = float(linear.damping[slowest] * omega[slowest])
    duration = min(_DECAY_TIMES / rate, longest) if rate > 0.0 else longest
    return float(f"{duration:.1e}")


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
