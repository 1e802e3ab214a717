"""Motion that begins anew at one moment: a hit that nobody recorded, or samples that a logger lost or wrote twice.

The states on both sides of a node follow from the samples before and behind it. What a jump between them takes off -2 log
likelihood, all states and coefficients following, is a chi-square of as many degrees of freedom as there are states where
nothing happened (a generalised likelihood ratio: Willsky and Jones, IEEE Trans. Automatic Control 21, 1976). One that hardly
shows, as of whole periods of a free decay, may move a damping by many of its standard errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.estimates.causes import EVENT, Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.harmonics import tells_time
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.tests.diagnosis import TestedCauses, least_gain
from linkwise.likelihood.tests.variances import (
    DRAWS,
    RELAXED,
    SEED,
    DrawnEquations,
    at_once,
    noise_draws,
    with_draws,
)
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_LONGEST = 20_000  # segments in which they are looked for
_COLUMNS = 64  # jumps of single states that are tested
_FEWEST = 8  # moments; with more states than let them be as many, looking for them takes a fifth of a fit
_BETWEEN = 4  # longer segments from one moment to the next, so that their ends hardly move it
_ENDS = 0.05  # of a record: nearer to an end a jump is another start of its motion
_RANK = 1e-9  # of the largest information on a jump: a direction with less is not seen
_PULSE = 30.0  # times the mean power of an input: of a hit, whose impulse few samples hardly tell
_ALIKE = 9.0  # of -2 log likelihood: three standard errors, by which a jump is told from another scale of the motion
_HINT = 6.25  # with twice the logarithm of the moments, of one degree of freedom: one fit in 80 by chance


@dataclass(frozen=True, eq=False)
class Jump:
    """The likeliest jump of all states, alone, as an `event`, and what it makes of the coefficients (p,).

    Chance gives one fit in 20 000 a jump that `is_significant`, one in 80 others. One unknown in place of all states would
    gain `of_one` where it is as rare.
    """

    event: Cause
    moves: Floats
    is_significant: bool
    of_one: float


def likeliest_jump(
    fit: LikelihoodFit, identified: Structure, records: Sequence[Record], tested: TestedCauses | None
) -> Jump | None:
    """The jump at one moment that explains most of what exact laws leave; None where chance may well give it.

    It is looked for in the segments, and by the linearised equations, in which causes were `tested`.
    """
    exact = fit.model_error == 0.0 and isinstance(fit.optimum.loss, Gaussian) and fit.has_errors
    states, model = fit.segments.system.dimension, tested and tested.quadratic.model
    large = identified.hosts or states * _FEWEST > _COLUMNS or fit.segments.count > _LONGEST
    if not exact or large or fit.random_forces:
        return None
    optimum, linear = fit.optimum, None
    if tested and model:
        longer = tested.longer.segments
        if tells_time(longer, records) and longer.count >= _BETWEEN * _count(longer):
            optimum, linear = tested.longer, model.linear
    segments = optimum.segments
    moments = _moments(segments)
    try:
        none = 0.0, 0, np.empty(0), 0.0
        equations = DrawnEquations.of(fit, optimum, RELAXED, linear) if len(moments) else None
        jumps = () if equations is None else _jumps(fit, equations, moments)
        gain, segment, moves, growth = max(jumps, default=none, key=lambda jump: jump[0])
    except np.linalg.LinAlgError:
        return None
    of_one = float(scipy.special.chdtri(1, scipy.special.chdtrc(states, gain)))
    if not of_one > _HINT + 2.0 * float(np.log(max(len(moments), 1))):
        return None
    ends = np.flatnonzero(~segments.linked) + 1  # of records
    begin = int(np.max(ends[ends <= segment], initial=0))
    end = int(np.min(ends[ends > segment], initial=segments.count))
    others = np.clip(moments[moments != segment] + 1, begin, end - 1)
    first = int(np.max(others[others <= segment], initial=begin))
    last = int(np.min(others[others > segment + 1], initial=end - 1))
    event = replace(event_between(segments, first, last, records, gain), share=growth)
    return Jump(event, moves, of_one > least_gain(len(moments)), of_one)


def _count(segments: Segments) -> int:
    """The number of moments that are tested."""
    return max(_FEWEST, _COLUMNS // segments.system.dimension)


def _moments(segments: Segments) -> Indices:
    """Numbers of segments at whose ends a jump is tested, evenly along each record, and not at a hit."""
    count = _count(segments)
    starts = np.concatenate([[0], np.flatnonzero(~segments.linked) + 1, [segments.count]])
    found = []
    for start, stop in pairwise(starts.tolist()):
        share = max(2, round(count * (stop - start) / segments.count))
        margin = _ENDS * (stop - start)
        found.append(np.linspace(start + margin, stop - 2 - margin, share))
    moments = np.unique(np.rint(np.concatenate(found)).astype(int))
    moments = moments[(moments >= 0) & (moments < segments.count - 1)]
    moments = moments[segments.linked[moments]]
    near, hits = max(1, segments.count // (2 * count)), np.zeros(segments.count, dtype=bool)
    for values in (segments.inputs.force, segments.inputs.base, segments.inputs.frame):
        if values is not None:
            power = np.max(values**2, axis=tuple(range(values.ndim - 1)))
            hits |= power > _PULSE * np.mean(values**2)
    around = np.convolve(hits, np.ones(2 * near + 1), "same") > 0.5
    return np.asarray(moments[~around[moments]])


def _jumps(
    fit: LikelihoodFit, equations: DrawnEquations, moments: Indices
) -> Iterator[tuple[float, int, Floats, float]]:
    """The likeliest of the jumps of all states at the ends of some segments, each alone, of each part of these: what it takes
    off -2 log likelihood, the segment, what it makes of the parameters (p,), and by which part of itself the motion grows, 0
    where that does not explain as much.
    """
    optimum = equations.optimum
    m, scale = optimum.segments.system.dimension, optimum.scales.theta[: len(fit.values)]
    pulls = _pulls(equations)
    for part in at_once(len(moments), optimum.segments.count * m * m):
        some = moments[part]
        border, followed = _by_jumps(equations, some)
        on_jumps = np.eye(m) / RELAXED**2 - followed
        information, directions = np.linalg.eigh(on_jumps)
        seen = information > _RANK * information[:, -1:]
        inverse = np.where(seen, 1.0 / np.where(seen, information, 1.0), 0.0)
        along = directions.transpose(0, 2, 1) @ pulls[some]
        gains = np.sum(along**2 * inverse[..., None], axis=1)
        drawn = np.mean(gains[:, 1:], axis=1) / m if gains.shape[1] > 1 else None
        noise = np.full(len(gains), optimum.noise**2) if drawn is None else drawn
        gains = gains[:, 0] / noise
        best = int(np.argmax(gains))
        size = directions[best] @ (inverse[best] * along[best, :, 0])
        moves = (border[: len(scale), best * m : (best + 1) * m] @ size) * scale
        state = optimum.point.nodes[:, some[best] + 1] / optimum.scales.state
        pull = state @ pulls[some[best], :, 0]
        growth = pull / (state @ on_jumps[best] @ state)
        alike = gains[best] - growth * pull / noise[best] < _ALIKE
        yield float(gains[best]), int(some[best]), np.where(fit.free, moves, 0.0), float(growth * alike)


def _by_jumps(equations: DrawnEquations, moments: Indices) -> tuple[Floats, Floats]:
    """The steps (P, d) of the border that follow from jumps of single states of unit size, and by how much less than their
    defects alone those at each moment (j, m, m) cost with nodes and border that follow.
    """
    linear, count = equations.linear, len(equations.free)
    m = equations.optimum.segments.system.dimension
    nodes = np.zeros((equations.optimum.segments.count, m, m * len(moments)))
    border = np.zeros((count, m * len(moments)))
    for number, segment in enumerate(moments):
        own = slice(number * m, (number + 1) * m)
        nodes[segment + 1, :, own] = np.diag(linear.joined[segment])
        nodes[segment, :, own] = -linear.state_ends[segment].T
        border[:, own] = -linear.right_ends[segment, :, :count].T
    forward, right, steps = equations.eliminated(nodes / RELAXED**2, border / RELAXED**2)
    left, of_right, of_steps = (
        own.reshape(-1, len(moments), m).transpose(1, 0, 2) for own in (forward, right, steps)
    )
    return steps, left.transpose(0, 2, 1) @ left + of_right.transpose(0, 2, 1) @ of_steps


def _pulls(equations: DrawnEquations) -> Floats:
    """(K - 1, m, 1 + d) slopes of half the cost by jumps, of the residuals and, where noise is coloured, of draws of it."""
    optimum, linear = equations.optimum, equations.linear
    if optimum.coloured is None:
        pulls = linear.right[..., -1:].astype(float), linear.of_data.gradient[:, None]
    else:
        draws = noise_draws(optimum, DRAWS, np.random.default_rng(SEED))
        pulls = equations.pulls(1 + DRAWS, partial(with_draws, optimum.segments, draws))
    return equations.defects(*equations.solved(*pulls)) / RELAXED**2


def moment(segments: Segments, segment: int, records: Sequence[Record]) -> str:
    """When a segment begins, in words."""
    number, time = _begins(segments, segment, records)
    return f"{time:.3g} s{f' of record {number + 1}' if len(records) > 1 else ''}"


def event_between(segments: Segments, first: int, last: int, records: Sequence[Record], gain: float) -> Cause:
    """What happened from the beginning of one segment to that of another; its size is the middle of both, in s."""
    (_, start), (_, end) = (_begins(segments, place, records) for place in (first, last))
    source = f"between {moment(segments, first, records)} and {moment(segments, last, records)}"
    return Cause(EVENT, "", 0.5 * (start + end), "s", gain, 0.5 * (end - start), source=source)


def _begins(segments: Segments, segment: int, records: Sequence[Record]) -> tuple[int, float]:
    """The number of the record in which a segment begins, and the time in s."""
    samples = len(segments.samples)
    begins = np.cumsum([0, *(-(-len(record) // samples) for record in records[:-1])])
    number = int(np.searchsorted(begins, segment, side="right")) - 1
    record = records[number]
    return number, float(record.start + (segment - begins[number]) * samples * record.step)
