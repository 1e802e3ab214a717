"""Vibration absorption (paper section 4): a structure with and without its sinks under the same excitation, and its options.

Removed: the masses of the sinks and all links to them are taken away, as in the paper's Figs. 3 and 5. Locked: each sink
is held rigid at its initial elongation, so that its mass moves with its host.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import NoneType
from typing import Any, Unpack, final

import numpy as np

from linkwise.absorption.result import Absorption, Harvest, MassChange, MassDecay, SinkResult
from linkwise.absorption.runs import AbsorptionRun, barriers, decay_of, rest_positions, single_run
from linkwise.absorption.sinks import (
    SUFFIX,
    Sink,
    delivered_powers,
    dissipators,
    find_sinks,
    primary_masses,
    with_harvesters,
)
from linkwise.analysis.linear_modes import modes, natural_frequencies
from linkwise.arrays import Floats, finite
from linkwise.errors import SimulationError, StructureError, expect, options_given
from linkwise.expression import Expression, Number, Symbol, add, substitute, to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.excitation import Excitation, InputSignal, TimeFunction
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass, require_rest_at_zero
from linkwise.model.structure import Structure, refuse_rig
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.simulation.run import RunSchedule, check_excitation, output_times
from linkwise.simulation.simulate import ExcitationKeywords, SimulatedMotion

BASELINES = ("removed", "locked")


class AbsorptionKeywords(ExcitationKeywords, total=False):
    """The keywords of `AbsorptionOptions.of`: its fields, and those of `Excitation`."""

    duration: float | None
    rate: float | None
    sinks: Sequence[str]
    without: str
    settle: float
    harvesters: Mapping[str, float | str] | None


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class AbsorptionOptions:
    """The options of `absorb`, `absorption_intervals` and `absorption_map`.

    Those functions take the same as keywords; an object serves for several structures.

    Parameters
    ----------
    duration : float, optional
        Time to simulate, in s; by default three decay times of the least damped mode without sinks, or 300 of its periods.
    rate : float, optional
        Samples per second in Hz; by default at least 20 in a period of the fastest mode.
    sinks : sequence of str
        The links that are sinks; without names, every link with more than one stable well is one.
    without : {"removed", "locked"}
        How the sinks are taken out for comparison: their masses and all links to these are removed, as in the paper, or
        the sinks are locked at their initial elongation. Removed by default.
    settle : float
        A mass has settled when its excursion stays below this part of its peak without sinks, for the last 5 % of the run
        at least; 0.05 by default. Excursions are counted from the stable equilibrium where it ends.
    harvesters : mapping of str to float or str, optional
        Harvesters by link: the damping in N s/m of a damper in parallel, or the power in W that the link itself delivers, an
        expression in d, v, its states and its coefficients such as ``"V**2/R"``.
    excitation : Excitation
        What sets the structure in motion.

    Raises
    ------
    SimulationError
        If `settle` is not between 0 and 1.
    StructureError
        If `without` is neither "removed" nor "locked".

    Examples
    --------
    >>> import linkwise as lw
    >>> options = lw.absorption.AbsorptionOptions.of(duration=2.0, release={"v:m1": 1.0})
    >>> [lw.absorb(lw.bnes_chain(2, alpha=alpha), options).trusted for alpha in (-100.0, -50.0)]
    [True, True]
    """

    duration: float | None = field(default=None, metadata={"typed": "S"})
    rate: float | None = field(default=None, metadata={"typed": "HZ"})
    sinks: Sequence[str] = field(default=(), metadata={"typed": "LINK"})
    without: str = field(
        default="removed", metadata={"typed": "BASELINE", "choices": {name: name for name in BASELINES}}
    )
    settle: float = field(default=0.05, metadata={"typed": "PART"})
    harvesters: Mapping[str, float | str] | None = field(
        default=None, metadata={"typed": "LINK=NS/M|POWER", "example": "nes1=0.01"}
    )
    excitation: Excitation = field(default_factory=Excitation)

    def __post_init__(self) -> None:
        expect("AbsorptionOptions: duration", self.duration, float, NoneType)
        expect("AbsorptionOptions: settle", self.settle, float)
        if not 0.0 < self.settle < 1.0:
            message = f"settle is a part of the peak and must be between 0 and 1, got {self.settle!r}"
            raise SimulationError(message)
        if self.without not in BASELINES:
            known = ", ".join(map(repr, BASELINES))
            raise StructureError(f"unknown way to take out sinks, {self.without!r}; choose from {known}")

    @classmethod
    def of(cls, **keywords: Unpack[AbsorptionKeywords]) -> AbsorptionOptions:
        """Make options from keywords.

        Parameters
        ----------
        **keywords
            The fields but `excitation`, and those of `Excitation`: `release`, `impulses`, `forces`, `base`.

        Returns
        -------
        AbsorptionOptions
            The options.

        Raises
        ------
        SimulationError, StructureError
            If an option or the excitation is invalid.
        TypeError
            If a keyword is unknown.
        """
        names = {option.name for option in fields(cls)}
        own: dict[str, Any] = {name: value for name, value in keywords.items() if name in names}
        drives: dict[str, Any] = {name: value for name, value in keywords.items() if name not in names}
        return cls(**own, excitation=Excitation(**drives))


def without_sinks(
    structure: Structure, sinks: Sequence[Sink], excitation: Excitation, removal: str
) -> tuple[Structure, Excitation]:
    """The structure with its sinks "removed" or "locked", and the excitation that is left for it.

    Excitation of a sink's mass is dropped with a removed sink, and acts on the host of a locked one; a release then keeps the
    momentum of both. Raises StructureError if no valid structure is left, SimulationError if no excitation is left.
    """
    left, remaining = (_take_out if removal == "removed" else _lock)(structure, sinks, excitation)
    if remaining.is_empty:
        problem = f"with the sinks {removal} nothing sets the structure in motion, so there is nothing to compare with"
        if removal == "removed":
            remedy = "excite a primary mass, or compare with the sinks locked"
            raise SimulationError(f"{problem}; {remedy}", arguments=("without",))
        raise SimulationError(f"{problem}; give a release, an impulse, a force or a motion of the base")
    return left, remaining


def _take_out(
    structure: Structure, sinks: Sequence[Sink], excitation: Excitation
) -> tuple[Structure, Excitation]:
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
    return left, Excitation(release, impulses, forces, base)


def _lock(
    structure: Structure, sinks: Sequence[Sink], excitation: Excitation
) -> tuple[Structure, Excitation]:
    for sink in sinks:
        if {sink.host, sink.mass} & set(structure.points):
            locked = f"point {sink.host}: locked, it would change the modes of the host"
        elif sink.mass is None or sink.host in (GROUND, BASE):
            locked = f"{sink.host}: locked, it would hold its mass still"
        else:
            continue
        raise StructureError(
            f"the sink is linked to the {locked}; compare with the sinks removed",
            f'link "{sink.link}"',
            arguments=("without",),
        )
    host = {sink.mass: sink.host for sink in sinks if sink.mass is not None}
    root = {name: _carrier(name, host) for name in structure.mass_names}
    x = {name: excitation.release.get(f"x:{name}", 0.0) for name in structure.mass_names}
    offset = {name: x[name] - x[root[name]] for name in root}  # from its root, as long as it is locked
    kilograms = dict(zip(structure.mass_names, structure.mass_values.tolist(), strict=True))
    joined = dict.fromkeys((name for name in structure.mass_names if name not in host), 0.0)
    momenta = dict.fromkeys(joined, 0.0)  # of masses locked together, which keep their momentum
    for rider, name in root.items():
        joined[name] += kilograms[rider]
        momenta[name] += kilograms[rider] * excitation.release.get(f"v:{rider}", 0.0)
    changed = {name: Coefficient.number(total) for name, total in joined.items() if total != kilograms[name]}
    stay = (mass for mass in structure.masses if mass.name in joined)
    masses = tuple(replace(mass, mass=changed.get(mass.name, mass.mass)) for mass in stay)
    links = tuple(moved for link in structure.links if (moved := _reattached(link, root, offset)) is not None)
    left = _structure(structure, masses, links, "locked")
    impulses = tuple(replace(impulse, mass=root[impulse.mass]) for impulse in excitation.impulses)
    release = {f"x:{name}": x[name] for name in joined if x[name]}
    release |= {f"v:{name}": momentum / joined[name] for name, momentum in momenta.items() if momentum}
    forces = _combined_forces(excitation.forces, root)
    return left, Excitation(release, impulses, forces, excitation.base)


def _carrier(name: str, host: Mapping[str, str]) -> str:
    """The mass that a mass ends up locked to, over a chain of sinks."""
    path = [name]
    while path[-1] in host:
        path.append(host[path[-1]])
        if path[-1] in path[:-1]:
            circle = ", ".join(path)
            raise StructureError(f"the sinks carry one another in a circle ({circle}); name fewer sinks")
    return path[-1]


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
    unshared = [{name: replace(c, same_as=None) for name, c in link.coefficients.items()} for link in links]
    independent = tuple(replace(link, coefficients=c) for link, c in zip(links, unshared, strict=True))
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
    """A `structure` with harvesters, its `sinks`, the run without them as `baseline`, and the `options` of the comparison."""

    structure: Structure
    sinks: tuple[Sink, ...]
    baseline: RunSchedule
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
        left, remaining = without_sinks(equipped, sinks, excitation, options.without)
        duration = _default_duration(left) if options.duration is None else options.duration
        rate = _default_rate(structure, duration) if options.rate is None else options.rate
        times = output_times(duration, rate)
        check_excitation(equipped, excitation, float(times[-1]))
        return cls(equipped, sinks, RunSchedule(left, remaining, times), options)

    @property
    def times(self) -> Floats:
        """Those of the output in s, (N,)."""
        return self.baseline.times

    @cached_property
    def powers(self) -> Mapping[str, Expression]:
        """The power in W of each harvester that is given by an expression, by link."""
        return delivered_powers(self.structure, self.options.harvesters or {})

    @property
    def schedule(self) -> RunSchedule:
        """The run with sinks."""
        return RunSchedule(self.structure, self.options.excitation, self.times)

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

    @cached_property
    def dissipators(self) -> dict[str, list[int]]:
        """What dissipates, by name, with the numbers of its links."""
        return dissipators(self.structure)

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


def absorb(
    structure: Structure,
    options: AbsorptionOptions | None = None,
    *,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> Absorption:
    """Compare the vibration of a structure with its sinks and without them.

    Parameters
    ----------
    structure : Structure
        The structure, every coefficient a number or a start.
    options : AbsorptionOptions, optional
        What to simulate.
    progress : Progress
        Called with a `ProgressReport` before each of the two runs.
    **keywords
        In place of `options`: its fields `duration` (s, required), `rate` (Hz), `sinks`, `without`, `settle` and `harvesters`
        (N s/m by link), and the excitation, as in `simulate`: `release`, `impulses`, `forces`, `base`.

    Returns
    -------
    Absorption
        Decay and settling of the primary masses, the share of the energy that each link dissipates, and the crossings of
        each sink between its wells.

    Raises
    ------
    StructureError
        If a link does not exist, a coefficient is unknown and has no start, or there are no sinks.
    SimulationError
        If nothing moves without the sinks, and as `simulate`.
    TypeError
        If `structure` is no `Structure`.

    See Also
    --------
    absorption_intervals : The same for an identified structure, with intervals.
    absorption_map : The same over a grid of parameters.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.absorb(lw.bnes_chain(2), duration=6.0, release={"v:m1": 1.0})
    >>> found.masses[0].name, len(found.sinks[0].crossings)
    ('m1', 109)
    """
    expect("absorb(structure): structure", structure, Structure)
    comparison = Comparison.of(structure, options_given(AbsorptionOptions.of, options, keywords))
    return compare(comparison, progress)


def compare(comparison: Comparison, progress: Progress = silent) -> Absorption:
    """Make both runs of a comparison."""
    progress(ProgressReport(0.0, "with sinks"))
    with_sinks = _run(comparison, comparison.schedule, comparison.powers)
    progress(ProgressReport(0.5, "without sinks"))
    without = _run(comparison, comparison.baseline, {})
    level = comparison.options.settle * decay_of(without).peak
    if not np.any(without.v):
        raise SimulationError(
            f"with the sinks {comparison.options.without} nothing moves, so there is nothing to compare "
            "with: the structure starts at rest in equilibrium; give a release, an impulse, a force or a motion of the base "
            "that moves a primary mass"
        )
    decays = zip(
        comparison.primaries, level.tolist(), _decays(with_sinks, level), _decays(without, level), strict=True
    )
    return Absorption(
        removal=comparison.options.without,
        settle=comparison.options.settle,
        time=comparison.times,
        masses=tuple(MassChange(*of_mass) for of_mass in decays),
        sinks=_sink_results(comparison, with_sinks),
        harvests=_harvests(comparison, with_sinks),
        absorbing=comparison.absorbing,
        with_sinks=with_sinks,
        without=without,
    )


def _run(comparison: Comparison, schedule: RunSchedule, powers: Mapping[str, Expression]) -> AbsorptionRun:
    """One of the two runs."""
    motion = SimulatedMotion.of(schedule)
    positions = rest_positions(comparison.resting_structure, comparison.primaries)
    return replace(single_run(motion, comparison.primaries, positions, powers), horizon=motion.horizon)


def _decays(run: AbsorptionRun, level: Floats) -> list[MassDecay]:
    """The decay of each primary mass; `level` (P,) m."""
    decay = decay_of(run)
    settled, rates = (map(finite, column(level)) for column in (decay.settled, decay.rate))
    sizes = (run.rest.tolist(), decay.peak.tolist(), decay.rms.tolist())
    return [MassDecay(*row) for row in zip(*sizes, settled, rates, strict=True)]


def _sink_results(comparison: Comparison, run: AbsorptionRun) -> tuple[SinkResult, ...]:
    names = [link.name for link in run.structure.links]
    horizon = np.inf if run.horizon is None else run.horizon
    results = []
    for sink in comparison.sinks:
        number = names.index(sink.link)
        tops, crossings = barriers(run.structure.links[number]).tops, run.crossings[number]
        before, share = int(np.sum(crossings < horizon)), run.share(sink.link)
        results.append(SinkResult(sink, tuple(tops.tolist()), share, run.d[:, number], crossings, before))
    return tuple(results)


def _harvests(comparison: Comparison, run: AbsorptionRun) -> tuple[Harvest, ...]:
    harvests, duration = [], float(comparison.times[-1])
    for link, load in (comparison.options.harvesters or {}).items():
        if isinstance(load, str):
            energy = run.delivered[link]
            harvest = Harvest(link, None, energy, energy / duration, energy / run.total, load)
        else:
            share = run.share(f"{link}{SUFFIX}")
            harvest = Harvest(link, load, share * run.total, share * run.total / duration, share)
        harvests.append(harvest)
    return tuple(harvests)
