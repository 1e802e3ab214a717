"""Linearised equations of structures of many masses: local ones against those of the whole, on several graphs."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record, truth
from structures import HARDENING, link, named, structure, with_links

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit, sensor_model
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import ShootingProblem, fit_bytes, require_room, shooting_problem
from linkwise.likelihood.shooting.linear_model import column_origins
from linkwise.likelihood.shooting.local_equations import LocalLinearization, local_linearization
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.neighbourhoods import TOLERANCE, LocalRows, clusters, neighbourhoods, reach
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors, evaluate
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.likelihood.starts.values import starting_values
from linkwise.likelihood.tests.score_test import CandidateForce, candidate_forces
from linkwise.model.law import Law
from linkwise.signals.base_frame import framed

pytestmark = pytest.mark.slow


def linked(name: str, pairs: Iterable[tuple[int, int]], count: int, **values: lw.Coefficient) -> lw.Structure:
    """Masses of 1 kg with hardening links between pairs of them, -1 for the ground."""
    links = (
        link(
            f"l{number}",
            f"m{first}-" + ("ground" if second < 0 else f"m{second}"),
            HARDENING,
            **({"k": 2e4 + 500.0 * number, "k3": 3e7, "c": 2.0} | (values if number else {})),
        )
        for number, (first, second) in enumerate(pairs)
    )
    return structure({f"m{k}": 1.0 for k in range(count)}, *links, name=name)


def grid(side: int) -> lw.Structure:
    across = [(side * i + j, side * i + j + 1) for i in range(side) for j in range(side - 1)]
    down = [(side * i + j, side * i + j + side) for i in range(side - 1) for j in range(side)]
    return linked("grid", [(0, -1), *across, *down], side * side)


def tree(count: int) -> lw.Structure:
    return linked("tree", [(k, (k - 1) // 2 if k else -1) for k in range(count)], count)


def with_memory(count: int) -> lw.Structure:
    """A chain with a hysteretic link in its middle."""
    chain = linked("chain with memory", [(k, k - 1) for k in range(count) if k != 5], count)
    return with_links(chain, named("joint", "m5-m4", "bouc-wen", k=400.0, c=1.5, F=12.0, x0=0.002, s=0.7))


def shared(count: int) -> lw.Structure:
    """A chain of which all links have the same damping."""
    damping = lw.Coefficient.shared("l0.c")
    return linked("shared", [(k, k - 1) for k in range(count)], count, c=damping)


@dataclass(frozen=True)
class Case:
    """A structure whose coefficients are unknown, and masses; sensors of these kinds; channels with an unknown offset."""

    make: Callable[[], lw.Structure]
    masses: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ("x",)
    offsets: tuple[str, ...] = ()


CASES = {
    "chain": Case(lambda: lw.bnes_chain(12)),
    "grid": Case(lambda: grid(4), offsets=("x:m3", "x:m12")),
    "shared coefficients and unknown masses": Case(lambda: shared(12), ("mass:m3", "mass:m11")),
    "links with memory": Case(lambda: with_memory(10), sensors=("x", "state")),
    "velocities and accelerations": Case(lambda: tree(12), sensors=("v", "a")),
}


@cache
def problem(name: str) -> tuple[ShootingProblem, Misfit]:
    """A short record's problem, away from the truth by 2 % of every coefficient."""
    case = CASES[name]
    true = case.make()
    unknown = true.unknown("all", *case.masses)
    release = {f"v:{true.mass_names[k]}": (-1.0) ** k * (0.5 + 0.1 * k) for k in range(true.size)}
    record = lw.simulate(true, release=release, duration=0.2, rate=1000.0, sensors=case.sensors)
    record = record.with_noise(40.0, seed=1)
    frames = (framed(record, unknown),)
    sensing = sensor_model(frames, LikelihoodOptions(offsets=case.offsets))
    shooting = shooting_problem([frames[0].record], unknown, 1.02 * truth(true, unknown), None, sensing)
    return shooting, evaluate(shooting.segments, shooting.start, shooting.scales, Gaussian())


def both(
    name: str, *, whole: bool, candidates: CandidateForces | None = None, errors: SensorErrors | None = None
) -> tuple[LocalLinearization, Linearization]:
    """Local and dense equations; the reach that of the record, or the `whole` structure."""
    shooting, misfit = problem(name)
    segments, scales, loss = shooting.segments, shooting.scales, Gaussian()
    n = len(segments.system.incidence)
    reached = np.ones((n, n), dtype=bool) if whole else reach(segments, misfit, scales)
    origins = column_origins(segments, candidates, errors)
    moving = segments.system.parameters.size + (0 if candidates is None else len(candidates.first))
    groups = neighbourhoods(segments, reached, clusters(segments.system), origins, moving)
    assert len(groups) > 1
    rows = LocalRows(segments, misfit, scales, loss, groups, candidates, errors)
    dense = linearise(segments, misfit, scales, loss, candidates=candidates, errors=errors)
    return local_linearization(rows), dense


