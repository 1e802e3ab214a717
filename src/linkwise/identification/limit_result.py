"""The result of `limit`: the smallest errors of coefficients, forces and wells that a planned test allows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.display import JudgedView, enumerated, format_value, listed, table, text_of
from linkwise.errors import IdentificationError
from linkwise.estimates.link_estimate import (
    NORMAL_95,
    CoefficientEstimate,
    LinkEstimate,
    moving_mass,
    true_motion,
)
from linkwise.likelihood.fisher_information import Precision
from linkwise.likelihood.rigs.link_path import LinkPath
from linkwise.model.coefficient import Name
from linkwise.model.link import Link, refuse_signals
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.verdict import UNGRADED, Basis, Verdict

# standard errors: 95 of 100 such effects leave zero outside their 95 % interval (1.960 + 1.645)
DETECTION = 3.605
_MOST_ROWS = 40  # of a table that are printed


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
        Root mean square, over the motion, of the standard deviation of its force at rest, in N; with memory or signals, of
        its force along the motion, from which its states follow.
    estimate : LinkEstimate
        Coefficients, wells, barrier and in-well frequencies with the intervals that an estimate at the bound would have.

    References
    ----------
    The paper, Eq. 8, for the NMSE.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> planned = lw.limit(chain, duration=0.5, rate=1000.0, noise=40.0, unknown=["nes"], release={"v:m1": 1.0})
    >>> nes = planned.link("nes1")
    >>> nes.name, 0.0 < nes.force_error < nes.detectable
    ('nes1', True)
    """

    name: str
    nmse: float
    force_error: float
    estimate: LinkEstimate

    @property
    def detectable(self) -> float:
        """The smallest force in N that 95 of 100 such tests would distinguish from zero."""
        return DETECTION * self.force_error


