"""Intervals of absorption: draws have the covariance, intervals are those of the parameters, folders keep what they need."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal, said
from present import present
from problems import chain_record
from structures import equal_sinks

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")

TRIAL: dict[str, Any] = {"duration": 1.0, "rate": 500.0, "release": {"v:m1": 1.0}}


def known(
    covariance: list[list[float]], *names: str, lower: float = -np.inf, masses: int = 2
) -> lw.estimates.Posterior:
    bounds = np.full(len(names), lower), np.full(len(names), np.inf)
    named = tuple(map(lw.model.Name.parse, names))
    return lw.estimates.Posterior(lw.bnes_chain(masses), named, np.array(covariance), *bounds)


def test_draws_have_the_covariance_and_keep_the_bounds() -> None:
    covariance = np.array([[4.0, -150.0], [-150.0, 1e4]])
    drawn = known(covariance.tolist(), "nes1.alpha", "nes1.beta").draws(20000, seed=1000)
    # the standard error of a covariance from R draws is sqrt((s_i s_j)^2 (1 + r^2) / R); four of them
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)) * 2.0 / 20000)
    assert np.all(np.abs(np.cov(drawn.T) - covariance) < 4.0 * size)
    # likewise, of means
    assert np.all(np.abs(drawn.mean(axis=0) - [-100.0, 1e6]) < 4.0 * np.sqrt(np.diag(covariance) / 20000))
    pairs = known(covariance.tolist(), "nes1.alpha", "nes1.beta").mirrored_draws(8, seed=1) - [-100.0, 1e6]
    np.testing.assert_allclose(pairs.T @ pairs / 8, covariance, rtol=1e-12)
    assert np.all(known([[1e-4]], "nes1.c", lower=0.01).mirrored_draws(99, seed=1) >= 0.01)
    bounded = known([[1e-4]], "nes1.c", lower=0.01).draws(500, seed=1000)
    # the bound that was stated
    assert bounded.min() >= 0.01 and len(bounded) == 500
    message = r"draws only \d+ lie within the bounds of the coefficients"
    with pytest.raises(lw.IdentificationError, match=message):
        known([[1e-4]], "nes1.c", lower=0.09).draws(500, seed=1000)


@pytest.mark.slow
def test_the_interval_of_one_parameter_is_its_own() -> None:
    """What grows with the damper's coefficient has its quantiles where the coefficient has them."""
    deviation = 0.02
    intervals = lw.absorption.absorption_intervals(
        known([[deviation**2]], "spring1.c"), **TRIAL, draws=400, seed=1000
    )
    share = intervals.quantity("share:spring1")
    ends = [
        lw.absorb(lw.bnes_chain(2, c=1.0 + side * 1.96 * deviation), **TRIAL).with_sinks.share("spring1")
        for side in (-1.0, 1.0)
    ]
    assert share.value == pytest.approx(intervals.absorption.with_sinks.share("spring1"), abs=1e-7)
    # a quantile q of R draws is off by sqrt(q (1 - q) / R) / density: 0.134 deviations at 2.5 % and R = 400; three of them
    slack = 3.0 * 0.134 * (ends[1] - ends[0]) / (2.0 * 1.96)
    assert share.lower == pytest.approx(ends[0], abs=slack) and share.upper == pytest.approx(
        ends[1], abs=slack
    )
    assert intervals.quantity("crossings").missing == 0 and intervals.diverged == 0 and intervals.trusted


def test_an_estimate_gives_intervals_that_hold_the_truth(fitted: lw.Estimate) -> None:
    intervals = lw.absorption.absorption_intervals(fitted, **TRIAL, draws=100, seed=1000)
    truth = lw.absorb(lw.bnes_chain(2), **TRIAL)
    for name, value in (("sinks_share", truth.sinks_share), ("rms_reduction", truth.rms_reduction)):
        quantity = intervals.quantity(name)
        assert present(quantity.lower) < present(value) < present(quantity.upper)
    inside = (intervals.lower[:, 0] <= truth.with_sinks.envelope[:, 0]) & (
        truth.with_sinks.envelope[:, 0] <= intervals.upper[:, 0]
    )
    assert np.mean(inside) > 0.5  # one truth, whose samples hang together: most of them
    assert np.all(intervals.lower <= intervals.upper) and np.all(intervals.lower[0] < intervals.upper[0])
    never = intervals.quantity("settled_without")
    assert (never.value, never.lower, never.upper, never.missing) == (None, None, None, 100)
    text = str(intervals)
    assert "95 % of 100 draws of the identified structure (seed 1000) lie within:" in text and "never" in text


