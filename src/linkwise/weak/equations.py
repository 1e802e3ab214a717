"""Weak equations of a structure on a record, without the bias due to noise (METHODS section 4), and their residuals.

`weak_equations` selects the masses that have one, places their windows, and keeps the smoothed motion in the windows. A
`Patch` has the equations of a few neighbouring masses as one small dense system.

For mass i the equation of motion m x'' + sum_l B_il f_l - w = 0, multiplied by a test function phi and integrated over its
window, is a sum of known functions of the record, each multiplied by one number:

    m_i int phi'' x_i  +  sum_l B_il sum_a c_a int kernel_a h_a(d_l)  -  int phi w_i  =  0

The terms of the links (`LawTerms`) come first, those of inertia and applied forces follow. A term enters the equations of the
masses at both ends of its link with opposite signs, and the bias of products of terms (`WeakEquations._bias`; Fuller,
Measurement Error Models, 1987) does not depend on the mass, so a patch of masses needs one set of products.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat

import numpy as np
from scipy.ndimage import maximum_filter1d

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.coefficient import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import BAND_LIMITED, at_samples
from linkwise.records.record import Record
from linkwise.signals.base_frame import frame_acceleration
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.layout import LawTerms, StructureLayout, structure_layout
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2, PatchLayout, WeakLawGroup
from linkwise.weak.window import Window


@dataclass(frozen=True, eq=False)
class Patch:
    """The equations of some masses, one for each window: signs (m, q) times coefficients times rows (q, R) is zero.

    The coefficient of a term is its parameter, if it has one, plus `fixed`.

    Attributes
    ----------
    layout : PatchLayout
        The terms.
    fixed : array of shape (q,)
        Known parts of the coefficients.
    rows : array of shape (q, R)
        The terms in all windows; zero in windows with missing samples.
    products : array of shape (q, q)
        Products of the rows, summed over windows.
    moments : array of shape (q, q)
        The products without the bias due to noise.
    valid : array of shape (R,)
        1 for windows without a missing sample, 0 for others.
    slopes : array of shape (q, K)
        Slopes of the terms with respect to d at the centre of every `WeakEquations.slope_stride`-th window.
    """

    layout: PatchLayout
    fixed: Floats
    rows: Floats
    products: Floats
    moments: Floats
    valid: Floats
    slopes: Floats

    @property
    def windows(self) -> float:
        """Number of valid windows."""
        return float(self.valid.sum())

    def numbers(self, values: Floats) -> Floats:
        """(q,) coefficients of the terms with parameters `values` (p,)."""
        return np.append(values, 0.0)[self.layout.coefficients.parameter] + self.fixed

    def residual(self, values: Floats) -> Floats:
        """(m, R) residuals of the equations with parameters `values` (p,), in units of the rows."""
        return np.asarray((self.layout.signs * self.numbers(values)) @ self.rows)

    def largest(self, numbers: Floats | float = 1.0) -> Floats:
        """(m,) sums of squares of the largest term of each mass, with coefficients `numbers` (q,) or 1."""
        sizes = self.products.diagonal() * np.square(numbers)
        return np.asarray(np.max(np.abs(self.layout.signs) * sizes, axis=1))


@dataclass(frozen=True, eq=False)
class WeakEquations:
    """All weak equations of one record, and the smoothed motion in their windows.

    Attributes
    ----------
    structure_layout : StructureLayout
        Layout of the structure.
    values : array of shape (p,)
        Present values of the parameters; NaN where they have none.
    motion : MeasuredDisplacements
        Displacements and their noise.
    window : Window
        The test functions.
    rate_window : Window
        What smooths the rates that laws act by.
    smooth : array of shape (K, n + 2, R)
        Displacements of masses, base and ground under the kernels.
    filtered : array of shape (K, n + 2, R)
        The same with the acceleration of the coordinates in that of masses that are parameters.
    applied : mapping of int to array of shape (N,)
        Applied forces by mass.
    recorded : mapping of str to array of shape (N,)
        Signals that laws name.
    time : array of shape (R,)
        Centres of the windows in s.
    thinning : int
        Stride in windows of the sums that give the covariance.
    only : collection of int or None
        The masses and modes whose equations are wanted; None for all.
    """

    structure_layout: StructureLayout
    values: Floats
    motion: MeasuredDisplacements
    window: Window
    rate_window: Window
    smooth: Floats
    filtered: Floats
    applied: Mapping[int, Floats]
    recorded: Mapping[str, Floats]
    time: Floats
    thinning: int
    only: Collection[int] | None

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return self.structure_layout.names

    def by_name(self, values: Floats) -> dict[str, float]:
        """Values (p,) of the parameters by their names."""
        return dict(zip(self.parameters, map(float, values), strict=True))

    @property
    def windows(self) -> int:
        """Number of windows R."""
        return len(self.time)

    @cached_property
    def points(self) -> Indices:
        """(P,) the windows next to the points of `Window.adjoint`, over which sums over time go."""
        return self.window.adjoint_windows(self.windows, self.thinning)

    @property
    def inside(self) -> slice:
        """Where the points between the first and the last centre are."""
        return slice(0, len(self.points) - 2 * self.window.half)

    @property
    def slope_stride(self) -> int:
        """Stride in windows of `Patch.slopes`."""
        return _SLOPE_THINNING * self.thinning

    @cached_property
    def displacements(self) -> Floats:
        """(n + 2, R) displacements: averages without bias to third order: that of a curve under phi is biased by half its
        curvature times the second moment of phi.
        """
        time = self.window.step * np.arange(-self.window.half, self.window.half + 1)
        phi, area = self.window.kernels[PHI], self.window.area
        return np.asarray((self.smooth[PHI] - 0.5 * (phi @ time**2 / area) * self.smooth[PHI_2]) / area)

    @cached_property
    def d(self) -> Floats:
        """(E, R) smoothed elongations in m, of links and then of what elements of states read."""
        return self.structure_layout.reading @ self.displacements

    @cached_property
    def v(self) -> Floats:
        """(E, R) their rates in m/s."""
        return np.asarray(self.structure_layout.reading @ -self.smooth[PHI_1] / self.window.area)

    @property
    def states(self) -> Floats:
        """(S, R) smoothed states of links."""
        return self.displacements[self.structure_layout.structure.size : -2]

    @property
    def acceleration(self) -> Floats:
        """(n + S, R) smoothed accelerations in m/s^2 of masses and modes, and second derivatives of states."""
        return self.smooth[PHI_2, :-2] / self.window.area

    @cached_property
    def signals(self) -> dict[str, Floats]:
        """(R,) smoothed signals that laws name."""
        return {name: self.window.sums(signal) / self.window.area for name, signal in self.recorded.items()}

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """The equations; IdentificationError where a parameter lacks a start."""
        patches: list[Patch] = []
        for valid, masses in self.masses_by_windows:
            wanted = [mass for mass in masses if self.only is None or mass in self.only]
            firsts = range(0, len(wanted), _PATCH)
            patches += [self.patch(wanted[first : first + _PATCH], valid) for first in firsts]
        return tuple(patches)

    @cached_property
    def masses_by_windows(self) -> list[tuple[Floats, list[int]]]:
        """Masses whose displacement and those of all their neighbours were measured, with the weights (R,) of their windows.

        Masses in one list lack the same windows, and either each of their equations has a parameter or none has.
        """
        layout = self.structure_layout
        measured = np.append(self.motion.measured, [self.motion.has_channel[-2], True])
        whole = np.ones(len(self.time))
        by_windows: dict[tuple[bytes, bool], tuple[Floats, list[int]]] = {}
        for mass, near in enumerate(layout.neighbourhoods):
            if measured[near].all():
                laws = [layout.elements[number].law for number in np.flatnonzero(layout.action[mass])]
                known = [self.recorded[name] for law in laws for name in law.signals]
                known += [self.applied[mass]] if mass in self.applied else []
                nodes = near[: layout.equations]
                missing = np.any([*self.motion.missing[nodes], *map(np.isnan, known)], axis=0)
                # v is unknown where a window lacks a sample, or leaves the record
                if layout.needs_rate[mass]:
                    missing = maximum_filter1d(missing, self.rate_window.length, mode="constant", cval=True)
                valid = self.window.whole(missing) if missing.any() else whole
                key = valid.tobytes(), bool(layout.has_parameters[mass])
                by_windows.setdefault(key, (valid, []))[1].append(mass)
        return list(by_windows.values())

    @cached_property
    def elongation_variance(self) -> Floats:
        """(L,) variances in m^2 of the noise in the elongations of the links."""
        return self.structure_layout.elongation_variance(self.motion)

    @cached_property
    def floored_elongation_variance(self) -> Floats:
        """(L,) the same, with `MeasuredDisplacements.floored_variance`."""
        return self.structure_layout.elongation_variance(self.motion, floored=True)

    def patch(self, masses: Sequence[int], valid: Floats) -> Patch:
        """The equations of m masses by number, in windows with weights `valid` (R,)."""
        layout = self.structure_layout.layout(masses, (mass for mass in masses if mass in self.applied))
        evaluated, slope = self._evaluated(layout)
        rows = self._rows(layout, evaluated)
        if not valid.all():
            rows *= valid
        products = rows @ rows.T
        present = np.append(self.values, 0.0)[layout.coefficients.parameter]
        return Patch(
            layout=layout,
            fixed=np.where(layout.coefficients.parameter < 0, layout.coefficients.known, 0.0)
            - np.where(layout.increment, present, 0.0),
            rows=rows,
            products=products,
            moments=products - self._bias(layout, evaluated, slope, valid),
            valid=valid,
            slopes=self._slopes(layout, slope, evaluated),
        )

    def _bias(
        self, layout: PatchLayout, evaluated: Sequence[LawTerms], slope: Floats, valid: Floats
    ) -> Floats:
        """(q, q) bias of the products of all terms due to noise, summed over windows of weights `valid` (R,).

        `slope` (q,) are the slopes of terms by d where they are constant, 0 for others.

        Two terms of one equation contain the same noise, so their product is biased even where each of them is unbiased. For
        functions h, g of elongations d, d' whose noises have the covariance c, with unbiased h and g, that of h(d) g(d') at
        one sample is

            c h' g' - c^2/2 h'' g'' + c^3/6 h''' g''' - ...

        and in a window it is the sum of that over its samples, weighted by the product of both kernels. Summed over all
        windows it is the product of two signals, weighted by the sum of the windows at each sample (`Window.coverage`).

        A smoothed rate contains the noise of its elongation under the odd filter that gives the rate. It is in common with
        that of a linear damper in the same window and with that of functions of the same rate, and hardly with terms under
        even test functions. To first order the bias of a product is the covariance of both noises times the slopes of both
        functions, which are taken as constant within a window.
        """
        kernel, kernels, window = layout.kernel, self.window.kernels, self.window
        noise, rate_filter = self.motion.covariance(layout.nodes), self.rate_window.slope[0]
        covariance = layout.incidence @ noise @ layout.incidence.T
        bias = (
            valid.sum() * covariance * np.outer(slope, slope) * (kernels @ kernels.T)[kernel[:, None], kernel]
        )
        by_rate = [(terms, (terms.rate_slope,), 1) for terms in evaluated if terms.rate_slope is not None]
        curved = [
            (terms, terms.derivatives[1:], 0) for terms in evaluated if not isinstance(terms.slope, float)
        ]
        every: list[tuple[LawTerms, Sequence[Floats | float], int]] = [*by_rate, *curved]
        filtered = [kernels]  # by how many of two terms act by a rate
        for taps in (rate_filter, -rate_filter) if by_rate else ():
            filtered.append(np.stack([_correlated(under, taps) for under in filtered[-1]]))
        coverage: dict[tuple[int, int], Floats] = {}
        for number, (first, slopes, rates) in enumerate(every):
            rows, under, samples = first.terms, first.part.kernel, np.shape(slopes[0])[-1]
            for several in (rates, 2 * rates):
                if (under, several) not in coverage:
                    coverage[under, several] = window.coverage(
                        kernels[under] * filtered[several], valid, samples
                    )
            along = (first.part.sign * (slopes[0] @ coverage[under, rates].T))[:, kernel]
            linear = covariance[rows] * along * slope
            bias[rows] += linear
            bias[:, rows] += linear.T
            weighted: dict[tuple[int, int], list[Floats]] = {}
            for other, (second, of_second, also) in enumerate(every[number:]):
                place = rates + also, second.part.kernel
                if place not in weighted:
                    weighted[place] = [h * coverage[under, place[0]][place[1]] for h in slopes]
                mixed = _product_bias(weighted[place], of_second, covariance[rows, second.terms])
                mixed *= first.part.sign * second.part.sign
                bias[rows, second.terms] += mixed
                if other > 0:
                    bias[second.terms, rows] += mixed.T
        return np.asarray(bias)

    def _evaluated(self, layout: PatchLayout) -> tuple[list[LawTerms], Floats]:
        """The terms of laws at every sample, and the slopes (q,) of all terms where they are constant, 0 for others."""
        evaluated, parts = list[LawTerms](), iter(layout.law_parts)
        for group in layout.groups:
            law, links = group.weak_law, group.links
            inside = {
                name: group.coefficients[name].at(self.values)[:, None]
                if name in group.coefficients
                else self.recorded[name]
                for name in law.inside
            }
            self._require_starts(group, inside)
            noise = self.elongation_variance[links][:, None]
            d, v = np.zeros((len(links), 1)), np.zeros(())
            if law.curved:
                d = self.structure_layout.elongations(self.motion.displacements, links)
            rate_slopes: Iterable[Floats | None] = repeat(None)
            if law.needs_rate:
                v, passed = self._rates(d), float(np.linalg.norm(self.rate_window.slope))
                # without noise slopes do not count
                deviation = np.where(noise > 0.0, passed * np.sqrt(noise), 1.0)
                rate_slopes = law.rate_slopes(d, v, noise, deviation, inside)
            functions = law.evaluate(d, v, noise, inside)
            for h, slope in zip(functions, rate_slopes, strict=False):
                part, terms = next(parts)
                evaluated.append(LawTerms(part, links, terms, tuple(h), slope))
        return evaluated, _constant_slopes(layout, evaluated)

    def _require_starts(self, group: WeakLawGroup, inside: Mapping[str, Floats]) -> None:
        """IdentificationError if an unknown of a group enters its law nonlinearly and has no start."""
        law, layout = group.weak_law.law, self.structure_layout
        for name in (name for name in law.nonlinear if name in inside):
            for row in np.flatnonzero(np.isnan(inside[name])):
                link = layout.structure.links[layout.elements[group.links[row]].link]
                raise IdentificationError(
                    f'link "{link.name}": {name} enters the law {law.text} '
                    f"nonlinearly and needs a start: write {name} = {{ start = ... }} among its coefficients"
                )

    def _rates(self, d: Floats) -> Floats:
        """(m, N) v from d (m, N), held at the edges."""
        inner = np.stack([np.correlate(own, self.rate_window.slope[0]) for own in d])
        return np.pad(inner, ((0, 0), (self.rate_window.half, self.rate_window.half)), mode="edge")

    def _rows(self, layout: PatchLayout, evaluated: Sequence[LawTerms]) -> Floats:
        """(q, R): the terms under their kernels."""
        rows = np.zeros((len(layout.kernel), self.filtered.shape[2]))
        for terms in evaluated:
            kernel, sign, first = terms.part.kernel, terms.part.sign, terms.derivatives[0]
            if terms.part.plain:
                rows[terms.terms] = self.structure_layout.elongations(self.filtered[kernel], terms.links)
                rows[terms.terms] *= sign
            elif isinstance(first, float):
                rows[terms.terms] = sign * first * self.window.kernels[kernel].sum()
            else:
                taps = sign * self.window.kernels[kernel : kernel + 1]
                rows[terms.terms] = self.window.filter(first, taps)[0]
        rows[layout.inertial] = self.filtered[PHI_2, layout.masses]
        for row, mass in enumerate(layout.forced, start=layout.inertial.stop):
            rows[row] = -self.window.sums(self.applied[mass])
        return rows

    def _slopes(self, layout: PatchLayout, constant: Floats, evaluated: Sequence[LawTerms]) -> Floats:
        """(q, K): slopes of the terms' functions at the centres of every `slope_stride`-th window."""
        windows = np.arange(0, self.filtered.shape[2], self.slope_stride)
        centres = self.window.half + windows * self.window.stride
        slopes = np.repeat(constant[:, None], len(centres), axis=1)
        for terms in evaluated:
            if not isinstance(terms.slope, float):
                slopes[terms.terms] = terms.part.sign * terms.slope[:, centres]
        return slopes