@dataclass(frozen=True, eq=False, repr=False)
class Limit(JudgedView):
    """The smallest standard errors that a planned test allows, of p unknowns; printed, a table.

    The bound holds for estimates that look at segments of the record, each with a free start and all with the same laws. Of
    one segment it is that of the whole record; a fit that links shorter ones comes out below, in chaotic motion several times.

    Attributes
    ----------
    structure : Structure
        The structure with its expected numbers.
    parameters : tuple of Parameter
        The p unknowns.
    values : (p,) ndarray
        Their expected values in SI units.
    precision : Precision
        Their covariance at the bound, and the combinations of them that leave no trace in the sensors.
    noise : mapping of str to float
        Standard deviation of the noise in each channel, in its SI unit.
    record : Record
        The record of the test without noise.
    segment : float
        Length of the segments in s.
    basis : Basis
        The answer that the structure comes from.

    See Also
    --------
    limit : Plan a test.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> planned = lw.limit(chain, duration=0.5, rate=1000.0, noise=40.0, unknown=["nes"], release={"v:m1": 1.0})
    >>> [parameter.name for parameter in planned.parameters]
    ['nes1.alpha', 'nes1.beta', 'nes1.c']
    >>> planned.standard_errors.shape, planned.findings, planned.trusted
    ((3,), (), True)
    """

    structure: Structure
    parameters: tuple[Parameter, ...]
    values: Floats
    precision: Precision
    noise: Mapping[str, float]
    record: Record
    segment: float
    basis: Basis = UNGRADED

    @cached_property
    def standard_errors(self) -> Floats:
        """The standard errors (p,) in SI units; infinite for what the sensors do not determine."""
        return np.asarray(np.sqrt(self.precision.variance(np.eye(len(self.values)))))

    @cached_property
    def covariance(self) -> Floats:
        """The covariance (p, p) in SI units; rows and columns of what the sensors do not determine are infinite."""
        covariance = self.precision.root @ self.precision.root.T
        undetermined = np.isinf(self.standard_errors)
        covariance[undetermined, :] = covariance[:, undetermined] = np.inf
        return np.asarray(covariance)

    @property
    def coefficients(self) -> tuple[CoefficientEstimate, ...]:
        """The unknowns with their expected values and, where they are identifiable, the intervals at the bound."""
        numbers = zip(self.parameters, self.values.tolist(), self.standard_errors.tolist(), strict=True)
        return tuple(_coefficient(unknown.name, unknown.unit, *sizes) for unknown, *sizes in numbers)

    def coefficient(self, name: str) -> CoefficientEstimate:
        """One unknown with its expected value and, where it is identifiable, its interval at the bound.

        Parameters
        ----------
        name : str
            Its name, such as "nes1.alpha" or "m1.mass".

        Returns
        -------
        CoefficientEstimate
            The unknown, in SI units.

        Raises
        ------
        IdentificationError
            If there is no such unknown; the message lists them.
        """
        named: dict[str, CoefficientEstimate] = {one.name: one for one in self.coefficients}
        if name not in named:
            message = f'"{name}" is not an unknown of this test; choose from {", ".join(named)}'
            raise IdentificationError(message)
        return named[name]

    def force_deviation(self, name: str, d: ArrayLike) -> Floats:
        """The standard deviation of the force of a link at rest (v = 0); with memory, at states of 0.

        Parameters
        ----------
        name : str
            The name of the link.
        d : array_like
            Elongations in m.

        Returns
        -------
        ndarray
            The standard deviation in N, in the shape of `d`; infinite where the sensors do not determine the force.

        Raises
        ------
        StructureError
            If there is no such link, or its law names a signal.
        """
        d = np.asarray(d, dtype=float)
        link = self.structure.link(name)
        refuse_signals([link], "forces at rest", "its `force_error` is that along the motion")
        slopes = link.law.partials(d, 0.0, {**link.values, **link.zero_states}).by_coefficient
        return self._deviation(self.structure.links.index(link), slopes, d.shape)

    def _deviation(self, index: int, slopes: Mapping[str, Floats], shape: tuple[int, ...]) -> Floats:
        """The standard deviation in N of a force with derivatives by the coefficients of a link."""
        gradient = np.zeros((*shape, len(self.values)))
        for column, parameter in enumerate(self.parameters):
            for member, key in parameter.members:
                if member == index:
                    gradient[..., column] += slopes[key]
        return np.asarray(np.sqrt(self.precision.variance(gradient)))

    @cached_property
    def links(self) -> tuple[LinkLimit, ...]:
        """The precision for each link that has an unknown coefficient."""
        unknown = {index for parameter in self.parameters for index, _ in parameter.members}
        return tuple(self._link_limit(index) for index in sorted(unknown) if index >= 0)

    def link(self, name: str) -> LinkLimit:
        """The precision for one link.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        LinkLimit
            What the test allows for it.

        Raises
        ------
        IdentificationError
            If no such link has an unknown coefficient; the message lists those that have.
        """
        links = {link.name: link for link in self.links}
        if name not in links:
            message = f'nothing is unknown in a link "{name}" of this test; choose from {", ".join(links)}'
            raise IdentificationError(message)
        return links[name]

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the sensors determine every unknown."""
        all_determined = not self.precision.confounded and np.isfinite(self.standard_errors).all()
        return (Verdict.UNKNOWNS_DETERMINED if all_determined else Verdict.UNKNOWNS_NOT_DETERMINED,)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the sensors do not determine; empty where they determine everything."""
        sentences = []
        for group in self.precision.confounded:
            names = [self.parameters[i].name for i in group]
            sentence = (
                f"{enumerated(names)} are confounded: these sensors identify a combination of them "
                "only. Give one of them as known, or add a sensor or a force that moves them differently."
            )
            alone = f"{names[0]} has no effect on these sensors: this test cannot identify it."
            sentences.append(alone if len(names) == 1 else sentence)
        return tuple(sentences)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            Coefficients and links by name, noise, verdicts and findings; SI units.
        """
        return {
            **self._judgement(),
            "segment": self.segment,
            "samples": len(self.record) * len(self.record.responses),
            "noise": dict(self.noise),
            "coefficients": {coefficient.name: _as_dict(coefficient) for coefficient in self.coefficients},
            "links": {
                link.name: {
                    "nmse_percent": link.nmse,
                    "force_error": link.force_error,
                    "detectable": link.detectable,
                    "wells": [list(well.interval or (well.value,) * 2) for well in link.estimate.wells],
                    "barrier": None if (top := link.estimate.barrier) is None else list(top.interval or ()),
                }
                for link in self.links
            },
            "findings": list(self.findings),
        }

    def __str__(self) -> str:
        head = (
            f"{self.structure.name or 'structure'}: the accuracy that this test allows\n"
            f"{self.verdicts[0].value}\n"
            f"{len(self.record)} samples each of {listed(list(self.noise))} at {self.record.rate:g} Hz, {_segments_text(self)}"
        )
        sizes = {name: f"{sigma:.3g} {unit_in(self.structure, name)}" for name, sigma in self.noise.items()}
        noise: Rows = [("noise", "deviation"), *((name, size.strip()) for name, size in sizes.items())]
        title = ("coefficient", "value", "std. error", "relative", "detectable", "unit")
        forces = [(link.name, _percent(link.nmse), _detectable(link), "") for link in self.links]
        wells = [row for link in self.links for row in _well_rows(link)]
        tables: list[Rows] = [
            noise,
            [title, *(_coefficient_row(coefficient) for coefficient in self.coefficients)],
            [("force of", "expected NMSE", "detectable", ""), *forces],
            [("", "value", "95 % interval", "unit"), *wells],
        ]
        shown = (table(rows, most=_MOST_ROWS) for rows in tables)
        return text_of([head], *shown, (f"! {finding}" for finding in self.findings))

    def _link_limit(self, index: int) -> LinkLimit:
        link, (d, v) = self.structure.links[index], true_motion(self.record, index)
        if not link.law.is_plain:
            path, names = true_path(link, index, self.record), link.law.coefficients
            force, slopes = path.force(), path.by_unknowns(names)
            deviation = self._deviation(index, dict(zip(names, slopes.T, strict=False)), d.shape)
        else:
            force, deviation = link.force(d), self.force_deviation(link.name, d)
        power, mean = float(np.var(force)), float(np.mean(deviation**2))
        with np.errstate(divide="ignore"):
            nmse = float(100.0 * np.divide(mean, power)) if mean > 0.0 else 0.0
        return LinkLimit(link.name, nmse, float(np.sqrt(mean)), self._link_estimate(index, d, v))

    def _link_estimate(self, index: int, d: Floats, v: Floats) -> LinkEstimate:
        link = self.structure.links[index]
        numbered = enumerate(self.parameters)
        columns = {
            key: n for n, parameter in numbered for member, key in parameter.members if member == index
        }
        free = tuple(key for key in link.coefficients if key in columns)
        selected = [columns[key] for key in free]
        covariance, errors = self.covariance[np.ix_(selected, selected)], self.standard_errors[selected]
        return LinkEstimate(
            link=link,
            coefficients=tuple(
                _coefficient(Name(link.name, key), link.law.units[key], link.values[key], error)
                for key, error in zip(free, errors.tolist(), strict=True)
            ),
            d_range=(float(d.min()), float(d.max())),
            v_range=(float(v.min()), float(v.max())),
            free=free,
            covariance=covariance if np.isfinite(covariance).all() else None,
            moving_mass=moving_mass(self.structure, index),
        )


def true_path(link: Link, index: int, record: Record) -> LinkPath:
    """A link, number `index` of its structure, along the motion of a simulated record."""
    truth, (d, v) = record.simulated, true_motion(record, index)
    assert truth is not None
    states = [truth.states[f"{link.name}.{name}"] for name in link.law.states]
    states += [record.channel(f"signal:{name}") for name in link.law.signals]
    ordered = tuple(link.values[name] for name in link.law.coefficients)
    inside = np.stack(states, axis=1) if states else np.zeros((len(d), 0))
    return LinkPath(link.law, ordered, d, v, record.step, inside, True)


def _coefficient(name: Name, unit: str, value: float, error: float) -> CoefficientEstimate:
    half = NORMAL_95 * error
    interval = (value - half, value + half) if np.isfinite(error) else None
    return CoefficientEstimate(name, value, unit, False, error, interval)


def _as_dict(coefficient: CoefficientEstimate) -> dict[str, Any]:
    error = coefficient.standard_error
    assert error is not None
    return {
        "value": coefficient.value,
        "unit": coefficient.unit,
        "standard_error": error,
        "relative_percent": 100.0 * error / abs(coefficient.value) if coefficient.value else None,
        "detectable": DETECTION * error,
    }


Rows = list[tuple[str, ...]]


def _segments_text(limit: Limit) -> str:
    """What a free start of each segment leaves of the record, in words."""
    if limit.segment * limit.record.rate >= len(limit.record) - 0.5:
        return "in one segment with a\nfree start, as a fit of the whole record has it."
    return (
        f"in segments of {limit.segment:g} s with free starts;\na fit that links segments, as identify does, comes out "
        "better, in chaotic motion several times."
    )


def _coefficient_row(coefficient: CoefficientEstimate) -> tuple[str, ...]:
    error, value = coefficient.standard_error, format_value(coefficient.value)
    assert error is not None
    if not np.isfinite(error):
        return coefficient.name, value, "not identifiable", "", "", coefficient.unit
    relative = _percent(100.0 * error / abs(coefficient.value)) if coefficient.value else ""
    detectable = f"{DETECTION * error:.2g}"
    return coefficient.name, value, f"{error:.2g}", relative, detectable, coefficient.unit


def _percent(share: float) -> str:
    return f"{share:.2g} %" if np.isfinite(share) else "not identifiable"


def _detectable(link: LinkLimit) -> str:
    unit = link.estimate.link.law.force_unit
    return f"{link.detectable:.2g} {unit}" if np.isfinite(link.detectable) else "not identifiable"


def _well_rows(link: LinkLimit) -> Rows:
    """Rows of the wells and the barrier of a link that has them."""
    estimate = link.estimate
    named = [(f"{link.name} well {number}", well) for number, well in enumerate(estimate.wells, start=1)]
    named += [(f"{link.name} barrier", estimate.barrier)] if estimate.barrier is not None else []
    texts = [(label, *quantity.texts, quantity.unit) for label, quantity in named]
    return [(label, value, interval or "not identifiable", unit) for label, value, interval, unit in texts]
