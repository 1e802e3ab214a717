"""The answer: what every estimator returns, and the table that tells whether it can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array

from linkwise.arrays import Bools, Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.errors import StructureError
from linkwise.estimates.energy_supply import supplied_power
from linkwise.estimates.findings import link_findings
from linkwise.estimates.link_estimate import NORMAL_95, CoefficientEstimate, DerivedQuantity, LinkEstimate
from linkwise.estimates.link_motion import LinkMotion
from linkwise.html import JudgedView
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.text import as_text
from linkwise.verdict import Verdict, is_trusted, status_of

_ROUNDING = 1e-9  # of a coefficient: a negative variance smaller than the square of it is zero


@dataclass(frozen=True)
class NoiseEstimate:
    """Standard deviation of the noise in a channel, in its SI `unit`, and the signal-to-noise ratio in dB (METHODS 2)."""

    sigma: float
    unit: str
    snr_db: float

    @classmethod
    def of(cls, record: Record, name: str, sigma: float) -> NoiseEstimate:
        """For channel `name` of `record`, whose samples hold noise of `sigma`."""
        return cls.beside(float(np.nanmean(record.channel(name) ** 2)), name, sigma)

    @classmethod
    def beside(cls, power: float, name: str, sigma: float) -> NoiseEstimate:
        """For channel `name`, whose samples have the mean square `power` and hold noise of `sigma`."""
        motion = power - sigma**2
        ratio = (
            10.0 * np.log10(motion / sigma**2)
            if sigma > 0.0 and motion > 0.0
            else (np.inf if sigma == 0.0 else -np.inf)
        )
        return cls(float(sigma), Channel.parse(name).unit, float(ratio))


@dataclass(frozen=True, eq=False)
class Estimate(JudgedView):
    """Values `values` (p,) of the unknowns `parameters` of `given_structure`, with their `covariance` (p, p), from `record`.

    `fit_verdicts` are what can be said of the fit as a whole, and `message` says what the first of them means here; without
    convergence, or with residuals that noise does not explain (`chi_square_per_sample` far from 1), no interval is given.
    `compute_motion` tells, when asked, how the identified links moved; `profile` gives, for a likelihood fit, the
    profile-likelihood interval of a parameter, from its name, its standard error and a function that is told each value
    tried. `free` (p,) is False where a parameter was stopped by its bound, which leaves it without an interval; `intervals`
    is False for methods whose covariance tells no more than the size of the residuals. `notes` are those of the records: what
    was assumed or changed before anything was estimated.
    """

    method: str
    fit_verdicts: tuple[Verdict, ...]
    message: str
    seconds: float
    given_structure: Structure
    parameters: tuple[Parameter, ...]
    values: Floats
    covariance: Floats | csc_array
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

    asked = DeprecatedAttribute(Deprecated("given_structure", since="0.2.0", until="0.4.0"))
    moved = DeprecatedAttribute(Deprecated("compute_motion", since="0.2.0", until="0.4.0"))

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What can be said of the answer as a whole: of the fit, and of the laws that it found."""
        laws = (
            (Verdict.COVARIANCE_NOT_POSITIVE, self._has_negative_variance),
            (Verdict.ENERGY_FED, bool(self.supplies)),
        )
        return (*self.fit_verdicts, *(verdict for verdict, holds in laws if holds))

    @property
    def _has_negative_variance(self) -> bool:
        """Whether a variance is negative beyond the rounding of its coefficient."""
        if not (self.intervals and is_trusted(self.fit_verdicts)):
            return False
        variance = self.covariance.diagonal()[self.free]
        return bool(np.any(~(variance >= -((_ROUNDING * self.values[self.free]) ** 2))))

    @cached_property
    def supplies(self) -> dict[str, float]:
        """Mean power in W of the links that give energy to the motion beyond doubt; empty where intervals say nothing."""
        if not (self.intervals and is_trusted(self.fit_verdicts)):
            return {}
        powers = {
            link.name: supplied_power(
                link, *self._freedom(index), self.motion.d[:, index], self.motion.v[:, index]
            )
            for index, link in enumerate(self.structure.links)
            if self._freedom(index)[0]
        }
        return {name: power for name, power in powers.items() if power is not None}

    @property
    def explanation(self) -> str:
        """`message`, and the advice of verdicts on the laws found."""
        return " ".join([self.message, *(v.value for v in self.verdicts if v not in self.fit_verdicts)])

    @property
    def status(self) -> str:
        """ "converged", or the first verdict that forbids trust: "not converged", "chi-square off", "forces unexplained"."""
        return status_of(self.verdicts)

    @cached_property
    def motion(self) -> LinkMotion:
        """How the identified links moved."""
        return self.compute_motion()

    @cached_property
    def structure(self) -> Structure:
        """The identified structure: every coefficient a number."""
        return self.motion.structure

    @cached_property
    def links(self) -> tuple[LinkEstimate, ...]:
        """What was found of every link, in the structure's order."""
        return tuple(self._link(index) for index in range(len(self.structure.links)))

    @cached_property
    def masses(self) -> tuple[CoefficientEstimate, ...]:
        """The masses, "m1.mass" and so on."""
        return tuple(
            self._coefficient(f"{mass.name}.mass", (-1 - index, "mass"), "kg", mass.mass.value or 0.0)
            for index, mass in enumerate(self.structure.masses)
        )

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the record cannot determine; empty where there is nothing to say."""
        stopped = [
            parameter.name for parameter, free in zip(self.parameters, self.free, strict=True) if not free
        ]
        bounds = tuple(
            f"{name} was stopped by its bound and has no interval; widen the bound if it is not physical."
            for name in stopped
        )
        supplies = self.supplies
        of_links = (line for link in self.links for line in link_findings(link, supplies.get(link.link.name)))
        return (*self.remarks, *bounds, *of_links)

    def coefficient(self, name: str) -> CoefficientEstimate:
        """The coefficient "nes1.alpha" or the mass "m1.mass"; StructureError lists the names there are."""
        return (
            self._coefficients[name]
            if name in self._coefficients
            else self._unknown_name(name, self._coefficients)
        )

    def link(self, name: str) -> LinkEstimate:
        """What was found of one link; StructureError lists the names there are."""
        found = {each.link.name: each for each in self.links}
        return found[name] if name in found else self._unknown_name(name, found)

    def force_band(self, name: str, d: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Force at rest of link `name` at elongations `d` in m, and the lower and upper end of its 95 % band, in N."""
        return self.link(name).force_band(d)

    def to_dict(self) -> dict[str, Any]:
        """What result.json holds."""
        fit = {"chi_square_per_sample": self.chi_square_per_sample, "samples": self.samples}
        return {
            "method": self.method,
            "status": self.status,
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
            "message": self.explanation,
            "seconds": self.seconds,
            "noise": {
                name: {"sigma": n.sigma, "unit": n.unit, "snr_db": n.snr_db} for name, n in self.noise.items()
            },
            "fit": fit,
            "findings": list(self.findings),
            "notes": list(self.notes),
            "masses": {each.name.removesuffix(".mass"): _as_dict(each) for each in self.masses},
            "links": [_link_dict(each) for each in self.links],
        }

    def __str__(self) -> str:
        return as_text(self)

    @cached_property
    def _coefficients(self) -> dict[str, CoefficientEstimate]:
        return {
            each.name: each for each in (*(c for link in self.links for c in link.coefficients), *self.masses)
        }

    @cached_property
    def _places(self) -> dict[tuple[int, str], int]:
        return {
            member: number for number, parameter in enumerate(self.parameters) for member in parameter.members
        }

    def _coefficient(self, name: str, place: tuple[int, str], unit: str, value: float) -> CoefficientEstimate:
        number = self._places.get(place)
        if number is None:
            return CoefficientEstimate(name, value, unit, known=True)
        if not self.trusted or not self.free[number]:
            return CoefficientEstimate(name, value, unit, known=False)
        error = float(np.sqrt(max(self.covariance[number, number], 0.0)))
        if not self.intervals:
            return CoefficientEstimate(name, value, unit, False, error)
        half = NORMAL_95 * error
        return CoefficientEstimate(name, value, unit, False, error, (value - half, value + half))

    def _link(self, index: int) -> LinkEstimate:
        link = self.structure.links[index]
        free, covariance = self._freedom(index)
        masses = dict(zip(self.structure.mass_names, self.structure.mass_values, strict=True))
        return LinkEstimate(
            link=link,
            coefficients=tuple(
                self._coefficient(
                    f"{link.name}.{name}", (index, name), link.law.units[name], link.values[name]
                )
                for name in link.coefficients
            ),
            d_range=(float(self.motion.d_range[index, 0]), float(self.motion.d_range[index, 1])),
            v_range=_range(self.motion.v[:, index]),
            free=free,
            covariance=covariance if self.trusted and self.intervals else None,
            moving_mass=1.0 / sum(1.0 / masses[end] for end in link.between if end in masses),
        )

    def _freedom(self, index: int) -> tuple[tuple[str, ...], Floats]:
        """The coefficients of a link that were found (q,), and their covariance (q, q)."""
        numbers = {
            name: self._places[index, name]
            for name in self.given_structure.links[index].coefficients
            if (index, name) in self._places
        }
        which = np.array(list(numbers.values()), dtype=int)
        block = self.covariance[np.ix_(which, which)] if len(which) else np.zeros((0, 0))
        return tuple(numbers), np.asarray(block if isinstance(block, np.ndarray) else block.toarray())

    def _unknown_name(self, name: str, there: Mapping[str, Any]) -> Any:
        raise StructureError(f'"{name}" is not in the answer; there are {", ".join(there)}')


def _range(values: Floats) -> tuple[float, float]:
    return (float(np.nanmin(values)), float(np.nanmax(values)))


def _as_dict(each: CoefficientEstimate) -> dict[str, Any]:
    shown: dict[str, Any] = {"value": each.value, "unit": each.unit, "known": each.known}
    if not each.known:
        shown["standard_error"] = each.standard_error
        shown["interval"] = None if each.interval is None else list(each.interval)
    return shown


def _derived(each: DerivedQuantity) -> dict[str, Any]:
    return {
        "value": each.value,
        "unit": each.unit,
        "interval": None if each.interval is None else list(each.interval),
    }


def _link_dict(each: LinkEstimate) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "name": each.link.name,
        "between": list(each.link.between),
        "law": each.link.law.text,
        "coefficients": {c.name.rpartition(".")[2]: _as_dict(c) for c in each.coefficients},
        "range": {"d": list(each.d_range), "v": list(each.v_range)},
    }
    if each.wells:
        shown["wells"] = [{"d": well.value, "interval": _derived(well)["interval"]} for well in each.wells]
        shown["in_well_frequencies"] = [_derived(frequency) for frequency in each.frequencies]
    if each.barrier is not None:
        shown["barrier"] = _derived(each.barrier)
    return shown