def _constant_slopes(layout: PatchLayout, evaluated: Sequence[LawTerms]) -> Floats:
    """(q,) slopes of the terms by d where they are constant, 0 for others; that of inertia is by x."""
    slopes = np.zeros(len(layout.kernel))
    for terms in evaluated:
        if isinstance(terms.slope, float):
            slopes[terms.terms] = terms.part.sign * terms.slope
    slopes[layout.inertial] = 1.0
    return slopes


def _product_bias(
    weighted: Sequence[Floats], derivatives: Sequence[Floats | float], covariance: Floats
) -> Floats:
    """(m, m'): the bias of the products of two sets of curved functions, summed over samples.

    `weighted` are the derivatives of the first times the weights of the samples.
    """
    total, factor = np.zeros(covariance.shape), -1.0
    for order, (h, g) in enumerate(zip(weighted, derivatives, strict=False), start=1):
        factor /= -order
        products = g * h.sum(axis=-1, keepdims=True) if isinstance(g, float) else h @ g.T
        total += factor * covariance**order * products
    return total


def _correlated(kernel: Floats, taps: Floats) -> Floats:
    """The sums of a kernel over the taps of a centred filter around each of its samples."""
    half = len(taps) // 2
    return np.correlate(kernel, taps, "full")[half : half + len(kernel)]


