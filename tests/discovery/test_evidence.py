"""Evidence, path and runners-up against fits made anew with the decision turned round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from judged import masses, terms
from present import some
from problems import bent_chain, chain_record

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.evidence import exchange_remarks, term_evidence
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import Penalty, QuadraticModel, Selection
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions

#: Of cost: where two fits end within 0.02 of their least cost each, and the parabola is one to the third order.
WITHIN = 0.05


@dataclass(frozen=True, eq=False)
class Case:
    """The two-mass chain whose sink bends a little to one side, k2 = 150 N/m^2, and what was discovered."""

    truth: lw.Structure
    record: lw.Record
    discovery: lw.Discovery

    def refitted(self, *, add: str = "", drop: str = "") -> tuple[float, dict[str, float]]:
        """Least cost and values of the answer with one decision turned round."""
        pool = candidates_for([self.record], masses(self.truth), "cubic")
        names = {term.name for term in self.discovery.kept} - {drop} | ({add} if add else set())
        structure = pool.structure(names)
        starts = {term.name: (term.value, term.standard_error) for term in self.discovery.terms}
        theta, spread = np.array([starts[parameter.name] for parameter in structure.parameters]).T
        fit = likelihood_fit(
            [self.record], structure, theta, spread=spread, options=LikelihoodOptions(model_error=False)
        )
        assert fit.status.name == "CONVERGED"
        cost = fit.misfit.cost(fit.optimum.q)
        return cost, dict(zip((p.name for p in structure.parameters), map(float, fit.values), strict=True))


@pytest.fixture(scope="module")
def case() -> Case:
    bent = bent_chain(150.0)
    record = bent.record(1000)
    return Case(bent.structure, record, lw.discover(record, masses(bent.structure)))


@pytest.fixture(scope="module")
def answer(case: Case) -> float:
    """The cost of the answer itself."""
    return case.refitted()[0]


def test_a_weak_term_is_found_and_the_least_certain(case: Case) -> None:
    assert terms(case.discovery.structure) == terms(case.truth)
    assert [term.name for term in case.discovery.terms if term.kept][-1] == "m2-m1.k2"


def test_every_candidate_is_told_once_the_kept_first(case: Case) -> None:
    tested_terms = case.discovery.terms
    assert len({term.name for term in tested_terms}) == len(tested_terms) == 12
    assert [term.kept for term in tested_terms] == [True] * 6 + [False] * 6
    selected, dropped = [t.margin for t in tested_terms[:6]], [t.margin for t in tested_terms[6:]]
    assert selected == sorted(selected, reverse=True)
    assert dropped == sorted(dropped)
    assert all(term.margin > 0.0 for term in some(tested_terms))
    doubted = [term.name for term in some(tested_terms) if term.certain != (term.margin > CERTAIN)]
    assert doubted == ["m2-m1.k2"]  # the weak one, of which a form that was not offered is as good
    assert [
        remark for remark in case.discovery.remarks if "explains the record as well as m2-m1.k2" in remark
    ]


def test_values_are_those_of_the_fit(case: Case) -> None:
    for term in some(case.discovery.kept):
        estimate = case.discovery.estimate.coefficient(term.name)
        assert abs(term.value - estimate.value) < np.sqrt(WITHIN) * estimate.standard_error
        # the covariance of one fit in two ways; the parabola is taken one step before its end, 1e-6 here
        assert term.standard_error == pytest.approx(estimate.standard_error, rel=0.01)
        assert term.unit == estimate.unit
        assert abs(term.z) >= abs(term.value / term.standard_error)  # without what was dropped


def test_the_margin_of_a_term_that_was_kept_is_what_its_absence_costs(case: Case, answer: float) -> None:
    """The weakest one; the parabola is a cubic's tangent ten deviations away, so that 3 % of the cost is its own error."""
    weakest = case.discovery.kept[-1]
    cost, _ = case.refitted(drop=weakest.name)
    assert weakest.margin == pytest.approx(cost - answer - weakest.penalty, rel=0.03)


def test_the_margin_of_a_term_that_was_dropped_is_what_it_would_not_earn(case: Case, answer: float) -> None:
    """Those of links that stand pay for the term; those of links that do not, for the link too."""
    dropped = [term for term in case.discovery.terms if not term.kept]
    assert {term.link for term in dropped} == {"m1-ground", "m2-ground"}
    for term in dropped:
        cost, values = case.refitted(add=term.name)
        assert abs(values[term.name] - term.value) < np.sqrt(WITHIN) * term.standard_error
        assert abs(term.margin - (term.penalty - (answer - cost))) < WITHIN
    prices = {term.link: term.penalty for term in dropped}
    pairs, samples = 3, 2 * 2001
    assert prices["m2-ground"] - prices["m1-ground"] == pytest.approx(np.log(samples) + 2.0 * np.log(pairs))


def test_the_path_is_lowest_at_the_choice(case: Case) -> None:
    path = case.discovery.path
    assert [point.terms for point in path] == list(range(path[0].terms, path[0].terms + len(path)))
    costs = np.array([point.cost for point in path])
    rounding = 1e-9 * costs[0]  # the path takes differences of whole costs
    assert np.all(np.diff(costs) <= rounding) and costs.min() == 0.0 and costs[-1] <= rounding
    (chosen,) = [point for point in path if point.chosen]
    assert chosen.terms == 6 and chosen.criterion == 0.0 and chosen.step == ""
    assert all(point.criterion > 0.0 for point in some(point for point in path if not point.chosen))


