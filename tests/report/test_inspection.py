"""The folder of an inspection: its document, figures and page."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import said
from record_faults import chain

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture(scope="module")
def clipped() -> lw.Record:
    record = chain(2, 30.0)
    values = record.values.copy()
    values[:, 0] = np.clip(values[:, 0], None, 0.7 * values[:, 0].max())
    return replace(record, values=values, source="<b>clipped</b>", simulated=None)


def test_folder_holds_numbers_figures_and_page(clipped: lw.Record, tmp_path: Path) -> None:
    inspection = lw.inspect([clipped, chain(2, 30.0)])
    folder = lw.report.write_inspection(inspection, tmp_path / "looked")
    names = {path.name for path in folder.iterdir()}
    assert {"inspection.json", "report.html"} <= names
    assert {
        f"{kind}_{n}.png" for kind in ("histories", "spectra", "maps", "coherence") for n in (1, 2)
    } <= names
    document = json.loads((folder / "inspection.json").read_text())
    assert document["alerts"] == [alert.to_dict() for alert in inspection.alerts]
    page = (folder / "report.html").read_text(encoding="utf-8")
    body = page[page.index("<body>") :]
    assert body.index("clipped x:m1") < body.index("samples at 1000 Hz")  # alerts first
    assert "<b>clipped</b>" not in body and "&lt;b&gt;clipped&lt;/b&gt;" in body


def test_the_command_writes_it_and_replaces_its_own(clipped: lw.Record, tmp_path: Path) -> None:
    lw.write_record(clipped, tmp_path / "run.csv")
    for _ in range(2):
        assert "--json" not in said(f"inspect {tmp_path}/run.csv -o {tmp_path}/looked").out
    assert "clipped x:m1" in (tmp_path / "looked" / "report.html").read_text(encoding="utf-8")


def test_a_spectrum_shows_the_motion_and_the_noise() -> None:
    record = chain(2, 20.0)
    noise = lw.inspect(record).channel("x:m1").noise
    assert noise is not None
    axes = lw.plot.spectrum(record, "x:m1", noise)
    frequency, density = axes.lines[0].get_data()
    peak = np.asarray(frequency)[np.argmax(density)]
    # the spring under 1 kg; bins of 2 Hz
    assert peak == pytest.approx(np.sqrt(30000.0) / (2 * np.pi), abs=4.0)
    floor = np.median(np.asarray(density)[np.asarray(frequency) > 200.0])
    # a median over 150 bins and the estimate, each good to a few per cent; measured 0.4 %
    assert np.asarray(axes.lines[1].get_ydata())[0] == pytest.approx(floor, rel=0.1)
