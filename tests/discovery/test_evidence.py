"""Evidence, path and runners-up against fits made anew with the decision turned round."""

from dataclasses import dataclass

import numpy as np
import pytest
from present import some
from problems import bent_chain
from within import masses, terms

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.criterion import CERTAIN
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


def test_every_candidate_is_told_once_the_kept_first(case: Case) -> None:
    """The weak term is found, and the least certain."""
    assert terms(case.discovery.structure) == terms(case.truth)
    assert case.discovery.kept[-1].name == "m2-m1.k2"
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
    """One term less is the weakest without its margin, one more the best of those dropped, if z ranks as margins."""
    path = case.discovery.path
    assert [point.terms for point in path] == list(range(path[0].terms, path[0].terms + len(path)))
    costs = np.array([point.cost for point in path])
    rounding = 1e-9 * costs[0]  # the path takes differences of whole costs
    assert np.all(np.diff(costs) <= rounding) and costs.min() == 0.0 and costs[-1] <= rounding
    smaller, chosen, larger = path[4 - path[0].terms + 1 :][:3]
    assert chosen.chosen and (chosen.terms, chosen.criterion, chosen.step) == (6, 0.0, "")
    assert all((point.criterion > 0.0) is not point.chosen for point in path)
    weakest = case.discovery.kept[-1]
    assert smaller.step == f"- {weakest.name}"
    assert abs(smaller.criterion - weakest.margin) < rounding
    added = {f"+ {term.name}": term for term in case.discovery.terms if not term.kept}
    assert abs(larger.criterion - added[larger.step].margin) < rounding


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
