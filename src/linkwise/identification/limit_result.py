"""What a planned test can tell: bounds of coefficients, forces and wells, and the table that says so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.link_estimate import NORMAL_95, CoefficientEstimate, DerivedQuantity, LinkEstimate
from linkwise.html import NotebookView
from linkwise.likelihood.fisher_information import Precision
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.text import align_columns, format_value

DETECTION = 3.605  # deviations: 95 of 100 such effects leave zero outside their 95 % interval (1.960 + 1.645)
_MANY = 40  # rows of a table that anybody reads


@dataclass(frozen=True, eq=False)
class LinkLimit:
    """The precision that a planned test allows for one link.

    Attributes
    ----------
    name : str
        The name of the link.
    nmse : float
        The expected NMSE of its force in %.
    force_error : float
        Root mean square, over the motion, of the standard deviation of its force at rest, in N.
    estimate : LinkEstimate
        Coefficients, wells, barrier and in-well frequencies with the intervals that an estimate at the bound would have.

    References
    ----------
    The paper, Eq. 8, for the NMSE.
    """

    name: str
    nmse: float
    force_error: float
    estimate: LinkEstimate

    @property
    def detectable(self) -> float:
        """The force in N that would be told from none in 95 of 100 such tests."""
        return DETECTION * self.force_error


@dataclass(frozen=True, eq=False)
class Limit(NotebookView):
    """The smallest standard errors of `parameters` (p,), whose true `values` are (p,), in a test that is planned.

    `record` is that test without noise, `noise` the standard deviation in each of its channels in SI units. The bound is that
    of estimates that look at `segment` seconds at a time, each with a free start, all with the same laws; a fit that links
    segments may come out somewhat below. `findings` says in words what the sensors cannot tell.
    """

    structure: Structure
    parameters: tuple[Parameter, ...]
    values: Floats
    precision: Precision
    noise: Mapping[str, float]
    record: Record
    segment: float

    @cached_property
    def standard_errors(self) -> Floats:
        """(p,) in SI units; infinite where the sensors cannot tell."""
        return np.asarray(np.sqrt(self.precision.variance(np.eye(len(self.values)))))

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) over what is told; infinite rows and columns where a parameter is not."""
        covariance = self.precision.root @ self.precision.root.T
        blind = np.isinf(self.standard_errors)
        covariance[blind, :] = covariance[:, blind] = np.inf
        return np.asarray(covariance)

    @property
    def coefficients(self) -> tuple[CoefficientEstimate, ...]:
        """Each unknown with its true value and, where it is told, the interval around it that an estimate could have."""
        return tuple(
            _coefficient(parameter.name, parameter.unit, float(value), float(error))
            for parameter, value, error in zip(
                self.parameters, self.values, self.standard_errors, strict=True
            )
        )

    def coefficient(self, name: str) -> CoefficientEstimate:
        """The unknown "nes1.alpha" or "m1.mass"; IdentificationError lists those there are."""
        found = {each.name: each for each in self.coefficients}
        if name not in found:
            raise IdentificationError(f'"{name}" is no unknown of this test; they are {", ".join(found)}')
        return found[name]

    def force_deviation(self, name: str, d: ArrayLike) -> Floats:
        """Standard deviation in N of the force at rest of link `name` at elongations `d` in m, in the shape of `d`."""
        d = np.asarray(d, dtype=float)
        link = self.structure.link(name)
        slopes = link.law.partials(d, 0.0, link.values).by_coefficient
        gradient = np.zeros((*d.shape, len(self.values)))
        index = self.structure.links.index(link)
        for column, parameter in enumerate(self.parameters):
            for member, key in parameter.members:
                if member == index:
                    gradient[..., column] += slopes[key]
        return np.asarray(np.sqrt(self.precision.variance(gradient)))

    @cached_property
    def links(self) -> tuple[LinkLimit, ...]:
        """What can be told of each link with something unknown in it."""
        concerned = {index for parameter in self.parameters for index, _ in parameter.members}
        return tuple(self._link(index) for index in sorted(concerned) if index >= 0)

    def link(self, name: str) -> LinkLimit:
        """What can be told of one link; IdentificationError lists those there are."""
        found = {each.name: each for each in self.links}
        if name not in found:
            raise IdentificationError(
                f'nothing is unknown in a link "{name}" of this test; there are {", ".join(found)}'
            )
        return found[name]

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the sensors cannot tell; empty where they tell everything."""
        told = []
        for group in self.precision.confounded:
            names = [self.parameters[i].name for i in group]
            told.append(
                f"{names[0]} leaves no trace in these sensors: this test cannot tell it at all."
                if len(names) == 1
                else f"{', '.join(names[:-1])} and {names[-1]} are seen only together: these sensors cannot tell one from the "
                "other. Give one of them as known, or add a sensor or a force that moves them differently."
            )
        return tuple(told)

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is infinite becomes null in JSON."""
        return {
            "segment": self.segment,
            "samples": len(self.record) * len(self.record.responses),
            "noise": dict(self.noise),
            "coefficients": {each.name: _as_dict(each) for each in self.coefficients},
            "links": {
                each.name: {
                    "nmse_percent": each.nmse,
                    "force_error": each.force_error,
                    "detectable": each.detectable,
                    "wells": [list(well.interval or (well.value,) * 2) for well in each.estimate.wells],
                    "barrier": None
                    if each.estimate.barrier is None
                    else list(each.estimate.barrier.interval or ()),
                }
                for each in self.links
            },
            "findings": list(self.findings),
        }

    def __str__(self) -> str:
        return _table(self)

    def _link(self, index: int) -> LinkLimit:
        link = self.structure.links[index]
        truth = self.record.simulated
        assert truth is not None
        d = self.structure.elongations(truth.displacement, truth.base)[:, index]
        force, deviation = link.force(d), self.force_deviation(link.name, d)
        power, mean = float(np.var(force)), float(np.mean(deviation**2))
        with np.errstate(divide="ignore"):
            nmse = float(100.0 * np.divide(mean, power)) if mean > 0.0 else 0.0
        return LinkLimit(link.name, nmse, float(np.sqrt(mean)), self._estimate(index, d))

    def _estimate(self, index: int, d: Floats) -> LinkEstimate:
        link, truth = self.structure.links[index], self.record.simulated
        assert truth is not None
        rate = np.gradient(d, self.record.step)
        places = {
            key: column
            for column, parameter in enumerate(self.parameters)
            for member, key in parameter.members
            if member == index
        }
        free = tuple(key for key in link.coefficients if key in places)
        which = [places[key] for key in free]
        block = self.covariance[np.ix_(which, which)]
        errors = self.standard_errors
        masses = dict(zip(self.structure.mass_names, self.structure.mass_values, strict=True))
        return LinkEstimate(
            link=link,
            coefficients=tuple(
                _coefficient(
                    f"{link.name}.{key}", link.law.units[key], link.values[key], float(errors[places[key]])
                )
                for key in free
            ),
            d_range=(float(d.min()), float(d.max())),
            v_range=(float(rate.min()), float(rate.max())),
            free=free,
            covariance=block if np.isfinite(block).all() else None,
            moving_mass=1.0 / sum(1.0 / masses[end] for end in link.between if end in masses),
        )


