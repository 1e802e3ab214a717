"""Score tests of weak equations: terms that the laws lack, and forces on one mass alone that no link explains.

A term of size zero is added to the equations. Its score is the sum over windows of the term times what the laws leave, without
the bias due to noise and beside the coefficients of the laws (Rao 1948); its variance is that of the normal equations due to
noise (`scatter`). Terms of a link act on both of its masses. One on a single mass stands for an error of a sensor, of a stated
mass or of an applied force, which action and reaction do not excuse.

The test functions of the fit are as short as the fastest motion. In the equation of a mass that moves more slowly most of what
they leave is noise of its inertia, which falls with the fifth power of their width, so every term is tested under wider ones
too. They see an error of a sensor or of a stated mass of a tenth the size.

The equations of each patch of masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import SIGNIFICANT, assemble_blocks, normal_equations, residual_power, significance
from linkwise.weak.patch import Patch
from linkwise.weak.patch_layout import PatchLayout, TermCoefficients
from linkwise.weak.scatter import SlopeStatistics, score_blocks

_TERMS = ("1", "d", "d**2", "d**3", "v", "v*d", "v*d**2")  # of which none needs a smoothed v
_FIFTH = "d**5"
_FIFTH_SAMPLES = (
    7.0  # per period of the fastest motion that the fifth power needs: fewer alias it into the test functions
)
_LARGEST = 48  # masses of a structure whose equations are tested
_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
_CANCELLED = 0.1  # of what white noise would give: a smaller variance is the difference of large ones that are not exact
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits
_WIDTHS = (1.0, 3.0)  # of the test functions of the fit: the wider ones hold a period of the fastest motion
_FEWEST = 50  # windows, of which scores are about normal


@dataclass(frozen=True)
class SignificantScore:
    """A term whose score is beyond chance.

    Attributes
    ----------
    place : str
        The link that lacks the term, or the mass on which it acts alone.
    term : str
        The term, as in a law; "acceleration" or "force" for that of a mass.
    of : str
        The link or the mass whose motion a force on a single mass follows; empty for a term of a link.
    z : float
        The score in standard errors.
    """

    place: str
    term: str
    of: str
    z: float

    @property
    def description(self) -> str:
        """In words."""
        if not self.of:
            return f"a force like {self.term} in {self.place}"
        return f"a force like {self.term} of {self.of} on {self.place} alone"


def significant_score(
    record: Record, structure: Structure, equations: WeakEquations, values: Floats, excess: float
) -> SignificantScore | None:
    """The most significant term that the laws lack.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    values : array of shape (p,)
        The parameters found.
    excess : float
        Power of the residuals over that expected from noise; scores scatter as much more.

    Returns
    -------
    SignificantScore or None
        The term; None where chance explains all scores, or the structure has too many masses.
    """
    if structure.size > _LARGEST:
        return None
    known = dict(zip(equations.parameters, map(float, values), strict=True))
    fine = record.rate > _FIFTH_SAMPLES * equations.motion.bandwidth
    wide = _with_terms(structure, (*_TERMS, _FIFTH) if fine else _TERMS)
    uncertain = _NOISE_POWER + (abs(excess - 1.0) if record.noise else 0.0)
    try:
        for width in _WIDTHS:  # wider ones only where those of the fit see nothing
            system = _under_wider(record, wide, equations, known, width)
            score = None if system is None else _largest_score(system, known, excess, uncertain)
            if score is not None:
                return score
    except (IdentificationError, np.linalg.LinAlgError):  # a term may not be finite along the motion
        pass
    return None


def _largest_score(
    system: WeakEquations, known: dict[str, float], excess: float, uncertain: float
) -> SignificantScore | None:
    """The largest score in a system if it is beyond chance."""
    tests = [_Tests.of(patch, system, known) for patch in system.patches]
    scores = [(test.scores(excess, uncertain), test) for test in tests]
    largest = max(scores, key=lambda pair: float(np.max(np.abs(pair[0]), initial=0.0)), default=None)
    if largest is None or not len(largest[0]):
        return None
    number = int(np.argmax(np.abs(largest[0])))
    z = float(largest[0][number])
    count = len(_WIDTHS) * sum(len(z_scores) for z_scores, _ in scores)
    return largest[1].named(number, z) if z**2 > _CHANCE + 2.0 * np.log(count) else None


def _under_wider(
    record: Record, structure: Structure, equations: WeakEquations, known: dict[str, float], width: float
) -> WeakEquations | None:
    """The equations of a structure under test functions `width` times as wide as of `equations`; None where they are too few.

    Slopes of laws, which say what noise does, and rates that laws act by are those of the motion under the given ones.
    """
    window = equations.window if width == 1.0 else equations.window.widened(width)
    if width > 1.0 and window.rows(len(record)) < _FEWEST:
        return None
    system = weak_equations(
        record,
        structure,
        equations.motion,
        window=window,
        rate_window=equations.window,
        values=known,
    )
    centres = window.half + window.stride * np.arange(system.windows)
    nearest = np.rint((centres - equations.window.half) / equations.window.stride).astype(int)
    nearest = np.minimum(nearest, equations.windows - 1)
    return replace(system, d=equations.d[:, nearest], v=equations.v[:, nearest])


def _with_terms(structure: Structure, terms: Sequence[str]) -> Structure:
    """The structure with an unknown coefficient for each of `terms` that a law does not have one for."""
    return replace(structure, links=tuple(_with_link_terms(link, terms) for link in structure.links))


def _with_link_terms(link: Link, terms: Sequence[str]) -> Link:
    unknown = {
        to_text(link.law.basis[name]).replace(" ", "")
        for name in link.law.linear
        if link.coefficients[name].value is None
    }
    prefix = _prefix(link)
    added = {f"{prefix}{number}": term for number, term in enumerate(terms) if term not in unknown}
    text = " + ".join([link.law.text, *(f"{name}*({term})" for name, term in added.items())])
    coefficients = {**link.coefficients, **{name: Coefficient.unknown() for name in added}}
    return replace(link, law=Law.parse(text), coefficients=coefficients)


def _prefix(link: Link) -> str:
    """What no coefficient of the link begins with."""
    prefix = "added"
    while any(name.startswith(prefix) for name in link.coefficients):
        prefix += "_"
    return prefix


@dataclass(frozen=True, eq=False)
class _Tests:
    """The equations of a patch with terms of size zero.

    `parameter` (q,) numbers the coefficients of its terms, first the p that are found, whose values are `values`; then come
    those of the terms that are tested, of which `rows` and `masses` (t,) are the first row and, for a term on a single mass,
    the mass, else -1.
    """

    patch: Patch
    system: WeakEquations
    statistics: SlopeStatistics
    values: Floats
    rows: Indices
    masses: Indices

    @classmethod
    def of(cls, patch: Patch, system: WeakEquations, known: dict[str, float]) -> _Tests:
        """The terms that a patch of `system` has beside the parameters that are `known`."""
        layout, names = patch.layout, system.parameters
        statistics = SlopeStatistics.along(
            patch, system, np.array([known.get(name, 0.0) for name in names], dtype=float)
        )
        is_estimated = np.array([name in known for name in names], dtype=bool)
        estimated = np.unique(layout.free_parameters[is_estimated[layout.free_parameters]])
        tested = np.unique(layout.free_parameters[~is_estimated[layout.free_parameters]])
        local = np.full(len(names) + 1, -1)
        local[np.concatenate([estimated, tested])] = np.arange(len(estimated) + len(tested))
        parameter = local[layout.coefficients.parameter]
        firsts = [int(np.flatnonzero(parameter == len(estimated) + k)[0]) for k in range(len(tested))]
        single = np.array(list(_single_terms(layout, parameter < len(estimated))), dtype=int).reshape(-1, 2)
        every = np.concatenate([np.arange(len(parameter)), single[:, 0]])
        signs = np.zeros((len(layout.masses), len(every)))
        signs[:, : len(parameter)] = layout.signs
        signs[single[:, 1], len(parameter) + np.arange(len(single))] = 1.0
        added = len(estimated) + len(tested) + np.arange(len(single))
        wide = replace(
            layout,
            kernel=layout.kernel[every],
            signs=signs,
            incidence=layout.incidence[every],
            increment=np.append(layout.increment, np.zeros(len(single), dtype=bool)),
            coefficients=TermCoefficients(
                np.append(parameter, added), np.append(layout.coefficients.known, np.zeros(len(single)))
            ),
        )
        both = np.ix_(every, every)
        return cls(
            patch=replace(
                patch,
                layout=wide,
                fixed=np.append(patch.fixed, np.zeros(len(single))),
                rows=patch.rows[every],
                products=patch.products[both],
                moments=patch.moments[both],
                slopes=patch.slopes[every],
            ),
            system=system,
            statistics=statistics,
            values=np.array([known[names[number]] for number in estimated], dtype=float),
            rows=np.concatenate([np.array(firsts, dtype=int), single[:, 0]]),
            masses=np.concatenate([np.full(len(firsts), -1), single[:, 1]]),
        )

    def scores(self, excess: float, uncertain: float) -> Floats:
        """(t,) scores in standard errors; 0 for terms that the laws have already.

        They scatter as the `excess` of the residuals says, and as the power of the noise is `uncertain`, a relative error.
        """
        p, count = len(self.values), len(self.values) + len(self.rows)
        theta = np.append(self.values, np.zeros(len(self.rows)))
        weights = [1.0 / residual_power(self.patch, theta)]
        moments, right = (_dense(array) for array in normal_equations([self.patch], weights, count))
        blocks = score_blocks([(self.patch, self.statistics)], weights, self.system)
        scatter = _dense(assemble_blocks(((which, block[0]) for which, block in blocks), count))
        biased, right_biased = (
            _dense(array) for array in normal_equations([self.patch], weights, count, bias=1.0)
        )
        scale = 1.0 / np.sqrt(np.maximum(biased.diagonal(), np.finfo(float).tiny))
        moments, scatter, biased = (matrix * np.outer(scale, scale) for matrix in (moments, scatter, biased))
        slope, slope_biased = (
            scale * sums - matrix @ (theta / scale)
            for sums, matrix in ((right, moments), (right_biased, biased))
        )
        beside = np.linalg.lstsq(moments[:p, :p], moments[:p, p:], rcond=1e-12)[0]
        across = np.concatenate([-beside, np.eye(count - p)])
        left, bias, variance = (
            np.einsum("ij,ij->j", across, matrix @ across) for matrix in (moments, biased - moments, scatter)
        )
        tested = (left > _COLLINEAR) & (moments.diagonal()[p:] > 0.0) & (scatter.diagonal()[p:] > 0.0)
        white = np.where(tested, left * scatter.diagonal()[p:], 0.0) / np.where(
            tested, moments.diagonal()[p:], 1.0
        )
        tested &= variance > _CANCELLED * white
        added = uncertain * (across.T @ (slope_biased - slope))
        variance = max(excess, 1.0) * np.maximum(variance, white) + added**2
        windows = round(self.system.windows / self.system.window.overlap)
        tested &= significance(np.where(tested, left, 1.0), bias, windows) > SIGNIFICANT
        return np.where(tested, across.T @ slope, 0.0) / np.sqrt(np.where(tested, variance, 1.0))

    def named(self, number: int, z: float) -> SignificantScore:
        """The term of a test."""
        layout, row, mass = self.patch.layout, int(self.rows[number]), int(self.masses[number])
        structure = self.system.structure_layout.structure
        names = [structure.mass_names[index] for index in layout.masses.tolist()]
        place = "" if mass < 0 else names[mass]
        for terms in layout.group_terms:
            if terms.terms.start <= row < terms.terms.stop:
                link = structure.links[int(layout.groups[terms.group].links[row - terms.terms.start])]
                name = terms.part.coefficient or ""
                term = to_text(link.law.basis[name]) if name in link.law.basis else link.law.text
                return SignificantScore(place or link.name, term, link.name if place else "", z)
        first = _first_inertia(layout) - len(np.flatnonzero(self.masses >= 0))
        follows = "acceleration" if row < first + len(names) else "force"
        return SignificantScore(place, follows, names[(row - first) % len(names)], z)


def _first_inertia(layout: PatchLayout) -> int:
    return len(layout.kernel) - len(layout.masses) - len(layout.forced)


def _single_terms(layout: PatchLayout, own: Bools) -> Iterator[tuple[int, int]]:
    """Rows and masses of forces on single masses: terms of their links, if `own` (q,), accelerations of them and of their
    neighbours, and applied forces.
    """
    incidence, first = np.abs(layout.link_incidence), _first_inertia(layout)
    inertia = np.arange(first, first + len(layout.masses))
    for mass, (signs, near) in enumerate(zip(layout.signs, incidence @ incidence.T, strict=True)):
        for row in np.flatnonzero((signs != 0.0) & own).tolist():
            yield row, mass
        for row in inertia[(near > 0.0) & (signs[inertia] == 0.0)].tolist():
            yield row, mass


def _dense(matrix: Floats | csc_array) -> Floats:
    return matrix if isinstance(matrix, np.ndarray) else np.asarray(matrix.toarray())
