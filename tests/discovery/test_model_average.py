"""Models that survive a selection: probabilities of terms, and bands averaged over the models."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from present import some
from random_force import random_force
from structures import oscillator

import linkwise as lw
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.model_average import model_average
from linkwise.discovery.selection import Penalty, QuadraticModel, Selection, ranked_moves
from linkwise.plot.discoveries import departures_figure
from linkwise.plot.style import MEASURED

RATE, DURATION = 200.0, 8.0
REACH = np.linspace(-0.03, 0.03, 7)  # m, which the motion reaches
K, C = 987.0, 6.0


@cache
def found(k3: float, seed: int) -> lw.Discovery:
    """A mass of 1 kg under a random force of 6 N root mean square from 1 to 12 Hz, at 20 dB."""
    true = oscillator("k*d + c*v + k3*d**3", k=K, c=C, k3=k3)
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    record = lw.simulate(true, forces=forces, duration=DURATION, rate=RATE).with_noise(20.0, seed=seed)
    return lw.discover(record, {"m1": 1.0}, terms="d, v, d**2, d**3, d**5, v*abs(v)")


def test_probabilities_are_those_of_all_models_where_these_can_be_counted() -> None:
    """Of a quadratic model in four columns that do not share anything, of which one is hardly needed."""
    z = np.array([30.0, 3.6, 3.0, 0.5])
    quadratic = QuadraticModel(("l.a", "l.b", "l.c", "l.e"), np.eye(4), z)
    penalty = Penalty(term=9.0, link=0.0, pair=np.zeros(4, dtype=np.intp), stated=frozenset())
    moves = tuple(ranked_moves(quadratic, penalty, [0, 1], swaps=True))
    selection = SimpleNamespace(
        quadratic=quadratic,
        penalty=penalty,
        neighbours=moves,
        structure=SimpleNamespace(parameters=("l.a", "l.b")),
    )
    law = SimpleNamespace(term=SimpleNamespace(law=lw.Law.parse("d")))
    candidates = SimpleNamespace(by_name=dict.fromkeys(quadratic.names, law))
    average = model_average(cast(Selection, selection), cast(Candidates, candidates), np.array([1.0, 2.0]))
    # each column is there or not by itself: odds exp((z^2 - 9) / 2)
    odds = np.exp(0.5 * (z**2 - penalty.term))
    expected = odds / (1.0 + odds)
    # models beyond the window of 10, of weight exp(-5) each, are left where no move from the selected one reaches them
    told = [average.probabilities[name] for name in quadratic.names]
    np.testing.assert_allclose(told, expected, atol=4.0 * np.exp(-5.0))
    assert average.models[0] == ("l.a", "l.b")
    # errors that are larger than those of the quadratic model are so in all models: the median for terms beside
    np.testing.assert_allclose(average.covariances[0].diagonal()[:2], [1.0, 4.0])
    assert average.covariances[1:, 2, 2].max() == pytest.approx(1.5**2)


def test_a_term_beyond_doubt_is_there_with_certainty_and_one_in_doubt_is_not() -> None:
    clear, faint = found(4e5, 41), found(2e4, 43)
    assert clear.inclusion["m1-ground.k3"] > 0.999  # a margin above 20, odds of exp(10)
    [doubtful] = [term for term in faint.terms if term.term == "d**3"]
    assert not doubtful.certain
    odds = np.exp(0.5 * (doubtful.margin if doubtful.kept else -doubtful.margin))
    # of the two models that a single decision divides; other models change that a little
    assert faint.inclusion[doubtful.name] == pytest.approx(odds / (1.0 + odds), abs=0.25)
    assert len(faint.average.weights) > 1 and sum(faint.average.weights) == pytest.approx(1.0, rel=1e-12)


def test_the_band_averaged_over_models_is_wider_than_that_of_the_selected_terms_alone() -> None:
    discovery = found(2e4, 43)
    estimate, average = discovery.estimate, discovery.average
    force, lower, upper = discovery.force_band("m1-ground", REACH)
    alone = np.asarray(estimate.covariance) - np.asarray(estimate.for_dropped_terms)
    names = [parameter.name for parameter in estimate.parameters]
    own = [names.index(name) for name in average.coefficients if name in names]
    np.testing.assert_allclose(
        np.sqrt(alone.diagonal()[own]), np.sqrt(average.covariances[0].diagonal()[: len(own)]), rtol=0.01
    )
    spread = np.array(
        [
            sum(
                value * average.laws[name].force(REACH, 0.0, {})
                for name, value in zip(average.coefficients, values, strict=True)
                if name in average.laws
            )
            for values in average.values
        ]
    )
    mean = average.weights @ spread
    # the selected model's values are those of the last fit, which its quadratic model repeats
    np.testing.assert_allclose(force, mean, rtol=1e-3, atol=1e-3)
    between = np.sqrt(average.weights @ (spread - mean) ** 2)
    assert np.all(upper - lower >= 2.0 * 1.95 * between)
    plain = discovery.force_band("m1-ground", REACH, averaged=False)
    np.testing.assert_array_equal(plain, estimate.force_band("m1-ground", REACH))


def test_the_true_force_is_within_the_averaged_band() -> None:
    """Of each of twelve forces; correlated along the elongation, and 95 % of them are to be covered."""
    elongations = REACH[REACH != 0.0]
    inside = []
    for seed in (43, 44, 45, 46):
        _, lower, upper = found(2e4, seed).force_band("m1-ground", elongations)
        true = K * elongations + 2e4 * elongations**3
        inside.append(np.all((lower <= true) & (true <= upper)))
    assert sum(inside) >= 3  # two of four miss by chance in 1.4 %


def test_probabilities_and_models_are_written_and_printed() -> None:
    discovery = found(2e4, 43)
    document = discovery.to_dict()
    for term in some(document["terms"]):
        assert term["inclusion"] == discovery.inclusion[term["name"]]
    assert [model["weight"] for model in document["models"]] == discovery.average.weights.tolist()
    assert set(document["models"][0]["terms"]) == {term.name for term in discovery.kept}
    [line] = [line for line in str(discovery).splitlines() if "probability" in line]
    assert line.index("margin") < line.index("probability") < line.index("would be")


def test_the_page_shows_the_models_that_survive_where_they_tell_another_force(tmp_path: Path) -> None:
    faint, clear = found(2e4, 43), found(4e5, 41)
    assert faint.average.departing(faint.estimate.links) == "m1-ground"
    assert clear.average.weights[0] < 1.0 and clear.average.departing(clear.estimate.links[:0]) is None
    folder = lw.report.write_discovery(faint, tmp_path / "faint")
    assert (folder / "average.png").is_file()
    assert "Other models that survive" in (folder / "report.html").read_text(encoding="utf-8")
    [axes] = departures_figure(faint, "m1-ground").axes
    drawn = [line for line in axes.lines if line.get_color() == MEASURED]
    assert len(drawn) == sum(faint.average.weights[1:] >= 0.02)


def test_a_link_that_is_not_there_is_refused() -> None:
    with pytest.raises(lw.StructureError):
        found(2e4, 43).force_band("m1-m9", REACH)
