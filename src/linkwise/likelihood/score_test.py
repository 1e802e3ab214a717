"""Score tests (Rao 1948): the local quadratic model of the cost in the parameters and the amplitudes of candidate forces.

At an optimum the Gauss-Newton model of the cost is augmented by forces of amplitude zero, one column each, without a new
search. It predicts the reduction of the cost by any of them and the change of the parameters, for hundreds of forces at the
cost of one step of the fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.long_records import is_long
from linkwise.likelihood.memory_forces import MemoryForce
from linkwise.likelihood.shooting.block_information import FactoredModel
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderEquations
from linkwise.likelihood.shooting.eliminated_states import eliminated_rows
from linkwise.likelihood.shooting.flow import Inputs, Trajectories, at_ends_and_middles
from linkwise.likelihood.shooting.linear_model import Border, border_equations, linear_model, precise_model
from linkwise.likelihood.shooting.local_rows import as_slice
from linkwise.likelihood.shooting.normal_equations import Linearization, add_prior_curvature
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.likelihood.shooting.tested_in_pieces import tested_in_pieces
from linkwise.model.law import Law, forces_program
from linkwise.runtime import one_blas_thread

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

    The latter is the curvature itself where the noise is white. `model` is that of the optimum without what is tested, where
    masses are few or it was asked for in blocks; `growth` is that of the largest sensitivity of the states over a segment, in
    their units, 1 where the equations are local.
    """

    curvature: Floats
    slope: Floats
    scatter: Floats
    model: FactoredModel | None = None
    growth: float = 1.0


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge; the result is checked
def local_quadratic(optimum: Optimum, forces: Sequence[CandidateForce]) -> LocalQuadratic:
    """The quadratic model at `optimum` in its p parameters and the amplitudes of f `forces`.

    Raises numpy.linalg.LinAlgError where the optimum's equations are singular.
    """
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        candidates, units = candidate_forces(optimum, misfit, forces)
        augmented = augmented_quadratic(optimum, misfit, candidates)
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
    misfit: Misfit,
    candidates: CandidateForces,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> AugmentedQuadratic:
    """The model at `optimum` in p scaled parameters, the amplitudes of `candidates` and the sizes of `errors`.

    It is that of the optimum alone as well, in `blocks` of segments where these are several. Nodes, and the offsets and gains
    that are estimated with the parameters, are eliminated. Raises numpy.linalg.LinAlgError where the equations are singular.
    """
    segments = optimum.segments
    in_pieces = _in_pieces(optimum, misfit, candidates, errors)
    if in_pieces is not None:
        return in_pieces
    linear = linear_model(
        segments, misfit, optimum.scales, optimum.loss, candidates=candidates, errors=errors, blocks=blocks
    )
    in_blocks = blocks > 1
    border: Border | None
    if isinstance(linear, Linearization):
        linear, border = precise_model(linear, optimum.q, own=segments.system.parameters.size)
    else:
        border = linear.factor(optimum.q) if in_blocks else border_equations(linear, optimum.q)
    if border is None:
        raise np.linalg.LinAlgError("the equations at the optimum are not positive definite")
    added = len(candidates.first) + (0 if errors is None else len(errors.channel))
    model, growth = None, 1.0
    if isinstance(linear, Linearization):
        growth = float(np.max(np.abs(linear.state_ends), initial=1.0))
    if (in_blocks or isinstance(border, BorderedFactor)) and not border.damped:
        estimated = np.delete(
            np.arange(len(border.schur)), segments.system.parameters.size + np.arange(added)
        )
        assert not isinstance(border, BorderEquations)  # a factor was asked for
        model = FactoredModel.within(linear, border, estimated, optimum.q)
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
        return AugmentedQuadratic(curvature, slope, curvature, model, growth)
    rows = eliminated_rows(
        segments, misfit, optimum.scales, optimum.loss, optimum.q, candidates=candidates, errors=errors
    )
    assert rows is not None  # the same equations have a factor
    scores = optimum.coloured.score_covariance(rows, segments.linked, len(segments.samples))
    if segments.prior is not None:
        add_prior_curvature(scores, segments.prior, optimum.scales, segments.system.parameters.size)
    elimination = np.concatenate([np.eye(own.stop), -follow])
    return AugmentedQuadratic(curvature, slope, elimination.T @ scores @ elimination)


