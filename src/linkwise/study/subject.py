"""One structure of a study, with its excitation, sensors, unknowns and judged links."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from linkwise.display import near_miss
from linkwise.errors import LinkwiseError, SimulationError, StudyError
from linkwise.expression import differentiate, symbols
from linkwise.model.excitation import Excitation, Impulse
from linkwise.model.link import BASE
from linkwise.model.parameters import Parameter, coefficient_slots, replace_coefficients, replace_shapes
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.simulation.run import check_place
from linkwise.simulation.simulate import simulate

_ALL = ("x", "v", "a")
_KINDS = (*_ALL, "f", "state")
# beside the seed: the stream of what is known to within, the noise being drawn from the seed alone
_PRIOR = 1


@dataclass(frozen=True, eq=False)
class Subject:
    """A structure of a study.

    Parameters
    ----------
    name : str
        The name in the study.
    structure : Structure
        The true structure, every coefficient a number. A coefficient known to within, such as a frequency of a host, has its
        start as true value; in each cycle an identification is told another one, off by a random error of its standard
        deviation.
    duration, rate : float
        Length of the records in s, and samples per second in Hz.
    release : mapping of str to float
        Initial values, as in `simulate`.
    impulses : tuple of Impulse
        Blows, as in `simulate`.
    forces : mapping of str to str
        Force in N on each mass, as text in t.
    base : str or None
        Displacement of the base in m, as text in t.
    sensors : tuple of str
        What is measured: kinds ("x", "v", "a" of every mass and point, "f" of every link, "state" of links with memory) or
        channels ("x:m1"). By default displacements, and forces of links alone on a rig.
    unknown : tuple of str
        What is identified, as in `Structure.unknown`; "all" are all links, but no modes of hosts.
    judge : tuple of str
        The links whose force is compared with the truth, as in `Structure.unknown`; by default the unknown ones with a
        nonlinear stiffness, or all unknown ones if there are none.
    frequency : float or None
        The frequency of the motion in Hz by which "samples a period" are counted.
    scatter : float
        Cycle k = 0, 1, ... starts from (1 + k scatter) times the release. Past its horizon a chaotic motion is one of many,
        some harder to identify than others: with a tiny scatter every cycle follows its own orbit, so that a median over
        cycles characterises the structure and not one orbit.

    Raises
    ------
    StudyError
        If something does not fit the structure; the error names the key.

    Examples
    --------
    >>> import linkwise as lw
    >>> subject = lw.study.Subject(
    ...     "chain", lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0}, unknown=("nes",)
    ... )
    >>> subject.judged_links, subject.measured(subject.simulate()).channels
    (('nes1',), ('x:m1', 'x:m2'))
    """

    name: str
    structure: Structure
    duration: float
    rate: float
    release: Mapping[str, float] = field(default_factory=dict)
    impulses: tuple[Impulse, ...] = ()
    forces: Mapping[str, str] = field(default_factory=dict)
    base: str | None = None
    sensors: tuple[str, ...] = ("x",)
    unknown: tuple[str, ...] = ("all",)
    judge: tuple[str, ...] = ()
    scatter: float = 0.0
    frequency: float | None = None

    def __post_init__(self) -> None:
        for key in ("duration", "rate", "frequency"):
            value = getattr(self, key)
            if value is not None and not 0.0 < value < float("inf"):
                raise StudyError(f"must be positive and finite, got {value!r}", key)
        if not math.isfinite(self.scatter):
            raise StudyError(f"must be finite, got {self.scatter!r}", "scatter")
        self._check_excitation()
        for key, names in (("sensors", self.sensors), ("unknown", self.unknown)):
            if not names:
                raise StudyError("must name at least one", key)
        for name in self.sensors:
            if name not in _KINDS:
                self._channel(name, "sensors", _KINDS)
        unknowns = ("unknown", lambda: self.unknown_structure.parameters)
        for key, check in (unknowns, ("judge", lambda: self.judged_links)):
            try:
                check()
            except LinkwiseError as error:
                raise StudyError(str(error), key) from None

    @cached_property
    def true_structure(self) -> Structure:
        """The structure that is simulated, every coefficient a number."""
        given = self.structure.parameters
        return self.structure.with_values({p.name: p.start for p in given if p.start is not None})

    @property
    def samples_per_period(self) -> float | None:
        """Samples in a period of `frequency`; None without one."""
        return None if self.frequency is None else self.rate / self.frequency

    @cached_property
    def unknown_structure(self) -> Structure:
        """The structure with its unknowns, which methods identify."""
        modes = self.structure.modes
        joints = [link.name for link in self.structure.links if link.name not in modes] if modes else []
        named = (joints if joints and name == "all" else [name] for name in self.unknown)
        return self.structure.unknown(*(name for names in named for name in names))

    def stated_structure(self, seed: int) -> Structure:
        """The structure with its unknowns, where what is known to within is off the truth by a random error.

        Parameters
        ----------
        seed : int
            The seed of the errors.

        Returns
        -------
        Structure
            The structure.
        """
        structure, rng = self.unknown_structure, np.random.default_rng([seed, _PRIOR])
        slots = coefficient_slots(structure.masses, structure.links, structure.hosts)
        known = [p for p in structure.parameters if math.isfinite(p.sigma)]
        drawn: dict[str, float] = {p.name: _drawn(p, rng) for p in known}
        stated = {name: replace(slots[name].coefficient, value=value) for name, value in drawn.items()}
        if not stated:
            return structure
        masses, links = replace_coefficients(structure.masses, structure.links, slots, stated)
        return Structure(structure.name, masses, links, replace_shapes(structure.hosts, stated))

    @cached_property
    def judged_links(self) -> tuple[str, ...]:
        """The names of the links whose force is compared with the truth."""
        chosen = self.structure.unknown(*self.judge) if self.judge else self.unknown_structure
        unknown = [link for link in chosen.links if not all(c.known for c in link.coefficients.values())]
        if self.judge:
            return tuple(link.name for link in unknown)
        joints = [link for link in unknown if link.name not in self.structure.modes]
        slopes = {link.name: symbols(differentiate(link.law.expression, "d")) for link in joints}
        nonlinear = [link for link in joints if link.law.states or "d" in slopes[link.name]]
        return tuple(link.name for link in nonlinear or joints or unknown)

    def simulate(self, cycle: int = 0) -> Record:
        """Simulate a cycle without noise.

        Parameters
        ----------
        cycle : int
            The number of the cycle, 0 for the first.

        Returns
        -------
        Record
            Displacements, velocities and accelerations of every mass and point, other sensors, and the inputs.

        Raises
        ------
        SimulationError
            If the motion diverges.
        """
        factor = 1.0 + self.scatter * cycle
        return simulate(
            self.true_structure,
            duration=self.duration,
            rate=self.rate,
            sensors=list(dict.fromkeys((*_ALL, *self._sensors))),
            release={name: value * factor for name, value in self.release.items()},
            impulses=self.impulses,
            forces=self.forces,
            base=self.base,
        )

    def measured(self, clean: Record) -> Record:
        """Select what the sensors measure.

        Parameters
        ----------
        clean : Record
            A record of all motion, as `simulate` returns it.

        Returns
        -------
        Record
            The channels of the sensors, in their order, and the inputs.
        """
        structure, channels = self.structure, dict[str, None]()
        owners = {
            **dict.fromkeys(_ALL, structure.places),
            "f": [link.name for link in structure.links],
            "state": [f"{structure.links[k].name}.{state}" for k, state in structure.topology.states],
        }
        for sensor in self._sensors:
            named = [f"{sensor}:{owner}" for owner in owners[sensor]] if sensor in owners else [sensor]
            channels.update(dict.fromkeys(named))
        return clean.select([*channels, *clean.inputs])

    @property
    def _sensors(self) -> tuple[str, ...]:
        """The sensors; of links alone on a rig by default load cells."""
        return ("f",) if self.structure.on_rig and self.sensors == ("x",) else self.sensors

    def document(self) -> dict[str, Any]:
        """The table of a study file that defines this subject, the structure included.

        Returns
        -------
        dict
            Plain data, for TOML or JSON.
        """
        return {
            "name": self.name,
            "toml": format_structure(self.structure),
            "duration": float(self.duration),
            "rate": float(self.rate),
            "release": {name: float(value) for name, value in self.release.items()},
            "impulse": [
                {"mass": impulse.mass, "momentum": float(impulse.momentum), "time": float(impulse.time)}
                for impulse in self.impulses
            ],
            "forces": dict(self.forces),
            **({} if self.base is None else {"base": self.base}),
            "sensors": list(self.sensors),
            "unknown": list(self.unknown),
            "judge": list(self.judge),
            "scatter": float(self.scatter),
            **({} if self.frequency is None else {"frequency": float(self.frequency)}),
        }

    def _check_excitation(self) -> None:
        for channel in self.release:
            self._check_release(channel, f"release.{channel}")
        for index, impulse in enumerate(self.impulses):
            self._check_mass(impulse.mass, f"impulse[{index}].mass")
        for mass, text in self.forces.items():
            self._check_mass(mass, f"forces.{mass}")
            self._check_time_function(f"forces.{mass}", forces={mass: text})
        if self.base is not None:
            self._check_time_function("base", base=self.base)
        if (self.base is not None) != bool(self.structure.base_incidence.any()):
            when = 'if, and only if, a link ends at "base"'
            raise StudyError(f"the motion of the base must be given {when}", "base")

    def _check_release(self, name: str, key: str) -> None:
        channel = self._channel(name, key)
        got = {"a": "an acceleration", "f": "a force"}.get(channel.kind)
        if got is not None:
            raise StudyError(f"a release takes displacements (x) and velocities (v), got {got}", key)
        for host in self.structure.hosts:
            if channel.place in host.points:
                mode = f"release these, such as {channel.kind}:{host.coordinates[0]}"
                raise StudyError(f"a point moves as the modes of its host do; {mode}", key)

    def _check_time_function(self, key: str, **excitation: Any) -> None:
        try:
            Excitation(**excitation)
        except LinkwiseError as error:
            raise StudyError(f"not a function of time: {error}", key) from None

    def _channel(self, name: str, key: str, kinds: tuple[str, ...] = ()) -> Channel:
        try:
            channel = Channel.parse(name)
        except LinkwiseError as error:
            others = f", or one of the kinds {', '.join(kinds)}" if kinds else ""
            places, links = self.structure.places, self.structure.links
            example = f"v:{places[0]}" if places else f"f:{links[0].name}"
            raise StudyError(f"{error}; expected a channel such as {example}{others}", key) from None
        if channel.is_input or channel.place == BASE:
            raise StudyError(f'"{name}" is an input, not the motion of a mass', key)
        if channel.is_motion:
            self._check_mass(channel.place, key)
            return channel
        try:
            check_place(channel, self.structure, name)
        except SimulationError as error:
            raise StudyError(error.message, key) from None
        return channel

    def _check_mass(self, name: str, key: str) -> None:
        names = self.structure.places
        if name not in (*names, *self.structure.modes):
            hint = near_miss(name, names)
            raise StudyError(f'unknown mass "{name}"{hint}; choose from {", ".join(names)}', key)


def _drawn(parameter: Parameter, rng: np.random.Generator) -> float:
    """A value off the true one by the error of what is known to within, inside the bounds."""
    value = (parameter.start or 0.0) + parameter.sigma * rng.standard_normal()
    return float(np.clip(value, parameter.lower, parameter.upper))
