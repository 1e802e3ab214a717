"""Linearised equations of structures of many masses: local ones against those of the whole, on several graphs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import HARDENING, link, named, structure, with_links

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood import search as module
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit, sensor_model
from linkwise.likelihood.longer_optimum import in_longer_segments
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import ShootingProblem, shooting_problem
from linkwise.likelihood.room import fit_bytes, require_room
from linkwise.likelihood.score_test import CandidateForce, candidates_along
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule
from linkwise.likelihood.shooting.block_information import FactoredModel, block_information
from linkwise.likelihood.shooting.eliminated_states import eliminated_rows
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel, column_origins, linear_model
from linkwise.likelihood.shooting.linearised_defects import change_of_defects, pull_of_defects
from linkwise.likelihood.shooting.local_equations import LocalLinearization
from linkwise.likelihood.shooting.local_products import local_linearization
from linkwise.likelihood.shooting.local_rows import LocalRows
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.neighbourhoods import TOLERANCE, clusters, neighbourhoods, reach
from linkwise.likelihood.shooting.normal_equations import Linearization, block_ends, blocks_of, linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.likelihood.starts.values import starting_values
from linkwise.model.law import Law
from linkwise.signals.base_frame import framed

RELAXATIONS = (1.0, 1e-2, 1e-5)


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


def star(count: int) -> lw.Structure:
    return linked("star", [(k, 0 if k else -1) for k in range(count)], count)


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
    "tree": Case(lambda: tree(14)),
    "grid": Case(lambda: grid(4), offsets=("x:m3", "x:m12")),
    "star": Case(lambda: star(9)),
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
    values = [
        float(dict(zip(true.mass_names, true.mass_values, strict=True))[p.name.removesuffix(".mass")])
        if p.name.endswith(".mass")
        else present(true.coefficient(p.name).value)
        for p in unknown.parameters
    ]
    frames = (framed(record, unknown),)
    sensing = sensor_model(frames, LikelihoodOptions(offsets=case.offsets))
    shooting = shooting_problem([frames[0].record], unknown, 1.02 * np.array(values), None, sensing)
    return shooting, evaluate(shooting.segments, shooting.start, shooting.scales, Gaussian())


def both(
    name: str,
    *,
    whole: bool,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
    blocks: int = 1,
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
    dense = linearise(segments, misfit, scales, loss, candidates=candidates, errors=errors, blocks=blocks)
    return local_linearization(rows, blocks=blocks), dense


def differences(local: LocalLinearization, dense: Linearization, q: float) -> tuple[float, float]:
    """Largest difference of the border's steps, over the longest of them, in standard errors, and relative one of these."""
    of_local, of_dense = present(local.factor(q)), present(dense.factor(q))
    free = np.ones(len(of_dense.reduced), dtype=bool)
    errors = np.sqrt(np.diag(np.linalg.inv(of_dense.schur)))
    steps: list[Floats] = [present(factor.solve(free))[1] for factor in (of_local, of_dense)]
    ratio = np.sqrt(np.diag(np.linalg.inv(of_local.schur))) / errors
    longest = np.max(np.abs(steps[1]) / errors)
    return float(np.max(np.abs(steps[0] - steps[1]) / errors) / longest), float(np.max(np.abs(ratio - 1.0)))


