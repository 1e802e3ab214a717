"""The old way to the law of a link: terms added one by one, each law fitted for itself. `discover` replaces it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated
from linkwise.errors import IdentificationError
from linkwise.identification.identify import identify
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import refuse_memory
from linkwise.model.structure import Link, Structure, refuse_hosts
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.record import Record
from linkwise.verdict import Verdict

FAMILY = (
    "v",
    "d",
    "d**2",
    "d**3",
    "d**4",
    "d**5",
    "v*d",
    "v*d**2",
    "v*d**4",
    "v*abs(d)",
    "v*abs(v)",
    "v**3",
    "1",
)


_NOW_DISCOVER = Deprecated("discover", since="0.3.0", until="0.5.0")


@dataclass(frozen=True)
class LawStep:
    """A law on the path of `law_path`.

    Attributes
    ----------
    structure : Structure
        The structure with this law, its coefficients unknown.
    terms : tuple of str
        The terms of the law, in the order in which they were added.
    left : float
        Root mean square of the residuals over that of the record.
    residual : float
        Standard deviation of the residuals, in standard deviations of the noise.
    bic : float
        The Bayesian information criterion with `residual` profiled out; smaller is better.

    Examples
    --------
    >>> import warnings
    >>> import linkwise as lw
    >>> spring = lw.Link("k", ("m", "ground"), lw.Law.parse("k*d"), {"k": 400.0})
    >>> structure = lw.Structure("oscillator", (lw.Mass("m", 1.0),), (spring,))
    >>> record = lw.simulate(structure, release={"v:m": 1.0}, duration=2.0, rate=200.0).with_noise(40.0, seed=1)
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")
    ...     path = lw.law_path(record, structure.unknown("k"), "k", candidates=("d", "v"), start=("d",), most=2)
    >>> [step.terms for step in path]
    [('d',), ('d', 'v')]
    """

    structure: Structure
    terms: tuple[str, ...]
    left: float
    residual: float
    bic: float


@checked
def law_path(
    record: Record,
    structure: Structure,
    link: str,
    *,
    candidates: Sequence[str] = FAMILY,
    start: Sequence[str] = ("d", "v"),
    most: int = 8,
    progress: Progress = silent,
) -> tuple[LawStep, ...]:
    """Find the law of one link term by term, each time adding the term that explains most of the record.

    Deprecated: `discover` on the masses of the link selects the terms by evidence from a few fits, with intervals and
    verdicts; other links are stated to it. Here every law is fitted for itself, by `identify` with `exact`. A candidate whose
    fit does not converge is passed over; the path ends where none is left.

    Parameters
    ----------
    record : Record
        A record of the structure.
    structure : Structure
        The structure; coefficients of all other links are known or unknown as it states.
    link : str
        The name of the link.
    candidates : sequence of str
        Terms in the elongation d (m) and its rate v (m/s), such as "d**3" and "v*abs(d)"; "1" is a constant force.
    start : sequence of str
        The terms of the first law.
    most : int
        The number of terms of the last law.
    progress : Progress
        Called with a `ProgressReport` before each fit.

    Returns
    -------
    tuple of LawStep
        The laws, by number of terms.

    Raises
    ------
    IdentificationError
        If the first law does not converge, or `most` is negative.
    StructureError
        If there is no such link.

    Examples
    --------
    >>> import warnings
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0).with_noise(40.0, seed=1)
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")
    ...     path = lw.law_path(record, chain, "nes1", candidates=("d**2", "d**3"), most=3)
    >>> [step.terms for step in path]
    [('d', 'v'), ('d', 'v', 'd**3')]
    """
    _NOW_DISCOVER.warn("linkwise.law_path", f"linkwise.{_NOW_DISCOVER.new}", depth=4)
    if most < 0:
        raise IdentificationError(f"most must not be negative, got {most}")
    refuse_memory(structure.links, "searches for a law")
    refuse_hosts(structure, "searches for a law")
    terms = tuple(start)
    path = [_fitted(record, structure, link, terms)]
    if path[0] is None:
        raise IdentificationError(
            f'link "{link}": the law with the terms {", ".join(start)} does not converge on this record'
        )
    while len(terms) < most:
        remaining = [term for term in candidates if term not in terms]
        tried = []
        for number, term in enumerate(remaining):
            done = (len(terms) + number / len(remaining)) / most
            progress(ProgressReport(done, f"{len(terms) + 1} terms: {term}"))
            tried.append(_fitted(record, structure, link, (*terms, term)))
        converged = [step for step in tried if step is not None]
        if not converged:
            break
        best = min(converged, key=lambda step: step.left)
        path.append(best)
        terms = best.terms
    return tuple(step for step in path if step is not None)


def law_of(terms: Sequence[str]) -> tuple[Law, dict[str, Coefficient]]:
    """The law p1*TERM + p2*TERM + ... with unknown coefficients."""
    names = [f"p{number}" for number in range(1, len(terms) + 1)]
    text = " + ".join(
        name if term == "1" else f"{name}*{term}" for name, term in zip(names, terms, strict=True)
    )
    return Law.parse(text), {name: Coefficient.unknown() for name in names}


def _fitted(record: Record, structure: Structure, link: str, terms: tuple[str, ...]) -> LawStep | None:
    """One law on the path, or None where its fit does not converge."""
    new = Link(link, structure.link(link).between, *law_of(terms))
    searched = replace(structure, links=tuple(new if old.name == link else old for old in structure.links))
    try:
        fit = identify(record, searched, exact=True)
    except IdentificationError:
        return None
    if Verdict.NOT_CONVERGED in fit.verdicts:
        return None
    power = [noise.sigma**2 / np.nanmean(record.channel(name) ** 2) for name, noise in fit.noise.items()]
    chi_square = float(fit.chi_square_per_sample or np.nan)
    bic = fit.samples * np.log(chi_square) + len(fit.values) * np.log(fit.samples)
    return LawStep(searched, terms, float(np.sqrt(np.mean(power))), float(np.sqrt(chi_square)), float(bic))
