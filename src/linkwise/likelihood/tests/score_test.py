"""Score tests (Rao 1948): the cost about an optimum in the parameters and in the sizes of what is tested, all zero.

The Gauss-Newton model of the cost is augmented by one column for each force or error, without a new search. It predicts the
reduction of the cost by any of them and the change of the parameters, for hundreds of columns at the cost of one step of the
fit: `Quadratic` is that model, its `tests` what each column alone would do.

Hypotheses are terms of links and links of a structure that a fit may lack, among them forces with memory along the motion:
what a law of displacement and velocity lacks where a joint slips or a mount relaxes. Where random forces act, the score of a
term has the slope of the log determinant as well (`determinant_slopes`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
from linkwise.likelihood.shooting.flow import input_along
from linkwise.likelihood.shooting.linear_model import eliminated_rows, linear_model, tested_in_pieces
from linkwise.likelihood.shooting.normal_equations import (
    FactoredModel,
    add_prior_curvature,
    linearise,
    precise_model,
)
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, Segments, SensorErrors
from linkwise.likelihood.shooting.tangents import (
    CandidateForces,
    Single,
    extra_columns,
    tangents,
    whitened_jacobian,
)
from linkwise.model.coefficient import MASS, Coefficient
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import BASE, GROUND, Link, differ_in_unit
from linkwise.model.structure import Structure
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread

Pieces = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""The part (N, K) of a state that is left after each piece of a motion, and what the piece adds.

By the change of the elongation in m (N, K), the duration in s (K,), which the first piece, between segments, takes nothing of,
and the standard deviations (2,) of the elongation in m and of its rate in m/s.
"""


@dataclass(frozen=True)
class MemoryForce:
    """A force of unit size whose state decays by a part of itself over each piece of the motion, and is driven by the rest.

    Its state is zero at the begin of each record; what it was there fades. `text` is what a diagnosis calls it, and `law` the
    name of a law that has it.
    """

    text: str
    law: str
    pieces: Pieces

    def along(self, motion: Floats, step: Floats, linked: Bools) -> Floats:
        """The force along the elongation of a link.

        Parameters
        ----------
        motion : array of shape (2 J + 1, 2, K)
            The elongation of the link in m and its rate in m/s, at the ends of the J steps of K segments and in their middles,
            in turn.
        step : array of shape (K,)
            Duration of a step in s.
        linked : array of bool, shape (K - 1,)
            Which neighbouring segments follow each other.

        Returns
        -------
        array of shape (2 J + 1, K)
            The force there; zero where there is no motion.
        """
        path, spread = motion[:, 0], np.array([np.std(motion[:, 0]), np.std(motion[::2, 1])])
        if not (np.isfinite(spread).all() and (spread > 0.0).all()):
            return np.zeros(path.shape)
        before = np.roll(path[-1:], 1, axis=1)  # where the segment before ends
        left, added = self.pieces(np.diff(path, axis=0, prepend=before), 0.5 * step, spread)
        return _states(left, added, np.append(False, linked))


def _states(left: Floats, added: Floats, follows: Bools) -> Floats:
    """(N, K) z_j = left_j z_(j-1) + added_j along each of K segments, the first following the last of that before it.

    Where segments do not follow (K,) it is zero. That is a system of equations with two diagonals.
    """
    left[0] *= follows
    added[0] *= follows
    diagonals = np.stack([np.ones(left.size), np.roll(-left.T.ravel(), -1)])
    states, _ = dtbtrs(diagonals, added.T.reshape(-1, 1), uplo="L", diag="U")
    return np.asarray(states.reshape(added.T.shape).T)


_REACH = 0.3  # of the standard deviation of the elongation


def _slip(change: Floats, duration: Floats, motion: Floats) -> tuple[Floats, Floats]:
    """A slider that yields over a reach, by dz = (dd - z |dd|)/x0; exact where the elongation is monotonic over a piece.

    That is the model of P. R. Dahl ("A solid friction model", 1968). With a third of the deviation it resembles sliders that
    yield over a twentieth of it to all of it: beside d, d**3 and v their correlation with it is 0.7 to 1, that of sign(v),
    v*abs(v) or d**5 at most 0.7.
    """
    left = np.exp(-np.abs(change) / (_REACH * motion[0]))
    return left, np.sign(change) * (1.0 - left)


