"""`linkwise start --yes` on files as public programs write them: each column is mapped rightly, or asked about in words."""

import io
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
import scipy
from commands import said
from foreign_files import Response, content, lab_view, lms_signal, lvm, matlab_v73, universal, workbook
from pyarrow import parquet

import linkwise as lw

MASSES, RATE, GRAVITY = {"frame": 2.3, "sink": 0.21}, 1000.0, 9.80665
ANSWERED = " ".join(f"--mass {name}={mass}" for name, mass in MASSES.items())
RIG = lw.rig(
    MASSES,
    {"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"},
    {"leaf.k": 3400.0, "leaf.c": 2.1, "nes.alpha": 130.0, "nes.beta": 4e6, "nes.c": 0.12},
)
RUN = lw.simulate(
    RIG,
    forces={"frame": "230*exp(-((t - 0.1)/0.003)**2)"},
    duration=0.4,
    rate=RATE,
    sensors=("x", "v", "a"),
).with_noise(40.0, seed=11)
T, N = RUN.time, len(RUN.time)
X1, X2, V1, A1, A2 = (RUN[name] for name in ("x:frame", "x:sink", "v:frame", "a:frame", "a:sink"))
F, MM1, MM2 = RUN["force:frame"], 1e3 * X1, 1e3 * X2
BOTH = {"x:frame": X1, "x:sink": X2}
FORCED, ACCELERATED = {**BOTH, "force:frame": F}, {"a:frame": A1, "a:sink": A2, "force:frame": F}


GERMAN = {"separator": ";", "decimal": ","}
TABS = {"separator": "\t", "decimal": ","}


def text(
    head: str,
    *columns: Any,
    separator: str = ",",
    decimal: str = ".",
    encoding: str = "utf-8",
    number: str = "%.7f",
) -> bytes:
    rows = (separator.join(number % value for value in row) for row in zip(*columns, strict=True))
    return (head + "\n" + "\n".join(row.replace(".", decimal) for row in rows) + "\n").encode(encoding)


def written(write: Callable[[io.BytesIO], object]) -> bytes:
    file = io.BytesIO()
    write(file)
    return file.getvalue()


def matlab(**content: Any) -> bytes:
    return written(lambda file: scipy.io.savemat(file, content, long_field_names=True))


def labview() -> bytes:
    rows = text("", T, A1 / GRAVITY, A2 / GRAVITY, F, separator="\t").decode().split()
    lines = ["\t".join(rows[k : k + 4]) for k in range(0, len(rows), 4)]
    return lvm("One", lines, "X_Value\tAcc frame\tAcc sink\tHammer\tComment", "g\tg\tN", 1 / RATE).encode()


def uff() -> bytes:
    sets = (("Acc frame", A1, 12, "m/s^2"), ("Acc sink", A2, 12, "m/s^2"), ("Hammer", F, 13, "N"))
    responses = [Response(name, values, 1 / RATE, code, unit=unit) for name, values, code, unit in sets]
    return content(".uff", lambda path: universal(path, responses))


def signals() -> bytes:
    each = ("frame:+Z", "g", A1 / GRAVITY), ("sink:+Z", "g", A2 / GRAVITY), ("hammer:+Z", "N", F)
    return matlab(
        **{
            f"Signal_{k}": lms_signal(v[:, None], unit, name, 1 / RATE)
            for k, (name, unit, v) in enumerate(each)
        }
    )


def groups() -> bytes:
    def write(file: io.BytesIO) -> None:
        with h5py.File(file, "w") as content:
            for name, unit, values in (
                ("time", "s", T), ("frame", "um", 1e6 * X1), ("sink", "um", 1e6 * X2), ("load_cell", "N", F),
            ):  # fmt: skip
                content.create_dataset(f"rig/{name}", data=values).attrs["units"] = unit

    return written(write)


def daqmx() -> bytes:
    channels = {
        "ai0 Acc Frame": (A1 / GRAVITY, "g"),
        "ai1 Acc Sink": (A2 / GRAVITY, "g"),
        "ai2 Hammer": (F, "N"),
    }
    own = {f"cDAQ1Mod1/{name}": channel for name, channel in channels.items()}
    stated = {"wf_increment": 1 / RATE, "wf_samples": N, "wf_start_offset": 0.0}
    return content(".tdms", lambda path: lab_view(path, own, "Log", **stated))


def table(**columns: Any) -> bytes:
    return written(lambda file: parquet.write_table(pyarrow.table(columns), file))


EXCEL = '\ufeff"Zeit (ms)";"Frame (mm)";"Sink (mm)";"Hammer (N)"'


def sound() -> bytes:
    return written(lambda file: scipy.io.wavfile.write(file, 1000, (1e3 * A1).astype(np.int16)))


