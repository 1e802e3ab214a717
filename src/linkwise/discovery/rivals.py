"""What may be there in place of terms that were found, and explains the records as well or better: rivals, of five kinds.

Margins of terms against each other say nothing of what nobody offered. Here terms give way, in the local quadratic model of
the cost, to errors of stated values and offsets of sensors (`rival_errors`), other forms of force (`rival_forms`), other ends
of a link (`rival_links`) and other terms (`rival_terms`); and, by a fit, to frequencies of a host (`rival_frequencies`). The
criterion of the best model without the terms against that of the selection says which of both the records prefer. The law of a
link whose displacement no sensor shows may be another one about another origin (`rival_origins`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, permutations

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.discovery.candidates import CandidateTerm
from linkwise.discovery.criterion import CERTAIN, QuadraticModel
from linkwise.discovery.selection import Selection, TermSearch, cost_of, leaves_only_noise
from linkwise.discovery.terms import Term
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.terms import Offset, of_kind
from linkwise.likelihood.tests.columns import Added, errors_of_stated_values
from linkwise.likelihood.tests.score_test import Hypothesis, local_quadratic
from linkwise.model.coefficient import Name
from linkwise.model.link import GROUND
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record

_NAMED = 3  # rivals of a kind that remarks name
_LARGEST = 0.05  # relative: scales, load cells and data sheets are better than that
_LARGEST_DAMPING = 1.0  # of a mode, which changes with temperature and joints
_STRONG = 6.0  # of the criterion: "strong" evidence for the error (Kass and Raftery 1995)
_SAME = 0.05  # of the criterion: rounds to 0.0
_DROPPED_BESIDE = 2  # more links that an error may make needless with a term
_CHECK = "check the value, or let it be unknown"
_FREQUENCY = "frequency"
_STATED_WRONG = (
    "The laws explain the record to within its noise, and an error of what was stated would do so with fewer terms: no "
    "interval is given. Check the stated value that the findings name, or let it be unknown."
)
_OFF_ZERO = (
    "A zero offset of a sensor would explain the record with fewer terms than were found: no interval is given. Check the "
    "zero of the channel that the findings name, or let its offset be estimated."
)
_CEILING, _STEPS = 1.5, 40  # chi-square and steps at which a fit ends that does not explain the records
_STIFFNESS = ("d", "d*abs(d)", "d**3", "d**5", "d**2", "d**4")
_DAMPING = ("v", "sign(v)", "sign(v)*sqrt(abs(v))", "v*abs(v)", "v**3", "v*abs(d)", "v*d**2")
_SATURATING = (0.2, 0.7)  # times the root mean square rate of a link: where tanh turns
_MOST_LINKS = 40
_MOST_OF_A_KIND = 4  # of one kind on a link, of which all subsets are tried
_MOST_TERMS = 150  # of a selection: exchanges of links in larger ones take longer than their fit
_ODD = 1e-9  # of the largest force: rounding
_ORIGIN = (
    "The law of {} is not odd, and no sensor shows its displacement: about another origin another law, such as one with two "
    "wells, may be the same force. Measure the displacement, or excite the link until it moves through all of its wells."
)


@dataclass(frozen=True)
class Rival:
    """What may be there in place of the `terms`, by number, at a criterion that is higher by `excess`; a sentence says it.

    Of the sentences of a `kind` the first three are told. Where the records have strong evidence for it, `untrusted` says why
    no interval is given, or `moved` (p,) by how much the parameters of the selection would change with it.
    """

    kind: str
    terms: tuple[int, ...]
    excess: float
    remark: str
    untrusted: str = ""
    moved: Floats | None = None


_KINDS = {
    "form": "",
    "error": "",
    "link": "exchanges of a link would cost as little.",
    "origin": "",
    "term": "terms could be exchanged for others at as small a cost.",
}
"""What may replace terms, in the order in which it is told, and what is said of the number of those that are not."""


def rival_remarks(rivals: Sequence[Rival]) -> Iterator[str]:
    """What is said of the first rivals of each kind, and how many more there are."""
    for kind, more in _KINDS.items():
        own = [rival.remark for rival in rivals if rival.kind == kind]
        yield from own[:_NAMED]
        if more and len(own) > _NAMED:
            yield f"{len(own) - _NAMED} more {more}"


def _best_of_each(rivals: Iterable[tuple[object, Rival]]) -> tuple[Rival, ...]:
    """The best of the rivals in each place, the best of all first."""
    best: dict[object, Rival] = {}
    for place, rival in sorted(rivals, key=lambda placed: placed[1].excess):
        best.setdefault(place, rival)
    return tuple(best.values())


# by kind of error: it in words of its place and size, and what to do about it
_ERRORS = {
    "mass": ("the mass of {} were {} than stated", _CHECK),
    "coefficient": ("{} were {} than stated", _CHECK),
    "frequency": ("the frequency of {} were {} than stated", _CHECK),
    "damping": ("the damping of {} were {} than stated", _CHECK),
    "force gain": ("{} were {} than recorded", "check its calibration"),
    "offset": ("{} had a zero offset of {}", "check the zero of the channel, or estimate its offset"),
    "common offset": (
        "{} were off by {}",
        "check the zeros of the channels, or estimate their offsets and offer no constant force",
    ),
}
# what an error is an example of, if not one of what is stated
_EXAMPLES = {
    "offset": "a zero offset of a sensor",
    "common offset": "a zero offset that all sensors of displacement have in common",
}


def _error(
    selection: Selection, lacking: Hypothesis, size: float, terms: tuple[int, ...], excess: float
) -> Rival:
    """An error of a size in its unit, of relative `size` without one, beside which the `terms` are not needed."""
    relative = f"{100.0 * abs(size):.2g} % {'more' if size > 0.0 else 'less'}"
    (phrase, advice), example = (
        _ERRORS[lacking.kind],
        _EXAMPLES.get(lacking.kind, "an error of what is stated"),
    )
    error = phrase.format(lacking.where, f"{size:.3g} {lacking.unit}" if lacking.unit else relative)
    names = " and ".join(selection.quadratic.names[number] for number in terms)
    if excess < -_STRONG:
        remark = f"If {error}, {names} would not be needed and the criterion would be {-excess:.3g} lower: {advice}."
        untrusted = _OFF_ZERO if lacking.kind in _EXAMPLES else _STATED_WRONG
        return Rival("error", terms, excess, remark, untrusted)
    change = f"only {excess:.1f} higher" if excess > 0.0 else f"{-excess:.1f} lower"
    remark = (
        f"This record hardly distinguishes {names} from {example}: if "
        f"{error.replace('a zero offset', 'one')}, the criterion would be {'the same' if abs(excess) < _SAME else change} "
        f"without {'it' if len(terms) == 1 else 'them'}."
    )
    return Rival("error", terms, excess, remark)


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def rival_errors(
    selection: Selection, identified: Structure, channels: Sequence[Channel]
) -> tuple[Rival, ...]:
    """For each set of terms that an error could replace the best such error, the best set first.

    A mass that is stated 1 % wrong leaves a force in proportion to its acceleration, for which a term on another link may
    stand in: a spring to the ground, of a mass that moves mostly at one frequency. A score test of the error beside all terms
    found is then silent.

    About another zero of its displacement a linear spring pulls with a constant force, and a cubic one has a quadratic part
    beside that: in place of constant forces offsets are tried.

    `identified` is the structure of the selection with the values of its fit, `channels` are those of the records.
    """
    p, optimum = len(selection.inside), selection.fit.optimum
    constants = [k for k, entry in selection.entries.items() if k < p and entry.term.is_constant]
    unknown = {mass.name for mass in selection.structure.masses if not mass.mass.known}
    largest = (
        dict.fromkeys(_ERRORS, _LARGEST) | {"damping": _LARGEST_DAMPING} | dict.fromkeys(_EXAMPLES, np.inf)
    )
    try:
        offsets = _offsets(selection, channels) if constants else ()
        errors, local = errors_of_stated_values(optimum, selection.structure, identified, offsets)
        sizes = np.array([0.0 if e.where in unknown else largest.get(e.kind, 0.0) for e in errors])
        model = selection.quadratic_beside(local, [-1] * len(errors), [error.where for error in errors])
        screened = _may_be_replaced(model, p, sizes)
        return _best_of_each(
            (replaced, _error(selection, error, size, replaced, excess))
            for number, error in enumerate(errors)
            for term in (constants if error.kind in _EXAMPLES else selection.inside)
            if screened[term, number]
            for size, replaced, excess in _without_term(model, p, p + number, term)
            if abs(size) < sizes[number]
        )
    except np.linalg.LinAlgError:
        return ()


def _offsets(selection: Selection, channels: Sequence[Channel]) -> Iterator[Added]:
    """The offset of each sensor, and one that all sensors of displacement have in common, but for those that the fit has.

    The latter is there where the equilibrium of a structure is not where its sensors show zero.
    """
    found = {offset.channel for offset in of_kind(selection.fit.options.errors, Offset)}
    ones = np.ones_like(selection.fit.optimum.misfit.residuals[:, 0])
    common: dict[str, list[tuple[int, Floats]]] = {}
    for number, name in enumerate(name for name in channels if not name.is_input):
        if name not in found:
            unit, samples = unit_in(selection.structure, name), [(number, ones)]
            yield Added(Hypothesis("offset", name, unit=unit), samples=samples)
            if name.startswith("x:"):
                common.setdefault(unit, []).extend(samples)
    if len(common) == 1:
        ((unit, samples),) = common.items()
        if len(samples) > 1:
            yield Added(Hypothesis("common offset", "all displacements", unit=unit), samples=samples)


def _may_be_replaced(model: QuadraticModel, p: int, largest: Floats) -> Bools:
    """(p, e) whether a term, dropped beside an error, leaves a small error and a criterion that more drops may lower.

    Small is below `largest` (e,). Raises numpy.linalg.LinAlgError if the columns of the terms are linearly dependent.
    """
    penalty, by_curvature = model.penalty, replace(model, scatter=None)
    saved = np.where(penalty.has_other_terms(range(p)), 0.0, penalty.link)
    exchanges = by_curvature.exchanges(range(p))
    sizes = np.reshape([each.values for each in exchanges], (p, len(largest)))
    gains = np.reshape([each.z**2 for each in exchanges], (p, len(largest)))
    excess = (by_curvature.solve(range(p)).z ** 2 - saved)[:, None] - gains
    more = _DROPPED_BESIDE * (penalty.term + penalty.link)
    selected = penalty.pair[:p, None] >= 0
    return np.asarray(selected & (np.abs(sizes) < largest) & (excess < CERTAIN + more))


def _without_term(
    model: QuadraticModel, p: int, error: int, term: int
) -> Iterator[tuple[float, tuple[int, ...], float]]:
    """Where an error, by its number in `model`, may replace one of p terms: its size, all terms replaced, and the excess.

    The latter is the criterion above that of the selection, if it is below 10; of errors only this one may join.
    """
    inside = np.array([*(number for number in range(p) if number != term), error])
    part = model.among(inside)
    try:
        retained = part.local_search(range(p))
        size = float(part.solve(retained).values[-1])
        excess = part.criterion(retained) + model.penalty.term - model.criterion(range(p))
    except np.linalg.LinAlgError:
        return
    if excess < CERTAIN:
        yield size, tuple(sorted({*range(p)} - set(inside[retained].tolist()))), float(excess)


def rival_frequencies(search: TermSearch, selection: Selection) -> tuple[Rival, ...]:
    """The error of the frequency that moves farthest, in its errors, where frequencies do as well as links on hosts alone.

    A frequency that is stated a few percent wrong is imitated by springs between points of the host: so well that a local
    model about these springs, which are many standard errors from zero, cannot say what a fit without them would find. It is
    made, with all frequencies of the hosts unknown in place of such links.

    None without such links in a selection that leaves only noise.
    """
    structure = selection.structure
    ends = {*structure.points, GROUND}
    found = (pair for pair in search.candidates.pairs if not pair.stated)
    on_hosts = {pair.name for pair in found if ends.issuperset(pair.between)}
    names = [parameter.name for parameter in structure.parameters]
    replaced = tuple(k for k, name in enumerate(names) if name.owner in on_hosts)
    stated = ((name, structure.link(name).coefficients.get(_FREQUENCY)) for name in sorted(structure.modes))
    modes = [Name(name, _FREQUENCY) for name, value in stated if value and value.known and value.value]
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
        fit = search.fit(freed, (theta, None), options)
    except (IdentificationError, np.linalg.LinAlgError):
        return ()
    if not leaves_only_noise(fit):
        return ()
    penalty, inside = selection.quadratic.penalty, [k for k in range(len(names)) if k not in replaced]
    criterion = cost_of(fit, selection.noise) + penalty.total(inside) + penalty.term * len(modes)
    excess = float(criterion - selection.criterion(selection.noise))
    if excess >= CERTAIN:
        return ()
    place = {parameter.name: number for number, parameter in enumerate(freed.parameters)}
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    changes = {name: float(fit.values[place[name]]) - values[name] for name in modes}
    most = max(modes, key=lambda name: abs(changes[name]) / deviations[place[name]])
    error = Hypothesis(_FREQUENCY, most.owner)
    return (_error(selection, error, changes[most] / values[most], replaced, excess),)


def rival_forms(selection: Selection) -> tuple[Rival, ...]:
    """For each link and kind of term the form that replaces terms there best, the best of all first.

    A selection takes the best of the terms on offer: v and sign(v) where the damping follows the square root of the rate. Each
    of the usual forms joins each link that was found, and terms of the same kind, of stiffness or of damping, give way to it.

    It is better, or, of stiffness, explains the records about as well in place of nonlinear terms. A form that would only join
    the terms, however much it gains, says nothing of whether they stand in for another one.
    """
    p, pairs = len(selection.inside), selection.candidates.pairs
    places: dict[tuple[int, bool], list[int]] = {}
    for k, entry in selection.entries.items():
        damping, open_ = entry.term.is_damping, entry.offered.parameters
        if k < p and not (open_ or pairs[entry.pair].stated) and (entry.term.elastic or damping):
            places.setdefault((entry.pair, damping), []).append(k)
    few = [(place, terms) for place, terms in places.items() if len(terms) <= _MOST_OF_A_KIND][:_MOST_LINKS]
    tested = [(place, terms, form) for place, terms in few for form in _forms(selection, *place)]
    if not tested:
        return ()
    entries = [CandidateTerm(form.text, pair, form, form) for (pair, _), _, form in tested]
    try:
        forces = selection.candidates.forces(entries, selection.structure)
        local = local_quadratic(selection.fit.optimum, forces)
        names = [entry.name for entry in entries]
        model = selection.quadratic_beside(local, [entry.pair for entry in entries], names)
    except np.linalg.LinAlgError:
        return ()
    linear = {k for k, entry in selection.entries.items() if entry.term.text == "d"}
    rivals = []
    for number, ((pair, damping), chosen, form) in enumerate(tested, start=p):
        excesses = _excesses(model, p, chosen, number, must_damp=damping)
        terms = min(excesses, key=lambda dropped: excesses[dropped], default=())
        if not (terms and excesses[terms] < -CERTAIN):
            curved = () if damping else [d for d in excesses if d and linear.isdisjoint(d)]
            terms = min(curved, key=lambda dropped: excesses[dropped], default=())
        if terms and excesses[terms] < CERTAIN:
            rival = _form(model, p, pairs[pair].name, form, number, terms, excesses[terms])
            rivals.append(((pair, damping), rival))
    return _best_of_each(rivals)


def _form(
    model: QuadraticModel, p: int, link: str, form: Term, number: int, terms: tuple[int, ...], excess: float
) -> Rival:
    """A form on a link, by number in a model, beside which the `terms` are not needed."""
    names = " and ".join(model.names[k] for k in terms)
    if excess >= -CERTAIN:
        remark = (
            f"A force like {form.text} in {link}, which was not offered, explains the record as well as {names} (the "
            f"criterion changes by {excess:+.2g}). A wider range of motion, or less noise, would distinguish them."
        )
        return Rival("form", terms, excess, remark)
    remark = (
        f"With a force like {form.text} in {link}, which was not offered, {names} would not be needed and the "
        f"criterion would be {-excess:.3g} lower: offer it."
    )
    retained = [k for k in range(p) if k not in terms]
    moved = -model.solve(range(p)).values
    moved[retained] += model.solve([*retained, number]).values[:-1]
    return Rival("form", terms, excess, remark, moved=moved)


def link_rates(selection: Selection) -> dict[str, float]:
    """Root mean square rate of each link along the fitted motion, in m/s."""
    return {name: float(np.sqrt(np.mean(v**2))) for name, (_, v) in selection.link_motions().items()}


def _forms(selection: Selection, pair: int, damping: bool) -> Iterator[Term]:
    """Forms of a kind that were not offered on a pair, by number."""
    offered = {
        entry.term.text.replace(" ", "") for entry in selection.candidates.entries if entry.pair == pair
    }
    texts = _DAMPING if damping else _STIFFNESS
    rate = link_rates(selection)[selection.candidates.pairs[pair].name] if damping else 0.0
    saturating = [f"tanh(v/{part * rate:.2g})" for part in _SATURATING] if rate > 0.0 else []
    return (Term(text, "form") for text in (*texts, *saturating) if text not in offered)


def _excesses(
    model: QuadraticModel, p: int, chosen: Sequence[int], form: int, *, must_damp: bool
) -> dict[tuple[int, ...], float]:
    """By how much the criterion is higher with a form, for all choices of terms that give way to it."""
    excesses: dict[tuple[int, ...], float] = {}
    try:
        selected = model.criterion(range(p))
        for dropped in chain.from_iterable(combinations(chosen, count) for count in range(len(chosen) + 1)):
            inside = [*(number for number in range(p) if number not in dropped), form]
            if not must_damp or model.solve(inside).values[-1] > 0.0:
                excesses[dropped] = model.criterion(inside) - selected
    except np.linalg.LinAlgError:
        return {}
    return excesses


def rival_links(selection: Selection) -> tuple[Rival, ...]:
    """The exchanges of a whole link that would raise the criterion by less than `CERTAIN`, the least first.

    Two points near each other move nearly alike, and so may points of a host whose modes a record does not excite; two links
    of the same mass may share what is one link's. An exchange of one term at a time does not show that, since the terms of a
    link belong together.

    Beside hosts for any other link; else for one of the selected ones that shares a mass with it.
    """
    candidates, inside = selection.candidates, selection.inside
    pairs, count, exchanges = candidates.pairs, len(inside), []
    if count > _MOST_TERMS:
        return ()
    found = selection.quadratic.penalty.pairs_of(inside) - candidates.stated_pairs
    masses = {mass.name for mass in candidates.masses}
    terms: dict[int, dict[str, int]] = {}
    for number, entry in selection.entries.items():
        terms.setdefault(entry.pair, {})[entry.term.text] = number
    for pair, rival in permutations(sorted(terms), 2):
        shared = masses.intersection(pairs[pair].between).intersection(pairs[rival].between)
        if pair not in found or not (shared if rival in found else candidates.hosts):
            continue
        own = {text: number for text, number in terms[pair].items() if number < count}
        rest = {*inside} - {*own.values()}
        model = rest | {terms[rival][text] for text in own if text in terms[rival]}
        # a link that is left out is what the margins of its terms tell
        excess = selection.excess(model) if own.keys() <= terms[rival].keys() and model != rest else np.inf
        if excess < CERTAIN:
            change = f"only {excess:.1f} higher" if excess >= 0.0 else f"{-excess:.1f} lower"
            remark = (
                f"This record hardly distinguishes the link {pairs[pair].name} from {pairs[rival].name}: with that in its "
                f"place the criterion is {change}. Excite modes, or measure points, in which both differ."
            )
            exchanges.append(Rival("link", tuple(own.values()), excess, remark))
    return tuple(sorted(exchanges, key=lambda rival: rival.excess))


def rival_terms(selection: Selection) -> tuple[Rival, ...]:
    """The exchanges of a term kept for one dropped that would raise the criterion by less than `CERTAIN`."""
    names = selection.quadratic.names
    return tuple(
        Rival(
            "term",
            (move.dropped, move.added),
            -move.gain,
            f"This record hardly distinguishes {names[move.dropped]} from {names[move.added]}: with the other in its place "
            f"the criterion is {f'only {-move.gain:.1f} higher' if move.gain <= 0.0 else 'no higher, to first order'}.",
        )
        for move in selection.neighbours
        if move.dropped is not None and move.added is not None and -move.gain < CERTAIN
    )


def rival_origins(selection: Selection, estimate: Estimate, records: Sequence[Record]) -> tuple[Rival, ...]:
    """The links found whose force is not odd in their motion, and whose displacement is not in the records, if any.

    A force alpha*d + beta*d**3 with two wells is k*d + k2*d**2 + k3*d**3 about the one in which the motion stays. Velocities
    and accelerations cannot distinguish them; a law that is odd about its origin has no other with as few terms.
    """
    channels = [channel for record in records for channel in record.channels]
    placed = {GROUND, *(channel.place for channel in channels if channel.kind == "x")}
    found = []
    for index, link in enumerate(estimate.structure.links):
        if placed.issuperset(link.between) or link.law.states:
            continue
        d, v = estimate.motion.d[:, index], estimate.motion.v[:, index]
        force = link.force(d, v)
        if np.max(np.abs(force + link.force(-d, -v))) > _ODD * np.max(np.abs(force)):
            found.append(link.between)
    pairs, ends = selection.candidates.pairs, {frozenset(between) for between in found}
    terms = [k for k, entry in selection.entries.items() if frozenset(pairs[entry.pair].between) in ends]
    remark = _ORIGIN.format(" and ".join("-".join(between) for between in found))
    return (Rival("origin", tuple(terms), 0.0, remark),) if found else ()