def _relaxation(change: Floats, duration: Floats, motion: Floats) -> tuple[Floats, Floats]:
    """A spring in series with a damper (Maxwell), z' = v - z/tau; exact where the rate is constant over a piece.

    The time tau is the ratio of the deviations of d and v, that of a radian of a harmonic motion. Those that relax thirty
    times as fast or ten times as slowly resemble it: beside d, d**3 and v their correlation with it is 0.6 to 1. Faster it is
    a damper, slower a spring.
    """
    time = motion[0] / motion[1]
    decay = np.maximum(duration / time, np.finfo(float).tiny)
    left = np.repeat(np.exp(-decay)[None], len(change), axis=0)
    added = change * (-np.expm1(-decay) / decay)
    left[0], added[0] = 1.0, change[0]
    return left, added


MEMORY_FORCES = (
    MemoryForce("hysteresis", "bouc-wen", _slip),
    MemoryForce("relaxation", "zener", _relaxation),
)
"""What a link may lack that no function of its elongation and rate is."""

MEMORY_TERMS = {force.text: force.law for force in MEMORY_FORCES}
"""What a diagnosis calls them, and the name of a law that has each."""

PRICE_OF_REACH = 10.0
"""Of -2 log likelihood, for the reach or the time that a force with memory has beside its size: about the logarithm of the
number of samples, as of any coefficient."""


