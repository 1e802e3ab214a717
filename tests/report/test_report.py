"""What a result folder and its page say, those of an inspection among them."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from record_faults import chain, changed
from structures import torsion_chain

import linkwise as lw
from linkwise.report.discovery import discovery_page
from linkwise.report.estimate import estimate_figures, estimate_page
from linkwise.report.figure_units import lengths_as_in_figures, table_as_in_figures
from linkwise.report.result_folder import Reported

pytestmark = pytest.mark.usefixtures("unrendered")


def page_of(estimate: lw.Estimate, **options: Any) -> str:
    """The page without figures."""
    return estimate_page(Reported(estimate, **options), {})


def test_verdict_comes_first_and_what_was_found_before_what_was_known(fitted: lw.Estimate) -> None:
    body = page_of(fitted).partition("<body>")[2]
    assert fitted.trusted
    assert 0 < body.index("This answer can be trusted.") < body.index("<h2>Evidence") < body.index("<table>")
    assert body.index("<h3>nes1 ") < body.index("<h3>spring1 ")
    alpha, low = fitted.coefficient("nes1.alpha"), fitted.link("nes1").wells[0]
    half = 1e-3 * 1.96 * present(alpha.standard_error)
    law = re.findall(
        r'<p class="law">alpha = (.*?) ± (.*?) N/mm, beta = .* N/mm\^3, c = 0\.0\d+ ± 0\.\d+ N s/m</p>', body
    )
    # the unit of length of the axes; two digits of what is within, the value to these
    assert [float(text) for text in law[0]] == pytest.approx([1e-3 * alpha.value, half], abs=0.05 * half)
    assert f"well 1 = {1e3 * low.value:.1f}" in body and "frequency in well 2 = " in body
    assert "<summary>Links: nes1, spring1</summary>" in body
    assert "<svg" not in body  # no link was to be pictured


def test_a_mass_that_was_asked_for_stands_on_the_first_screen(fitted: lw.Estimate) -> None:
    asked = lw.identify(fitted.record, fitted.given_structure.unknown("mass:m2"), method="weak")
    first = page_of(asked).partition("<h2>Evidence")[0]
    assert re.search(r'<h3>Masses</h3>\s<p class="law">m2 = 0\.0\d+ ± 0\.0\d+ kg</p>', first)
    assert "<h3>Masses" not in page_of(fitted)


def test_moments_stand_in_units_of_the_angle() -> None:
    truth = torsion_chain()
    record = lw.simulate(truth, release={"v:disc1": 1.0}, duration=2.0, rate=500.0).with_noise(40.0, seed=1)
    page = re.sub(r"[\d.]+ ± [\d.e-]+", "#", page_of(lw.identify(record, truth.unknown("sink"))))
    assert '"law">alpha = -# N m/rad, beta = # N m/rad^3, c = # N m s/rad</p>' in page
    assert "well 1 = -# rad, well 2 = # rad, barrier = # mJ, frequency in well 1 = # Hz" in page


def test_a_bad_answer_is_said_to_be_one(fitted: lw.Estimate) -> None:
    bad = replace(fitted, fit_verdicts=(lw.Verdict.NOT_CONVERGED,), message="The cost still falls.")
    assert not bad.trusted
    page = page_of(bad)
    assert "Do not trust this answer." in page and "can be trusted" not in page
    assert "<p>The cost still falls.</p>" in page and "<li>Not converged." in page
    assert "Every number on this page, for the reason above." in page and " ± " not in page


def test_one_sentence_says_what_could_still_be_wrong_and_by_how_much(fitted: lw.Estimate) -> None:
    assert "Nothing that this record shows. Beyond the range visited" in page_of(fitted)
    unseen = lw.estimates.UnseenTerm("nes1", "d**5", 1.07, "nes1.beta", -1.0, 513.0, 0.03)
    assert (
        "does not rule out a force like d**5 in nes1 of up to 107 % of the force there, which would change nes1.beta by 3 % "
        "or 510 of its standard errors."
    ) in page_of(replace(fitted, unseen_terms=(unseen,)))
    verdicts = (lw.Verdict.UNEXPLAINED_FORCES,)
    rough = replace(fitted, fit_verdicts=verdicts, approximate=True, model_error=0.12)
    assert "Forces by about 12 %, and coefficients by more than their intervals" in page_of(rough)


def test_a_force_without_elongation_is_drawn_over_the_rate(fitted: lw.Estimate) -> None:
    """Over the elongation there is nothing to see of a dashpot."""
    sink = fitted.structure.link("nes1")
    given = {**sink.coefficients, **dict.fromkeys(("alpha", "beta"), lw.Coefficient.number(0.0))}
    links = (fitted.structure.links[0], replace(sink, coefficients=given))
    motion = replace(fitted.motion, structure=replace(fitted.structure, links=links))
    damped = replace(fitted, compute_motion=lambda: motion)
    for answer, label in ((damped, "rate v, m/s"), (fitted, "elongation d, mm")):
        drawn = present(estimate_figures(Reported(answer))["force_nes1"].figure)()
        assert drawn.axes[0].get_xlabel() == label


def test_page_needs_nothing_else(answer_folder: Path) -> None:
    page = (answer_folder / "report.html").read_text(encoding="utf-8")
    assert re.findall(r"<(?:script|link|img|iframe)[^>]*\b(?:src|href)=", page) == []
    assert "http" not in page and "<script" not in page
    titles = re.findall('<svg role="img" aria-label="([^"]*)"', page)
    assert titles[0] == "nes1" and titles[-1] == "Record"
    assert len(page) < 1.5e6


def test_big_figures_lie_beside(fitted: lw.Estimate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that no page is larger than 1.5 MB, however many links and channels there are."""
    monkeypatch.setattr("linkwise.report.result_folder._PAGE", 40)
    page = (lw.report.write_result(fitted, tmp_path / "answer") / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 1 and '<a href="histories.png">histories.png</a>' in page


def test_folder_holds_what_the_interface_promises(answer_folder: Path, fitted: lw.Estimate) -> None:
    forces = {"force_spring1.csv", *(f"force_nes1.{suffix}" for suffix in ("csv", "png"))}  # one is known
    others = {"result.json", "structure.toml", "covariance.csv", "report.html", "histories.png"}
    assert {path.name for path in answer_folder.iterdir()} == others | forces
    identified = lw.read_structure(answer_folder / "structure.toml")
    assert identified.parameters == () and identified == fitted.structure


def test_result_json_is_that_of_the_interface(answer_folder: Path, fitted: lw.Estimate) -> None:
    result = json.loads((answer_folder / "result.json").read_text(encoding="utf-8"))
    assert {"method", "status", "message", "seconds", "version", "noise", "fit", "links"} <= set(result)
    assert result["version"] == lw.__version__ and result["method"] == "weak"
    assert set(result["noise"]["x:m1"]) >= {"sigma", "unit", "snr_db"}
    assert set(result["fit"]) >= {"chi_square_per_sample", "samples"}
    sink = next(link for link in result["links"] if link["name"] == "nes1")
    assert sink["between"] == ["m2", "m1"] and sink["law"] == "alpha*d + beta*d**3 + c*v"
    alpha = sink["coefficients"]["alpha"]
    assert set(alpha) >= {"value", "unit", "known", "standard_error", "interval"}
    assert alpha["unit"] == "N/m" and alpha["known"] is False
    assert len(sink["range"]["d"]) == len(sink["range"]["v"]) == 2
    assert len(sink["wells"]) == 2 and len(sink["wells"][0]["interval"]) == 2
    assert sink["barrier"]["unit"] == "J"
    assert set(result["nmse_percent"]) == {"spring1", "nes1"}
    assert result["files"] == sorted({path.name for path in answer_folder.iterdir()} - {"result.json"})


def test_force_file_is_the_curve_with_its_band(answer_folder: Path, fitted: lw.Estimate) -> None:
    path = answer_folder / "force_nes1.csv"
    assert path.read_text().splitlines()[0] == "d,force,lower,upper"
    d, force, lower, upper = np.loadtxt(path, delimiter=",", skiprows=1).T
    assert (d[0], d[-1]) == pytest.approx(fitted.link("nes1").d_range, rel=1e-9)  # ten printed digits
    np.testing.assert_allclose(force, fitted.structure.link("nes1").force(d), rtol=1e-8, atol=1e-8)
    assert np.all(lower <= force) and np.all(force <= upper)


def test_progress_reaches_the_end_and_never_goes_back(fitted: lw.Estimate, tmp_path: Path) -> None:
    fractions: list[float] = []
    lw.report.write_result(fitted, tmp_path / "answer", progress=lambda one: fractions.append(one.fraction))
    # four files are written, the last report is before the last of them
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and 0.8 < fractions[-1] <= 1.0


def test_discovery_of_memory_is_written(
    discovered: lw.Discovery, chain: lw.Structure, tmp_path: Path
) -> None:
    """Its figures are not compared with the true forces, which the motion alone does not tell."""
    simulated = discovered.estimate.record.simulated
    assert simulated is not None
    sink = chain.link("nes1")
    joint = lw.model.named_law("dahl").link(sink.name, sink.between, {"sigma": 1e4, "Fc": 1.0, "c": 0.1})
    with_memory = replace(simulated, structure=replace(chain, links=(chain.links[0], joint)))
    record = replace(discovered.estimate.record, simulated=with_memory)
    discovery = replace(discovered, estimate=replace(discovered.estimate, record=record))
    folder = lw.report.write_result(discovery, tmp_path / "answer")
    assert "truth" not in json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert (folder / "force_m2-m1.png").exists()


def test_the_box_of_a_discovery_has_its_grade_and_not_that_of_its_fit(discovered: lw.Discovery) -> None:
    """A search that did not settle is refused, though the laws that it found explain the record."""
    unsettled = replace(discovered, verdicts=(lw.Verdict.SEARCH_UNSETTLED,))
    assert discovered.trusted and unsettled.estimate.trusted and not unsettled.trusted
    page = discovery_page(Reported(unsettled), {})
    assert '<div class="verdict refused">' in page and "Every number on this page" in page
    assert '<div class="verdict explained">' in discovery_page(Reported(discovered), {})


@pytest.fixture(scope="module")
def clipped() -> lw.Record:
    record = chain(2, 30.0)
    clipped = changed(record, **{str(record.channels[0]): lambda x: np.clip(x, None, 0.7 * x.max())})
    return replace(clipped, source="<b>clipped</b>")


def test_folder_holds_numbers_figures_and_page(clipped: lw.Record, tmp_path: Path) -> None:
    inspection = lw.inspect([clipped, chain(2, 30.0)])
    folder = lw.report.write_result(inspection, tmp_path / "looked")
    names = {path.name for path in folder.iterdir()}
    assert {"inspection.json", "report.html"} <= names
    kinds = ("histories", "spectra", "maps", "coherence")
    assert {f"{kind}_{n}.png" for kind in kinds for n in (1, 2)} <= names
    document = json.loads((folder / "inspection.json").read_text())
    assert document["alerts"] == [alert.to_dict() for alert in inspection.alerts]
    page = (folder / "report.html").read_text(encoding="utf-8")
    body = page[page.index("<body>") :]
    assert body.index("clipped x:m1") < body.index("samples at 1000 Hz")  # alerts first
    assert "<b>clipped</b>" not in body and "&lt;b&gt;clipped&lt;/b&gt;" in body


def test_lengths_stand_in_the_units_of_figures() -> None:
    texts = ["0.002977 m at 27.8 Hz, from -0.02 to 0.02 m", "-2 to 2 m/s, 5 m/s^2, 3 N/m", "x:m2=0.00999"]
    assert lengths_as_in_figures(texts) == ["2.977 mm at 27.8 Hz, from -20 to 20 mm", *texts[1:]]
    assert lengths_as_in_figures(["9.58e-07 m about 0.01 m"]) == ["958 nm about 10 mm"]
    table = [("Hz", "x:m1, m"), ("3", "9.58e-07"), ("4", "0.01")]
    assert table_as_in_figures(table) == [("Hz", "x:m1, mm"), ("3", "0.000958"), ("4", "10")]
    assert lengths_as_in_figures(["0 m", "1.0020e-06 m to 2e-06 m"]) == ["0 µm", "1.002 µm to 2 µm"]