def _in_pieces(
    optimum: Optimum, misfit: Misfit, candidates: CandidateForces, errors: SensorErrors | None
) -> AugmentedQuadratic | None:
    """The model of a long record with white noise, without blocks; None of others, and where equations are singular."""
    if optimum.coloured is not None or not is_long(optimum.segments):
        return None
    tested = tested_in_pieces(
        optimum.segments, misfit, optimum.scales, optimum.loss, optimum.q, candidates, errors
    )
    if tested is None:
        return None
    factor, growth = tested
    return AugmentedQuadratic(factor.schur, factor.reduced, factor.schur, None, growth)


def candidate_forces(
    optimum: Optimum, misfit: Misfit, forces: Sequence[CandidateForce]
) -> tuple[CandidateForces, Floats]:
    """The forces along the orbit, scaled to a root mean square of 1, and the scale factors (f,)."""
    return candidates_along(optimum.segments, misfit, forces)


def candidates_along(
    segments: Segments, misfit: Misfit, forces: Sequence[CandidateForce]
) -> tuple[CandidateForces, Floats]:
    """`candidate_forces` along the orbit of `misfit`."""
    ends, middles = states_at_ends_and_middles(
        misfit.trajectories,
        segments.flow_steps_per_tangent,
        segments.step,
        segments.inputs,
        segments.system.base_error,
    )
    points = segments.system.at(misfit.point.theta).points
    pairs = {pair: number for number, pair in enumerate(dict.fromkeys((f.first, f.second) for f in forces))}
    places = np.array(list(pairs), dtype=int).reshape(-1, 2).T % (ends.shape[2] + len(points))
    firsts, seconds = map(as_slice, places)
    elongations = np.empty((len(ends) + len(middles), 2, len(pairs), segments.count))
    for own, motion in ((elongations[::2], ends), (elongations[1::2], middles)):
        of_places = _with_points(motion, points)
        np.subtract(of_places[:, :, firsts], of_places[:, :, seconds], out=own)
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
        return forces_program(plain)(motion[:, 0], motion[:, 1])
    return [law.along(motion, step, segments.linked) for law in laws if isinstance(law, MemoryForce)]


def states_at_ends_and_middles(
    orbit: Trajectories, refine: int, step: Floats, inputs: Inputs, base_error: int | None = None
) -> tuple[Floats, Floats]:
    """x and v (J + 1, 2, n + 2, K) at the ends of the steps of the tangents and (J, 2, n + 2, K) in their middles.

    The base, less the state `base_error`, and the ground follow the masses. The middles follow from x, v and a at both ends,
    to the sixth order.
    """
    coarse = orbit.thinned(refine)
    h = step * refine
    ends, middles = coarse.states.copy(), coarse.middles(h)
    ends[:, 1] /= h
    middles[:, 1] /= h
    base_ends, base_middles = _base(inputs, refine, len(ends), ends.shape[-1])
    if base_error is not None:
        base_ends = base_ends - np.stack([coarse.memory, 0.0 * coarse.memory], axis=1)[:, :, [base_error]]
        between = coarse.middle_memory
        base_middles = base_middles - np.stack([between, 0.0 * between], axis=1)[:, :, [base_error]]
    return _with_base_and_ground(ends, base_ends), _with_base_and_ground(middles, base_middles)


def _with_base_and_ground(motion: Floats, base: Floats) -> Floats:
    """(J, 2, n + 2, K): after the masses the base (index -2) and the ground (index -1)."""
    ground = np.zeros_like(base)
    return np.concatenate([motion, base, ground], axis=2)


def _with_points(motion: Floats, points: Floats) -> Floats:
    """(J, 2, n + k + 2, K): before the base the points (k, n) of hosts, in reverse, so that their numbers are indices."""
    if not len(points):
        return motion
    masses, supports = motion[:, :, :-2], motion[:, :, -2:]
    of_points = np.einsum("pn,jdnk->jdpk", points[::-1], masses)
    return np.concatenate([masses, of_points, supports], axis=2)


def _base(inputs: Inputs, refine: int, ends: int, count: int) -> tuple[Floats, Floats]:
    """(J + 1, 2, 1, K) and (J, 2, 1, K) of the base, at rest where it has no record."""
    if inputs.base is None:
        return np.zeros((ends, 2, 1, count)), np.zeros((ends - 1, 2, 1, count))
    at_ends, middles = at_ends_and_middles(inputs.base, refine)
    return at_ends[:, :, None], middles[:, :, None]
