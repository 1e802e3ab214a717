"""Score tests (Rao 1948): the local quadratic model of the cost in the parameters and the amplitudes of candidate forces.

At an optimum the Gauss-Newton model of the cost is augmented by forces of amplitude zero, one column each, without a new
search. It predicts the reduction of the cost by any of them and the change of the parameters, for hundreds of forces at the
cost of one step of the fit.

Hypotheses of what a fit may lack: terms of its links, and links of its structure.

Score tests of columns one at a time: what each takes off the cost, its size, and how it changes the coefficients.

Forces with memory along a motion: what a law of displacement and velocity lacks where a joint slips or a mount relaxes.

Scores of missing terms by the marginal likelihood, where random forces act: the part of the log determinant.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from linkwise.arrays import Bools, Floats, Indices
from linkwise.estimates.causes import CAUSE_KINDS
from linkwise.expression import to_text
from linkwise.expression.program import cached_program
from linkwise.likelihood.marginal import is_long
from linkwise.likelihood.random_forces import system_with
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.flow import at_ends_and_middles
from linkwise.likelihood.shooting.linear_model import (
    FactoredModel,
    eliminated_rows,
    precise_model,
    tested_in_pieces,
)
from linkwise.likelihood.shooting.neighbourhoods import as_slice
from linkwise.likelihood.shooting.normal_equations import add_prior_curvature, linearise
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors, evaluate
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.rotations import differ_in_unit
from linkwise.model.structure import Structure
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread


class MemoryForce(ABC):
    """A force of unit size whose state decays by a part of itself over each piece of the motion, and is driven by the rest.

    Its state is zero at the begin of each record; what it was there fades. `text` is what a diagnosis calls it, and `law` the
    name of a law that has it.
    """

    text: str
    law: str

    @abstractmethod
    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """The part (N, L, K) of the state that is left after each piece, and what the piece adds.

        Parameters
        ----------
        change : array of shape (N, L, K)
            The change of the elongation in m over each piece; the first piece, between segments, takes no time.
        duration : array of shape (K,)
            The duration in s of each other piece.
        motion : tuple of array of shape (L, 1)
            The standard deviations of the elongation in m and of its rate in m/s.
        """

    def along(self, motion: Floats, step: Floats, linked: Bools) -> Floats:
        """The force along elongations of some links.

        Parameters
        ----------
        motion : array of shape (2 J + 1, 2, L, K)
            Elongations in m and their rates in m/s, at the ends of the J steps of K segments and in their middles, in turn.
        step : array of shape (K,)
            Duration of a step in s.
        linked : array of bool, shape (K - 1,)
            Which neighbouring segments follow each other.

        Returns
        -------
        array of shape (2 J + 1, L, K)
            The force there; zero where there is no motion.
        """
        path = motion[:, 0]
        spread = np.std(path, axis=(0, 2)), np.std(motion[::2, 1], axis=(0, 2))
        moves = np.isfinite(spread).all(axis=0) & (np.min(spread, axis=0) > 0.0)
        change = np.empty(path.shape)
        np.subtract(path[1:], path[:-1], out=change[1:])
        change[0, :, :1] = 0.0
        # where a segment starts, that before it ends
        np.subtract(path[0, :, 1:], path[-1, :, :-1], out=change[0, :, 1:])
        d, v = (np.where(moves, deviation, 1.0)[:, None] for deviation in spread)
        force = _states(*self.pieces(change, 0.5 * step, (d, v)), linked)
        force[:, ~moves] = 0.0
        return force


def _states(left: Floats, added: Floats, linked: Bools) -> Floats:
    """(N, L, K) z_j = left_j z_(j-1) + added_j along each of K segments, the first following the last of that before it.

    Where segments are not `linked` (K - 1,) it is zero.
    """
    states, follows = added, np.append(False, linked)
    first, states[0] = np.where(follows, added[0], 0.0), 0.0
    fades, carried = np.empty_like(left), np.empty_like(first)
    fades[0] = 1.0
    np.multiply.accumulate(left[1:], axis=0, out=fades[1:])
    for before, part, own in zip(states[:-1], left[1:], states[1:], strict=True):
        own += np.multiply(part, before, out=carried)
    first[:, 1:] += (linked * left[0, :, 1:]) * states[-1, :, :-1]
    # of a segment by that of the one before it: a system of equations with two diagonals
    by_start = np.zeros_like(first)
    by_start[:, :-1] = -(linked * left[0, :, 1:]) * fades[-1, :, :-1]
    starts, _ = dtbtrs(
        np.stack([np.ones(first.size), by_start.ravel()]), first.reshape(-1, 1), uplo="L", diag="U"
    )
    states += fades * starts.reshape(first.shape)
    return states


@dataclass(frozen=True)
class Slip(MemoryForce):
    """A slider that yields over `reach` times the deviation of the elongation, by dz = (dd - z |dd|)/x0.

    That is the model of P. R. Dahl ("A solid friction model", 1968). With a third of the deviation it resembles sliders that
    yield over a twentieth of it to all of it: beside d, d**3 and v their correlation with it is 0.7 to 1, that of sign(v),
    v*abs(v) or d**5 at most 0.7.
    """

    reach: float = 0.3
    text: str = "hysteresis"
    law: str = "bouc-wen"

    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """Exact where the elongation is monotonic over a piece: the state decays towards the sign of the change."""
        left = np.exp(-np.abs(change) / (self.reach * motion[0]))
        return left, np.sign(change) * (1.0 - left)


@dataclass(frozen=True)
class Relaxation(MemoryForce):
    """A spring in series with a damper (Maxwell), z' = v - z/tau; tau is `time` times the ratio of the deviations of d and v.

    That is the time of a radian of a harmonic motion. Those that relax thirty times as fast or ten times as slowly resemble
    it: beside d, d**3 and v their correlation with it is 0.6 to 1. Faster it is a damper, slower a spring.
    """

    time: float = 1.0
    text: str = "relaxation"
    law: str = "zener"

    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """Exact where the rate is constant over a piece."""
        time = self.time * motion[0] / motion[1]
        decay = np.maximum(duration / time, np.finfo(float).tiny)
        left = np.repeat(np.exp(-decay)[None], len(change), axis=0)
        added = change * (-np.expm1(-decay) / decay)
        left[0], added[0] = 1.0, change[0]
        return left, added


MEMORY_FORCES: tuple[MemoryForce, ...] = (Slip(), Relaxation())
"""What a link may lack that no function of its elongation and rate is."""

MEMORY_TERMS = {force.text: force.law for force in MEMORY_FORCES}
"""What a diagnosis calls them, and the name of a law that has each."""

PRICE_OF_REACH = 10.0
"""Of -2 log likelihood, for the reach or the time that a force with memory has beside its size: about the logarithm of the
number of samples, as of any coefficient."""


_COLLINEAR = 1e-6  # of its own curvature: what is left of a column beside the coefficients of the laws
_ROUNDED = 1e-6
"""Of what is left: variance of its score in coloured noise, below which both are rounding; a pole of 0.95 leaves 2.6 %."""


@dataclass(frozen=True, eq=False)
class SingleTests:
    """Of each of f columns alone, with the p coefficients fitted anew to first order, all scaled.

    Attributes
    ----------
    gains : array of shape (f,)
        What it would take off the cost.
    sizes, deviations : array of shape (f,)
        Its size, and the standard deviation of that.
    changes : array of shape (p, f)
        By how much the coefficients would change.
    """

    gains: Floats
    sizes: Floats
    deviations: Floats
    changes: Floats


def single_tests(curvature: Floats, slope: Floats, scatter: Floats, parameters: int) -> SingleTests:
    """Test the columns that follow the `parameters`.

    `scatter` is the covariance of the slope, which is the curvature where noise is white. A column of which the coefficients,
    or unknowns that were eliminated, leave nothing but rounding gains nothing, nor does one that is not finite. Raises
    numpy.linalg.LinAlgError where the equations of the parameters are not finite.
    """
    finite = finite_columns(curvature, slope, scatter, parameters)
    if not finite.all():
        white = scatter is curvature
        within = np.concatenate([np.ones(parameters, dtype=bool), finite])
        curvature, slope = _without(curvature, within), np.where(within, slope, 0.0)
        scatter = curvature if white else _without(scatter, within)
    scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    scaled, gradient = curvature / np.outer(scale, scale), slope / scale
    own, added = slice(0, parameters), slice(parameters, None)
    if not (
        np.isfinite(scaled[own]).all() and np.isfinite(gradient).all()
    ):  # LAPACK may never return from these
        raise np.linalg.LinAlgError("the equations of the parameters are not finite")
    projection = np.linalg.lstsq(
        scaled[own, own], np.column_stack([scaled[own, added], gradient[own]]), rcond=1e-12
    )[0]
    left = scaled[added, added].diagonal() - np.einsum("ij,ij->j", scaled[own, added], projection[:, :-1])
    score = gradient[added] - scaled[added, own] @ projection[:, -1]
    tested = left > _COLLINEAR
    left = np.where(tested, left, 1.0)
    variance = left
    if scatter is not curvature:
        of_slope = scatter / np.outer(scale, scale)
        coupled = np.einsum("ji,ji->i", projection[:, :-1], of_slope[own, added])
        followed = np.einsum("ji,jk,ki->i", projection[:, :-1], of_slope[own, own], projection[:, :-1])
        variance = of_slope[added, added].diagonal() - 2.0 * coupled + followed
        tested &= variance > _ROUNDED * left
        variance = np.where(tested, variance, 1.0)
    gains = np.where(tested, score**2 / variance, 0.0)
    changes = -projection[:, :-1] * (score / left) / scale[own, None]
    return SingleTests(gains, score / left / scale[added], np.sqrt(variance) / left / scale[added], changes)


def finite_columns(curvature: Floats, slope: Floats, scatter: Floats, parameters: int) -> Bools:
    """Which of the f columns after the `parameters` have finite products with these, themselves and the residuals."""
    own, added = slice(0, parameters), slice(parameters, None)
    return np.asarray(
        np.isfinite(slope[added])
        & np.isfinite(curvature[own, added]).all(axis=0)
        & np.isfinite(curvature.diagonal()[added])
        & np.isfinite(scatter[own, added]).all(axis=0)
        & np.isfinite(scatter.diagonal()[added])
    )


def _without(matrix: Floats, within: Bools) -> Floats:
    """The matrix with zeros in the rows and columns that are not `within`."""
    return np.where(within[:, np.newaxis] & within, matrix, 0.0)


_AT_ONCE = 6_000_000  # numbers in the forces of one batch


@dataclass(frozen=True)
class CandidateForce:
    """A force of unit size: `law` without coefficients, between places `first` and `second`, numbered as in a topology."""

    first: int
    second: int
    law: Law | MemoryForce


@dataclass(frozen=True, eq=False)
class LocalQuadratic:
    """-2 log likelihood over the square of the noise factor, about the optimum: c - 2 g'z + z'H z in z = (theta, amplitudes).

    `curvature` (p + f, p + f) H and `slope` (p + f,) g, with nodes, offsets and gains eliminated; `scatter` (p + f, p + f) is
    the covariance of g where the noise is coloured, None where it is H.
    """

    curvature: Floats
    slope: Floats
    scatter: Floats | None


@dataclass(frozen=True, eq=False)
class AugmentedQuadratic:
    """Curvature (k, k) and slope (k,) of the cost in scaled unknowns, and the covariance `scatter` (k, k) of the slope.

    The latter is the curvature itself where the noise is white. `model` is that of the optimum without what is tested.
    """

    curvature: Floats
    slope: Floats
    scatter: Floats
    model: FactoredModel | None = None


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def local_quadratic(optimum: Optimum, forces: Sequence[CandidateForce]) -> LocalQuadratic:
    """The quadratic model at `optimum` in its p parameters and the amplitudes of f `forces`.

    Raises numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        candidates, units = candidate_forces(optimum.segments, optimum.misfit, forces)
        augmented = augmented_quadratic(optimum, candidates)
    return in_their_units(optimum, augmented, units)