SHEET = [
    ["Test", "Rig A"],
    [],
    ["Time", "Displacement frame", "Displacement sink", "Shaker force"],
    ["s", "mm", "mm", "N"],
]
PHONE = [
    {"sensor": "Accelerometer", "seconds_elapsed": f"{t:.6f}", "z": f"{a:.6f}"}
    for t, a in zip(T, A1, strict=True)
]
CATMAN = "CATMAN\nDatum: 12.03.2024\nAnzahl Kanäle: 4\n\nZeit\tWeg Frame\tWeg Sink\tKraft Frame\ns\tmm\tmm\tN"
SCOPE = (
    "Model,MDO3024\n\nHorizontal Units,S,\nSample Interval,0.001,\nVertical Units,V,V\nLabel,,\nTIME,CH1,CH2"
)
POLYTEC = (
    "Source File Name:\trun.svd\nDomain:\tTime\nSignal:\tVib Velocity\n\nTime\tVelocity Frame\n[ s ]\t[ m/s ]"
)
LATER_MATLAB = content(".mat", lambda path: matlab_v73(path, {"t": T, "x_frame": X1, "x_sink": X2}))
ROWS = [*SHEET, *np.stack([T, MM1, MM2, F], axis=1).tolist()]
WORKBOOK = content(".xlsx", lambda path: workbook(path, ROWS))
FILES: dict[str, tuple[str, bytes, dict[str, np.ndarray] | str]] = {  # what is mapped, or a part of what is asked
    "Excel, German": ("run.csv", text(EXCEL, 1e3 * T, MM1, MM2, F, **GERMAN), FORCED),
    "Excel, Unicode": ("run.txt", text("t [s]\tWeg Frame [mm]\tWeg Sink [mm]", T, MM1, MM2, **TABS, encoding="utf-16"), BOTH),
    "DIN 1313": ("run.dat", text("Zeit / s;Frame / mm;Sink / mm", T, MM1, MM2, **GERMAN), BOTH),
    "catman": ("run.asc", text(CATMAN, T, MM1, MM2, F, **TABS, encoding="latin-1"), FORCED),
    "inches": ("run.csv", text("Time (sec),Frame Disp (in),Sink Disp (in)", T, X1 / 0.0254, X2 / 0.0254), BOTH),
    "savetxt": ("run.txt", text("# time[s] frame[mm] sink[mm]", T, MM1, MM2, separator=" ", number="%.9e"), BOTH),
    "Polytec": ("run.txt", text(POLYTEC, T, V1, separator="\t", number="%.9e"), {"v:frame": V1}),
    "LVM": ("run.lvm", labview(), ACCELERATED),
    "UFF": ("run.uff", uff(), ACCELERATED),
    "TDMS": ("run.tdms", daqmx(), ACCELERATED),
    "MAT v5": ("run.mat", matlab(t=T[:, None], x_frame=X1, x_sink=X2), BOTH),
    "MAT v7.3": ("run.mat", LATER_MATLAB, BOTH),
    "Testlab": ("run.mat", signals(), ACCELERATED),
    "HDF5": ("run.h5", groups(), FORCED),
    "Parquet": ("run.parquet", table(**{"Time [s]": T, "Frame [mm]": MM1, "Sink [mm]": MM2}), BOTH),
    "XLSX": ("run.xlsx", WORKBOOK, FORCED),
    "NPZ": ("run.npz", written(lambda file: np.savez(file, time=T, x_frame=X1, x_sink=X2)), BOTH),
    "JSON": ("run.json", json.dumps({"fs": RATE, "x:frame": X1.tolist(), "x:sink": X2.tolist()}).encode(), BOTH),
    "pandas": ("run.parquet", table(time_ms=1e3 * T, frame_mm=MM1, sink_mm=MM2), "--channel 'x:sink[mm]=sink_mm'"),
    "WAV": ("run.wav", sound(), "1 (no guess)"),
    "PicoScope": ("run.csv", text("Time,Channel A,Channel B\n(ms),(mV),(V)\n", 1e3 * T, X1, X2), "Channel B (no guess)"),
    "Tektronix": ("run.csv", text(SCOPE, T, X1, X2), "CH1 (no guess), CH2 (no guess)"),
    "a phone": ("run.json", json.dumps(PHONE).encode(), "z (no guess)"),
    "Dewesoft": ("run.mat", matlab(Data1_AI_1_frame=A1, Data1_time_AI_1_frame=T), "no guess; which"),
    "controller": ("run.csv", text("Time [s],Frame [mm],Gap [mm],Aim [mm]", T, MM1, MM2, X1), "Gap (displacement; which"),
    "spin test": ("run.csv", text("Time [s],T [degC],Frame [mm],Shaft [rpm]", T, T, MM1, T), "Shaft (velocity; which"),
}  # fmt: skip


@pytest.mark.parametrize("program", FILES)
def test_columns_are_mapped_rightly_or_asked_about(
    program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("linkwise.cli.start._run", lambda *_: 0)  # the columns are all that is asked here
    name, content, expected = FILES[program]
    Path(name).write_bytes(content)
    line = f"start {shlex.quote(name)} {ANSWERED} --yes -o found"
    if isinstance(expected, str):
        assert expected in said(line, 2).err
        assert [path.name for path in tmp_path.iterdir()] == [name]
        return
    said(line)
    record = lw.read_record(name, mapping="found/sensors.toml")
    assert set(record.channels) == set(expected) and record.rate == pytest.approx(RATE)
    for channel, values in expected.items():
        assert np.abs(record[channel] - values).max() < 1e-4 * np.abs(values).max()