def test_what_moves_together_is_drawn_together(chain: lw.Structure) -> None:
    """Two sinks with one unknown alpha: both names are known, and vary as one."""
    shared = equal_sinks().unknown("nes1.alpha")
    record = chain_record(4, duration=1.0).with_noise(40.0, seed=1000)
    fit = lw.identify(record, shared, method="weak")
    assert fit.trusted
    knowledge = lw.estimates.Posterior.of(fit)
    assert knowledge.names == ("nes1.alpha", "nes2.alpha")
    drawn = knowledge.draws(50, seed=1)
    np.testing.assert_allclose(drawn[:, 0], drawn[:, 1], rtol=1e-9)  # the root of a singular matrix
    assert np.ptp(drawn[:, 0]) > 0.0


def test_the_folder_of_an_answer_keeps_what_is_known(answer_folder: Path, fitted: lw.Estimate) -> None:
    posterior, true = lw.estimates.read_posterior(answer_folder), lw.estimates.Posterior.of(fitted)
    assert posterior.structure == fitted.structure and posterior.names == true.names
    np.testing.assert_array_equal(posterior.covariance, true.covariance)
    result = json.loads((answer_folder / "result.json").read_text())
    assert "covariance.csv" in result["files"]


@pytest.mark.slow
def test_the_folder_of_a_discovery_keeps_what_is_for_dropped_terms(
    discovered: lw.Discovery, discovery_folder: Path, tmp_path: Path
) -> None:
    assert discovered.trusted
    posterior = lw.estimates.read_posterior(discovery_folder)
    true = lw.estimates.Posterior.of(discovered.estimate)
    np.testing.assert_allclose(posterior.covariance, true.covariance, rtol=1e-9)  # the file has half of it
    dropped, expected = present(posterior.for_dropped_terms), present(true.for_dropped_terms)
    np.testing.assert_allclose(dropped, expected, rtol=1e-9)
    own, whole = np.diag(posterior.beside_terms_kept), np.diag(posterior.covariance)
    assert (own > 0.0).all() and (own < whole).all()
    unsettled = replace(discovered, verdicts=(*discovered.verdicts, lw.Verdict.SEARCH_UNSETTLED))
    lw.report.write_result(unsettled, tmp_path / "unsettled")
    assert not (tmp_path / "unsettled" / "covariance.csv").exists()


def test_an_answer_not_to_be_trusted_has_no_intervals(fitted: lw.Estimate, tmp_path: Path) -> None:
    bad = replace(fitted, fit_verdicts=(lw.Verdict.NOT_CONVERGED,), message="The cost still falls.")
    with pytest.raises(lw.IdentificationError, match=r"no covariance to draw from \(not converged\)"):
        lw.absorption.absorption_intervals(bad, **TRIAL)
    lw.report.write_result(bad, tmp_path / "bad")
    assert not (tmp_path / "bad" / "covariance.csv").exists()
    with pytest.raises(lw.RecordError, match=r"covariance\.csv: .* is not to be trusted \(not converged\)"):
        lw.estimates.read_posterior(tmp_path / "bad")