_SINGULAR = 1e-12
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
    finite : array of bool, shape (f,)
        Whether its products with the coefficients, itself and the residuals are finite; else it gains nothing.
    """

    gains: Floats
    sizes: Floats
    deviations: Floats
    changes: Floats
    finite: Bools


@dataclass(frozen=True)
class CandidateForce:
    """A force of unit size: `law` without coefficients, between places `first` and `second`, numbered as in a topology."""

    first: int
    second: int
    law: Law | MemoryForce


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The cost about an optimum, c - 2 g'z + z'H z, in p parameters and what is tested beside them; all else is eliminated.

    `curvature` (k, k) H and `slope` (k,) g, and the covariance `scatter` (k, k) of g, None where noise is white, so that it is
    H. `model` is that of the optimum without what is tested, where masses are few or it was asked for in blocks.
    """

    curvature: Floats
    slope: Floats
    scatter: Floats | None = None
    model: FactoredModel | None = None

    def within(self, order: Sequence[int] | Indices) -> Quadratic:
        """That of some unknowns alone, in an order."""
        chosen = np.array(order)
        block = np.ix_(chosen, chosen)
        scatter = None if self.scatter is None else self.scatter[block]
        return Quadratic(self.curvature[block], self.slope[chosen], scatter, self.model)

    def without(self, gone: Indices) -> Quadratic:
        """That in the others, which some unknowns follow to where the cost is least."""
        if not len(gone):
            return self
        kept = np.setdiff1d(np.arange(len(self.slope)), gone)
        scale = 1.0 / np.sqrt(np.maximum(self.curvature.diagonal()[gone], np.finfo(float).tiny))
        squares, products = self.curvature[np.ix_(gone, gone)], self.curvature[np.ix_(gone, kept)]
        solved = np.linalg.lstsq(squares * np.outer(scale, scale), products * scale[:, None], rcond=_SINGULAR)
        following = np.eye(len(self.slope))[:, kept]
        following[gone] = -scale[:, None] * solved[0]
        scatter = None if self.scatter is None else following.T @ self.scatter @ following
        curvature = self.curvature[np.ix_(kept, kept)] + products.T @ following[gone]
        return Quadratic(curvature, following.T @ self.slope, scatter, self.model)

    def summed(self, sums: Floats) -> Quadratic:
        """That in unknowns each of which stands for several of these, added up by `sums` (k, h)."""
        scatter = None if self.scatter is None else sums.T @ self.scatter @ sums
        return Quadratic(sums.T @ self.curvature @ sums, sums.T @ self.slope, scatter, self.model)

    def in_units(self, optimum: Optimum, units: Floats) -> Quadratic:
        """That in the parameters themselves, and in sizes whose scaled ones have the `units` (h,), as -2 log likelihood."""
        unit = np.concatenate([optimum.scales.theta[: len(self.slope) - len(units)], units])
        scale = np.outer(unit, unit) * optimum.noise**2
        curvature = self.curvature / scale
        slope = self.slope / unit / optimum.noise**2
        slope = slope + curvature @ np.concatenate([optimum.point.theta, np.zeros(len(units))])
        return Quadratic(curvature, slope, None if self.scatter is None else self.scatter / scale)

    def tests(self, parameters: int) -> SingleTests:
        """The tests of the columns that follow so many parameters.

        A column of which the coefficients, or unknowns that were eliminated, leave nothing but rounding gains nothing, nor
        does one that is not finite. Raises numpy.linalg.LinAlgError where the equations of the parameters are not finite.
        """
        curvature, slope, scatter = self.curvature, self.slope, self.scatter
        own, added = slice(0, parameters), slice(parameters, None)
        finite = np.isfinite(slope[added])
        for matrix in (curvature,) if scatter is None else (curvature, scatter):
            finite &= np.isfinite(matrix[own, added]).all(axis=0) & np.isfinite(matrix.diagonal()[added])
        if not finite.all():
            within = np.append(np.ones(parameters, dtype=bool), finite)
            both = np.outer(within, within)
            curvature, slope = np.where(both, curvature, 0.0), np.where(within, slope, 0.0)
            scatter = None if scatter is None else np.where(both, scatter, 0.0)
        scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
        scaled, gradient = curvature / np.outer(scale, scale), slope / scale
        # LAPACK may never return from what is not finite
        if not (np.isfinite(scaled[own]).all() and np.isfinite(gradient).all()):
            raise np.linalg.LinAlgError("the equations of the parameters are not finite")
        projection = np.linalg.lstsq(
            scaled[own, own], np.column_stack([scaled[own, added], gradient[own]]), rcond=_SINGULAR
        )[0]
        left = scaled[added, added].diagonal() - np.einsum("ij,ij->j", scaled[own, added], projection[:, :-1])
        score = gradient[added] - scaled[added, own] @ projection[:, -1]
        tested = left > _COLLINEAR
        left = np.where(tested, left, 1.0)
        variance = left
        if scatter is not None:
            of_slope = scatter / np.outer(scale, scale)
            coupled = np.einsum("ji,ji->i", projection[:, :-1], of_slope[own, added])
            followed = np.einsum("ji,jk,ki->i", projection[:, :-1], of_slope[own, own], projection[:, :-1])
            variance = of_slope[added, added].diagonal() - 2.0 * coupled + followed
            tested &= variance > _ROUNDED * left
            variance = np.where(tested, variance, 1.0)
        sizes = score / left
        return SingleTests(
            np.where(tested, score**2 / variance, 0.0),
            sizes / scale[added],
            np.sqrt(variance) / left / scale[added],
            -projection[:, :-1] * sizes / scale[own, None],
            finite,
        )


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def local_quadratic(optimum: Optimum, forces: Sequence[CandidateForce]) -> Quadratic:
    """-2 log likelihood about `optimum` in its p parameters and the amplitudes of f `forces`.

    Raises numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        candidates, units = candidate_forces(optimum.segments, optimum.misfit, forces)
        return augmented_quadratic(optimum, candidates).in_units(optimum, units)


def augmented_quadratic(
    optimum: Optimum,
    candidates: CandidateForces,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> Quadratic:
    """The cost at `optimum` in p scaled parameters, the amplitudes of `candidates` and the sizes of `errors`.

    The model of the optimum alone is in `blocks` of segments where these are several. Nodes, and the offsets and gains that
    are estimated with the parameters, are eliminated. Raises numpy.linalg.LinAlgError where the equations are singular.
    """
    segments, misfit, q = optimum.segments, optimum.misfit, optimum.q
    parameters, added = segments.system.parameters.size, sum(extra_columns(candidates, errors))
    own, total = parameters + added, segments.parameters + added
    estimated, of_sensors = np.r_[:parameters, own:total], np.arange(own, total)  # offsets and gains follow
    if optimum.coloured is None and is_long(segments):
        border = tested_in_pieces(misfit, q, candidates, errors, estimated)
        if border is not None:
            return Quadratic(border.schur, border.reduced).without(of_sensors)
    linear = linear_model(misfit, candidates, errors, blocks)
    linear, border = precise_model(linear, q, own=parameters, kept=estimated)
    if border is None:
        raise np.linalg.LinAlgError("the equations at the optimum are not positive definite")
    schur, reduced, model = border.schur, border.reduced, None
    if not border.damped:
        model = FactoredModel(linear.within(estimated), border.within(estimated))
    scores = None
    if optimum.coloured is not None:
        rows = eliminated_rows(misfit, q, candidates, errors)
        assert rows is not None  # the same equations have a factor
        scores = optimum.coloured.score_covariance(rows, segments.linked, len(segments.samples))
        if segments.prior is not None:
            add_prior_curvature(scores, segments.prior, optimum.scales, parameters)
    return Quadratic(schur, reduced, scores, model).without(of_sensors)


def candidate_forces(
    segments: Segments, misfit: Misfit, forces: Sequence[CandidateForce]
) -> tuple[CandidateForces, Floats]:
    """The forces along the orbit, scaled to a root mean square of 1, and the scale factors (f,)."""
    along, units = forces_along(segments, misfit, forces)
    ends = np.array([[force.first, force.second] for force in forces], dtype=int).reshape(-1, 2)
    return CandidateForces(ends[:, 0], ends[:, 1], [*along.transpose(1, 0, 2)]), units


def forces_along(
    segments: Segments, misfit: Misfit, forces: Sequence[CandidateForce]
) -> tuple[Single, Floats]:
    """(2 J + 1, f, K) the forces at the ends and in the middles of the steps of tangents, scaled as of `candidate_forces`."""
    motion = _with_points(states_along(segments, misfit), segments.system.at(misfit.point.theta).points)
    every = segments.flow_steps_per_tangent
    along = {name: input_along(values, every) for name, values in segments.inputs.signals.items()}
    both = np.empty((len(motion), len(forces), segments.count), np.float32)
    units = np.ones(len(forces))

    def put(number: int, values: Floats) -> None:
        power = float(np.einsum("jk,jk->", values[::2], values[::2])) / values[::2].size
        units[number] = 1.0 / np.sqrt(power) if power > 0.0 else 1.0
        np.multiply(values, units[number], out=both[:, number], casting="same_kind")

    plain = dict[tuple[int, int], dict[int, Law]]()
    for number, force in enumerate(forces):
        if isinstance(force.law, Law):
            plain.setdefault((force.first, force.second), {})[number] = force.law
        else:
            elongation = motion[:, :, force.first] - motion[:, :, force.second]
            put(number, force.law.along(elongation, segments.step * every, segments.linked))
    for (first, second), laws in plain.items():
        program = cached_program(tuple(law.expression for law in laws.values()), (*VARIABLES, *along))
        d, v = (motion[:, kind, first] - motion[:, kind, second] for kind in (0, 1))
        for number, values in zip(laws, program(d, v, *along.values()), strict=True):
            put(number, values)
    return both, units


def states_along(segments: Segments, misfit: Misfit) -> Floats:
    """x and v (2 J + 1, 2, n + 2, K) at the ends of the steps of the tangents and in their middles, in turn.

    The base, less its error among the states, and the ground follow the masses. The middles follow from x, v and a at both
    ends, to the sixth order.
    """
    refine, base_error = segments.flow_steps_per_tangent, segments.system.base_error
    orbit, step = misfit.trajectories.thinned(refine), segments.step * refine
    masses = orbit.half_states(step)
    masses[:, 1] /= step
    base = np.zeros((len(masses), 2, 1, segments.count))
    if segments.inputs.base is not None:
        base[:, :, 0] = input_along(segments.inputs.base, refine)
    if base_error is not None:
        base[:, 0, 0] -= orbit.half_memory[:, base_error]
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
FILTER = "filter"
"""The kind of a hypothesis of a filter that all sensors share."""

BETWEEN_MODES = "damping between modes"
"""The kind of a hypothesis of damping that a host lacks, whose place is the link that would hold it."""

ASYMMETRY = "d**2"
"""The term by which one well of a bistable link, or one side of any, differs from the other."""

_USUAL = ("d*abs(d)", ASYMMETRY, "d**3", "d**5", "v*abs(v)", "sign(v)", *MEMORY_TERMS)
_OF_MODES = tuple(map(Law.parse, ("d", "v")))  # a frequency or a damping that is off
_OF_LINKS = tuple(map(Law.parse, ("d", "v", "d**3")))
_LINKS = 40  # that are tested, in the structure's order
_PAIRS = 40  # without a link, up to which all of them are tested


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be wrong, with the words of a `Cause`; the `unit` of a force, of others as `unit_of` says."""

    kind: str
    where: str
    term: str = ""
    source: str = ""
    unit: str = ""

    @property
    def name(self) -> str:
        """What it is and where, as of a `Cause`."""
        return f"{self.term or self.kind} of {self.where}" + (f" from {self.source}" if self.source else "")

    @cached_property
    def is_usual(self) -> bool:
        """Whether it is one of the few terms that links lack most often."""
        return self.kind == "term" and self.term in _USUAL