def _coefficient(name: str, unit: str, value: float, error: float) -> CoefficientEstimate:
    half = NORMAL_95 * error
    interval = (value - half, value + half) if np.isfinite(error) else None
    return CoefficientEstimate(name, value, unit, False, error, interval)


def _as_dict(each: CoefficientEstimate) -> dict[str, Any]:
    error = each.standard_error
    assert error is not None
    return {
        "value": each.value,
        "unit": each.unit,
        "standard_error": error,
        "relative_percent": 100.0 * error / abs(each.value) if each.value else None,
        "detectable": DETECTION * error,
    }


def _table(limit: Limit) -> str:
    """The whole answer as text."""
    head = (
        f"{limit.structure.name or 'structure'}: the best that this test can tell\n"
        f"{len(limit.record)} samples each of {_listed(list(limit.noise))} at {limit.record.rate:g} Hz, in segments of "
        f"{limit.segment:g} s with free starts;\na fit that links segments may come out somewhat better."
    )
    noise: list[tuple[str, ...]] = [
        ("noise", "deviation"),
        *((name, _noise_text(limit, name)) for name in limit.noise),
    ]
    title = ("coefficient", "value", "std. error", "relative", "smallest seen", "unit")
    forces = [(each.name, _percent(each.nmse), _force(each.detectable), "") for each in limit.links]
    blocks = [
        head,
        _rows(noise),
        _rows([title, *(_row(each) for each in limit.coefficients)]),
        _rows([("force of", "expected NMSE", "smallest seen", ""), *forces]),
    ]
    wells = [row for link in limit.links for row in _wells(link)]
    if wells:
        blocks.append(_rows([("", "value", "95 % interval", "unit"), *wells]))
    if limit.findings:
        blocks.append("\n".join(f"! {finding}" for finding in limit.findings))
    return "\n\n".join(blocks)


def _rows(rows: list[tuple[str, ...]]) -> str:
    lines = align_columns(rows)
    left_out = len(lines) - 1 - _MANY
    if left_out > 0:
        lines = [*lines[: 1 + _MANY], f"  ... and {left_out} more"]
    return "\n".join(lines)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])}, ..., {names[-1]}"


def _noise_text(limit: Limit, name: str) -> str:
    return f"{limit.noise[name]:.3g} {limit.record.unit(name)}"


def _row(each: CoefficientEstimate) -> tuple[str, ...]:
    error = each.standard_error
    assert error is not None
    if not np.isfinite(error):
        return each.name, format_value(each.value), "cannot be told", "", "", each.unit
    share = _percent(100.0 * error / abs(each.value)) if each.value else ""
    return each.name, format_value(each.value), f"{error:.2g}", share, f"{DETECTION * error:.2g}", each.unit


def _percent(share: float) -> str:
    return f"{share:.2g} %" if np.isfinite(share) else "cannot be told"


def _force(newtons: float) -> str:
    return f"{newtons:.2g} N" if np.isfinite(newtons) else "cannot be told"


def _wells(link: LinkLimit) -> list[tuple[str, ...]]:
    """Rows of the wells and the barrier of a link that has them."""
    found = link.estimate
    named = [(f"{link.name} well {i}", well) for i, well in enumerate(found.wells, start=1)]
    named += [(f"{link.name} barrier", found.barrier)] if found.barrier is not None else []
    return [_derived(label, each) for label, each in named]


def _derived(label: str, each: DerivedQuantity) -> tuple[str, ...]:
    if each.interval is None:
        return label, format_value(each.value), "cannot be told", each.unit
    error = 0.25 * (each.interval[1] - each.interval[0])
    low, high = (format_value(end, error) for end in each.interval)
    return label, format_value(each.value, error), f"{low} to {high}", each.unit
