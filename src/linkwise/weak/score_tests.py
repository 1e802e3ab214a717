"""Score tests of weak equations: terms that the laws lack, and forces on one mass alone that no link explains.

A term of size zero is added to the equations. Its score is the sum over windows of the term times what the laws leave, without
the bias due to noise and beside the coefficients of the laws (Rao 1948); its variance is that of the normal equations due to
noise (`scatter`). Terms of a link act on both of its masses. One on a single mass stands for an error of a sensor, of a stated
mass or of an applied force, which action and reaction do not excuse.

The test functions of the fit are as short as the fastest motion. In the equation of a mass that moves more slowly most of what
they leave is noise of its inertia, which falls with the fifth power of their width, so every term is tested under wider ones
too. They see an error of a sensor or of a stated mass of a tenth the size.

Friction and quadratic damping act by the rate as the test functions of the fit smooth it: what that takes from the terms makes
their scores smaller, and what its noise adds is known (`rate_bias`).

The equations of each patch of masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.tested_terms import ScoreTests, first_inertia
from linkwise.weak.window import Window

_TERMS = ("1", "d", "d**2", "d**3", "v", "v*d", "v*d**2")  # of which none needs a smoothed v
_FIFTH = "d**5"
_DAMPING = ("sign(v)", "v*abs(v)")  # under an input: where the motion decays, its pieces tell them from c*v
# per period of the fastest motion that the fifth power needs: fewer alias it into the test functions
_FIFTH_SAMPLES = 7.0
_LARGEST = 48  # masses of a structure whose equations are tested
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
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
    driven = equations.force is not None or equations.motion.base is not None
    terms = (*_TERMS, *((_FIFTH,) if fine else ()), *(_DAMPING if driven else ()))
    wide, prefix = with_terms(structure, terms)
    uncertain = _NOISE_POWER + (abs(excess - 1.0) if record.noise else 0.0)
    try:
        for width in _WIDTHS:  # wider ones only where those of the fit see nothing
            window = equations.window if width == 1.0 else equations.window.widened(width)
            if width > 1.0 and window.rows(len(record)) < _FEWEST:
                break
            system = _with_tested_terms(record, wide, prefix, equations, known, window)
            tests = [
                ScoreTests.of(patch, system, known, equations.structure_layout) for patch in system.patches
            ]
            score = _largest_score(tests, excess, uncertain)
            if score is not None:
                return score
    except (IdentificationError, np.linalg.LinAlgError):  # a term may not be finite along the motion
        pass
    return None


def _largest_score(tests: Sequence[ScoreTests], excess: float, uncertain: float) -> SignificantScore | None:
    """The largest score in all patches if it is beyond chance."""
    count = len(_WIDTHS) * max(sum(len(test.rows) for test in tests), 1)
    least = _CHANCE + 2.0 * float(np.log(count))
    scored = [(test.largest(excess, uncertain, least), test) for test in tests]
    beyond = [_named(test, *score) for score, test in scored if score is not None]
    return max(beyond, key=lambda score: abs(score.z), default=None)


def _with_tested_terms(
    record: Record,
    structure: Structure,
    prefix: str,
    equations: WeakEquations,
    known: dict[str, float],
    window: Window,
) -> WeakEquations:
    """The equations of a structure with terms whose coefficients begin with `prefix`, under some test functions.

    Slopes of laws, which say what noise does, and rates that laws act by are those of the motion under those of the fit.
    """
    system = weak_equations(
        record,
        structure,
        equations.motion,
        window=window,
        rate_window=equations.window,
        values=known,
        alone=lambda part: part.coefficient is not None and part.coefficient.startswith(prefix),
    )
    centres = window.half + window.stride * np.arange(system.windows)
    nearest = np.rint((centres - equations.window.half) / equations.window.stride).astype(int)
    nearest = np.minimum(nearest, equations.windows - 1)
    return replace(system, d=equations.d[:, nearest], v=equations.v[:, nearest])


@lru_cache(maxsize=32)
def with_terms(structure: Structure, terms: tuple[str, ...]) -> tuple[Structure, str]:
    """The structure with an unknown coefficient for each of some terms that a law does not have one for.

    Parameters
    ----------
    structure : Structure
        The structure.
    terms : tuple of str
        The terms, as in a law.

    Returns
    -------
    wide : Structure
        The structure with the terms.
    prefix : str
        What the names of their coefficients begin with, and no other coefficient.
    """
    prefix = "added"
    while any(name.startswith(prefix) for link in structure.links for name in link.coefficients):
        prefix += "_"
    links = tuple(_with_link_terms(link, terms, prefix) for link in structure.links)
    return replace(structure, links=links), prefix


def _with_link_terms(link: Link, terms: Sequence[str], prefix: str) -> Link:
    unknown = {
        to_text(link.law.basis[name]).replace(" ", "")
        for name in link.law.linear
        if link.coefficients[name].value is None
    }
    added = {f"{prefix}{number}": term for number, term in enumerate(terms) if term not in unknown}
    text = " + ".join([link.law.text, *(f"{name}*({term})" for name, term in added.items())])
    coefficients = {**link.coefficients, **{name: Coefficient.unknown() for name in added}}
    return replace(link, law=Law.parse(text, link.states), coefficients=coefficients)


def _named(tests: ScoreTests, number: int, z: float) -> SignificantScore:
    """The term of a test."""
    layout, row, mass = tests.patch.layout, int(tests.rows[number]), int(tests.masses[number])
    of_system = tests.system.structure_layout
    structure = of_system.structure
    names = [of_system.equation_names[index] for index in layout.masses.tolist()]
    place = "" if mass < 0 else names[mass]
    for terms in layout.group_terms:
        if terms.terms.start <= row < terms.terms.stop:
            element = of_system.elements[int(layout.groups[terms.group].links[row - terms.terms.start])]
            link, law, name = structure.links[element.link], element.law, terms.part.coefficient or ""
            term = to_text(law.basis[name]) if name in law.basis else law.text
            return SignificantScore(place or link.name, term, link.name if place else "", z)
    of_inertia = row - first_inertia(layout)
    if of_inertia < len(names):
        return SignificantScore(place, "acceleration", names[of_inertia], z)
    return SignificantScore(place, "force", structure.mass_names[layout.forced[of_inertia - len(names)]], z)
