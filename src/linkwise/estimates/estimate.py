"""The result of every estimator, the interface of estimators, and the result as plain data."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Bools, Floats
from linkwise.display import (
    JudgedView,
    align_columns,
    format_chi_square,
    format_duration,
    paragraph,
    remark_lines,
    table,
    text_of,
)
from linkwise.errors import IdentificationError, StructureError, require_known
from linkwise.estimates.causes import (
    SLIP,
    Cause,
    NoiseEstimate,
    RandomForceEstimate,
    SensorErrorEstimate,
    UnseenTerm,
)
from linkwise.estimates.findings import bound_findings, energy_findings, link_findings, supplied_power
from linkwise.estimates.link_estimate import (
    COEFFICIENT_HEAD,
    NORMAL_95,
    CoefficientEstimate,
    DerivedQuantity,
    LinkEstimate,
    LinkMotion,
    coefficient_row,
    moving_mass,
)
from linkwise.inspection.inspect import EstimatedError, unanswered_alerts
from linkwise.inspection.result import Alert
from linkwise.model.coefficient import MASS, SHAPE, Name
from linkwise.model.host import is_between_modes
from linkwise.model.link import Link
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record
from linkwise.registry import lazy_module
from linkwise.verdict import Grade, Verdict, admit_intervals, status_of

if TYPE_CHECKING:
    import pandas
else:  # not a requirement
    pandas = lazy_module("pandas")


def coefficient_document(coefficient: CoefficientEstimate) -> dict[str, Any]:
    """A coefficient as plain data: value, unit and, of unknown ones, standard error and interval."""
    document = {"value": coefficient.value, "unit": coefficient.unit, "known": coefficient.known}
    uncertainty = {"standard_error": coefficient.standard_error, "interval": _ends(coefficient.interval)}
    return document if coefficient.known else document | uncertainty


def _ends(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def _derived_document(quantity: DerivedQuantity) -> dict[str, Any]:
    return {"value": quantity.value, "unit": quantity.unit, "interval": _ends(quantity.interval)}


def link_document(link: LinkEstimate) -> dict[str, Any]:
    """A link as plain data: name, ends, law, the rates and units of its states, coefficients and ranges, and wells,
    in-well frequencies and barrier where there are any.
    """
    document: dict[str, Any] = {
        "name": link.link.name,
        "between": list(link.link.between),
        "law": link.link.law.text,
        "coefficients": {c.name.key: coefficient_document(c) for c in link.coefficients},
        "range": {"d": list(link.d_range), "v": list(link.v_range)},
    }
    if link.link.law.states:
        units = {name: unit.replace("?", "") for name, unit in link.link.law.state_units.items()}
        rates = link.link.law.rates
        document["states"] = {rate.name: {"rate": rate.text, "unit": units[rate.name]} for rate in rates}
    if link.wells:
        document["wells"] = [{"d": well.value, "interval": _ends(well.interval)} for well in link.wells]
        document["in_well_frequencies"] = [_derived_document(frequency) for frequency in link.frequencies]
    if link.barrier is not None:
        document["barrier"] = _derived_document(link.barrier)
    return document


def mode_document(mode: LinkEstimate, shapes: Sequence[CoefficientEstimate] = ()) -> dict[str, Any]:
    """A mode of a host as plain data: name, frequency and damping, and where `shapes` of modes were estimated its own, by
    point.
    """
    coefficients = {c.name.key: coefficient_document(c) for c in mode.coefficients}
    own = [c for c in shapes if c.name.owner == mode.link.name]
    shape = {c.name.key.removeprefix(SHAPE): coefficient_document(c) for c in own}
    return {"name": mode.link.name, **coefficients, **({"shape": shape} if shape else {})}


_REFUSED = "No interval is given."
_APPROXIMATE = (
    "Intervals are approximate: of the laws of this form that come closest over motion like that of the record. They hold the "
    "scatter between parts of it and the change to longer horizons, and say nothing of laws of another form."
)
_ROUNDING = 1e-9  # of a coefficient: a negative variance smaller than the square of it is zero


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(JudgedView):
    """The result of `identify`: coefficients with their uncertainty, noise, and what limits the trust in them.

    Attributes
    ----------
    method, message : str
        Name of the method, and explanation of the first verdict on the fit.
    fit_verdicts : tuple of Verdict
        Verdicts on the fit as a whole.
    given_structure : Structure
        The structure with its unknowns.
    parameters : tuple of Parameter
        The p unknowns.
    values, covariance : array of shape (p,); array of shape (p, p)
        Their values in SI units and their covariance.
    free : array of bool, shape (p,)
        False where a parameter is at its bound, which leaves it without an interval.
    noise : mapping of str to NoiseEstimate
        Noise of the channels.
    chi_square_per_sample : float or None
        Residual power relative to that expected from noise; None where the method does not test it.
    seconds, samples : float, int
        Computing time in s, and number of samples fitted.
    compute_motion, record : callable, Record
        Computes the motion of the links, on first use of `motion`; the record.
    intervals : bool
        False for methods whose covariance gives no confidence intervals.
    profile : callable or None
        Profile-likelihood interval, for `profile_interval`; None without a likelihood.
    approximate : bool
        Whether values and covariance are those of laws that leave more than noise, with the scatter between parts of the
        records.
    profile_intervals : mapping of str to tuple of float
        Profile-likelihood intervals of unknowns, where they were asked for.
    remarks, notes : tuple of str
        Findings of the method; notes of the records on what was assumed or changed when they were read.
    model_error : float
        Part of the forces that the laws leave, by root mean squares; 0 where they explain the record to within its noise.
    diagnosis : tuple of Cause
        What would explain what the laws leave, in sensors, masses, applied forces and terms, the largest gain first.
    added : tuple of Cause
        Errors of sensors and inputs that were taken into the model, since laws as stated leave more than noise without them.
    alternative : Estimate or None
        The answer of laws with what is missing in those stated, if they leave only noise then; `added` holds what that is.
    more_records : tuple of Record
        The records that were fitted together with `record`.
    random_forces, sensor_errors : tuple of RandomForceEstimate, tuple of SensorErrorEstimate
        Ambient forces and noise of applied forces; offsets, gains and delays of sensors that were found with the coefficients.
    disturbances : tuple of EstimatedError
        Drifts and hums of sensors that were found with the coefficients.
    may_fade : tuple of float
        Frequencies in Hz of harmonic forces and hums that were found with the coefficients, and that the records do not show
        to go on: a mode that the laws lack looks like them.
    unseen_terms : tuple of UnseenTerm
        What exact laws may lack without a sign in the records, though it would move a coefficient, the farthest first.
    links_in_doubt : frozenset of str
        Links of a discovery that others may stand for; their coefficients have no intervals.
    for_dropped_terms : array of shape (p, p) or None
        The part of the covariance that allows for terms that a discovery dropped, or at which residuals hint;
        predictions without these do not have it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> estimate.trusted, estimate.status
    (True, 'converged')
    >>> alpha = estimate.coefficient("nes1.alpha")
    >>> f"{alpha.value:.1f} +- {alpha.standard_error:.1f} {alpha.unit}"
    '-99.6 +- 0.4 N/m'
    """

    method: str
    fit_verdicts: tuple[Verdict, ...]
    message: str
    seconds: float
    given_structure: Structure
    parameters: tuple[Parameter, ...]
    values: Floats
    covariance: Floats
    free: Bools
    noise: Mapping[str, NoiseEstimate]
    chi_square_per_sample: float | None
    samples: int
    compute_motion: Callable[[], LinkMotion]
    record: Record
    remarks: tuple[str, ...] = ()
    intervals: bool = True
    profile: Callable[[str, float, Progress], tuple[float, float]] | None = None
    notes: tuple[str, ...] = ()
    model_error: float = 0.0
    diagnosis: tuple[Cause, ...] = ()
    more_records: tuple[Record, ...] = ()
    random_forces: tuple[RandomForceEstimate, ...] = ()
    sensor_errors: tuple[SensorErrorEstimate, ...] = ()
    disturbances: tuple[EstimatedError, ...] = ()
    may_fade: tuple[float, ...] = ()
    unseen_terms: tuple[UnseenTerm, ...] = ()
    links_in_doubt: frozenset[str] = frozenset()
    for_dropped_terms: Floats | None = None
    profile_intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    approximate: bool = False
    added: tuple[Cause, ...] = ()
    alternative: Estimate | None = None

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on the fit and on the identified laws."""
        negative = (Verdict.COVARIANCE_NOT_POSITIVE,) if self._has_negative_variance else ()
        return (*self.fit_verdicts, *negative, *((Verdict.ENERGY_FED,) if self.supplies else ()))

    @property
    def _has_negative_variance(self) -> bool:
        """Whether a variance is negative beyond the rounding of its coefficient."""
        if not (self.intervals and admit_intervals(self.fit_verdicts)):
            return False
        variance = self.covariance.diagonal()[self.free]
        return bool(np.any(~(variance >= -((_ROUNDING * self.values[self.free]) ** 2))))

    @cached_property
    def supplies(self) -> dict[str, float]:
        """Mean power in W of links that supply energy to the motion, by name; empty without trusted intervals."""
        if not (self.intervals and admit_intervals(self.fit_verdicts)):
            return {}
        powers = {}
        for index, link in self._links_judged:
            free, covariance = self._free_coefficients(index)
            if free and link.law.is_plain:
                d, v = self.motion.d[:, index], self.motion.v[:, index]
                powers[link.name] = supplied_power(link, free, covariance, d, v)
        return {name: power for name, power in powers.items() if power is not None}

    @cached_property
    def grade(self) -> Grade:
        """How far the answer goes: the verdicts allow it, and an approximate one has intervals by parts of the records."""
        grade = Grade.worst(verdict.grade for verdict in self.verdicts)
        withheld = not (self.approximate or admit_intervals(self.verdicts))
        return Grade.REFUSED if grade is Grade.APPROXIMATE and withheld else grade

    @property
    def without_intervals(self) -> str:
        """Why there are no intervals: the answer is refused, or its method gives none; empty where there are."""
        if self.grade is Grade.REFUSED:
            return self.status
        return "" if self.intervals else f"{self.method} gives no intervals"

    @property
    def explanation(self) -> str:
        """`message`, the advice of verdicts on the identified laws, and what intervals are beside more than noise."""
        advice = (verdict.value for verdict in self.verdicts if verdict not in self.fit_verdicts)
        of_approximate = _APPROXIMATE if self.approximate else ""
        consequence = {Grade.REFUSED: _REFUSED, Grade.APPROXIMATE: of_approximate}.get(self.grade, "")
        return " ".join(filter(None, [self.message, *advice, consequence]))

    @property
    def status(self) -> str:
        """ "converged", or the first verdict that forbids trust: "not converged", "chi-square off", "forces unexplained"."""
        return status_of(self.verdicts)

    @cached_property
    def motion(self) -> LinkMotion:
        """Motion of the identified links, computed on first use."""
        return self.compute_motion()

    @cached_property
    def structure(self) -> Structure:
        """The identified structure: every coefficient a number."""
        return self.motion.structure

    @cached_property
    def links(self) -> tuple[LinkEstimate, ...]:
        """Estimates of all links, in the order of the structure; of modes they are in `modes`."""
        return tuple(link for link in self._every_link if link.link.name not in self.structure.modes)

    @property
    def modes(self) -> tuple[LinkEstimate, ...]:
        """Estimates of the modes of hosts, with the coefficients frequency and damping, and of the damping between them."""
        shown = {name for host in self.structure.hosts for name in host.shown_links}
        return tuple(link for link in self._every_link if link.link.name in shown)

    @cached_property
    def _every_link(self) -> tuple[LinkEstimate, ...]:
        return tuple(self._link_estimate(index) for index in range(len(self.structure.links)))

    @property
    def _links_judged(self) -> list[tuple[int, Link]]:
        """Numbered links, without dampers between modes, which dissipate only together with those of the modes."""
        return [(n, link) for n, link in enumerate(self.structure.links) if not is_between_modes(link.name)]

    @cached_property
    def masses(self) -> tuple[CoefficientEstimate, ...]:
        """Estimates of all masses, with names such as "m1.mass"."""
        return tuple(
            self._coefficient_estimate(Name(mass.name, MASS), -1 - n, mass.mass_unit, mass.mass.value or 0.0)
            for n, mass in enumerate(self.structure.masses)
            if mass.name not in self.structure.modes
        )

    @cached_property
    def shapes(self) -> tuple[CoefficientEstimate, ...]:
        """Estimates of the shapes of hosts that were not known exactly, with names such as "wing.mode1.shape.tip"."""
        value = self.structure.coefficient
        given = ((p, value(p.name).value or 0.0) for p in self.parameters if p.name.is_shape)
        return tuple(self._coefficient_estimate(p.name, p.members[0][0], p.unit, shape) for p, shape in given)

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what is wrong with the records or cannot be determined; empty where there is nothing to say."""
        bounds = bound_findings(self.parameters, self.free, self.given_structure)
        judged = [(number, self._every_link[number]) for number, _ in self._links_judged]
        of_links = (
            one for _, link in judged for one in link_findings(link, self.supplies.get(link.link.name))
        )
        d, v = self.motion.d, self.motion.v
        of_energy = (
            one for number, link in judged for one in energy_findings(link, d[:, number], v[:, number])
        )
        return (*map(str, self.alerts), *self.remarks, *bounds, *of_links, *of_energy)

    @cached_property
    def alerts(self) -> tuple[Alert, ...]:
        """What is wrong with channels of the records by themselves and is not allowed for, worst first, as of `inspect`."""
        of_sensors = [EstimatedError(error.kind, error.channel) for error in self.sensor_errors]
        of_sensors += [EstimatedError("dropped", cause.where) for cause in self.added if cause.kind == SLIP]
        return unanswered_alerts((self.record, *self.more_records), (*of_sensors, *self.disturbances))

    def coefficient(self, name: str | Parameter) -> CoefficientEstimate:
        """Estimate of a coefficient.

        Parameters
        ----------
        name : str or Parameter
            Full name, such as "nes1.alpha" or "m1.mass", or one of `parameters`.

        Returns
        -------
        CoefficientEstimate
            The coefficient with its interval.

        Raises
        ------
        StructureError
            If there is no such coefficient.
        """
        key = str(name.name) if isinstance(name, Parameter) else name
        require_known("name", key, self._coefficients, StructureError)
        return self._coefficients[key]

    def link(self, name: str) -> LinkEstimate:
        """Estimate of a link.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        LinkEstimate
            The link with its coefficients.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        by_name = {link.link.name: link for link in self._every_link}
        require_known("name", name, by_name, StructureError)
        return by_name[name]

    def force_band(self, name: str, d: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Stiffness force of a link with its 95 % band.

        Parameters
        ----------
        name : str
            Name of the link.
        d : array_like
            Elongations in m.

        Returns
        -------
        force, lower, upper : array of the shape of `d`
            Force at v = 0 and ends of the band in N, as `LinkEstimate.force_band`.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        return self.link(name).force_band(d)

    def to_dict(self) -> dict[str, Any]:
        """The estimate as plain data.

        Returns
        -------
        dict
            The content of ``result.json``.
        """
        profiles = {name: list(ends) for name, ends in self.profile_intervals.items()}
        return {
            "method": self.method,
            "status": self.status,
            **self._judgement(),
            "message": self.explanation,
            "seconds": self.seconds,
            "noise": {name: asdict(noise) for name, noise in self.noise.items()},
            "fit": {"chi_square_per_sample": self.chi_square_per_sample, "samples": self.samples},
            "model_error_percent": 100.0 * self.model_error,
            "diagnosis": [cause.to_dict() for cause in self.diagnosis],
            "added": [cause.to_dict() | {"standard_error": cause.standard_error} for cause in self.added],
            "random_forces": [force.to_dict() for force in self.random_forces],
            "sensor_errors": [error.to_dict() for error in self.sensor_errors],
            "unseen_terms": [term.to_dict() for term in self.unseen_terms],
            "alerts": [alert.to_dict() for alert in self.alerts],
            "findings": list(self.findings),
            "notes": list(self.notes),
            "masses": {mass.name.owner: coefficient_document(mass) for mass in self.masses},
            "links": [link_document(link) for link in self.links],
            **({"profile_intervals": profiles} if profiles else {}),
            **({"modes": [mode_document(mode, self.shapes) for mode in self.modes]} if self.modes else {}),
            **({"alternative": self._alternative_document(self.alternative)} if self.alternative else {}),
        }

    def _alternative_document(self, other: Estimate) -> dict[str, Any]:
        """The second answer as plain data: the first term that it adds, its link and law, all of its laws and coefficients.

        The former three are left out where it adds none.
        """
        laws = self._laws_of(other)
        term = next((cause.term for cause in other.added if cause.term), "")
        link = next((name for name, law in laws.items() if term and f"({term})" in law), "")
        unknown = {name: c for name, c in other._coefficients.items() if not c.known}
        return {
            **({"term": term, "link": link, "law": laws[link]} if link else {}),
            "laws": laws,
            "grade": other.grade.value,
            "added": [cause.to_dict() for cause in other.added],
            "coefficients": {name: coefficient_document(c) for name, c in unknown.items()},
        }

    def _laws_of(self, other: Estimate) -> dict[str, str]:
        """The laws of links in another answer that those of this one do not have."""
        own = {(link.name, link.law.text) for link in self.given_structure.links}
        laws = ((link.name, link.law.text) for link in other.given_structure.links)
        return {name: law for name, law in laws if (name, law) not in own}

    @property
    def second_answer(self) -> tuple[str, list[str], list[tuple[str, ...]]]:
        """Title, what asks for it, and table of `alternative`; empty without one."""
        other = self.alternative
        if other is None:
            return "", [], []
        laws = self._laws_of(other)
        links = [link for link in other.given_structure.links if link.name in laws]
        asked = [f"{link.name} ({' - '.join(link.between)}): {laws[link.name]}" for link in links]
        for cause in (cause for cause in other.added if cause.is_instrument):
            asked.append(f"{cause.where}, {cause.known_to}" if cause.known_within else cause.asked)
        unknown = ((name, c) for name, c in other._coefficients.items() if not c.known)
        labels = [cause.label.partition("; try ")[0] for cause in other.added if not cause.known_within]
        several = (cause for cause in other.added if cause.known_within and cause.size)
        open_ = [replace(cause, known_within=0.0).label for cause in several]
        labels += [" or ".join(open_)] if open_ else []
        return (
            f"With {' and '.join(labels)} only noise is left: a second answer, to",
            asked,
            [COEFFICIENT_HEAD, *(coefficient_row(c, name) for name, c in unknown)],
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """The coefficients and masses as a table of pandas, which is not a requirement of linkwise.

        Returns
        -------
        pandas.DataFrame
            One row a coefficient, by its full name, with the columns value, standard_error, lower, upper, unit and known;
            NaN where there is no standard error or interval.

        Raises
        ------
        IdentificationError
            If pandas is not installed.

        Examples
        --------
        >>> import linkwise as lw
        >>> chain = lw.bnes_chain(2)
        >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
        >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
        >>> fit.to_dataframe().index.tolist()
        ['spring1.k', 'spring1.c', 'nes1.alpha', 'nes1.beta', 'nes1.c', 'm1.mass', 'm2.mass']
        """
        if find_spec("pandas") is None:
            raise IdentificationError(
                "to_dataframe() needs pandas, which is not installed: pip install pandas, or use to_dict()"
            )
        rows = {
            str(c.name): (c.value, c.standard_error, *(c.interval or (None, None)), c.unit, c.known)
            for c in self._coefficients.values()
            if c.name.owner not in self.structure.modes or c.name.is_shape
        }
        columns = ["value", "standard_error", "lower", "upper", "unit", "known"]
        table = pandas.DataFrame.from_dict(rows, "index", columns=columns)
        return table.astype(dict.fromkeys(columns[:4], float))

    def __str__(self) -> str:
        return text_of(*_blocks(self))

    @cached_property
    def _coefficients(self) -> dict[str, CoefficientEstimate]:
        of_links = (c for link in self._every_link for c in link.coefficients)
        return {c.name: c for c in (*of_links, *self.masses, *self.shapes)}

    @cached_property
    def _parameter_index(self) -> dict[tuple[int, str], int]:
        return {member: number for number, one in enumerate(self.parameters) for member in one.members}

    def _coefficient_estimate(self, name: Name, index: int, unit: str, value: float) -> CoefficientEstimate:
        number = self._parameter_index.get((index, name.key))
        if number is None:
            return CoefficientEstimate(name, value, unit, known=True)
        is_given = self.grade is not Grade.REFUSED and self.free[number]
        if not is_given or name.owner in self.links_in_doubt:
            return CoefficientEstimate(name, value, unit, known=False)
        error = float(np.sqrt(max(self.covariance[number, number], 0.0)))
        half = NORMAL_95 * error
        interval = (value - half, value + half) if self.intervals else None
        return CoefficientEstimate(name, value, unit, False, error, interval)

    def _link_estimate(self, index: int) -> LinkEstimate:
        link = self.structure.links[index]
        free, covariance = self._free_coefficients(index)
        has_intervals = not self.without_intervals and link.name not in self.links_in_doubt
        units, values, v = link.law.units, link.values, self.motion.v[:, index]
        return LinkEstimate(
            link=link,
            coefficients=tuple(
                self._coefficient_estimate(Name(link.name, key), index, units[key], values[key])
                for key in link.coefficients
            ),
            d_range=(float(self.motion.d_range[index, 0]), float(self.motion.d_range[index, 1])),
            v_range=(float(np.nanmin(v)), float(np.nanmax(v))),
            free=free,
            covariance=covariance if has_intervals else None,
            moving_mass=moving_mass(self.structure, index),
        )

    def _free_coefficients(self, index: int) -> tuple[tuple[str, ...], Floats]:
        """Unknown coefficients of a link (q,) and their covariance (q, q)."""
        names = self.given_structure.links[index].coefficients
        free = tuple(name for name in names if (index, name) in self._parameter_index)
        which = np.array([self._parameter_index[index, name] for name in free], dtype=int)
        return free, self.covariance[np.ix_(which, which)]


class Estimator(ABC):
    """A method of identification with its options; `identify` takes one as `method`.

    Concrete classes are frozen dataclasses: `MaximumLikelihood`, `WeakForm` and `PhysicsInformedSindy`.

    Attributes
    ----------
    method : str
        Name of the method, which `identify` also takes and estimates carry; set on the class.

    Examples
    --------
    >>> import linkwise as lw
    >>> isinstance(lw.WeakForm(), lw.estimates.Estimator), lw.WeakForm.method
    (True, 'weak')
    """

    method: ClassVar[str]
    """Its name: what `identify` takes as text, and what its estimates carry."""

    @abstractmethod
    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """Estimate the unknowns of a structure.

        Parameters
        ----------
        records : sequence of Record
            One or more records of the structure.
        structure : Structure
            The structure, with one unknown at least.
        progress : Progress
            Called with a `ProgressReport` at every step of an iteration.

        Returns
        -------
        Estimate
            The answer; its `seconds` are those of the call only where `identify` makes it.

        Raises
        ------
        IdentificationError
            If the records do not determine the unknowns at all, or there are more of them than the method takes.
        """

    def only_record(self, records: Sequence[Record]) -> Record:
        """The record, for a method that takes a single one.

        Parameters
        ----------
        records : sequence of Record
            The records given.

        Returns
        -------
        Record
            The only one.

        Raises
        ------
        IdentificationError
            If there are several.
        """
        if len(records) > 1:
            message = f'several records are for method "ml", not for "{self.method}", which takes one; got {len(records)}'
            raise IdentificationError(message)
        return records[0]


_MANY = 12  # channels or links that are shown
_SHAPES = 6  # of modes at points, that are shown
_CAUSES = 4  # of what is left, that are shown
# of an interval's half: from here a profile interval says something that a standard error does not
_DIFFERS = 0.1


def _blocks(estimate: Estimate) -> Iterator[Iterable[str]]:
    """The lines of each part of the text."""
    value = estimate.chi_square_per_sample
    chi = "" if value is None else f", chi-square {format_chi_square(value)}"
    head = f"{estimate.structure.name or 'structure'}: {estimate.method}, {estimate.status}, {estimate.grade.trust}"
    summary = f"{estimate.explanation} ({estimate.samples} samples{chi}, {format_duration(estimate.seconds)})"
    yield [head, paragraph(summary)]
    yield table(_noise_rows(estimate), most=_MANY, more="more channels")
    unknown = [mass for mass in estimate.masses if not mass.known]
    of_modes = [c for mode in estimate.modes if mode.free for c in mode.coefficients]
    for title, shown in (("masses", unknown), ("modes", of_modes)):
        rows = (coefficient_row(one, one.name.removesuffix(".mass")) for one in shown)
        yield table([COEFFICIENT_HEAD, *rows], title)
    yield _shapes_lines(estimate)
    links = [link for link in estimate.links if link.free]
    yield from ([str(link)] for link in links[:_MANY])
    if len(links) > _MANY:
        yield [f"... and {len(links) - _MANY} more links; the result folder lists all of them"]
    if profiles := list(_profile_rows(estimate)):
        yield ["95 % intervals that follow the likelihood (profiles)", *align_columns(profiles)]
    if len(estimate.diagnosis) > 1:
        causes = [(cause.description, f"{cause.gain:.3g}") for cause in estimate.diagnosis[:_CAUSES]]
        yield table([("what is left would be explained by", "gain"), *causes])
    title, asked, second = estimate.second_answer
    if second:
        yield [title, *(f"  {line}" for line in asked), *align_columns(second)]
    yield map(remark_lines, estimate.findings)


def _noise_rows(estimate: Estimate) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("noise", "deviation", "signal/noise")]
    for name, noise in estimate.noise.items():
        ratio = f"{noise.snr_db:.1f} dB" if isfinite(noise.snr_db) else "no noise"
        rows.append((name, f"{noise.sigma:.3g} {noise.unit}", ratio))
    return rows


def _shapes_lines(estimate: Estimate) -> list[str]:
    """The shapes that moved farthest from what was known of them, in its standard deviations."""
    known = {p.name: (p.start or 0.0, p.sigma) for p in estimate.parameters}

    def moved(shape: CoefficientEstimate) -> float:
        start, sigma = known[shape.name]
        return abs(shape.value - start) / sigma

    shapes = sorted(estimate.shapes, key=moved, reverse=True)
    more = ""
    if len(shapes) > _SHAPES:
        more = (
            f"more, which moved by {moved(shapes[_SHAPES]):.2g} of their standard deviation beforehand or less; the result "
            "folder lists all of them"
        )
    rows = (coefficient_row(shape, shape.name) for shape in shapes)
    return table([COEFFICIENT_HEAD, *rows], "shapes", most=_SHAPES, more=more)


def _profile_rows(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Profile intervals, with a mark on those that differ from the intervals of the standard errors."""
    for name, ends in estimate.profile_intervals.items():
        coefficient = estimate.coefficient(name)
        differs = coefficient.interval is not None and any(
            abs(end - standard) > _DIFFERS * (coefficient.interval[1] - coefficient.value)
            for end, standard in zip(ends, coefficient.interval, strict=True)
        )
        mark = "  differs from the table: trust this one" if differs else ""
        yield name, f"{ends[0]:.6g} to {ends[1]:.6g} {coefficient.unit}{mark}"