def unit_of(hypothesis: Hypothesis, structure: Structure) -> str:
    """The unit of its size: that of its force, of its kind, or of the channel that it is in."""
    return hypothesis.unit or CAUSE_KINDS[hypothesis.kind].unit or unit_in(structure, hypothesis.where)


Lacking = list[tuple[Hypothesis, CandidateForce]]
"""What links or the structure may lack, with the force of each."""


def missing_terms(structure: Structure, estimated: Collection[str] = ()) -> Lacking:
    """Terms that links may lack; modes of hosts come last.

    Terms whose coefficients are among those `estimated`, by name, are there: their scores are rounding.
    """
    modes, lacking = structure.modes, []
    offered = {link.name: laws for link in structure.links if (laws := _offered(link, structure))}
    tested = sorted(offered, key=lambda name: name in modes)[:_LINKS]
    for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True):
        if link.name not in tested:
            continue
        present, unit = linear_terms(link, estimated), link.law.force_unit
        for law in offered[link.name]:
            if law.text.replace(" ", "") in present:
                continue
            if link.name in modes and law.text == "d":  # beside that of the mode
                hypothesis = Hypothesis("frequency", link.name, law.text, unit="1")
            else:
                hypothesis = Hypothesis("term", link.name, law.text, unit=unit)
            lacking.append((hypothesis, CandidateForce(first, second, law)))
    return lacking


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


