"""One structure of a study with its excitation, sensors, unknowns and judged links; a case of it, and the row it leaves."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from statistics import median
from typing import Any

import numpy as np

from linkwise.errors import LinkwiseError, StudyError
from linkwise.expression import differentiate, symbols
from linkwise.model.excitation import Excitation, Impulse
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.simulation.run import check_excitation
from linkwise.simulation.simulate import recorded_channels, simulate

FAILED = "failed"  # the status of a row without an answer
INTERNAL_ERROR = "internal error"  # the same, if the fault is linkwise's and not the case's
WORKER_DIED = "worker died"  # the same, if worker processes were killed, ran out of memory, or crashed
REPEATED = (INTERNAL_ERROR, WORKER_DIED)  # the cases of such rows are run again
_ALL = ("x", "v", "a")
# beside the seed: the stream of what is known to within, the noise being drawn from the seed alone
_PRIOR = 1
_IN_FILE = {"structure": "toml", "impulses": "impulse"}  # fields under other names


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
        for key, part in self._excitation_by_key.items():
            with study_errors_at(key):
                check_excitation(self.structure, Excitation(**part, base=self.base), self.duration)
        if not self.unknown:
            raise StudyError("must name at least one", "unknown")
        derived = {"sensors": "_channels", "unknown": "unknown_structure", "judge": "judged_links"}
        for key, attribute in derived.items():
            with study_errors_at(key):
                getattr(self, attribute)

    @property
    def _excitation_by_key(self) -> dict[str, dict[str, Any]]:
        """The parts of the excitation, each by the key that an error names, the base aside."""
        parts: dict[str, dict[str, Any]] = {"base": {}}
        parts |= {f"release.{name}": {"release": {name: value}} for name, value in self.release.items()}
        parts |= {f"impulse[{k}]": {"impulses": (impulse,)} for k, impulse in enumerate(self.impulses)}
        return parts | {f"forces.{mass}": {"forces": {mass: text}} for mass, text in self.forces.items()}

    @cached_property
    def _channels(self) -> list[Channel]:
        """What the sensors measure."""
        return recorded_channels(self.structure, Excitation(base=self.base), self.sensors)

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
        known = [p for p in structure.parameters if math.isfinite(p.sigma)]
        drawn: dict[str, float] = {p.name: _drawn(p, rng) for p in known}
        own = structure.coefficient
        stated = {name: replace(own(name), value=value) for name, value in drawn.items()}
        return structure.with_coefficients(stated) if stated else structure

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
        return clean.select(list(dict.fromkeys([*self._channels, *clean.inputs])))

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
        own = {_IN_FILE.get(one.name, one.name): getattr(self, one.name) for one in fields(self)}
        own |= {"toml": format_structure(self.structure), "impulse": list(map(asdict, self.impulses))}
        stated = {key: value for key, value in own.items() if value is not None}
        document: dict[str, Any] = json.loads(json.dumps(stated, default=_plain))
        return document


def _plain(value: Any) -> dict[str, Any] | float:
    """A mapping as a dict, and a number of NumPy as a float."""
    return dict(value) if isinstance(value, Mapping) else float(value)


@contextmanager
def study_errors_at(where: str) -> Iterator[None]:
    """Errors of what a study file states there, as errors of the study."""
    try:
        yield
    except LinkwiseError as error:
        raise StudyError(str(error), where) from None


def _drawn(parameter: Parameter, rng: np.random.Generator) -> float:
    """A value off the true one by the error of what is known to within, inside the bounds."""
    value = (parameter.start or 0.0) + parameter.sigma * rng.standard_normal()
    return float(np.clip(value, parameter.lower, parameter.upper))


@dataclass(frozen=True, order=True)
class Case:
    """One run of a study.

    Attributes
    ----------
    structure, method : str
        Names of the structure and the method.
    snr_db : float
        The signal-to-noise ratio in dB.
    seed : int
        The seed of the noise.

    Examples
    --------
    >>> import linkwise as lw
    >>> print(next(lw.study.read_study("paper").cases()))
    2 masses, 40 dB, classical, displacement, seed 1000
    """

    structure: str
    snr_db: float
    method: str
    seed: int

    @property
    def cell(self) -> tuple[str, float, str]:
        """Structure, noise level and method: what cases of several seeds share."""
        return self.structure, self.snr_db, self.method

    def __str__(self) -> str:
        return f"{self.structure}, {self.snr_db:g} dB, {self.method}, seed {self.seed}"


@dataclass(frozen=True, kw_only=True)
class MethodResult:
    """The result of one method for one case: the part of its row that a method answers for.

    Attributes
    ----------
    status : str
        The status of the estimate ("converged", "not converged", "chi-square off", "forces unexplained"); of rows also
        "failed" without one, "internal error" or "worker died".
    seconds : float
        Time of the estimate in s, without simulation and noise.
    links : mapping of str to float
        The NMSE in % (paper Eq. 8) of the force of each judged link.
    coefficients, standard_errors : mapping of str to float
        The identified coefficients by full name, in SI units, and their standard errors, if the method has such;
        none where the estimate is not to be trusted.
    reason : str
        Why there is no answer, or none to be trusted.
    terms : mapping of str to int
        How many terms of the answer are "right", and how many "missing" and "extra", of a method that looks for terms; empty
        for one that is told them.

    Examples
    --------
    >>> import linkwise as lw
    >>> study = lw.study.read_study("paper")
    >>> subject, method = study.subjects[0], study.method("weak")
    >>> result = method.evaluate(subject, subject.simulate(), snr_db=40.0, seed=1)
    >>> result.status, sorted(result.coefficients)
    ('converged', ['nes1.alpha', 'nes1.beta', 'nes1.c', 'spring1.c', 'spring1.k'])
    """

    status: str
    links: Mapping[str, float] = field(default_factory=dict)
    coefficients: Mapping[str, float] = field(default_factory=dict)
    standard_errors: Mapping[str, float] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)
    reason: str = ""
    terms: Mapping[str, int] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether there is no answer."""
        return self.status in (FAILED, *REPEATED)

    @property
    def exact(self) -> bool | None:
        """Whether no term is missing and none is extra; None where terms are not looked for, or there is no answer."""
        return not (self.terms["missing"] or self.terms["extra"]) if self.terms else None

    @property
    def nmse(self) -> float | None:
        """The median of `links` in %, which tables of the study show; None if the case failed."""
        return median(self.links.values()) if self.links else None

    @property
    def worst(self) -> float | None:
        """The largest of `links` in %; None if the case failed."""
        return max(self.links.values(), default=None)


@dataclass(frozen=True)
class Row(MethodResult):
    """The outcome of one case of a study: which case it is, and the result of its method.

    Rows of one case are equal, except for `seconds`, whichever worker ran it and in whatever order, on processors of one
    kind. Two kinds round differently, and follow different orbits of a chaotic motion past its horizon.

    Attributes
    ----------
    structure, method : str
        Names of the structure and the method.
    masses : int
        The number of masses.
    snr_db : float
        The signal-to-noise ratio in dB.
    seed : int
        The seed of the noise.
    status, links, coefficients, standard_errors, seconds, reason, terms
        As in `MethodResult`.

    Examples
    --------
    >>> import linkwise as lw
    >>> row = lw.study.Row("bnes-2", 2, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.2, "nes2": 0.4})
    >>> row.nmse, row.failed
    (0.30000000000000004, False)
    """

    structure: str
    masses: int
    snr_db: float
    method: str
    seed: int

    @property
    def case(self) -> Case:
        """The case of this row."""
        return Case(self.structure, self.snr_db, self.method, self.seed)
