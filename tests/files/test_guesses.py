"""What columns hold: headers as public programs write them are read rightly, or are in doubt; never wrong without a word."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy
from foreign_files import lab_view

from linkwise.files import read_table
from linkwise.files.column_guesses import (
    NO_MASS,
    NO_QUANTITY,
    NO_UNIT,
    OTHER_TIME,
    TWICE,
    guessed_columns,
    proposed_masses,
)

RATE, COUNT = 500.0, 40


def table(
    path: Path, header: str, *, separator: str = ",", decimal: str = ".", step: float = 1.0 / RATE
) -> Path:
    """A text file with this header over columns of times and numbers."""
    lines = header.split("\n")
    width = max(line.count(separator) for line in lines)
    rows = [
        separator.join([f"{step * k:.6f}", *(f"{np.sin(k + n):.4f}" for n in range(width))])
        for k in range(COUNT)
    ]
    path.write_text("\n".join([*lines, *(row.replace(".", decimal) for row in rows)]), encoding="utf-8")
    return path


def held(path: Path, masses: tuple[str, ...]) -> list[str]:
    """What each column holds, with its unit and a mark for each doubt."""
    marks = {
        NO_UNIT: " unit?",
        NO_QUANTITY: " quantity?",
        NO_MASS: " mass?",
        TWICE: " twice?",
        OTHER_TIME: " other?",
    }
    return [
        f"{guess.name or '-'}{f'[{guess.unit}]' if guess.unit else ''}{''.join(marks[doubt] for doubt in guess.doubts)}"
        for guess in guessed_columns(read_table(path, None), masses)
    ]


RIG = ("frame", "sink")
HEADERS = [
    ("Zeit in s,Weg Rahmen in mm,Weg Tilger in mm", ("rahmen", "tilger"), "time[s] x:rahmen[mm] x:tilger[mm]"),
    ("Zeit/s,s1/µm,s2/µm", ("s1", "s2"), "time[s] x:s1[µm] x:s2[µm]"),
    ("Channel,frame,sink\nUnit,mm,mm", RIG, "time x:frame[mm] x:sink[mm]"),
    ("Time 1 (s),frame (mm),Time 2 (s),sink (mm)", RIG, "time[s] x:frame[mm] -[s] other? x:sink[mm]"),
    ("Time [s],Laser frame [mm],Laser sink [mm],Hammer [N]", RIG, "time[s] x:frame[mm] x:sink[mm] force:frame[N] mass?"),
    ("Time [s],Laser frame [mm],Laser 2 [mm],Force sink [N]", RIG, "time[s] x:frame[mm] x:sink[mm] force:sink[N]"),
    ("Time [s],Laser 1 [mm],Laser 2 [mm]", RIG, "time[s] x:frame[mm] mass? x:sink[mm] mass?"),
    ("Time [s],Laser 1 [mm],Laser 2 [mm]", ("m1", "m2"), "time[s] x:m1[mm] x:m2[mm]"),
    ("Time [s],Laser 2 [mm],Laser 1 [mm]", ("m1", "m2"), "time[s] x:m2[mm] x:m1[mm]"),
    ("Time [s],Acc [g],Acc 2 [g]", ("m1",), "time[s] a:m1[g] mass? a:m2[g] mass?"),
    ("Time [s],Acc_frame,Load cell", ("frame",), "time[s] a:frame unit? force:frame unit?"),
    ("Time (s),AccBase (m/s^2),AccFrame (m/s^2)", ("frame",), "time[s] a:base[m/s^2] a:frame[m/s^2]"),
    ("Time (s),Ground (m/s^2),Frame (m/s^2)", ("frame",), "time[s] a:base[m/s^2] mass? a:frame[m/s^2]"),
    ("Time (s),Sink on frame [mm],Frame [mm]", RIG, "time[s] x:sink[mm] mass? x:frame[mm]"),
    (
        "Time (s),Frame top [mm],Frame bottom [mm]",
        ("frame",),
        "time[s] x:frame[mm] twice? x:frame[mm] twice?",
    ),
    (
        "Time (s),Kraft [mm],Frame [V],Temp [degC]",
        ("frame",),
        "time[s] x:frame[mm] quantity? -[V] quantity? -[degC]",
    ),
    ("time,x:m1,x:m2[mm],force:m1", ("m1", "m2"), "time x:m1 x:m2[mm] force:m1"),
    ("t,x1 [mm],v1 [mm/s],a1 [m/s²]", ("m1",), "time x:m1[mm] v:m1[mm/s] a:m1[m/s²]"),
    ("Time [s],Frame [um],Frame vel [um/s],Counter", ("frame",), "time[s] x:frame[um] v:frame[um/s] -"),
    ("Time [s],Twist disc [deg],Torque disc [N m]", ("disc",), "time[s] x:disc[deg] force:disc[N m]"),
]  # fmt: skip


@pytest.mark.parametrize(("header", "masses", "expected"), HEADERS)
def test_headers_are_read_or_in_doubt(
    header: str, masses: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    assert " ".join(held(table(tmp_path / "run.csv", header), masses)) == expected


def test_units_behind_an_underscore_name_no_mass(tmp_path: Path) -> None:
    path = table(tmp_path / "run.csv", "time,disp_frame_mm,disp_sink_mm")
    assert proposed_masses(guessed_columns(read_table(path, None))) == ("frame", "sink")


def test_german_files_units_below_headers_and_times_in_another_unit(tmp_path: Path) -> None:
    german = "Messung;Prüfstand 3\nZeit;Weg Rahmen;Weg Tilger;Kraft Rahmen\ns;mm;mm;N"
    path = table(tmp_path / "german.csv", german, separator=";", decimal=",")
    expected = ["time[s]", "x:rahmen[mm]", "x:tilger[mm]", "force:rahmen[N]"]
    assert held(path, ("rahmen", "tilger")) == expected
    assert proposed_masses(guessed_columns(read_table(path, None))) == ("rahmen", "tilger")
    milliseconds = table(tmp_path / "ms.csv", "Time,Laser (mm)", step=2.0)  # in ms, unsaid
    assert held(milliseconds, ("m1",)) == ["time unit?", "x:m1[mm]"]
    assert held(table(tmp_path / "scope.csv", "Time,Channel A\n(ms),(mm)", step=2.0), ("m1",)) == [
        "time[ms]",
        "x:m1[mm]",
    ]


def test_files_of_laboratory_programs(tmp_path: Path) -> None:
    wave, units = np.sin(np.arange(COUNT)), {"Acc frame": "g", "cDAQ1Mod1_ai1": "mm", "ai2": "V"}
    channels = {name: (wave, unit) for name, unit in units.items()}
    lab_view(tmp_path / "run.tdms", channels, wf_increment=1.0 / RATE, wf_samples=COUNT, wf_start_offset=0.0)
    assert held(tmp_path / "run.tdms", RIG) == ["a:frame[g]", "x:frame[mm] mass?", "-[V]"]
    scipy.io.savemat(
        tmp_path / "run.mat",
        {"t": np.arange(COUNT) / RATE, "x_m1": np.ones(COUNT), "accel_m2": np.ones(COUNT)},
    )
    assert held(tmp_path / "run.mat", ("m1", "m2")) == ["time", "x:m1", "a:m2 unit?"]
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["rig/frame"] = np.arange(COUNT) / RATE, np.ones(COUNT)
        file["rig/frame"].attrs["unit"] = "mm"
    assert held(tmp_path / "run.h5", ("frame",)) == ["x:frame[mm]", "time"]
    np.save(tmp_path / "run.npy", np.ones((COUNT, 2)))
    assert held(tmp_path / "run.npy", ("frame",)) == ["-", "-"]