def test_what_is_wrong_with_a_folder_is_said(answer_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "structure.toml").write_bytes((answer_folder / "structure.toml").read_bytes())
    with pytest.raises(lw.RecordError, match="no result of identify either; give a structure file or a fol"):
        lw.estimates.read_posterior(tmp_path)
    for line, message in (
        (
            "nes1.alpha,nes1.alpha",
            r"covariance\.csv, line 2: 'nes1.alpha,nes1.alpha' is not two coefficients",
        ),
        ("nes1.alpha,nes1.alpha,one", r"line 2: .* is not two coefficients and a number"),
        ("nes1.alpha,nes1.alpha,1,2,3", r"line 2: .* is not two coefficients and a number"),
        ("nes1.alpha,nes1.beta,1", r'line 2: "nes1.beta" has no variance of its own'),
        ("nes7.alpha,nes7.alpha,1", r'unknown coefficient "nes7.alpha"'),
    ):
        (tmp_path / "covariance.csv").write_text(f"first,second,covariance\n{line}\n")
        with pytest.raises(lw.LinkwiseError, match=message):
            lw.estimates.read_posterior(tmp_path)


MORE = (
    '[[link]]\nname = "more"\nbetween = ["m1", "ground"]\nlaw = "k*d"\ncoefficients = { k = 1.0 }\n\n[[link]]'
)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("beta*d**3", "beta*d**5", r"the law of nes1 is not as in result\.json"),
        ("alpha = -", "alpha = -1", r"nes1\.alpha is not as in result\.json"),
        ("mass = 1.0", "mass = 1.01", r"the mass of m1 is not as in result\.json"),
        ('["m1", "ground"]', '["m2", "ground"]', r"between of spring1 is not as in result\.json"),
        ("[[link]]", MORE, r"link more is not as in result\.json"),
    ],
)
def test_an_edited_file_is_refused(
    answer_folder: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    copy = shutil.copytree(answer_folder, tmp_path / "answer")
    assert lw.estimates.read_posterior(copy).names
    text = (copy / "structure.toml").read_text()
    assert old in text
    (copy / "structure.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(lw.RecordError, match=f"edited since it was written: {message}"):
        lw.estimates.read_posterior(copy)
    out = tmp_path / "forces.py"
    with pytest.raises(lw.RecordError, match="do not hold; give the structure file"):
        lw.export_answer(copy, out)
    assert not out.exists() and lw.export_answer(copy / "structure.toml", out).exists()


@pytest.mark.slow
def test_the_command_reads_the_folder_of_an_answer(answer_folder: Path, tmp_path: Path) -> None:
    command = f"absorb {answer_folder} --duration 1 --rate 500 --release v:m1=1.0 --draws 20 --seed 3"
    out = said(f"{command} -o {tmp_path}/absorbed").out
    assert "95 % of 20 draws of the identified structure (seed 3)" in out
    header = (tmp_path / "absorbed" / "decay.csv").read_text().splitlines()[0]
    assert header.endswith("envelope:m1 lower,envelope:m1 upper")
    page = (tmp_path / "absorbed" / "report.html").read_text()
    assert page.index("<h2>Intervals") < page.index("<h2>Primary masses")
    printed = document(command)
    posterior = lw.estimates.read_posterior(answer_folder)
    share = lw.absorption.absorption_intervals(posterior, **TRIAL, draws=20, seed=3).quantity("sinks_share")
    assert printed["intervals"]["sinks_share"]["interval"] == [share.lower, share.upper]
    assert printed["draws"] == 20 and printed["seed"] == 3


def test_no_command_takes_the_place_of_another_ones_result_and_draws_need_one(answer_folder: Path) -> None:
    """The folder that is asked about is the last one to be lost."""
    before = {path.name: path.read_bytes() for path in answer_folder.iterdir()}
    options = "--duration 1 --release v:m1=1.0 --draws 4"
    refused = refusal(f"absorb {answer_folder} {options} -o {answer_folder}")
    assert "already exists and holds the result of another command (result.json); it was not ch" in refused
    assert {path.name: path.read_bytes() for path in answer_folder.iterdir()} == before
    for subject in (f"{answer_folder}/structure.toml", f"{answer_folder} --sweep nes1.alpha=-150:-50:2"):
        refused = refusal(f"absorb {subject} {options}")
        assert "--draws is for intervals: give the folder that identify wrote" in refused
