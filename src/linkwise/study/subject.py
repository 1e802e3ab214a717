"""One structure of a study: what drives it, what sees it, what is asked about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from linkwise.errors import LinkwiseError, StudyError
from linkwise.expression import differentiate, symbols
from linkwise.model.excitation import Excitation, Impulse
from linkwise.model.link import BASE
from linkwise.model.structure import Structure
from linkwise.model.toml_file import format_structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.simulation.simulate import simulate
from linkwise.text import near_miss

_ALL = ("x", "v", "a")


@dataclass(frozen=True, eq=False)
class Subject:
    """`structure` with every coefficient a number, simulated for `duration` s at `rate` Hz under its excitation.

    `release`, `impulses`, `forces` and `base` are as in `simulate`, forces and base as text in t. Estimators see `sensors`
    and are asked for `unknown`, as in `Structure.unknown`; `judge` names, in the same way, the links whose force is compared
    with the truth, by default those asked for whose stiffness is nonlinear, or all asked for where none is.

    With `scatter` s, cycle k = 0, 1, ... is released from (1 + k s) times the release. Past its horizon a chaotic motion is
    one of many, and some are harder to identify than others: a tiny scatter lets every cycle follow its own, so that a
    median over cycles is of the structure and not of one orbit.

    Raises StudyError, naming the key, for what does not fit the structure.
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

    def __post_init__(self) -> None:
        for key, value in (("duration", self.duration), ("rate", self.rate)):
            if not 0.0 < value < float("inf"):
                raise StudyError(f"it must be a number above 0, got {value!r}", key)
        if not math.isfinite(self.scatter):
            raise StudyError(f"it must be a finite number, got {self.scatter!r}", "scatter")
        self._check_excitation()
        for key, names in (("sensors", self.sensors), ("unknown", self.unknown)):
            if not names:
                raise StudyError("at least one must be named", key)
        for name in self.sensors:
            if name not in _ALL:
                self._check_channel(name, "sensors", _ALL)
        for key, check in (
            ("unknown", lambda: self.unknown_structure.parameters),
            ("judge", lambda: self.judged_links),
        ):
            try:
                check()
            except LinkwiseError as error:
                raise StudyError(str(error), key) from None

    @cached_property
    def unknown_structure(self) -> Structure:
        """The structure with its unknowns, as estimators get it."""
        return self.structure.unknown(*self.unknown)

    @cached_property
    def judged_links(self) -> tuple[str, ...]:
        """The links by whose force an answer is judged."""
        if self.judge:
            chosen = self.structure.unknown(*self.judge)
            return tuple(
                link.name for link in chosen.links if any(not c.known for c in link.coefficients.values())
            )
        unknown = [
            link
            for link in self.unknown_structure.links
            if any(not c.known for c in link.coefficients.values())
        ]
        nonlinear = [link for link in unknown if "d" in symbols(differentiate(link.law.expression, "d"))]
        return tuple(link.name for link in nonlinear or unknown)

    def simulate(self, cycle: int = 0) -> Record:
        """The clean record of a cycle, 0 the first: x, v and a of every mass, and the inputs.

        Raises SimulationError where it diverges.
        """
        factor = 1.0 + self.scatter * cycle
        return simulate(
            self.structure,
            duration=self.duration,
            rate=self.rate,
            sensors=_ALL,
            release={name: value * factor for name, value in self.release.items()},
            impulses=self.impulses,
            forces=self.forces,
            base=self.base,
        )

    def seen(self, clean: Record) -> Record:
        """What the sensors see of `clean`, in their order, with the inputs."""
        found: dict[str, None] = {}
        for sensor in self.sensors:
            kinds = [f"{sensor}:{mass}" for mass in self.structure.mass_names] if sensor in _ALL else [sensor]
            found.update(dict.fromkeys(kinds))
        return clean.select([*found, *clean.inputs])

    def document(self) -> dict[str, Any]:
        """The table of a study file that gives this subject, complete in itself."""
        return {
            "name": self.name,
            "toml": format_structure(self.structure),
            "duration": float(self.duration),
            "rate": float(self.rate),
            "release": {name: float(value) for name, value in self.release.items()},
            "impulse": [
                {"mass": one.mass, "momentum": float(one.momentum), "time": float(one.time)}
                for one in self.impulses
            ],
            "forces": dict(self.forces),
            **({} if self.base is None else {"base": self.base}),
            "sensors": list(self.sensors),
            "unknown": list(self.unknown),
            "judge": list(self.judge),
            "scatter": float(self.scatter),
        }

    def _check_excitation(self) -> None:
        for channel in self.release:
            self._check_channel(channel, f"release.{channel}")
            if channel[0] == "a":
                raise StudyError("an acceleration cannot be released, only x or v", f"release.{channel}")
        for index, impulse in enumerate(self.impulses):
            self._check_mass(impulse.mass, f"impulse[{index}].mass")
        for mass, text in self.forces.items():
            self._check_mass(mass, f"forces.{mass}")
            self._check_time_function(f"forces.{mass}", forces={mass: text})
        if self.base is not None:
            self._check_time_function("base", base=self.base)
        if (self.base is not None) != bool(self.structure.base_incidence.any()):
            raise StudyError(
                'it is the motion of "base", which must be given if, and only if, a link holds on to it',
                "base",
            )

    def _check_time_function(self, key: str, **excitation: Any) -> None:
        try:
            Excitation.of(**excitation)
        except LinkwiseError as error:
            raise StudyError(f"this is no function of time: {error}", key) from None

    def _check_channel(self, name: str, key: str, kinds: tuple[str, ...] = ()) -> None:
        try:
            channel = Channel.parse(name)
        except LinkwiseError as error:
            others = f", or one of the kinds {', '.join(kinds)}" if kinds else ""
            raise StudyError(
                f"{error}; expected a channel such as v:{self.structure.mass_names[0]}{others}", key
            ) from None
        if channel.is_input or channel.mass == BASE:
            raise StudyError(f'"{name}" is an input, not the motion of a mass', key)
        self._check_mass(channel.mass, key)

    def _check_mass(self, name: str, key: str) -> None:
        names = self.structure.mass_names
        if name not in names:
            raise StudyError(
                f'there is no mass "{name}"{near_miss(name, names)}; the masses are {", ".join(names)}', key
            )
