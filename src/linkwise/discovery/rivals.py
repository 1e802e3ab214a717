"""Errors of stated values beside which terms that were found would not be needed.

A mass that is stated 1 % wrong leaves a force in proportion to its acceleration, for which a term on another link may stand
in: a spring to the ground, of a mass that moves mostly at one frequency. A score test of the error beside all terms found is
then silent. Here each term in turn gives way to each error, in the local quadratic model, and the criterion of the best model
without the term against that of the selection says which of both the records prefer.

Forms of force that were not offered and explain the records better than terms that were found.

A selection takes the best of the terms on offer: v and sign(v) where the damping follows the square root of the rate. Their
margins against each other are large, and say nothing of forms that nobody offered. Here each of the usual forms joins each
link that was found, in the local quadratic model of the cost, and terms of the same kind give way to it: of stiffness to one
of stiffness, of damping to one of damping. Terms that the best form makes needless only stand in for it, where the criterion
is lower with it. A form of stiffness in whose place a term explains the records hardly better leaves it in doubt: which of the
two the link has cannot be decided.

Frequencies of a host that explain the records in place of links between its points and to the ground.

A frequency that is stated a few percent wrong is imitated by springs between points of the host: so well that a local model
about these springs, which are many standard errors from zero, cannot say what a fit without them would find. Here it is made,
with all frequencies of the hosts unknown in place of such links.

Zero offsets of sensors beside which constant forces that were found would not be needed.

About another zero of its displacement a linear spring pulls with a constant force, and a cubic one has a quadratic part beside
that. A selection with such terms and one with the offset of a channel explain a record equally well, or the latter does so
with fewer terms. In the local quadratic model each constant force in turn gives way to the offset of each channel, and to one
that all sensors of displacement have in common, as where the equilibrium of a structure is not where its sensors show zero.

Links that could as well be between other ends: all terms of one exchanged for those of another.

Two points near each other move nearly alike, and so may points of a host whose modes a record does not excite. Of masses, two
links of the same mass may share what is one link's. An exchange of one term at a time does not show that, since the terms of a
link belong together.

Links whose displacement no sensor shows, so that their law may be another one about another origin.

A force alpha*d + beta*d**3 with two wells is k*d + k2*d**2 + k3*d**3 about the one in which the motion stays. Velocities and
accelerations cannot distinguish them; a law that is odd about its origin has no other with as few terms.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, compress

import numpy as np
from scipy.linalg import block_diag

from linkwise.arrays import Bools, Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.evidence import widened
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import (
    QuadraticModel,
    Selection,
    TermSearch,
    cost_of,
    inverse_of,
    leaves_only_noise,
    link_motions,
    local_search,
)
from linkwise.discovery.terms import Term
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.shooting.residuals import SensorErrors, evaluate
from linkwise.likelihood.tests.columns import errors_of_stated_values
from linkwise.likelihood.tests.score_test import (
    CandidateForce,
    Hypothesis,
    LocalQuadratic,
    augmented_quadratic,
    candidate_forces,
    in_their_units,
    local_quadratic,
)
from linkwise.model.link import GROUND, Link
from linkwise.model.names import Name
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread

_LARGEST = 0.05  # relative: scales, load cells and data sheets are better than that
_LARGEST_DAMPING = 1.0  # of a mode, which changes with temperature and joints
_STRONG = 6.0  # of the criterion: "strong" evidence for the error (Kass and Raftery 1995)
_STATED = {
    "mass": "the mass of {} were {} than stated",
    "coefficient": "{} were {} than stated",
    "frequency": "the frequency of {} were {} than stated",
    "damping": "the damping of {} were {} than stated",
}
_PHRASES = {
    **_STATED,
    "force gain": "{} were {} than recorded",
    "offset": "{} had a zero offset of {}",
    "common offset": "{} were off by {}",
}
_CHECK = "check the value, or let it be unknown"
_ADVICE = {
    **dict.fromkeys(_STATED, _CHECK),
    "force gain": "check its calibration",
    "offset": "check the zero of the channel, or estimate its offset",
    "common offset": "check the zeros of the channels, or estimate their offsets and offer no constant force",
}
_OFFSETS = {
    "offset": "a zero offset of a sensor",
    "common offset": "a zero offset that all sensors of displacement have in common",
}
_SAME = 0.05  # of the criterion: rounds to 0.0
_NAMED = 3
_DROPPED_BESIDE = 2  # more links that an error may make needless with a term


@dataclass(frozen=True)
class RivalError:
    """An error of a stated value, `where`, of relative `size`, beside which the `terms`, by number, are not needed.

    Or a zero offset of a channel, or one of all displacements, in a `unit`.

    `excess` is the criterion of that model above that of the selection: below zero the records prefer the error.
    """

    kind: str
    where: str
    size: float
    terms: tuple[int, ...]
    excess: float
    unit: str = ""

    @property
    def is_preferred(self) -> bool:
        """Whether the records are strong evidence for the error and against the terms."""
        return self.excess < -_STRONG

    def remark(self, names: tuple[str, ...]) -> str:
        """A sentence for the user; `names` are those of all terms by number."""
        size = f"{100.0 * abs(self.size):.2g} % {'more' if self.size > 0.0 else 'less'}"
        of = "an error of what is stated"
        if self.kind in _OFFSETS:
            size, of = f"{self.size:.3g} {self.unit}", _OFFSETS[self.kind]
        error = _PHRASES[self.kind].format(self.where, size)
        terms = " and ".join(names[number] for number in self.terms)
        if self.is_preferred:
            return (
                f"If {error}, {terms} would not be needed and the criterion would be {-self.excess:.3g} lower: "
                f"{_ADVICE[self.kind]}."
            )
        error = error.replace("a zero offset", "one")
        change = f"only {self.excess:.1f} higher" if self.excess > 0.0 else f"{-self.excess:.1f} lower"
        if abs(self.excess) < _SAME:
            change = "the same"
        return (
            f"This record hardly distinguishes {terms} from {of}: if {error}, the criterion would be {change} without "
            f"{'it' if len(self.terms) == 1 else 'them'}."
        )


def rival_errors(selection: Selection, identified: Structure) -> tuple[RivalError, ...]:
    """For each set of terms that errors of stated values could replace the best such error, the best set first.

    `identified` is the structure of the selection with the values of its fit.
    """
    structure = selection.structure
    try:
        hypotheses, local = errors_of_stated_values(selection.fit.optimum, structure, identified)
    except np.linalg.LinAlgError:
        return ()
    p = len(structure.parameters)
    names = (*selection.quadratic.names[:p], *(hypothesis.where for hypothesis in hypotheses))
    model = QuadraticModel(names, local.curvature, local.slope, local.scatter)
    unknown = {mass.name for mass in structure.masses if not mass.mass.known}
    try:
        screened = _may_be_replaced(
            selection, model, np.array([_largest(hypothesis) for hypothesis in hypotheses])
        )
    except np.linalg.LinAlgError:
        return ()
    rivals = [
        RivalError(hypothesis.kind, hypothesis.where, size, terms, excess)
        for number, hypothesis in enumerate(hypotheses)
        if hypothesis.kind in _PHRASES and hypothesis.where not in unknown
        for term in np.flatnonzero(screened[:, number]).tolist()
        for size, terms, excess in without_term(selection, model, p + number, term)
        if abs(size) < _largest(hypothesis)
    ]
    best: dict[tuple[int, ...], RivalError] = {}
    for rival in sorted(rivals, key=lambda rival: rival.excess):
        best.setdefault(rival.terms, rival)
    return tuple(best.values())


def rival_remarks(rivals: tuple[RivalError, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """Sentences on the first of the `rivals`, with the `names` of terms by number."""
    return tuple(rival.remark(names) for rival in rivals[:_NAMED])


def _largest(hypothesis: Hypothesis) -> float:
    """The largest relative error of a stated value."""
    return _LARGEST_DAMPING if hypothesis.kind == "damping" else _LARGEST


def _may_be_replaced(selection: Selection, model: QuadraticModel, largest: Floats) -> Bools:
    """(p, e) whether a term, dropped beside an error, leaves a small error and a criterion that more drops may lower.

    Small is below `largest` (e,). By the inverse of the curvature of all terms, bordered by each error. Raises
    numpy.linalg.LinAlgError if the columns of the terms are linearly dependent.
    """
    penalty, p = selection.penalty, len(selection.structure.parameters)
    pair = penalty.pair[:p]
    alone = np.array(
        [np.sum(pair == number) == 1 and number not in penalty.stated for number in pair.tolist()]
    )
    saved = penalty.term + np.where(alone, penalty.link, 0.0)
    inverse = inverse_of(model.h[:p, :p])
    values, cross = inverse @ model.g[:p], model.h[:p, p:]
    along = inverse @ cross  # (p, e)
    left = model.h.diagonal()[p:] - np.einsum("pe,pe->e", cross, along)
    left = np.where(left > 0.0, left, np.inf)
    errors = (model.g[p:] - cross.T @ values) / left
    variance = inverse.diagonal()[:, None] + along**2 / left
    beside = values[:, None] - along * errors  # the terms beside each error
    sizes = errors + along / left / variance * beside  # of the error, once the term is dropped
    excess = beside**2 / variance - left * errors**2 + penalty.term - saved[:, None]
    more = _DROPPED_BESIDE * (penalty.term + penalty.link)
    return np.asarray((pair >= 0)[:, None] & (np.abs(sizes) < largest) & (excess < CERTAIN + more))


def without_term(
    selection: Selection, model: QuadraticModel, error: int, term: int
) -> Iterator[tuple[float, tuple[int, ...], float]]:
    """Where an error, by its number in `model`, may replace a term: its size, all terms replaced, and the excess.

    The latter is the criterion above that of the selection, if it is below 10; of errors only this one may join.
    """
    penalty, p = selection.penalty, len(selection.structure.parameters)
    chosen = list(range(p))
    selected = model.cost(chosen) + penalty.total(chosen)
    inside = np.array([*(number for number in chosen if number != term), error])
    block = np.ix_(inside, inside)
    scatter = None if model.scatter is None else model.scatter[block]
    part = QuadraticModel(tuple(model.names[k] for k in inside), model.h[block], model.g[inside], scatter)
    of_part = replace(penalty, pair=np.append(penalty.pair[inside[:-1]], -1))  # the error is not selected
    try:
        retained = local_search(part, of_part, range(p))
        size = float(part.solve(retained).values[-1])
        excess = part.cost(retained) + of_part.total(retained) + penalty.term - selected
    except np.linalg.LinAlgError:
        return
    if excess < CERTAIN:
        replaced = sorted(set(chosen) - set(inside[retained].tolist()))
        yield size, tuple(replaced), float(excess)


_STIFFNESS = ("d", "d*abs(d)", "d**3", "d**5", "d**2", "d**4")
_DAMPING = ("v", "sign(v)", "sign(v)*sqrt(abs(v))", "v*abs(v)", "v**3", "v*abs(d)", "v*d**2")
_SATURATING = (0.2, 0.7)  # times the root mean square rate of a link: where tanh turns
_VERY_STRONG = 10.0  # of the criterion: "very strong" evidence for the form (Kass and Raftery 1995)
_MOST_LINKS = 40
_MOST_OF_A_KIND = 4  # of one kind on a link, of which all subsets are tried
_NOT_TESTED = (
    "With random forces it is not tested whether terms stand in for a form that was not offered, or for an error of what "
    "was stated."
)


@dataclass(frozen=True)
class RivalForm:
    """A `form` on a `link` beside which the `terms`, by number, are not needed, at a criterion that is lower by `gain`.

    With a `gain` up to 10 it only explains the records about as well.

    `moved` (p,) is by how much the parameters of the selection would change, those of the terms to zero.
    """

    link: str
    form: str
    terms: tuple[int, ...]
    gain: float
    moved: Floats

    @property
    def is_better(self) -> bool:
        """Whether the terms only stand in for it, by very strong evidence."""
        return self.gain > _VERY_STRONG

    def remark(self, names: Sequence[str]) -> str:
        """A sentence for the user; `names` are those of all terms by number."""
        terms = " and ".join(names[number] for number in self.terms)
        if not self.is_better:
            return (
                f"A force like {self.form} in {self.link}, which was not offered, explains the record as well as {terms} (the "
                f"criterion changes by {-self.gain:+.2g}). A wider range of motion, or less noise, would distinguish "
                f"them."
            )
        return (
            f"With a force like {self.form} in {self.link}, which was not offered, {terms} would not be needed and the "
            f"criterion would be {self.gain:.3g} lower: offer it."
        )


def rival_forms(selection: Selection, candidates: Candidates) -> tuple[RivalForm, ...]:
    """For each link and kind of term the form that replaces terms there best, the best of all first.

    Where none is better, of stiffness the one that explains the records about as well in place of nonlinear terms.
    """
    structure, p = selection.structure, len(selection.structure.parameters)
    places = [*_places(selection, candidates)][:_MOST_LINKS]
    rates = link_rates(selection) if places else {}
    tested = [
        (link, chosen, form)
        for link, pair, damping, chosen in places
        for form in _forms(candidates, pair, damping=damping, rate=rates[link])
    ]
    if not tested:
        return ()
    index = structure.topology.index
    ends = {link.name: link.between for link in structure.links}
    forces = [
        CandidateForce(index[ends[link][0]], index[ends[link][1]], form.law) for link, _, form in tested
    ]
    try:
        local = local_quadratic(selection.fit.optimum, forces)
        model = selection.quadratic_beside(local, [form.text for _, _, form in tested])
    except np.linalg.LinAlgError:
        return ()
    linear = {name for name, entry in candidates.by_name.items() if entry.term.text.replace(" ", "") == "d"}
    rivals = []
    for number, (link, chosen, form) in enumerate(tested):
        totals = _totals(selection, model, chosen, p + number, damping=form.is_damping)
        terms = min(totals, key=lambda dropped: totals[dropped], default=())
        if not (terms and totals[terms] < -_VERY_STRONG):
            curved = (
                ()
                if form.is_damping
                else (d for d in totals if d and linear.isdisjoint(model.names[k] for k in d))
            )
            terms = min(curved, key=lambda dropped: totals[dropped], default=())
        gain = -totals[terms] if terms in totals else 0.0
        rivals.append(RivalForm(link, form.text, terms, gain, _moved(model, terms, p + number, p)))
    return best_rivals(rivals, [tuple(chosen) for _, chosen, _ in tested])


def best_rivals(rivals: Sequence[RivalForm], replaceable: Sequence[tuple[int, ...]]) -> tuple[RivalForm, ...]:
    """Of forms that replace terms, and are better or about as good, the best for each link and its `replaceable` terms.

    A form that would only join the terms, however much it gains, says nothing of whether they stand in for another one.
    """
    best: dict[tuple[str, tuple[int, ...]], RivalForm] = {}
    for rival, chosen in zip(rivals, replaceable, strict=True):
        key = rival.link, chosen
        if rival.terms and rival.gain > -_VERY_STRONG and (key not in best or rival.gain > best[key].gain):
            best[key] = rival
    return tuple(sorted(best.values(), key=lambda rival: -rival.gain))


def rival_form_remarks(rivals: Sequence[RivalForm], selection: Selection) -> tuple[str, ...]:
    """Sentences on the first of the `rivals` of a `selection`, or that none was looked for."""
    if selection.fit.random_forces:
        return (_NOT_TESTED,)
    return tuple(rival.remark(selection.quadratic.names) for rival in rivals[:_NAMED])


def allowing_for(estimate: Estimate, rivals: Sequence[RivalForm]) -> Estimate:
    """The estimate with intervals that include the effect of the `rivals` on the coefficients."""
    for rival in (rival for rival in rivals if rival.is_better):
        estimate = widened(estimate, np.outer(rival.moved, rival.moved))
    return estimate


def _moved(model: QuadraticModel, dropped: Collection[int], form: int, parameters: int) -> Floats:
    """(p,) by how much the parameters change with a form, by its number in the model, in place of terms."""
    retained = [number for number in range(parameters) if number not in dropped]
    moved = np.zeros(parameters)
    try:
        moved -= model.solve(range(parameters)).values
        moved[retained] += model.solve([*retained, form]).values[:-1]
    except np.linalg.LinAlgError:
        return np.zeros(parameters)
    return moved


def _places(selection: Selection, candidates: Candidates) -> Iterator[tuple[str, int, bool, list[int]]]:
    """Links and, for each kind, whether it is damping, with the terms chosen of that kind, by number."""
    links = {frozenset(link.between): link.name for link in selection.structure.links}
    by_kind: dict[tuple[int, bool], list[int]] = {}
    for number in range(len(selection.structure.parameters)):
        entry = candidates.by_name.get(selection.quadratic.names[number])
        if entry is None or entry.offered.parameters:
            continue
        if entry.term.elastic or entry.term.is_damping:
            by_kind.setdefault((entry.pair, entry.term.is_damping), []).append(number)
    for (pair, damping), chosen in by_kind.items():
        if not candidates.pairs[pair].stated and len(chosen) <= _MOST_OF_A_KIND:
            yield links[frozenset(candidates.pairs[pair].between)], pair, damping, chosen


def link_rates(selection: Selection) -> dict[str, float]:
    """Root mean square rate of each link along the fitted motion, in m/s."""
    return {name: float(np.sqrt(np.mean(v**2))) for name, (_, v) in link_motions(selection).items()}


def _forms(candidates: Candidates, pair: int, *, damping: bool, rate: float) -> Iterator[Term]:
    """Forms of a kind that were not offered on a pair."""
    offered = {entry.term.text.replace(" ", "") for entry in candidates.entries if entry.pair == pair}
    texts = _DAMPING if damping else _STIFFNESS
    if damping and rate > 0.0:
        texts = (*texts, *(f"tanh(v/{part * rate:.2g})" for part in _SATURATING))
    for text in texts:
        if text not in offered:
            yield Term(text, "form")


def _totals(
    selection: Selection, model: QuadraticModel, chosen: list[int], form: int, *, damping: bool
) -> dict[tuple[int, ...], float]:
    """By how much the criterion is higher with a form, for all choices of terms among the `chosen` that give way to it."""
    penalty, every = selection.penalty, range(len(selection.structure.parameters))
    pair = np.append(
        penalty.pair[: len(every)], np.full(len(model.names) - len(every), penalty.pair[chosen[0]])
    )
    penalty = replace(penalty, pair=pair)
    totals: dict[tuple[int, ...], float] = {}
    try:
        selected = model.cost(every) + penalty.total(list(every))
        for count in range(len(chosen) + 1):
            for dropped in combinations(chosen, count):
                inside = [*(number for number in every if number not in dropped), form]
                values = model.solve(inside).values
                if not damping or values[-1] > 0.0:
                    totals[dropped] = penalty.total(inside) - float(model.g[inside] @ values) - selected
    except np.linalg.LinAlgError:
        return {}
    return totals


_MOST_TERMS = 150  # of a selection: exchanges of links in larger ones take longer than their fit


@dataclass(frozen=True)
class LinkExchange:
    """A `link` found whose `terms`, by number, the `rival` link may have in its place, and the `excess` of the criterion."""

    link: str
    rival: str
    terms: tuple[int, ...]
    excess: float

    def remark(self) -> str:
        """A sentence for the user."""
        change = f"only {self.excess:.1f} higher" if self.excess >= 0.0 else f"{-self.excess:.1f} lower"
        return (
            f"This record hardly distinguishes the link {self.link} from {self.rival}: with that in its place the criterion "
            f"is {change}. Excite modes, or measure points, in which both differ."
        )


def link_exchanges(selection: Selection, candidates: Candidates) -> tuple[LinkExchange, ...]:
    """The exchanges of a whole link that would raise the criterion by less than `CERTAIN`, the least first.

    Beside hosts for any other link; else for one of the selected ones that shares a mass with it.
    """
    quadratic, penalty = selection.quadratic, selection.penalty
    count = len(selection.structure.parameters)
    chosen = list(range(count))
    pair_of = penalty.pair
    selected = quadratic.cost(chosen) + penalty.total(chosen)
    selected_pairs = set(pair_of[:count].tolist()) - {-1} - penalty.stated
    text = {
        number: candidates.by_name[name].term.text
        for number, name in enumerate(quadratic.names)
        if name in candidates.by_name
    }
    exchanges = []
    for pair in sorted(selected_pairs) if count <= _MOST_TERMS else ():
        own = np.flatnonzero(pair_of[:count] == pair).tolist()
        rest = [number for number in chosen if number not in own]
        others = set(pair_of[count:].tolist()) - {-1} - selected_pairs if candidates.hosts else set()
        for rival in sorted(others | _neighbours(pair, selected_pairs, candidates)):
            terms = {text[number]: number for number in np.flatnonzero(pair_of == rival).tolist()}
            if not {text[number] for number in own} <= terms.keys():
                continue
            model = sorted({*rest, *(terms[text[number]] for number in own)})
            if model == rest:  # the link is left out, which the margins of its terms tell
                continue
            try:
                excess = quadratic.cost(model) + penalty.total(model) - selected
            except np.linalg.LinAlgError:
                continue
            if excess < CERTAIN:
                names = candidates.pairs[pair].name, candidates.pairs[rival].name
                exchanges.append(LinkExchange(*names, tuple(own), float(excess)))
    return tuple(sorted(exchanges, key=lambda exchange: exchange.excess))


def _neighbours(pair: int, pairs: Collection[int], candidates: Candidates) -> set[int]:
    """Those of some pairs that end at a mass at which a pair ends as well."""
    masses = {mass.name for mass in candidates.masses}.intersection(candidates.pairs[pair].between)
    return {
        rival for rival in pairs if rival != pair and not masses.isdisjoint(candidates.pairs[rival].between)
    }


def link_exchange_remarks(exchanges: Sequence[LinkExchange]) -> tuple[str, ...]:
    """Sentences on the exchanges, and how many more there are."""
    more = len(exchanges) - _NAMED
    remarks = tuple(exchange.remark() for exchange in exchanges[:_NAMED])
    return remarks if more <= 0 else (*remarks, f"{more} more exchanges of a link would cost as little.")


_ODD = 1e-9  # of the largest force: rounding
_REMARK = (
    "The law of {} is not odd, and no sensor shows its displacement: about another origin another law, such as one with two "
    "wells, may be the same force. Measure the displacement, or excite the link until it moves through all of its wells."
)


@dataclass(frozen=True)
class UnknownOrigin:
    """A link `between` two ends with a law that is not odd about an origin that is not known, and its `terms` by number."""

    between: tuple[str, str]
    terms: tuple[int, ...]


def unknown_origins(
    estimate: Estimate, records: Sequence[Record], selection: Selection, candidates: Candidates
) -> tuple[UnknownOrigin, ...]:
    """The links that were found whose force is not odd in their motion, and whose displacement is not in the records."""
    channels = [channel for record in records for channel in record.channels]
    placed = {GROUND, *(channel.place for channel in channels if channel.kind == "x")}
    origins = []
    for index, link in enumerate(estimate.structure.links):
        if placed.issuperset(link.between) or link.law.states:
            continue
        d, v = estimate.motion.d[:, index], estimate.motion.v[:, index]
        force = link.force(d, v)
        if np.max(np.abs(force + link.force(-d, -v))) > _ODD * np.max(np.abs(force)):
            terms = [
                number
                for number, name in enumerate(selection.quadratic.names)
                if (entry := candidates.by_name.get(name)) is not None
                and set(candidates.pairs[entry.pair].between) == set(link.between)
            ]
            origins.append(UnknownOrigin(link.between, tuple(terms)))
    return tuple(origins)


def origin_remarks(origins: Sequence[UnknownOrigin]) -> tuple[str, ...]:
    """A sentence on these links, if there are any."""
    if not origins:
        return ()
    return (_REMARK.format(" and ".join("-".join(origin.between) for origin in origins)),)


_FREQUENCY = "frequency"
_CEILING, _STEPS = 1.5, 40  # chi-square and steps at which a fit ends that does not explain the records


def rival_frequencies(search: TermSearch, selection: Selection) -> tuple[RivalError, ...]:
    """The error of the frequency that moves farthest, in its errors, where frequencies do as well as links on hosts alone.

    None without such links in a selection that leaves only noise.
    """
    structure = selection.structure
    ends = {*structure.points, GROUND}
    on_hosts = {
        pair.name for pair in search.candidates.pairs if not pair.stated and ends.issuperset(pair.between)
    }
    names = [parameter.name for parameter in structure.parameters]
    replaced = tuple(k for k, name in enumerate(names) if name.owner in on_hosts)
    links = [structure.link(name) for name in sorted(structure.modes)]
    modes = [Name(link.name, _FREQUENCY) for link in links if _is_stated(link)]
    if not (replaced and modes and selection.settled and leaves_only_noise(selection.fit)):
        return ()
    remaining = selection.chosen - {names[k] for k in replaced}
    values = dict(zip(names, selection.fit.values.tolist(), strict=True))
    values |= {name: float(structure.coefficient(name).value or 0.0) for name in modes}
    try:
        freed = search.candidates.structure(remaining).unknown(*modes)
        theta = np.array([values[parameter.name] for parameter in freed.parameters])
        options = replace(
            search.sensors, model_error=False, ceiling=_CEILING, steps=_STEPS, progress=search.progress
        )
        fit = search.fit(freed, theta, None, options)
    except (IdentificationError, np.linalg.LinAlgError):
        return ()
    if not leaves_only_noise(fit):
        return ()
    penalty, inside = selection.penalty, [k for k in range(len(names)) if k not in replaced]
    criterion = cost_of(fit, selection.noise) + penalty.total(inside) + penalty.term * len(modes)
    excess = criterion - selection.criterion(selection.noise)
    if excess >= CERTAIN:
        return ()
    place = {parameter.name: number for number, parameter in enumerate(freed.parameters)}
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    changes = {name: float(fit.values[place[name]]) - values[name] for name in modes}
    most = max(modes, key=lambda name: abs(changes[name]) / deviations[place[name]])
    size = changes[most] / values[most]
    return (RivalError(_FREQUENCY, most.owner, size, replaced, float(excess)),)


def _is_stated(mode: Link) -> bool:
    """Whether the frequency of a mode is a number, other than 0."""
    frequency = mode.coefficients.get(_FREQUENCY)
    return frequency is not None and frequency.known and bool(frequency.value)


def rival_offsets(
    selection: Selection, candidates: Candidates, channels: Sequence[Channel]
) -> tuple[RivalError, ...]:
    """For each set of terms with a constant force the offset that replaces it best, the best of all first.

    `channels` are those of the records; offsets that the fit has found already are left out.
    """
    names = selection.quadratic.names[: len(selection.structure.parameters)]
    constants = [
        number
        for number, name in enumerate(names)
        if (entry := candidates.by_name.get(name)) is not None and entry.term.is_constant
    ]
    shown = [name for name in channels if not name.is_input]
    tested = [number for number, name in enumerate(shown) if name not in selection.fit.offsets]
    if not (constants and tested):
        return ()
    errors: list[tuple[str, str]] = [("offset", shown[number]) for number in tested]
    of_channels = np.eye(len(tested))
    units = [unit_in(selection.structure, where) for _, where in errors]
    displacements = np.array([shown[number].kind == "x" for number in tested])
    if np.count_nonzero(displacements) > 1 and len(set(compress(units, displacements))) == 1:
        errors.append(("common offset", "all displacements"))
        of_channels = np.column_stack([of_channels, displacements])
        units += [*compress(units, displacements)][:1]
    try:
        model = selection.quadratic_beside(
            _combined(_with_offsets(selection.fit.optimum, tested), of_channels),
            [f"{kind} of {where}" for kind, where in errors],
        )
    except np.linalg.LinAlgError:
        return ()
    rivals = [
        RivalError(kind, where, size, terms, excess, units[column])
        for term in constants
        for column, (kind, where) in enumerate(errors)
        for size, terms, excess in without_term(selection, model, len(names) + column, term)
        if excess < CERTAIN
    ]
    best: dict[tuple[int, ...], RivalError] = {}
    for rival in sorted(rivals, key=lambda rival: rival.excess):
        best.setdefault(rival.terms, rival)
    return tuple(best.values())


def _combined(local: LocalQuadratic, offsets: Floats) -> LocalQuadratic:
    """The local model in its parameters and in errors that are sums of its last (c,) unknowns, as `offsets` (c, e) says."""
    p = len(local.slope) - len(offsets)
    sums = block_diag(np.eye(p), offsets)
    scatter = None if local.scatter is None else sums.T @ local.scatter @ sums
    return LocalQuadratic(sums.T @ local.curvature @ sums, sums.T @ local.slope, scatter)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def _with_offsets(optimum: Optimum, channels: Sequence[int]) -> LocalQuadratic:
    """The local model in the parameters and, after them, in offsets of the `channels`, by number, in their SI units.

    Raises numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        errors = SensorErrors.of(optimum.segments, misfit)
        numbers = [
            number
            for number, (channel, kind) in enumerate(zip(errors.channel.tolist(), errors.kind, strict=True))
            if kind == "offset" and channel in channels
        ]
        offsets = SensorErrors(
            errors.channel[numbers],
            tuple(errors.kind[number] for number in numbers),
            errors.source[numbers],
            errors.values[:, numbers],
        )
        nothing, _ = candidate_forces(optimum, misfit, [])
        augmented = augmented_quadratic(optimum, misfit, nothing, offsets)
    units: Floats = np.ones(len(numbers))
    return in_their_units(optimum, augmented, units)
