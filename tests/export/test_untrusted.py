"""What is written and computed of an answer that is not to be trusted says so, in every file and where its file goes."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import openpyxl
import pytest
import scipy.io
from commands import said
from structures import oscillator

import linkwise as lw

pytestmark = pytest.mark.slow


SENTENCES = {
    lw.Grade.REFUSED: "The answer is NOT to be trusted (forces unexplained), and neither is what follows from its numbers.",
    lw.Grade.APPROXIMATE: (
        "The answer is approximate (forces unexplained): its laws leave more than noise, and so does what follows from its "
        "numbers."
    ),
}


def hardening() -> lw.Record:
    """A mass on a hardening spring, 40 dB above the noise."""
    true = oscillator("k*d + k3*d**3 + c*v", k=400.0, k3=4e6, c=1.0)
    record = lw.simulate(true, release={"x:m1": 0.02}, duration=2.0, rate=250.0)
    return record.with_noise(40.0, seed=5840010)


@pytest.fixture(scope="module")
def approximate() -> lw.Estimate:
    """A law that lacks the cubic term, fitted."""
    asked = oscillator("k*d + c*v", k=lw.Coefficient.unknown(), c=lw.Coefficient.unknown())
    found = lw.identify(hardening(), asked)
    assert found.status == "forces unexplained" and found.grade is lw.Grade.APPROXIMATE
    return found


@pytest.fixture(scope="module", params=[True, False])
def fit(request: pytest.FixtureRequest, approximate: lw.Estimate) -> lw.Estimate:
    """The same, approximate, or refused as without a path over horizons that is flat."""
    return replace(approximate, approximate=request.param)


@pytest.fixture(scope="module")
def answer(fit: lw.Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its folder."""
    return lw.report.write_result(fit, tmp_path_factory.mktemp("untrusted") / "answer")


def test_every_export_of_the_folder_says_so(fit: lw.Estimate, answer: Path, tmp_path: Path) -> None:
    sentence = SENTENCES[fit.grade]
    assert sentence in lw.export_answer(fit, tmp_path / "estimate.py").read_text()
    files = {suffix: tmp_path / f"forces{suffix}" for suffix in (".py", ".m", ".mat", ".csv", ".xlsx")}
    told = said(f"export {answer} {' '.join(map(str, files.values()))}", fit.grade.exit_code).err
    assert f"note: {sentence}" in told
    for suffix in (".py", ".m"):
        assert sentence in files[suffix].read_text()
    assert sentence in str(scipy.io.loadmat(files[".mat"], simplify_cells=True)["note"])
    rows = list(csv.DictReader(files[".csv"].read_text(encoding="utf-8-sig").splitlines()))
    assert [row["note"] for row in rows] == [sentence] * 3
    sheet = openpyxl.load_workbook(files[".xlsx"])["coefficients"]
    assert [row[-1].value for row in sheet.iter_rows()] == ["note", *[sentence] * 3]


def test_a_status_that_is_not_ours_is_refused(fit: lw.Estimate, answer: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(answer, tmp_path / "answer")
    document = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps({**document, "status": 'x"""\nos'}))
    message = "which linkwise does not write; identify again, or give"
    with pytest.raises(lw.StructureError, match=message) as refused:
        lw.export_answer(folder, tmp_path / "forces.py")
    assert "\n" not in str(refused.value)
    if fit.grade is lw.Grade.REFUSED:
        with pytest.raises(lw.RecordError, match="the estimate is not to be trusted; identify again"):
            lw.estimates.read_posterior(folder)


def test_a_folder_of_a_method_without_intervals_says_which_methods_give_them(tmp_path: Path) -> None:
    record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    asked = lw.bnes_chain(2).unknown("nes")
    fit = lw.identify(record.with_noise(40.0, seed=5840103), asked, method="sindy")
    assert lw.Verdict.NO_INTERVALS in fit.verdicts and fit.trusted
    folder = lw.report.write_result(fit, tmp_path / "answer")
    with pytest.raises(lw.RecordError, match='the method gives none; identify with method "ml" or "weak"'):
        lw.estimates.read_posterior(folder)


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("absorb moved.toml --duration 1 --release v:m1=1 --sink link --without locked", 2),
        ("limit moved.toml --duration 1 --rate 500 --release v:m1=1 --noise 40", 0),
        ("simulate moved.toml --duration 1 --rate 500 --release v:m1=1 -o run.csv", 0),
    ],
)
def test_commands_on_its_structure_file_say_so_wherever_the_file_went(
    command: str, code: int, fit: lw.Estimate, answer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code = fit.grade.exit_code if command.startswith("limit") else code
    Path("moved.toml").write_text((answer / "structure.toml").read_text())
    assert SENTENCES[fit.grade] in said(command, code).err


def test_a_comparison_goes_no_farther_than_the_answer(fit: lw.Estimate, answer: Path, tmp_path: Path) -> None:
    """Intervals of a law that lacks 40 % of the force let its prediction agree."""
    lw.write_record(hardening(), tmp_path / "run.csv")
    for given in (fit, answer):
        validation = lw.validate(hardening(), given)
        assert lw.Grade.worst((validation.grade, fit.grade)) is validation.grade and not validation.trusted
    code = validation.grade.exit_code
    printed = said(f"validate {tmp_path}/run.csv {answer} --json", code).out
    assert f'"grade": "{validation.grade.value}"' in printed


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(
    ("command", "files"),
    [
        ("respond answer --force m1=1 --from 2 --to 3 --starts 0", "response.json branches.csv"),
        ("backbone answer --mode 1 --to-amplitude x:m1=0.01", "backbone.json backbone.csv"),
        ("basins chain.toml --plane x:m2=-0.02:0.02,v:m2=-0.2:0.2 --points 2", "basins.json basins.csv"),
        ("absorb chain.toml --duration 0.1 --release v:m1=1", "absorption.json energy.csv"),
        (
            "design chain.toml --vary nes1.c=0.01:0.1 --evaluations 8 --duration 0.1 --release v:m1=1",
            "design.json designs.csv",
        ),
    ],
)
def test_pages_of_what_is_computed_from_it_have_its_grade(
    command: str, files: str, fit: lw.Estimate, answer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(answer, "answer")
    basis = lw.verdict.Basis(fit.grade, fit.status)
    Path("chain.toml").write_text(basis.comment + lw.model.format_structure(lw.bnes_chain(2)))
    said(f"{command} -o out", fit.grade.exit_code)
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert f'<div class="verdict {fit.grade.value}">' in page and SENTENCES[fit.grade] in page
    assert {*files.split()} <= {path.name for path in Path("out").iterdir()}
    result = json.loads(Path("out", files.split()[0]).read_text())
    assert (result["grade"], result["basis"]) == (fit.grade.value, SENTENCES[fit.grade])
    assert lw.verdict.Basis.stated_in(Path("out")) == basis