def in_their_units(optimum: Optimum, augmented: AugmentedQuadratic, units: Floats) -> LocalQuadratic:
    """The model in the parameters themselves and, after them, in amplitudes whose scaled ones have the `units` (f,)."""
    curvature, slope = augmented.curvature, augmented.slope
    unit = np.concatenate([optimum.scales.theta[: len(slope) - len(units)], units])
    scale = np.outer(unit, unit) * optimum.noise**2
    curvature = curvature / scale
    point = np.concatenate([optimum.point.theta, np.zeros(len(units))])
    return LocalQuadratic(
        curvature,
        slope / unit / optimum.noise**2 + curvature @ point,
        None if optimum.coloured is None else augmented.scatter / scale,
    )


def augmented_quadratic(
    optimum: Optimum,
    candidates: CandidateForces,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> AugmentedQuadratic:
    """The model at `optimum` in p scaled parameters, the amplitudes of `candidates` and the sizes of `errors`.

    It is that of the optimum alone as well, in `blocks` of segments where these are several. Nodes, and the offsets and gains
    that are estimated with the parameters, are eliminated. Raises numpy.linalg.LinAlgError where the equations are singular.
    """
    segments = optimum.segments
    in_pieces = _in_pieces(optimum, candidates, errors)
    if in_pieces is not None:
        return in_pieces
    linear = optimum.linear(candidates, errors, blocks)
    linear, border = precise_model(linear, optimum.q, own=segments.system.parameters.size)
    if border is None:
        raise np.linalg.LinAlgError("the equations at the optimum are not positive definite")
    added = len(candidates.first) + (0 if errors is None else len(errors.channel))
    model = None
    if not border.damped:
        estimated = np.delete(
            np.arange(len(border.schur)), segments.system.parameters.size + np.arange(added)
        )
        model = FactoredModel(linear, border).within(estimated)
    own = slice(0, segments.system.parameters.size + added)
    nuisance = slice(own.stop, None)
    curvature, slope = border.schur[own, own], border.reduced[own]
    follow: Floats = np.zeros((len(border.schur) - own.stop, own.stop))
    if len(follow):  # offsets and gains of sensors
        among, with_own = border.schur[nuisance, nuisance], border.schur[own, nuisance]
        follow = np.asarray(np.linalg.solve(among, with_own.T), dtype=float)
        curvature = curvature - with_own @ follow
        slope = slope - follow.T @ border.reduced[nuisance]
    if optimum.coloured is None:
        return AugmentedQuadratic(curvature, slope, curvature, model)
    rows = eliminated_rows(
        segments, optimum.misfit, optimum.scales, optimum.loss, optimum.q, candidates, errors
    )
    assert rows is not None  # the same equations have a factor
    scores = optimum.coloured.score_covariance(rows, segments.linked, len(segments.samples))
    if segments.prior is not None:
        add_prior_curvature(scores, segments.prior, optimum.scales, segments.system.parameters.size)
    elimination = np.concatenate([np.eye(own.stop), -follow])
    return AugmentedQuadratic(curvature, slope, elimination.T @ scores @ elimination)


def _in_pieces(
    optimum: Optimum, candidates: CandidateForces, errors: SensorErrors | None
) -> AugmentedQuadratic | None:
    """The model of a long record with white noise, without blocks; None of others, and where equations are singular."""
    if optimum.coloured is not None or not is_long(optimum.segments):
        return None
    factor = tested_in_pieces(
        optimum.segments, optimum.misfit, optimum.scales, optimum.loss, optimum.q, candidates, errors
    )
    return None if factor is None else AugmentedQuadratic(factor.schur, factor.reduced, factor.schur)


def candidate_forces(
    segments: Segments, misfit: Misfit, forces: Sequence[CandidateForce]
) -> tuple[CandidateForces, Floats]:
    """The forces along the orbit, scaled to a root mean square of 1, and the scale factors (f,)."""
    motion = _with_points(states_along(segments, misfit), segments.system.at(misfit.point.theta).points)
    pairs = {pair: number for number, pair in enumerate(dict.fromkeys((f.first, f.second) for f in forces))}
    places = np.array(list(pairs), dtype=int).reshape(-1, 2).T % motion.shape[2]
    firsts, seconds = map(as_slice, places)
    elongations = motion[:, :, firsts] - motion[:, :, seconds]
    both = np.empty((len(elongations), len(forces), segments.count), np.float32)
    units = np.ones(len(forces))
    for laws, numbers in _of_equal_pairs(forces):
        size = max(1, _AT_ONCE // (len(laws) * len(elongations) * segments.count))
        for begin in range(0, numbers.shape[1], size):
            some = numbers[:, begin : begin + size]
            among = as_slice(np.array([pairs[forces[k].first, forces[k].second] for k in some[0]]))
            for own, values in zip(some, _along(laws, segments, elongations[:, :, among]), strict=True):
                power = np.einsum("jlk,jlk->l", values[::2], values[::2]) / max(values[::2, 0].size, 1)
                units[own] = 1.0 / np.sqrt(np.where(power > 0.0, power, 1.0))
                both[:, as_slice(own)] = values * units[own, None]
    ends_of_pairs = np.array([[force.first, force.second] for force in forces], dtype=int).reshape(-1, 2)
    return CandidateForces(ends_of_pairs[:, 0], ends_of_pairs[:, 1], both[::2], both[1::2]), units


def _of_equal_pairs(forces: Sequence[CandidateForce]) -> Iterator[tuple[list[Law | MemoryForce], Indices]]:
    """The laws that act between the same L pairs of places, evaluated together, and the numbers (l, L) of their forces."""
    by_law: dict[Law | MemoryForce, list[int]] = {}
    for number, force in enumerate(forces):
        by_law.setdefault(force.law, []).append(number)
    groups: dict[tuple[object, ...], list[Law | MemoryForce]] = {}
    for law, numbers in by_law.items():
        pairs = tuple((forces[number].first, forces[number].second) for number in numbers)
        groups.setdefault((isinstance(law, MemoryForce) and law, pairs), []).append(law)
    for laws in groups.values():
        yield laws, np.array([by_law[law] for law in laws])


def _along(laws: Sequence[Law | MemoryForce], segments: Segments, motion: Floats) -> Iterable[Floats]:
    """Forces (2 J + 1, L, K) by d and v (2 J + 1, 2, L, K) at the ends and in the middles of the steps of tangents."""
    step = segments.step * segments.flow_steps_per_tangent
    plain = tuple(law.expression for law in laws if isinstance(law, Law))
    if plain:
        signals = segments.inputs.signals
        along = [input_along(values, segments.flow_steps_per_tangent)[:, None] for values in signals.values()]
        return cached_program(plain, (*VARIABLES, *signals))(motion[:, 0], motion[:, 1], *along)
    return [law.along(motion, step, segments.linked) for law in laws if isinstance(law, MemoryForce)]


def in_turn(ends: Floats, middles: Floats) -> Floats:
    """(2 J + 1, ...) of values at the ends (J + 1, ...) of steps and in their middles (J, ...)."""
    both = np.empty((len(ends) + len(middles), *ends.shape[1:]))
    both[::2], both[1::2] = ends, middles
    return both


def input_along(points: Floats, refine: int) -> Floats:
    """(2 J + 1, ...) of an input (J refine, 5, ...) that is given at the points of every step of the flow."""
    return in_turn(*at_ends_and_middles(points, refine))


def states_along(segments: Segments, misfit: Misfit) -> Floats:
    """x and v (2 J + 1, 2, n + 2, K) at the ends of the steps of the tangents and in their middles, in turn.

    The base, less its error among the states, and the ground follow the masses. The middles follow from x, v and a at both
    ends, to the sixth order.
    """
    refine, base_error = segments.flow_steps_per_tangent, segments.system.base_error
    orbit, step = misfit.trajectories.thinned(refine), segments.step * refine
    masses = in_turn(orbit.states, orbit.middles(step))
    masses[:, 1] /= step
    base = np.zeros((len(masses), 2, 1, segments.count))
    if segments.inputs.base is not None:
        base[:, :, 0] = input_along(segments.inputs.base, refine)
    if base_error is not None:
        base[:, 0, 0] -= in_turn(orbit.memory, orbit.middle_memory)[:, base_error]
    return np.concatenate([masses, base, np.zeros_like(base)], axis=2)


def _with_points(motion: Floats, points: Floats) -> Floats:
    """(J, 2, n + k + 2, K): before the base the points (k, n) of hosts, in reverse, so that their numbers are indices."""
    if not len(points):
        return motion
    masses, supports = motion[:, :, :-2], motion[:, :, -2:]
    of_points = np.einsum("pn,jdnk->jdpk", points[::-1], masses)
    return np.concatenate([masses, of_points, supports], axis=2)


_TERMS = tuple(
    map(
        Law.parse,
        ("1", "d", "d*abs(d)", "d**2", "d**3", "d**5", "v", "v*abs(v)", "v**3", "sign(v)", "v*d**2"),
    )
)
BETWEEN_MODES = "damping between modes"
"""The kind of a hypothesis of damping that a host lacks, whose place is the link that would hold it."""

_USUAL = ("d*abs(d)", "d**3", "d**5", "v*abs(v)", "sign(v)", *MEMORY_TERMS)
_OF_MODES = tuple(map(Law.parse, ("d", "v")))  # a frequency or a damping that is off
_OF_LINKS = tuple(map(Law.parse, ("d", "v", "d**3")))
_LINKS = 40  # that are tested, in the structure's order
_PAIRS = 40  # without a link, up to which all of them are tested


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be wrong, with the words of a `Cause`; `in_units_of` states the `unit` of all but forces."""

    kind: str
    where: str
    term: str = ""
    source: str = ""
    unit: str = ""


def in_units_of(hypotheses: Iterable[Hypothesis], structure: Structure) -> tuple[Hypothesis, ...]:
    """Hypotheses with the unit of their size: that of their force, of their kind, or of the channel that they are in."""
    return tuple(
        replace(
            lacking, unit=lacking.unit or CAUSE_KINDS[lacking.kind].unit or unit_in(structure, lacking.where)
        )
        for lacking in hypotheses
    )


Lacking = list[tuple[Hypothesis, CandidateForce]]
"""What links or the structure may lack, with the force of each."""


def missing_forces(structure: Structure, estimated: Collection[str] = ()) -> Lacking:
    """Terms that links may lack, and links that the structure may lack; as `missing_terms`."""
    return missing_terms(structure, estimated) + _missing_links(structure)


def usual_terms(structure: Structure, estimated: Collection[str] = ()) -> Lacking:
    """The few terms that links lack most often, for fits that leave no more than noise."""
    every = missing_terms(structure, estimated)
    return [every[number] for number in which_usual([hypothesis for hypothesis, _ in every], structure)]


def which_usual(hypotheses: Sequence[Hypothesis], structure: Structure) -> list[int]:
    """The numbers of the `usual_terms` among hypotheses."""
    return [
        number
        for number, hypothesis in enumerate(hypotheses)
        if hypothesis.kind == "term" and hypothesis.term in _USUAL and hypothesis.where not in structure.modes
    ]


def which_between_modes(hypotheses: Sequence[Hypothesis]) -> list[int]:
    """The numbers of those of damping between modes of hosts."""
    return [number for number, hypothesis in enumerate(hypotheses) if hypothesis.kind == BETWEEN_MODES]


def missing_terms(structure: Structure, estimated: Collection[str] = ()) -> Lacking:
    """Terms that links may lack; modes of hosts come last.

    Terms whose coefficients are among those `estimated`, by name, are there: their scores are rounding.
    """
    names = [link.name for link in structure.links if _offered(link, structure)]
    tested = set(sorted(names, key=lambda name: name in structure.modes)[:_LINKS])
    return [
        (_of_term(link.name, law, structure), CandidateForce(first, second, law))
        for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True)
        if link.name in tested
        for law in _lacking(link, structure, estimated)
    ]


def _lacking(link: Link, structure: Structure, estimated: Collection[str]) -> list[Law | MemoryForce]:
    """What a link may lack that is not among its terms with coefficients `estimated`."""
    present = linear_terms(link, estimated)
    return [law for law in _offered(link, structure) if law.text.replace(" ", "") not in present]


def _offered(link: Link, structure: Structure) -> tuple[Law | MemoryForce, ...]:
    """What a link may lack; one with states has its memory, a damper between modes nothing."""
    if link.name in structure.modes:
        return _OF_MODES if link.name in structure.mass_names else ()
    return _TERMS if link.states else (*_TERMS, *MEMORY_FORCES)


def linear_terms(link: Link, estimated: Collection[str] | None = None) -> set[str]:
    """The terms of the law of a link that have a coefficient each, as hypotheses write them; of those `estimated` only."""
    return {
        Law.parse(to_text(link.law.basis[name])).text.replace(" ", "")
        for name in link.law.linear
        if estimated is None or f"{link.name}.{name}" in estimated
    }


def _of_term(link: str, law: Law | MemoryForce, structure: Structure) -> Hypothesis:
    """A term that a link lacks; a force like d beside that of a mode is an error of its frequency."""
    kind = "frequency" if link in structure.modes and law.text == "d" else "term"
    unit = structure.link(link).law.force_unit if kind == "term" else "1"
    return Hypothesis(kind, link, law.text, unit=unit)


def _missing_links(structure: Structure) -> Lacking:
    """Links between masses or points, and from one to the ground, that are not there; none where there are too many of them.

    Where links end at the base, so may those; at the ground as well only where a link does. None joins a rotation and what
    moves along a line: its force would have no unit.
    """
    linked = {frozenset(link.between) for link in structure.links}
    supports = [end for end in (GROUND, BASE) if any(end in pair for pair in linked)] or [GROUND]
    ends = [
        *((name, support) for name in structure.places for support in supports),
        *((second, first) for first, second in combinations(structure.places, 2)),
    ]
    rotations = structure.rotations
    free = [pair for pair in ends if frozenset(pair) not in linked and not differ_in_unit(pair, rotations)]
    if len(free) > _PAIRS:
        return []
    index = structure.topology.index
    return [
        (
            Hypothesis("link", "-".join(pair), law.text, unit=unit_in(structure, f"force:{pair[0]}")),
            CandidateForce(index[pair[0]], index[pair[1]], law),
        )
        for pair in free
        for law in _OF_LINKS
    ]


_STEP = 0.5  # deviations of its size: for the difference of the log determinant


def determinant_slopes(
    optimum: Optimum,
    identified: Structure,
    masses: Sequence[str],
    candidates: Sequence[tuple[CandidateForce, float]],
) -> Floats:
    """What the log determinant of the equations of the states adds to the gradient J'r.

    Parameters
    ----------
    optimum : Optimum
        The optimum, with random forces.
    identified : Structure
        The structure with its values there.
    masses : sequence of str
        The masses that the random forces act on.
    candidates : sequence of (CandidateForce, float)
        The c candidate terms, and the standard deviations of their coefficients.

    Returns
    -------
    array of shape (c,)
        The addition for each candidate, by its coefficient.
    """
    # parts do not stand for the whole: log det with a term changes with the size of the motion
    whole = _without_unknowns(optimum)
    still = _log_determinant(whole, identified, masses)
    slopes = []
    for force, deviation in candidates:
        size = _STEP * deviation
        changed = _log_determinant(whole, _with_term(identified, force, size), masses)
        slopes.append(-0.5 * (changed - still) / size)
    return np.asarray(np.nan_to_num(np.array(slopes)))


def _without_unknowns(optimum: Optimum) -> Optimum:
    """The optimum with parameters that are numbers."""
    segments, p = optimum.segments, len(optimum.point.theta)
    assert segments.random is not None
    return replace(
        optimum,
        segments=replace(segments, prior=None, random=replace(segments.random, slope=None, origin=None)),
        misfit=replace(optimum.misfit, point=replace(optimum.point, theta=np.zeros(0))),
        scales=replace(optimum.scales, theta=optimum.scales.theta[p:]),
    )


def _with_term(structure: Structure, force: CandidateForce, size: float) -> Structure:
    names = {**dict(enumerate(structure.mass_names)), -1: GROUND, -2: BASE}
    signals = dict(force.law.signal_units) if isinstance(force.law, Law) else {}
    law = Law.parse(f"size*({force.law.text})", signals=signals)
    link_names, name = {link.name for link in structure.links}, "tested"
    while name in link_names:
        name += "_"
    ends = (names[force.first], names[force.second])
    link = Link(name, ends, law, {"size": size})
    return replace(structure, links=(*structure.links, link))


def _log_determinant(optimum: Optimum, structure: Structure, masses: Sequence[str]) -> float:
    sample = float(np.min(optimum.segments.step)) * optimum.segments.refine
    segments = replace(optimum.segments, system=system_with(structure, masses, sample))
    misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
    factor = linearise(segments, misfit, optimum.scales, optimum.loss).equations(optimum.q).factor()
    return float("nan") if factor is None else factor.root.log_determinant