@pytest.mark.parametrize("name", CASES)
def test_what_is_left_out_hardly_moves_the_answer(name: str) -> None:
    """A step by less than 2 % of the longest, in standard errors, and these by less than 1 %."""
    local, dense = both(name, whole=False)
    for q in (1.0, 1e-2, 1e-5):
        of_local, of_dense = present(local.factor(q)), present(dense.factor(q))
        errors, ours = (np.sqrt(np.diag(np.linalg.inv(factor.schur))) for factor in (of_dense, of_local))
        free = np.ones(len(errors), dtype=bool)
        step, wanted = (present(factor.solve(free))[1] / errors for factor in (of_local, of_dense))
        assert np.max(np.abs(step - wanted)) < 20.0 * TOLERANCE * np.max(np.abs(wanted))
        assert np.max(np.abs(ours / errors - 1.0)) < 10.0 * TOLERANCE


@pytest.mark.parametrize("name", ["chain", "grid"])
def test_candidates_and_errors_of_sensors(name: str) -> None:
    """Forces between neighbours, between masses far from each other, and to the ground; two kinds of errors."""
    shooting, misfit = problem(name)
    n = len(shooting.segments.system.incidence)
    forces = [
        CandidateForce(first, second, Law.parse(text))
        for first, second in [(1, 0), (n - 1, 0), (n // 2, -1), (2, 1)]
        for text in ("d**2", "v*abs(v)")
    ]
    candidates, _ = candidate_forces(shooting.segments, misfit, forces)
    errors = SensorErrors.of(shooting.segments, misfit)
    equations = both(name, whole=False, candidates=candidates, errors=errors)
    local, dense = present(equations[0].factor(0.1)), present(equations[1].factor(0.1))
    scale = np.sqrt(np.diag(dense.schur))
    assert len(scale) == shooting.segments.parameters + len(forces) + len(errors.kind)
    assert np.max(np.abs(local.schur - dense.schur) / np.outer(scale, scale)) < 10.0 * TOLERANCE
    largest = np.max(np.abs(dense.reduced) / scale)
    assert np.max(np.abs(local.reduced - dense.reduced) / scale) < 10.0 * TOLERANCE * largest


def test_intervals_of_many_masses() -> None:
    """The errors of all coefficients, weighed by their covariance: between the quantiles of 0.1 % and 99.9 %, for one seed."""
    chain = lw.bnes_chain(14)
    record = chain_record(14, duration=1.5).with_noise(20.0, seed=1000)
    fit = lw.identify(record, chain.unknown("all"))
    error = fit.values - truth(chain, fit.given_structure)
    assert fit.trusted and len(error) == 35
    low, high = scipy.stats.chi2.ppf([0.001, 0.999], len(error))
    assert low < error @ np.linalg.solve(fit.covariance, error) < high


@pytest.mark.parametrize("beta", [1.0, 1.5])
def test_a_cubic_term_that_is_held_too_large_leaves_more_than_noise(beta: float) -> None:
    record, chain = chain_record(14, duration=1.0).with_noise(20.0, seed=1002), lw.bnes_chain(14)
    held = present(chain.coefficient("nes3.beta").value) * beta
    asked = chain.unknown("all").with_values({"nes3.beta": held}).unknown("nes3.alpha", "nes3.c")
    options = LikelihoodOptions(ceiling=1.5, model_error=False, coloured_noise=False)
    start, spread = starting_values([record], asked)
    fit = likelihood_fit([record], asked, start, spread=spread, options=options)
    assert fit.chi_square_off is (beta > 1.0)


def test_a_fit_without_room_is_refused_before_the_work() -> None:
    """200 masses over 6 s at 1 kHz: a dense block a node, 1.5 GB, and 1.9 GB of neighbours."""
    needed = fit_bytes(1200, 200, 400, 500)
    assert 8 * 1200 * 400**2 < needed < 4e9
    require_room(1200, 200, 400, 500, free=needed)
    with pytest.raises(
        lw.IdentificationError, match=r"for 200 masses over 1200 segments .* needs 3.46 GB, and 2 GB are free"
    ):
        require_room(1200, 200, 400, 500, free=2_000_000_000)