@pytest.mark.parametrize("name", CASES)
def test_blocks_are_those_of_the_whole_where_all_is_reached(name: str) -> None:
    """The same numerics, in single precision, in another order."""
    local, dense = both(name, whole=True)
    of_local, of_dense = present(local.factor(0.1)), present(dense.factor(0.1))
    scale = np.sqrt(np.diag(of_dense.schur))
    assert np.max(np.abs(of_local.schur - of_dense.schur) / np.outer(scale, scale)) < 1e-3
    free = np.ones(len(of_dense.reduced), dtype=bool)
    free[1] = False
    (nodes, border), (dense_nodes, dense_border) = (
        present(factor.solve(free)) for factor in (of_local, of_dense)
    )
    assert border[1] == dense_border[1] == 0.0
    assert np.max(np.abs(nodes - dense_nodes)) < 1e-3 * np.max(np.abs(dense_nodes))
    drops = [model.equations(0.1).drop(nodes, border) for model in (local, dense)]
    assert drops[0] == pytest.approx(drops[1], rel=1e-6)
    assert of_local.log_determinant(free) == pytest.approx(of_dense.log_determinant(free), rel=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_defects_of_groups_follow_and_pull_as_those_of_the_whole(name: str) -> None:
    """The same numerics, in single precision, in another order; both are transposed maps, to the last digits."""
    local, dense = both(name, whole=True)
    K, m = dense.data.state.shape[:2]
    random, q = np.random.default_rng(2), 0.1
    nodes, border = random.normal(size=(K, m)), random.normal(size=len(dense.data.corner))
    missed = random.normal(size=(K - 1, m)) * dense.joined
    changes = []
    models: tuple[LocalLinearization | Linearization, ...] = (local, dense)
    free, steps = np.ones(len(border), dtype=bool), []
    for model in models:
        change = change_of_defects(model, nodes, border)
        pull, corner = pull_of_defects(model, missed)
        assert np.vdot(change, missed) == pytest.approx(-np.vdot(pull, nodes) - corner @ border, rel=1e-9)
        changes.append(change)
        factor = model.factor(q)
        assert factor is not None
        steps.append(present(factor.moved(pull, corner).solve(free)))
    assert np.max(np.abs(changes[0] - changes[1])) < 1e-4 * np.max(np.abs(changes[1]))
    for own, of_whole in zip(*steps, strict=True):
        assert np.max(np.abs(own - of_whole)) < 1e-3 * np.max(np.abs(of_whole))


@pytest.mark.parametrize("name", CASES)
def test_blocks_of_segments_say_what_their_rows_do(name: str) -> None:
    """Sums over the rows of each block with the states eliminated, in single precision, in another order."""
    shooting, misfit = problem(name)
    segments, blocks, q = shooting.segments, 6, 1e-2
    chunks = present(eliminated_rows(segments, misfit, shooting.scales, Gaussian(), q))
    ends = block_ends(segments.count, blocks)
    information = np.zeros((blocks, segments.parameters, segments.parameters))
    scores = np.zeros((blocks, segments.parameters))
    for chunk in chunks:
        for block, piece in blocks_of(chunk.part, ends):
            for rows, left in ((chunk.data, chunk.residuals), (chunk.defects, chunk.missed)):
                flat = rows[piece].reshape(-1, segments.parameters)
                information[block] += flat.T @ flat
                scores[block] += left[piece].ravel() @ flat
    scale = np.sqrt(information.sum(axis=0).diagonal())
    local, dense = both(name, whole=True, blocks=blocks)
    for linear, whole in ((local, present(local.factor(q)).schur), (dense, present(dense.factor(q)).schur)):
        by_block = present(block_information(linear, q))
        assert np.max(np.abs(by_block[1] - information) / np.outer(scale, scale)) < 1e-4
        assert np.max(np.abs(by_block[0] - scores) / scale) < 1e-4 * np.max(np.abs(scores) / scale)
        assert np.allclose(by_block[1].sum(axis=0), whole, atol=1e-6 * np.max(scale**2))


def test_some_unknowns_of_the_border_have_the_corner_that_they_have_among_all() -> None:
    """Products of a group with itself lie on the diagonal, of which they are also asked alone."""
    local, _ = both("chain", whole=False, blocks=3)
    every = np.arange(len(local.data.prior))
    for border in (every, every[::2]):
        own = local.within(border)
        for whole, form in ((local.data, own.data), (local.defects, own.defects)):
            expected = whole.corner[np.ix_(border, border)]
            scale = np.sqrt(np.maximum(expected.diagonal(), np.finfo(float).tiny))
            np.testing.assert_allclose(form.corner_diagonal, expected.diagonal(), rtol=1e-12)
            rounded = np.abs(form.corner - expected) / np.outer(scale, scale)
            assert np.max(rounded) < 1e-6  # of single precision
            np.testing.assert_allclose(form.corners_by_blocks.sum(axis=0), form.corner, rtol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_what_is_left_out_hardly_moves_the_answer(name: str) -> None:
    """A step by less than 2 % of the longest, in standard errors, and these by less than 1 %."""
    local, dense = both(name, whole=False)
    for q in RELAXATIONS:
        step, error = differences(local, dense, q)
        assert step < 20.0 * TOLERANCE
        assert error < 10.0 * TOLERANCE


@pytest.mark.parametrize("name", ["chain", "grid"])
def test_candidates_and_errors_of_sensors(name: str) -> None:
    """Forces between neighbours, between masses far from each other, and to the ground; two kinds of errors."""
    shooting, misfit = problem(name)
    n = len(shooting.segments.system.incidence)
    laws = [Law.parse(text) for text in ("d**2", "v*abs(v)")]
    pairs = [(1, 0), (n - 1, 0), (n // 2, -1), (2, 1)]
    forces = [CandidateForce(first, second, law) for first, second in pairs for law in laws]
    candidates, _ = candidates_along(shooting.segments, misfit, forces)
    errors = SensorErrors.of(shooting.segments, misfit)
    local, dense = both(name, whole=False, candidates=candidates, errors=errors)
    of_local, of_dense = present(local.factor(0.1)), present(dense.factor(0.1))
    scale = np.sqrt(np.diag(of_dense.schur))
    assert len(scale) == shooting.segments.parameters + len(forces) + len(errors.kind)
    assert np.max(np.abs(of_local.schur - of_dense.schur) / np.outer(scale, scale)) < 10.0 * TOLERANCE
    assert np.max(np.abs(of_local.reduced - of_dense.reduced) / scale) < 10.0 * TOLERANCE * np.max(
        np.abs(of_dense.reduced) / scale
    )


def test_blocks_without_candidates_are_in_those_with_them() -> None:
    """The states are eliminated alike, whatever else is in the border: to the rounding of single precision."""
    shooting, misfit = problem("chain")
    candidates, _ = candidates_along(shooting.segments, misfit, [CandidateForce(2, 1, Law.parse("d**2"))])
    errors = SensorErrors.of(shooting.segments, misfit)
    q, blocks, p = 1e-2, 6, shooting.segments.parameters
    parameters = shooting.segments.system.parameters.size
    alone = present(block_information(both("chain", whole=False, blocks=blocks)[0], q))
    scale = np.sqrt(alone[1].sum(axis=0).diagonal())
    models: tuple[GaussNewtonModel, ...] = both(
        "chain", whole=False, candidates=candidates, errors=errors, blocks=blocks
    )
    for linear in models:
        factor = linear.factor(q)
        assert factor is not None
        border = np.delete(np.arange(len(factor.schur)), parameters + np.arange(len(factor.schur) - p))
        model = FactoredModel.within(linear, factor, border, q)
        scores, information = present(block_information(model, q))
        tolerance = 1e-5 if isinstance(linear, LocalLinearization) else 10.0 * TOLERANCE
        assert np.max(np.abs(information - alone[1]) / np.outer(scale, scale)) < tolerance
        assert np.max(np.abs(scores - alone[0]) / scale) < tolerance * np.max(np.abs(alone[0]) / scale)
        assert np.allclose(model.factor.schur, information.sum(axis=0), atol=1e-5 * np.max(scale**2))


@pytest.mark.parametrize("name", CASES)
def test_reach_leaves_out_what_is_small_in_every_segment(name: str) -> None:
    """Dense Jacobians of all segments: what no group reaches is below three times the tolerance."""
    shooting, misfit = problem(name)
    segments, scales = shooting.segments, shooting.scales
    reached = reach(segments, misfit, scales)
    dense = linearise(segments, misfit, scales, Gaussian())
    n = len(reached)
    units = np.abs(dense.state_ends)
    by_mass = np.maximum(
        np.maximum(units[:, :n, :n], units[:, n : 2 * n, :n]) / units[:, : 2 * n, :n].max(axis=(0, 1)),
        np.maximum(units[:, :n, n : 2 * n], units[:, n : 2 * n, n : 2 * n])
        / units[:, : 2 * n, n : 2 * n].max(axis=(0, 1)),
    ).max(axis=0)
    assert np.max(by_mass, where=~reached, initial=0.0) < 3.0 * TOLERANCE
    assert reached.diagonal().all()


def test_intervals_of_many_masses() -> None:
    """The errors of 35 coefficients, weighed by their covariance: between the quantiles of 0.1 % and 99.9 %, for one seed."""
    chain = lw.bnes_chain(14)
    record = chain_record(14, duration=1.5).with_noise(20.0, seed=1000)
    fit = lw.identify(record, chain.unknown("all"))
    true = np.array([present(chain.coefficient(p.name).value) for p in fit.parameters])
    error = fit.values - true
    assert fit.trusted and len(error) == 35
    assert 14.7 < error @ np.linalg.solve(fit.covariance, error) < 66.6


@pytest.fixture(scope="module")
def chain_of_14() -> tuple[lw.Record, lw.Structure]:
    return chain_record(14, duration=1.0).with_noise(20.0, seed=1002), lw.bnes_chain(14).unknown("all")


def fitted(record: lw.Record, asked: lw.Structure, options: LikelihoodOptions | None = None) -> LikelihoodFit:
    theta, spread = starting_values([record], asked, None)
    return likelihood_fit([record], asked, theta, spread=spread, options=options)


def test_longer_segments_have_the_same_optimum(
    chain_of_14: tuple[lw.Record, lw.Structure], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the tolerance of the search, 0.02 of the cost, and standard errors to the tolerance of what is reached."""
    fit = fitted(*chain_of_14)
    optimum = fit.optimum
    longer, misfit = in_longer_segments(fit)
    assert longer.segments.count == -(-optimum.segments.count // 4)
    assert misfit.data == pytest.approx(fit.misfit.data, rel=1e-9)
    loose = replace(optimum, q=1e-3)  # whose defects longer segments would leave out
    assert in_longer_segments(replace(fit, optimum=loose))[0] is loose
    nodes = optimum.point.nodes + 0.1 * optimum.scales.state[:, None]  # a motion that is not continuous
    torn = replace(optimum, point=replace(optimum.point, nodes=nodes))
    apart = evaluate(torn.segments, torn.point, torn.scales, torn.loss)
    assert in_longer_segments(replace(fit, optimum=torn, misfit=apart))[0] is torn

    monkeypatch.setattr(LongerSegments, "of", lambda *_: None)
    short = fitted(*chain_of_14)
    errors = np.sqrt(np.diag(short.covariance))
    assert in_longer_segments(short)[0] is short.optimum
    assert np.max(np.abs(fit.values - short.values) / errors) < np.sqrt(2.0 * AnnealingSchedule.tolerance)
    assert np.max(np.abs(np.sqrt(np.diag(fit.covariance)) / errors - 1.0)) < 10.0 * TOLERANCE


@pytest.mark.parametrize(("beta", "attempts"), [(1.0, 1), (1.5, 0), (4.0, 0)])
def test_wrong_laws_stay_in_short_segments(
    chain_of_14: tuple[lw.Record, lw.Structure], monkeypatch: pytest.MonkeyPatch, beta: float, attempts: int
) -> None:
    """A cubic term that is held too large leaves more than noise, sooner or later."""
    record, asked = chain_of_14
    chain = lw.bnes_chain(14)
    held = present(chain.coefficient("nes3.beta").value) * beta
    structure = asked.with_values({"nes3.beta": held}).unknown("nes3.alpha", "nes3.c")
    tried: list[LongerSegments] = []
    search = module._in_longer_segments

    def counted(longer: LongerSegments, *rest: Any) -> AnnealingFit | None:
        tried.append(longer)
        return search(longer, *rest)

    monkeypatch.setattr(module, "_in_longer_segments", counted)
    options = LikelihoodOptions(ceiling=1.5, model_error=False, coloured_noise=False)
    fit = fitted(record, structure, options)
    assert len(tried) == attempts
    assert fit.chi_square_off is (beta > 1.0)


def test_few_masses_and_dense_graphs_stay_dense() -> None:
    for true, local in ((lw.bnes_chain(6), False), (star(20), False), (lw.bnes_chain(20), True)):
        unknown = true.unknown("all")
        record = lw.simulate(true, release={"v:" + true.mass_names[0]: 1.0}, duration=0.1, rate=1000.0)
        record = record.with_noise(40.0, seed=1)
        frames = (framed(record, unknown),)
        theta = np.array([present(true.coefficient(p.name).value) for p in unknown.parameters])
        shooting = shooting_problem([record], unknown, theta, None, sensor_model(frames, LikelihoodOptions()))
        misfit = evaluate(shooting.segments, shooting.start, shooting.scales, Gaussian())
        linear = linear_model(shooting.segments, misfit, shooting.scales, Gaussian())
        assert isinstance(linear, LocalLinearization) is local


def test_a_fit_without_room_is_refused_before_the_work() -> None:
    """200 masses over 6 s at 1 kHz: a dense block a node, 1.5 GB, and 1.9 GB of neighbours."""
    needed = fit_bytes(1200, 200, 400, 500)
    assert 8 * 1200 * 400**2 < needed < 4e9
    require_room(1200, 200, 400, 500, free=needed)
    with pytest.raises(
        lw.IdentificationError, match=r"for 200 masses over 1200 segments .* needs 3.46 GB, and 2 GB are free"
    ):
        require_room(1200, 200, 400, 500, free=2_000_000_000)