def test_the_neighbours_on_the_path_are_the_margins(case: Case) -> None:
    """One term less is the weakest without its margin, one more the best of those that were dropped, if z ranks as margins."""
    path = {point.terms: point for point in case.discovery.path}
    rounding = 1e-9 * path[min(path)].cost  # the path takes differences of whole costs
    weakest = case.discovery.kept[-1]
    assert path[5].step == f"- {weakest.name}"
    assert abs(path[5].criterion - weakest.margin) < rounding
    added = {f"+ {term.name}": term for term in case.discovery.terms if not term.kept}
    assert abs(path[7].criterion - added[path[7].step].margin) < rounding


def test_runners_up_are_one_step_away_best_first(case: Case) -> None:
    near = case.discovery.runners_up
    margins = [runner_up.margin for runner_up in near]
    assert margins == sorted(margins) and margins[0] > 0.0
    single = {
        f"{'without' if term.kept else 'with'} {term.name}": term.margin for term in case.discovery.terms
    }
    shown = [runner_up for runner_up in near if runner_up.change in single]
    assert len(shown) >= 3
    for runner_up in shown:
        assert runner_up.margin == pytest.approx(single[runner_up.change], rel=1e-8)
    assert min(single, key=single.__getitem__) in [runner_up.change for runner_up in near]


def select_structure(h: np.ndarray, g: np.ndarray) -> Selection:
    """A choice of the first two of some terms of the two-mass chain, about a parabola that is made up."""
    pool = candidates_for([chain_record(2, duration=0.1, speed=0.0)], masses(lw.bnes_chain(2)), "linear")
    names = ("m1-ground.k", "m2-m1.k", "m2-ground.k")
    structure = pool.structure(names[:2])
    penalty = Penalty.of(pool, names, 4000)
    return Selection(frozenset(names[:2]), structure, None, QuadraticModel(names, h, g), penalty, True, 1)  # type: ignore[arg-type]


def test_what_this_record_hardly_tells_apart_is_said() -> None:
    h = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.99], [0.0, 0.99, 1.0]])
    (sentence,) = exchange_remarks(select_structure(h, np.array([100.0, 50.0, 49.95])))
    assert sentence == (
        "This record hardly distinguishes m2-m1.k from m2-ground.k: with the other in its place the criterion is only 5.0 "
        "higher."
    )


@pytest.mark.parametrize(("lean", "certain"), [(0.999, {"m1-ground.k"}), (0.0, {"m1-ground.k", "m2-m1.k"})])
def test_what_another_term_could_replace_is_not_certain(lean: float, certain: set[str]) -> None:
    """However much would be lost without it and without the other."""
    h = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, lean], [0.0, lean, 1.0]])
    selection = select_structure(h, np.array([100.0, 50.0, 49.95 if lean else 1.0]))
    pool = candidates_for([chain_record(2, duration=0.1, speed=0.0)], masses(lw.bnes_chain(2)), "linear")
    evidence = term_evidence(selection, pool, trusted=True)
    selected = [term for term in evidence if term.kept]
    assert {term.name for term in selected if term.certain} == certain
    # 50^2 would be lost without both, of which no penalty takes more than a few tens
    assert len(selected) == 2 and min(term.margin for term in selected) > 1000.0
    (dropped,) = (term for term in evidence if not term.kept)
    assert dropped.margin > CERTAIN and dropped.certain == (lean == 0.0)
    assert not any(term.certain for term in some(term_evidence(selection, pool, trusted=False)))


def test_a_mass_with_links_to_several_that_moved_together_has_no_certain_one() -> None:
    """How its force is shared among them is not known, so that a link to the ground may make up for a wrong share."""
    structure = lw.bnes_chain(4)
    pool = candidates_for([lw.simulate(structure, duration=0.1, rate=1000.0)], masses(structure), "d")
    names = ("m1-ground.k", "m2-ground.k", "m3-ground.k", "m2-m1.k", "m3-m1.k", "m4-m1.k", "m4-ground.k")
    quadratic, penalty = QuadraticModel(names, np.eye(7), np.full(7, 100.0)), Penalty.of(pool, names, 4000)
    selection = Selection(frozenset(names), pool.structure(names), None, quadratic, penalty, True, 1)  # type: ignore[arg-type]

    def certain(*collinear: str, in_proportion: tuple[str, ...] = ()) -> set[str]:
        evidence = term_evidence(
            selection, pool, trusted=True, collinear=collinear, in_proportion=in_proportion
        )
        return {term.name for term in evidence if term.certain}

    assert certain() == set(names)
    assert certain("m2", "m3") == {"m4-ground.k"}  # m1 is linked to both
    assert certain("m3", "m4") == {"m2-ground.k"}
    assert certain("m2") == set(names) - {"m2-ground.k", "m2-m1.k"}
    assert certain("m2", in_proportion=("m2",)) == {
        "m3-ground.k",
        "m4-ground.k",
    }  # m1 is linked to the ground too


def test_what_it_tells_apart_is_not() -> None:
    assert exchange_remarks(select_structure(np.eye(3), np.array([100.0, 50.0, 1.0]))) == ()
