"""Models that survive a selection: probabilities of terms, and bands averaged over the models."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from present import some
from random_signals import random_force
from structures import oscillator

import linkwise as lw
from linkwise.plot.discoveries import departures
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


@pytest.mark.slow
def test_a_term_beyond_doubt_is_there_with_certainty_and_one_in_doubt_is_not() -> None:
    clear, faint = found(4e5, 41), found(2e4, 43)
    assert clear.inclusion["m1-ground.k3"] > 0.999  # a margin above 20, odds of exp(10)
    [doubtful] = [term for term in faint.terms if term.term == "d**3"]
    assert not doubtful.certain
    odds = np.exp(0.5 * (doubtful.margin if doubtful.kept else -doubtful.margin))
    # of the two models that a single decision divides; other models change that a little
    assert faint.inclusion[doubtful.name] == pytest.approx(odds / (1.0 + odds), abs=0.25)
    assert len(faint.average.weights) > 1 and sum(faint.average.weights) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.slow
def test_the_band_averaged_over_models_is_wider_than_that_of_the_selected_terms_alone() -> None:
    """By the scatter of the force between models; it holds the true force."""
    elongations, inside = REACH[REACH != 0.0], []
    for seed in (43, 44, 45, 46):
        discovery = found(2e4, seed)
        average = discovery.average
        force, lower, upper = discovery.force_band("m1-ground", elongations)
        forces = [average.laws[name].force(elongations, 0.0, {}) for name in average.laws]
        columns = [average.coefficients.index(name) for name in average.laws]
        by_model = np.asarray(average.values)[:, columns] @ np.array(forces)
        mean = average.weights @ by_model
        # the selected model's values are those of the last fit, which its quadratic model repeats
        np.testing.assert_allclose(force, mean, rtol=1e-3, atol=1e-3)
        between = np.sqrt(average.weights @ (by_model - mean) ** 2)
        assert np.all(upper - lower >= 2.0 * 1.95 * between)
        plain = discovery.force_band("m1-ground", elongations, averaged=False)
        np.testing.assert_array_equal(plain, discovery.estimate.force_band("m1-ground", elongations))
        true = K * elongations + 2e4 * elongations**3
        inside.append(np.all((lower <= true) & (true <= upper)))
    assert sum(inside) >= 3  # correlated along the elongation; two of four miss by chance in 1.4 %
    with pytest.raises(lw.StructureError):
        discovery.force_band("m1-m9", REACH)


def test_probabilities_and_models_are_written_and_printed() -> None:
    discovery = found(2e4, 43)
    document = discovery.to_dict()
    for term in some(document["terms"]):
        assert term["inclusion"] == discovery.inclusion[term["name"]]
    assert [model["weight"] for model in document["models"]] == discovery.average.weights.tolist()
    assert set(document["models"][0]["terms"]) == {term.name for term in discovery.kept}
    [line] = [line for line in str(discovery).splitlines() if "probability" in line]
    assert line.index("margin") < line.index("probability") < line.index("would be")


@pytest.mark.usefixtures("unrendered")
def test_the_page_shows_the_models_that_survive_where_they_tell_another_force(tmp_path: Path) -> None:
    faint, clear = found(2e4, 43), found(4e5, 41)
    assert faint.average.departing(faint.estimate.links) == "m1-ground"
    assert clear.average.weights[0] < 1.0 and clear.average.departing(clear.estimate.links[:0]) is None
    folder = lw.report.write_result(faint, tmp_path / "faint")
    assert (folder / "average.png").is_file()
    assert "Other models that survive" in (folder / "report.html").read_text(encoding="utf-8")
    axes = departures(faint, "m1-ground")
    drawn = [line for line in axes.lines if line.get_color() == MEASURED]
    assert len(drawn) == sum(faint.average.weights[1:] >= 0.02)
