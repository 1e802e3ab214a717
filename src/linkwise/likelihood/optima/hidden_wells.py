"""Starts of links of masses that only accelerometers, or none, show: about the place where they rest, which may be a well.

Nothing shows where such a mass rests, and forces of small motion hardly tell one well from another. About its place of rest a
link of any law moves like a spring that is not symmetric. That law, with a term in d**2 beside its own, has one place of rest,
and is fitted first, with loose continuity. Then the place of rest is the one about which the own law gives the same forces
along this motion, and the search goes on from there. A fit about another place leaves as little where the motion is so small
that noise hides how the link bends: then its coefficients are hardly known, and the two compete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.display import enumerated
from linkwise.errors import IdentificationError
from linkwise.expression import differentiate, symbols
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.starts.values import regressed, starting_values
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import BASE, Link, with_term
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_LOOSE = 0.03  # relaxation at which the fit about the place of rest ends: tighter ones creep
_NEAREST, _FARTHEST = 0.1, 300.0  # deviations of the motion that a place of rest may be away from d = 0
_GRID = 161  # places on either side, at equal ratios
_ROUNDS = 4  # of finer grids
_APART = 4.0  # standard errors beyond which values are others
_SAME = 1e-6  # relative: forces that are the same
_CERTAIN = 10.0  # standard errors: laws whose coefficients are known that well leave no doubt about the place of rest


def fit_about_rest(
    records: Sequence[Record],
    structure: Structure,
    options: LikelihoodOptions,
    first: LikelihoodFit,
    *,
    given: Mapping[str, float],
) -> LikelihoodFit | None:
    """A fit that starts about the places where hidden masses rest; None where there are none, or it fails.

    There are none in doubt, either, where a first fit leaves only noise and knows all coefficients of their links well.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    options : LikelihoodOptions
        The options.
    first : LikelihoodFit
        A fit from another start.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    LikelihoodFit or None
        The fit.
    """
    hidden = _hidden_links(structure, records[0].channels)
    if not hidden or _leaves_no_doubt(first, structure, hidden):
        return None
    centred, freed = _centred(structure, hidden), {structure.links[number].name for number in hidden}
    kept = {p.name for p in structure.parameters if p.name.owner not in freed}
    stated = {name: value for name, value in given.items() if name in kept}
    search = partial(likelihood_fit, records)
    try:
        theta, _ = starting_values(records, centred, stated)
        about = search(centred, theta, options=replace(options, model_error=False, tightest=_LOOSE))
        if about.interrupted:
            return None
        values, nodes = _moved(structure, centred, about, hidden)
        return search(structure, values, options=replace(options, nodes=nodes))
    except IdentificationError:
        return None


def about_another_rest(fit: LikelihoodFit) -> str:
    """What it means that masses of which no channel shows where they rest may as well rest elsewhere.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit; beside memory, other values as likely say nothing of places of rest.

    Returns
    -------
    str
        A part of a sentence with the names of the coefficients; empty where the masses rest at one place alone.
    """
    if not fit.others or fit.segments.system.states:
        return ""
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    apart = np.any([np.abs(values - fit.values) > _APART * errors for values in fit.others], axis=0)
    names = [name for name, far in zip(fit.names, apart.tolist(), strict=True) if far]
    if not names:
        return ""
    return (
        f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} hardly determined: a motion about another place of rest "
        "explains it as well, and no channel shows where the mass rests. Record a larger motion, or "
        "the displacement of the mass, or hold one of them at a known value."
    )


def other_places_of_rest(
    fit: LikelihoodFit, identified: Structure, channels: Sequence[Channel]
) -> Iterator[str]:
    """What laws have that are the same counted from another place of rest, where no channel shows the place of a mass.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    identified : Structure
        The structure with its values.
    channels : sequence of Channel
        The channels of the records.

    Yields
    ------
    str
        A sentence on a link and a place of rest, at which its law with other coefficients has the same forces, as one with
        terms in d, d**2 and d**3 does; none of structures with loops or hosts, whose links do not elongate each by itself.
    """
    is_shown = any(channel.kind == "x" or channel.of_link for channel in channels)
    if is_shown or identified.hosts or len(identified.links) != identified.size:
        return
    orbit = fit.misfit.trajectories.links
    deviations = dict(zip(fit.names, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0)), strict=True))
    places_of_links = np.argsort(fit.segments.system.order)  # behind them are those of random forces
    for link, k in zip(identified.links, places_of_links.tolist(), strict=False):
        names = [name for name in link.coefficients if f"{link.name}.{name}" in fit.names]
        if not names or not link.law.is_plain or BASE in link.between:
            continue
        told: set[str] = set()
        d, v = orbit[:, 0, k].ravel(), orbit[:, 1, k].ravel()
        force, span = link.force(d, v, {}), float(np.ptp(d))
        places = np.linspace(d.min() - span, d.max() + span, _GRID)
        at_places = partial(_at_rest, link)
        crossed = (
            np.abs(np.diff(np.sign([at_places(place) for place in places]))) > 0.0
        )  # never where one is not finite
        for n in np.flatnonzero(crossed).tolist():
            rest = scipy.optimize.brentq(at_places, places[n], places[n + 1])
            solved, left = regressed(link, d - rest, v, force, link.values, names)
            apart = any(
                abs(value - link.values[name]) > _APART * deviations[f"{link.name}.{name}"]
                for name, value in solved.items()
            )
            values = enumerated([f"{link.name}.{name} = {value:.4g}" for name, value in solved.items()])
            if apart and values not in told and left < _SAME**2 * float(force @ force):
                told.add(values)
                yield (
                    f"No channel shows where the masses rest: counted from another place of rest, the same law of {link.name} "
                    f"has {values}."
                )


def _at_rest(link: Link, d: float) -> float:
    """The force of a link that does not move, in N."""
    return float(link.force(np.array([d]), np.zeros(1), {})[0])


def _hidden_links(structure: Structure, channels: Sequence[Channel]) -> dict[int, int]:
    """Links that bend and alone hold a mass whose displacement no channel shows, with the coordinate of that, by number."""
    incidence = structure.incidence.toarray()
    shown = {channel.place for channel in channels if channel.kind == "x"}
    hidden = {}
    for coordinate, name in enumerate(structure.mass_names):
        numbers = np.flatnonzero(incidence[coordinate])
        if name in structure.modes or name in shown or len(numbers) != 1:
            continue
        number = int(numbers[0])
        link = structure.links[number]
        if BASE in link.between or not link.law.is_plain:
            continue
        if "d" in symbols(differentiate(link.law.expression, "d")):
            hidden[number] = coordinate
    return hidden


def _leaves_no_doubt(fit: LikelihoodFit, structure: Structure, hidden: Mapping[int, int]) -> bool:
    """Whether a fit explains the records, and every coefficient of the links that it has found is far from zero."""
    if not fit.converged or fit.chi_square_off:
        return False
    own = [any(link in hidden for link, _ in parameter.members) for parameter in structure.parameters]
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    return bool((np.abs(fit.values) > _CERTAIN * errors)[own].all())


def _centred(structure: Structure, hidden: Mapping[int, int]) -> Structure:
    """The structure with a term in d**2 in hidden links, whose coefficients are unknown as far as laws are linear in them."""
    links = list(structure.links)
    for number in hidden:
        linear = dict.fromkeys(links[number].law.linear, Coefficient.unknown())
        freed = replace(links[number], coefficients={**links[number].coefficients, **linear})
        links[number] = with_term(freed, "{0}*d**2", {"skew": Coefficient.unknown()})
    return replace(structure, links=tuple(links))


def _moved(
    structure: Structure, centred: Structure, about: LikelihoodFit, hidden: Mapping[int, int]
) -> tuple[Floats, Floats]:
    """Values (p,) of the unknowns of the structure, and nodes with its hidden masses moved to where they rest."""
    values: dict[str, float] = about.by_name
    valued = centred.with_values(values)
    nodes = about.optimum.point.nodes.copy()
    n = structure.size
    incidence = structure.incidence.toarray().T
    for k, coordinate in hidden.items():
        d, v = incidence[k] @ nodes[:n], incidence[k] @ nodes[n : 2 * n]
        names = {key: p.name for p in structure.parameters for number, key in p.members if number == k}
        force = valued.links[k].force(d, v, {})
        rest, numbers = _place_of_rest(structure.links[k], valued.links[k].values, d, v, force, names)
        values = values | {names[key]: number for key, number in numbers.items()}
        nodes[coordinate] += rest / incidence[k, coordinate]
    return np.array([values[p.name] for p in structure.parameters]), nodes


def _place_of_rest(
    link: Link,
    numbers: Mapping[str, float],
    d: Floats,
    v: Floats,
    force: Floats,
    names: Mapping[str, str],
) -> tuple[float, dict[str, float]]:
    """The elongation about which the law gives a force (K,) along a motion, and the coefficients in `names` with which.

    Coefficients in which the law is not linear have the `numbers` of the fit, known ones their own.
    """
    fixed = {
        name: numbers[name] if coefficient.value is None or name in names else float(coefficient.value)
        for name, coefficient in link.coefficients.items()
    }
    size = float(np.std(d)) or 1.0
    ratios = np.linspace(np.log(_NEAREST), np.log(_FARTHEST), _GRID)
    places = size * np.concatenate([np.exp(ratios), -np.exp(ratios)])
    best = np.inf, 0.0, dict[str, float]()
    for finer in range(_ROUNDS):
        for place in places.tolist():
            solved, left = regressed(link, d + place, v, force, fixed, tuple(names))
            best = min(best, (left, place, solved), key=lambda trial: trial[0])
        step = float(ratios[1] - ratios[0]) * (4.0 / _GRID) ** finer
        places = best[1] * np.exp(np.linspace(-2.0, 2.0, _GRID) * step)
    return best[1], {name: best[2].get(name, fixed[name]) for name in names}