MIN_WINDOWS = 8  # windows
_PATCH = 12  # masses: their dense products are cheap, and the terms of most links are shared
_DENSE_WINDOWS = 400  # from twice as many, sums of smooth slopes over time use every second window
_MAX_THINNING = 2
_SLOPE_THINNING = 4  # the slopes in products of noise with itself vary more slowly


def weak_equations(
    record: Record,
    structure: Structure,
    motion: MeasuredDisplacements,
    *,
    window: Window | None = None,
    rate_window: Window | None = None,
    values: dict[str, float] | None = None,
    only: Collection[int] | None = None,
) -> WeakEquations:
    """Weak equations of a structure on a record.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    motion : MeasuredDisplacements
        Displacements of the record, from `read_displacements`.
    window : Window, optional
        The test functions; chosen from the bandwidth by default.
    rate_window : Window, optional
        What smooths the rates that laws act by; then sums over time take every window. The test functions by default.
    values : dict of str to float, optional
        Present values of parameters that enter a law nonlinearly; their starts by default.
    only : collection of int, optional
        The numbers of the masses and modes whose equations are wanted; all by default.

    Returns
    -------
    WeakEquations
        The equations.

    Raises
    ------
    IdentificationError
        If the record is shorter than eight windows, too many samples are missing, or a parameter lacks a start.
    """
    layout = structure_layout(structure)
    window = window or Window.for_band(motion.bandwidth, record.rate, motion.noise_free)
    windows = window.rows(len(record))
    if windows < MIN_WINDOWS:
        raise IdentificationError(
            f"the record is too short: its {len(record)} samples give {windows} windows of {window.length} samples, and "
            f"{MIN_WINDOWS} are needed; record for longer"
        )
    thinning = min(max(1, windows // _DENSE_WINDOWS), _MAX_THINNING) if rate_window is None else 1
    applied = _applied(record, structure)
    smooth = window.filter(motion.displacements, window.kernels)
    equations = WeakEquations(
        structure_layout=layout,
        values=layout.values(values or {}),
        motion=motion,
        window=window,
        rate_window=rate_window or window,
        smooth=smooth,
        filtered=_with_frame(smooth, applied, frame_acceleration(record), layout, window),
        applied=applied,
        recorded={name: _at_samples(record, f"signal:{name}") for name in structure.signals},
        time=record.start + (window.half + window.stride * np.arange(windows)) / record.rate,
        thinning=thinning,
        only=only,
    )
    valid = [weights.sum() for weights, _ in equations.masses_by_windows]
    if valid and max(valid) < MIN_WINDOWS:
        raise IdentificationError(
            f"too many samples are missing: no mass has {MIN_WINDOWS} complete windows of {window.length} samples; fill "
            "single gaps first, keep the samples that all sensors have, or record again"
        )
    return equations


def _applied(record: Record, structure: Structure) -> dict[int, Floats]:
    """(N,) the applied force on each mass or mode that has one, by its number."""
    applied: dict[int, Floats] = {}
    for place in structure.places:
        channel = f"force:{place}"
        if channel in record.channels:
            force = _at_samples(record, channel)
            for mass, weight in structure.topology.weights(structure.topology.index[place]):
                applied[mass] = applied.get(mass, 0.0) + weight * force
    return dict(sorted(applied.items()))


def _at_samples(record: Record, channel: str) -> Floats:
    """(N,) what an input is around its samples."""
    return at_samples(record.channel(channel), record.interpolation.get(channel, BAND_LIMITED))


def _with_frame(
    smooth: Floats,
    applied: dict[int, Floats],
    acceleration: Floats | None,
    layout: StructureLayout,
    window: Window,
) -> Floats:
    """The sums (K, n + 2, R) with the acceleration (N,) of the coordinates in that of masses that are parameters.

    Their forces of inertia, which `applied` has by the values in the structure, leave it.
    """
    if acceleration is None:
        return smooth
    total, masses = smooth.copy(), layout.structure.masses
    for index in (index for index in range(len(masses)) if (-1 - index, MASS) in layout.parameter_index):
        total[PHI_2, index] += window.sums(acceleration)
        applied[index] = applied[index] + (masses[index].mass.value or 0.0) * acceleration
        if not applied[index].any():
            del applied[index]
    return total


def weak_residual(equations: WeakEquations, values: Floats) -> Floats:
    """(R, n) residuals in N of the weak equations with parameters `values` (p,).

    They are NaN for masses without an equation and windows with missing samples.
    """
    residual = np.full(equations.acceleration.T.shape, np.nan)
    for patch in equations.patches:
        total = np.where(patch.valid > 0.0, patch.residual(values) / equations.window.area, np.nan)
        residual[:, patch.layout.masses] = total.T
    return residual
