"""The examples in docstrings run and print what they say."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest
from here import studies_here

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")

PACKAGE = Path(lw.__file__).parent
TEXTS = {
    ".".join(("linkwise", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): text
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in (text := path.read_text(encoding="utf-8"))
}
STUDY = "results/mine"  # what examples of studies call theirs, the result of mine.toml
DEFINITION = """
snr_db = [40]
first_seed = 1000
cycles = 2

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 0.5
rate = 1000.0

[[method]]
kind = "weak"
"""


@pytest.fixture(scope="module")
def folder_with_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the study that examples read."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "mine.toml").write_text(DEFINITION, encoding="utf-8")
    with studies_here():
        lw.run_study(folder / "mine.toml", folder / STUDY, workers=1)
    return folder


@pytest.mark.parametrize("name", TEXTS)
def test_examples_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    needs_study = STUDY in TEXTS[name]
    monkeypatch.chdir(request.getfixturevalue("folder_with_study") if needs_study else tmp_path)
    results = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS)
    stated = sum(line.lstrip().startswith(">>> ") for line in TEXTS[name].splitlines())
    assert results.failed == 0 and results.attempted == stated > 0


def test_no_example_is_skipped() -> None:
    assert [name for name, text in TEXTS.items() if "doctest: +SKIP" in text] == []