def missing_links(structure: Structure) -> Lacking:
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
_LARGEST_STEP = (
    0.05  # of a mass, which coefficients make up for nearly all of, so that its size may hardly be known
)


_SIMPSON = 1.0 / 3.0, 2.0 / 3.0  # of a step: weights of its ends, which two steps share, and of its middle
_BASE = -2  # as an end of a force


def determinant_slopes(
    optimum: Optimum,
    identified: Structure,
    masses: Sequence[str],
    candidates: Sequence[tuple[CandidateForce | Hypothesis, float]],
    channels: Sequence[str] = (),
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
    candidates : sequence of (CandidateForce or Hypothesis, float)
        The c candidate terms, and relative errors of masses and gains, with the standard deviations of their sizes.
    channels : sequence of str, optional
        The responses, of whose gains there are errors.

    Returns
    -------
    array of shape (c,)
        The addition for each candidate, by its size.
    """
    # parts do not stand for the whole: log det with a term changes with the size of the motion
    whole, slopes = _without_unknowns(optimum), np.zeros(len(candidates))
    sample = float(np.min(whole.segments.step)) * whole.segments.refine
    segments = replace(whole.segments, system=system_with(identified, masses, sample))
    whole = replace(whole, misfit=replace(whole.misfit, segments=segments))
    forces = {k: one for k, (one, _) in enumerate(candidates) if isinstance(one, CandidateForce)}
    slopes[list(forces)] = _slopes_by_forces(whole, list(forces.values()))
    still = np.nan if len(forces) == len(candidates) else _log_determinant(whole)
    for number, (candidate, deviation) in enumerate(candidates):
        if isinstance(candidate, CandidateForce):
            continue
        size = _STEP * deviation
        if candidate.kind == MASS:
            size = min(size, _LARGEST_STEP)
            heavier = system_with(_with_heavier(identified, candidate.where, 1.0 + size), masses, sample)
            misfit = replace(whole.misfit, segments=replace(whole.segments, system=heavier))
        else:
            sigma = whole.scales.sigma.copy()
            sigma[channels.index(candidate.where)] /= 1.0 + size
            misfit = replace(whole.misfit, scales=replace(whole.scales, sigma=sigma))
        slopes[number] = -0.5 * (_log_determinant(replace(whole, misfit=misfit)) - still) / size
    return np.nan_to_num(slopes)


def _slopes_by_forces(optimum: Optimum, forces: Sequence[CandidateForce]) -> Floats:
    """(f,) the slopes by sizes of forces, from one factor: half the trace of H^-1 times the derivative of H.

    A force changes H by its own derivatives along each segment, of which `_pulls` are the weights; the motion is held.
    """
    segments, system = optimum.segments, optimum.segments.system.at(optimum.point.theta)
    misfit = optimum.misfit.at(optimum.point)
    motion = _with_points(states_along(segments, misfit), system.points)
    every, slopes = segments.flow_steps_per_tangent, np.zeros(len(forces))
    along = {name: input_along(values, every) for name, values in segments.inputs.signals.items()}
    pairs = {(force.first, force.second): _between(optimum, force.first, force.second) for force in forces}
    for point, pull in enumerate(_pulls(optimum, misfit)):
        weights = {pair: stretched @ pull @ pushed for pair, (stretched, pushed) in pairs.items()}
        signals = {name: values[point] for name, values in along.items()}
        for number, force in enumerate(forces):
            assert isinstance(force.law, Law)
            d, v = motion[point, :, force.first] - motion[point, :, force.second]
            partials = force.law.partials(d, v, signals)
            by_d, by_v = weights[force.first, force.second].T
            slopes[number] -= float(partials.by_d @ by_d + partials.by_v @ by_v)
    return slopes


def _between(optimum: Optimum, first: int, second: int) -> tuple[Floats, Floats]:
    """(2, m) how states, in their units, stretch a link and add to its rate, and (m,) their rates by a force in it."""
    system, scale, n = optimum.segments.system, optimum.scales.state, len(optimum.segments.system.incidence)
    masses = system.at(optimum.point.theta).masses
    stretched, pushed = np.zeros((2, len(scale))), np.zeros(len(scale))
    for end, side in ((first, 1.0), (second, -1.0)):
        if end >= 0:
            stretched[[0, 1], [end, n + end]] = side
            pushed[n + end] = -side / masses[end]
        elif end == _BASE and system.base_error is not None:
            stretched[0, 2 * n + system.base_error] = -side
    return stretched * scale, pushed / scale


def _pulls(optimum: Optimum, misfit: Misfit) -> Iterator[Floats]:
    """(K, m, m) half the derivative of log det H by a change of the rates of the states, in their units, at ends and middles
    of J steps in turn, 2 J + 1 in all.

    With the flow F from a node to there and A to the end of the segment, a change E adds A F^-1 E F times its duration to A.
    """
    segments, every = optimum.segments, slice(0, optimum.segments.count)
    linear = linearise(misfit)
    factor = linear.equations(optimum.q).factor()
    if factor is None:
        return
    inverse, couplings = factor.inverse_blocks()
    m, turned = segments.system.dimension, inverse[:-1] @ linear.state_ends.transpose(0, 2, 1)
    turned -= couplings.transpose(0, 2, 1) * linear.joined[:, None]
    by_ends = np.zeros_like(inverse)
    by_ends[:-1] = turned @ linear.state_ends / optimum.q**2
    rows = whitened_jacobian(misfit, every)[0][:, :, :m].astype(float)
    shown = inverse @ rows.transpose(0, 2, 1)
    step, sample = segments.step * segments.flow_steps_per_tangent, 2 * segments.tangents_before
    last = 2 * (segments.steps // segments.flow_steps_per_tangent)
    for point, flow in enumerate(_flows(optimum, misfit)):
        share, pulled = _SIMPSON[point % 2] * (0.5 if point in (0, last) else 1.0), by_ends
        if point <= sample > 0:
            pulled = pulled + (0.5 if point == sample else 1.0) * (shown @ rows)
        pull = (share * step)[:, None, None] * (flow @ pulled @ np.linalg.inv(flow))
        if point == sample:
            _add_accelerometers(pull, optimum, misfit, flow @ shown)
        yield pull


def _add_accelerometers(pull: Floats, optimum: Optimum, misfit: Misfit, shown: Floats) -> None:
    """What accelerometers, whose part of the inverse is `shown` (K, m, C), add to the derivative at a sample."""
    segments, scales, n = optimum.segments, optimum.scales, len(optimum.segments.system.incidence)
    roots = misfit.weights(slice(None))[0][0] / segments.deviations(scales)
    factors = segments.sensors.factors(misfit.point.gains)
    for channel in np.flatnonzero(segments.sensors.kind == A).tolist():
        row = n + int(segments.sensors.mass[channel])
        weight = roots[channel] * factors[channel] * scales.state[row]
        pull[:, :, row] += weight[:, None] * shown[:, :, channel]


def _flows(optimum: Optimum, misfit: Misfit) -> Iterator[Floats]:
    """(K, m, m) sensitivities of the states to those at the nodes, in their units, at ends and middles of steps in turn."""
    segments, scale, every = optimum.segments, optimum.scales.state, optimum.segments.flow_steps_per_tangent
    step, orbit = segments.step * every, misfit.trajectories.thinned(every)
    inputs = segments.inputs.at(misfit.point.gains, misfit.point.delays)
    steps = tangents(segments.system.at(misfit.point.theta), orbit, step, scale, np.empty(0), inputs=inputs)
    last = None
    for tangent in steps:
        x, u, memory = (np.array(part, dtype=float) for part in (*tangent.state, tangent.memory))
        if last is not None:
            x0, u0, memory0 = last
            between = 0.5 * (x + x0) - (u - u0) / 8.0, 1.5 * (x - x0) - 0.25 * (u + u0)
            yield _in_units(*between, 0.5 * (memory + memory0), step, scale)
        yield _in_units(x, u, memory, step, scale)
        last = x, u, memory


def _in_units(x: Floats, u: Floats, memory: Floats, step: Floats, scale: Floats) -> Floats:
    return np.concatenate([x, u / step, memory]).transpose(2, 0, 1) / scale[:, None]


def _with_heavier(structure: Structure, name: str, factor: float) -> Structure:
    """The structure, which has values, with one mass times a factor."""
    values = dict(zip(structure.mass_names, structure.mass_values.tolist(), strict=True))
    masses = (
        replace(mass, mass=Coefficient.number(factor * values[name])) if mass.name == name else mass
        for mass in structure.masses
    )
    return replace(structure, masses=tuple(masses))


def _without_unknowns(optimum: Optimum) -> Optimum:
    """The optimum with parameters that are numbers."""
    segments, p = optimum.segments, len(optimum.point.theta)
    assert segments.random is not None
    misfit = replace(
        optimum.misfit,
        segments=replace(segments, prior=None, random=replace(segments.random, slope=None, origin=None)),
        point=replace(optimum.point, theta=np.zeros(0)),
        scales=replace(optimum.scales, theta=optimum.scales.theta[p:]),
    )
    return replace(optimum, misfit=misfit)


def _log_determinant(optimum: Optimum) -> float:
    factor = linearise(optimum.misfit.at(optimum.point)).equations(optimum.q).factor()
    return float("nan") if factor is None else factor.root.log_determinant
