"""The estimate of one link: its coefficients, its motion, and the wells, barrier and frequencies that follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from linkwise.analysis.potential_wells import escape_energy, law_kind, lowest_escape, wells
from linkwise.arrays import Floats
from linkwise.display import NotebookView, align_columns, format_both, format_error, format_value
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient, Name
from linkwise.model.structure import Link, Structure
from linkwise.records.record import Record

T = TypeVar("T")

NORMAL_95 = 1.959963984540054  # standard deviations: 97.5 % quantile of the normal distribution
_RATES = 3  # states of a link whose rates are printed; the result folder has all
COEFFICIENT_HEAD = ("", "value", "std. error", "95 % interval", "unit")
_STEP = 1e-2  # of a standard error: small against the curvature of derived quantities, large against rounding
_BEYOND = 0.25  # of the visited range: wells farther outside are not searched for


@dataclass(frozen=True)
class CoefficientEstimate:
    """Estimate of a coefficient of a link or of a mass.

    Attributes
    ----------
    name : Name
        Full name, such as "nes1.alpha" or "m1.mass".
    value : float
        Its value in the SI unit.
    unit : str
        The unit.
    known : bool
        True where it was given and not estimated.
    standard_error : float or None
        Standard error; None for known ones and where none can be trusted.
    interval : tuple of float or None
        Ends of the 95 % interval; None likewise.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> alpha = estimate.coefficient("nes1.alpha")
    >>> alpha.known, alpha.unit
    (False, 'N/m')
    """

    name: Name
    value: float
    unit: str
    known: bool
    standard_error: float | None = None
    interval: tuple[float, float] | None = None

    def __str__(self) -> str:
        if self.standard_error is None:
            return f"{self.name} = {self.value:.6g} {self.unit}, {'given' if self.known else 'no standard error'}"
        value, error = format_both(self.value, self.standard_error)
        return f"{self.name} = {value} {self.unit}, standard error {error}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self}>"


@dataclass(frozen=True)
class DerivedQuantity:
    """A quantity that follows from coefficients.

    Attributes
    ----------
    name : str
        "well", "barrier" or "frequency".
    value : float
        Its value in the SI unit.
    unit : str
        The unit.
    interval : tuple of float or None
        Ends of the 95 % interval by the delta method; None where none can be trusted.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> barrier = estimate.link("nes1").barrier
    >>> barrier.name, barrier.unit
    ('barrier', 'J')
    """

    name: str
    value: float
    unit: str
    interval: tuple[float, float] | None

    @property
    def texts(self) -> tuple[str, str]:
        """The value and its interval to the digits that the interval gives; empty where there is none."""
        if self.interval is None:
            return format_value(self.value), ""
        error = 0.25 * (self.interval[1] - self.interval[0])
        return format_value(self.value, error), " to ".join(format_value(end, error) for end in self.interval)


def coefficient_row(coefficient: CoefficientEstimate, label: str) -> tuple[str, ...]:
    """The cells under `COEFFICIENT_HEAD`."""
    error, unit = coefficient.standard_error, coefficient.unit
    if coefficient.known or error is None:
        return label, format_value(coefficient.value), "given" if coefficient.known else "none", "", unit
    ends = coefficient.interval
    interval = "none" if ends is None else " to ".join(format_value(end, error) for end in ends)
    return label, format_value(coefficient.value, error), format_error(error), interval, unit


def _derived_row(quantity: DerivedQuantity, label: str) -> tuple[str, ...]:
    value, interval = quantity.texts
    return label, value, "", interval, quantity.unit


@dataclass(frozen=True, eq=False, repr=False)
class LinkEstimate(NotebookView):
    """Estimate of one link.

    Attributes
    ----------
    link : Link
        The identified link, all coefficients numbers.
    coefficients : tuple of CoefficientEstimate
        Its coefficients.
    d_range, v_range : tuple of float
        Ranges of the elongation in m and its rate in m/s in the record.
    free : tuple of str
        Names of the q unknown coefficients.
    covariance : array of shape (q, q) or None
        Their covariance; None where no interval can be trusted.
    moving_mass : float
        Reduced mass of the two ends in kg, which sets the in-well frequencies.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> link = estimate.link("nes1")
    >>> link.kind, link.free
    ('bistable', ('alpha', 'beta', 'c'))
    """

    link: Link
    coefficients: tuple[CoefficientEstimate, ...]
    d_range: tuple[float, float]
    v_range: tuple[float, float]
    free: tuple[str, ...]
    covariance: Floats | None
    moving_mass: float

    def __str__(self) -> str:
        rows = [coefficient_row(coefficient, coefficient.name.key) for coefficient in self.coefficients]
        rows += [_derived_row(well, f"well {i}") for i, well in enumerate(self.wells, start=1)]
        if self.barrier is not None:
            rows.append(_derived_row(self.barrier, "barrier"))
        rows += [_derived_row(one, f"frequency {i}") for i, one in enumerate(self.frequencies, start=1)]
        head = f"{self.link.name} ({' - '.join(self.link.between)}): {self.link.law.text}"
        d_low, d_high, v_low, v_high = (f"{end:.4g}" for end in (*self.d_range, *self.v_range))
        of_d, of_v = self.link.law.motion_units
        visited = f"range: d {d_low} to {d_high} {of_d}, v {v_low} to {v_high} {of_v}"
        rates = [f"  {rate}" for rate in self.link.rate_texts[:_RATES]]
        if len(self.link.rate_texts) > _RATES:
            rates.append(f"  ... and {len(self.link.rate_texts) - _RATES} more states")
        return "\n".join([head, *rates, *align_columns([COEFFICIENT_HEAD, *rows]), f"  {visited}"])

    def force_band(self, d: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Stiffness force (v = 0) with its 95 % band by the delta method.

        Parameters
        ----------
        d : array_like
            Elongations in m.

        Returns
        -------
        force, lower, upper : array of the shape of `d`
            Force and ends of the band in N. Both ends are NaN without a covariance, and equal to the force where nothing is
            unknown.
        """
        d = np.asarray(d, dtype=float)
        force = self.link.force(d, 0.0, self.link.zero_states)
        slopes = self.link.law.partials(d, 0.0, {**self.link.values, **self.link.zero_states}).by_coefficient
        gradient = np.array([np.broadcast_to(slopes[name], d.shape) for name in self.free])
        half = NORMAL_95 * self.deviation(gradient.reshape(len(self.free), *d.shape))
        return force, force - half, force + half

    def deviation(self, gradient: Floats) -> Floats:
        """The standard deviation of quantities that follow from the unknown coefficients, by the delta method.

        Parameters
        ----------
        gradient : array of shape (q, ...)
            Their derivatives by these coefficients.

        Returns
        -------
        array of shape (...)
            The standard deviations, 0 where nothing is unknown, NaN without a covariance.
        """
        if self.covariance is None:
            return np.full(gradient.shape[1:], np.nan if self.free else 0.0)
        variance = np.einsum("i...,ij,j...->...", gradient, self.covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @cached_property
    def kind(self) -> str:
        """Kind of the law over the visited range, such as "hardening"."""
        return law_kind(self.link, self._reach[1])

    @cached_property
    def wells(self) -> tuple[DerivedQuantity, ...]:
        """Stable equilibria in m of a law with two wells or more; empty for others."""
        positions, unit = self._searched(wells) or (), self.link.law.motion_units[0]
        derived = (self._derived("well", unit, value, partial(_well_near, value)) for value in positions)
        return tuple(derived) if len(positions) > 1 else ()

    @cached_property
    def barrier(self) -> DerivedQuantity | None:
        """Energy in J to leave the deepest well; None with fewer than two wells."""
        ends = self._searched(lowest_escape)
        of = partial(escape_energy, ends or (0.0, 0.0))
        return self._derived("barrier", "J", of(self.link), of) if ends else None

    @cached_property
    def frequencies(self) -> tuple[DerivedQuantity, ...]:
        """Natural frequencies in Hz of small oscillations of the two ends of the free link in each well; none on a rig."""
        if not np.isfinite(self.moving_mass):
            return ()
        frequencies = [partial(_frequency_near, well.value, self.moving_mass) for well in self.wells]
        return tuple(self._derived("frequency", "Hz", of(self.link), of) for of in frequencies)

    @property
    def _reach(self) -> tuple[float, float]:
        """Range in m in which wells are searched for: symmetric, a quarter wider than the visited range."""
        largest = max(abs(end) for end in self.d_range) * (1.0 + _BEYOND)
        return -largest, largest

    def _searched(self, search: Callable[[Link, float, float], T]) -> T | None:
        """Result of a search within `_reach`; None for a law that vanishes everywhere."""
        try:
            return search(self.link, *self._reach)
        except StructureError:
            return None

    def _derived(self, name: str, unit: str, value: float, of: Callable[[Link], float]) -> DerivedQuantity:
        """A derived quantity by the delta method, with a gradient by central differences."""
        gradient = np.zeros(len(self.free))
        variances = np.zeros(len(self.free)) if self.covariance is None else self.covariance.diagonal()
        for i, step in enumerate((_STEP * np.sqrt(np.maximum(variances, 0.0))).tolist()):
            if step > 0.0:
                sides = [of(self._perturbed(self.free[i], sign * step)) for sign in (1.0, -1.0)]
                gradient[i] = (sides[0] - sides[1]) / (2.0 * step)
        half = NORMAL_95 * float(self.deviation(gradient))
        return DerivedQuantity(name, value, unit, (value - half, value + half) if np.isfinite(half) else None)

    def _perturbed(self, coefficient: str, step: float) -> Link:
        perturbed = Coefficient.number(self.link.values[coefficient] + step)
        return replace(self.link, coefficients={**self.link.coefficients, coefficient: perturbed})


def _well_near(position: float, link: Link) -> float:
    """The well near `position` after a small change of the coefficients: one Newton step."""
    stiffness, force = float(link.stiffness(position)), float(link.force(position, 0.0, link.zero_states))
    return position - force / stiffness if stiffness > 0.0 else np.nan


def _frequency_near(position: float, mass: float, link: Link) -> float:
    """Frequency in Hz of small oscillations of a mass in kg in the well near `position`."""
    stiffness = float(link.stiffness(_well_near(position, link)))
    return float(np.sqrt(stiffness / mass) / (2.0 * np.pi)) if stiffness > 0.0 else np.nan


def moving_mass(structure: Structure, index: int) -> float:
    """Mass in kg that vibrates where a link alone joins what it joins, beside a host that is held; infinite on a rig."""
    masses, column = structure.mass_values, structure.topology.columns[index]
    bodies = [(mass, part) for mass, part in column if structure.mass_names[mass] not in structure.modes]
    mobility = sum(part**2 / float(masses[mass]) for mass, part in bodies or column)
    return 1.0 / mobility if mobility else np.inf


def true_motion(record: Record, index: int) -> tuple[Floats, Floats]:
    """Elongations (N,) m and rates (N,) m/s of a link, number `index` of what was simulated, along its motion in a record."""
    truth = record.simulated
    assert truth is not None
    base_rate = None if truth.base is None else np.gradient(truth.base, record.step)
    d = truth.structure.elongations(truth.displacement, truth.base)[:, index]
    return d, truth.structure.elongations(truth.velocity, base_rate)[:, index]


_DENSE = 64  # masses up to which all link forces are solved for at once
_DETERMINED = 1e-9  # relative singular value of the incidence below which link forces are not determined


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the L links of an identified structure at R times.

    Attributes
    ----------
    structure : Structure
        The identified structure.
    time : array of shape (R,)
        Times in s.
    d, v : array of shape (R, L)
        Elongations in m and rates in m/s.
    d_range : array of shape (L, 2)
        Smallest and largest elongation in m; may be wider than the range of a smoothed `d`.
    compute_residual : callable
        Computes the residuals M a + B f - w of the masses, shape (R, n), in N: NaN where not measured, None for no mass.
    identified_force : array of shape (R, L), optional
        Forces of the identified links in N, with the states of those with memory; None where they are not known.
    measured_force : array of shape (R, L), optional
        Forces in N that load cells showed, less their offsets; NaN for links without.
    residuals : mapping of str to array of shape (R,), optional
        What the fit leaves of each response, in standard deviations of its noise; NaN where a sample is missing. None by
        methods that do not fit the samples.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> motion = estimate.motion
    >>> motion.d.shape == motion.v.shape
    True
    """

    structure: Structure
    time: Floats
    d: Floats
    v: Floats
    d_range: Floats
    compute_residual: Callable[[], Floats | None]
    identified_force: Floats | None = None
    measured_force: Floats | None = None
    residuals: Mapping[str, Floats] | None = None

    def __repr__(self) -> str:
        return f"<LinkMotion of {self.structure.name}: {len(self.time)} samples>"

    @cached_property
    def force(self) -> Floats | None:
        """(R, L) measured forces of the links in N: the identified forces less their shares of the residuals.

        The residuals are those of smoothed equations, so smoothing does not bias the sum. NaN where the masses do not
        determine a force; None where they determine none, as with closed loops of links or masses without a sensor.
        """
        if self.measured_force is not None:
            return self.measured_force
        residual = self.compute_residual()
        if residual is None:
            return None
        incidence = self.structure.incidence
        share = np.full(self.d.shape, np.nan)
        solvable = 0 < self.structure.size <= _DENSE and not np.isnan(residual).any()
        if solvable and np.linalg.matrix_rank(incidence.toarray(), rtol=_DETERMINED) == incidence.shape[1]:
            share = np.linalg.lstsq(incidence.toarray(), residual.T)[0].T
        else:
            rows = incidence.tocsr()
            for mass in np.flatnonzero(np.diff(rows.indptr) == 1):
                entry = rows.indptr[mass]
                share[:, rows.indices[entry]] = rows.data[entry] * residual[:, mass]
        if np.isnan(share).all():
            return None
        links = self.structure.links
        identified = [link.force(self.d[:, i], self.v[:, i]) for i, link in enumerate(links)]
        return np.asarray(np.stack(identified, axis=1) - share)


def forces_with_memory(
    structure: Structure,
    motion: tuple[Floats, Floats],
    states: Iterable[tuple[tuple[int, str], Floats]],
    signals: Mapping[str, Floats],
) -> Floats | None:
    """(N, L) forces in N of links with memory or signals along elongations and rates (N, L), NaN for others; None without any.

    `states` (N,) have the number of their link and their name.
    """
    beside = [number for number, link in enumerate(structure.links) if not link.law.is_plain]
    if not beside:
        return None
    (d, v), of_states = motion, list(states)
    forces = np.full(d.shape, np.nan)
    for number in beside:
        inside = {name: state for (owner, name), state in of_states if owner == number} | dict(signals)
        forces[:, number] = structure.links[number].force(d[:, number], v[:, number], inside)
    return forces


def extremes(d: Floats, deviation: Floats | float = 0.0) -> Floats:
    """Smallest and largest elongation (L, 2) in m of `d` (N, L), narrowed at both ends by two standard deviations of the
    noise (L,).
    """
    low, high = np.nanmin(d, axis=0), np.nanmax(d, axis=0)
    inward = np.minimum(2.0 * np.asarray(deviation), 0.5 * (high - low))
    return np.stack([low + inward, high - inward], axis=1)
