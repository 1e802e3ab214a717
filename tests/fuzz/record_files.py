"""Records in every format, ours and those of other programs, sound and damaged."""

import json
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import openpyxl
import pyuff
from nptdms import ChannelObject, TdmsWriter
from problems import chain_record
from scipy.io import savemat

import linkwise as lw
from fuzz.case import Case, Kind
from fuzz.damage import damaged_bytes, damaged_text

N, RATE = 64, 200.0
TIME = np.arange(N) / RATE
CHANNELS = ("x:m1", "x:m2", "force:m1")
_TEXT = (".csv", ".txt", ".tsv", ".json", ".lvm")


def _values() -> Mapping[str, np.ndarray]:
    noise = np.random.default_rng(5).standard_normal((3, N))
    motion = np.stack([np.sin(40.0 * TIME), np.cos(70.0 * TIME) * np.exp(-TIME), np.sin(11.0 * TIME)])
    return dict(zip(CHANNELS, motion + 1e-3 * noise, strict=True))


def _own(suffix: str) -> bytes:
    record = lw.Record.from_arrays(TIME, _values(), noise={"x:m1": 1e-3}, source="a rig", notes=["A note."])
    return _written(suffix, lambda path: lw.write_record(record, path))


def _written(suffix: str, write: Callable[[Path], object]) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        write(path)
        return path.read_bytes()


def _csv(delimiter: str, header: str, comma: bool, preamble: str = "") -> bytes:
    rows = np.column_stack([TIME, *_values().values()])
    lines = [
        delimiter.join(f"{value:.9g}".replace(".", "," if comma else ".") for value in row) for row in rows
    ]
    return (preamble + "\n".join([header, *lines]) + "\n").encode("utf-16" if comma else "utf-8")


def _matlab(path: Path) -> None:
    values = _values()
    savemat(path, {
        "time": TIME, "x_m1": values["x:m1"], "rig": {"x_m2": values["x:m2"]}, "force_m1": values["force:m1"][:, None],
        "fs": RATE,
    })  # fmt: skip


def _matlab_73(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["time"] = TIME[None, :]
        for name, values in _values().items():
            file[name.replace(":", "_")] = values[None, :]


def _groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run/time"] = TIME
        for name, values in _values().items():
            item = file.create_dataset(f"run/{name}", data=1e3 * values, compression="gzip", shuffle=True)
            item.attrs["unit"] = "kN" if name.startswith("force") else "mm"


def write_universal(
    path: Path, channels: Mapping[str, np.ndarray] | None = None, functions: Mapping[str, int] | None = None
) -> None:
    """A universal file of channels, sampled at `RATE`, as data sets of these functions; 1 is a time response."""
    units = ("len_unit_exp", "force_unit_exp", "temp_unit_exp", "spec_data_type")
    axes = ("abscissa", "ordinate", "orddenom", "z_axis")
    rest: dict[str, object] = {f"{axis}_{unit}": 0 for axis in axes for unit in units}
    rest |= {f"{axis}_axis_units_lab": "NONE" for axis in axes} | {f"id{k}": "NONE" for k in range(2, 6)}
    for k, (name, values) in enumerate((channels or _values()).items()):
        data = {
            **rest, "type": 58, "binary": 0, "id1": name, "func_type": (functions or {}).get(name, 1), "ver_num": 1,
            "load_case_id": 0, "rsp_ent_name": "NONE", "rsp_node": 1, "rsp_dir": 3, "ref_ent_name": "NONE", "ref_node": 0,
            "ref_dir": 0, "ord_data_type": 4, "num_pts": len(values), "abscissa_spacing": 1, "abscissa_min": 0.0,
            "abscissa_inc": 1.0 / RATE, "z_axis_value": 0.0, "x": np.arange(len(values)) / RATE, "data": values,
        }  # fmt: skip
        pyuff.UFF(str(path)).write_sets(data, "add" if k else "overwrite")


def _labview(path: Path) -> None:
    with TdmsWriter(str(path)) as writer:
        for name, values in _values().items():
            unit = {"unit_string": "N" if name.startswith("force") else "m", "wf_increment": 1.0 / RATE}
            writer.write_segment([ChannelObject("rig", name, values, properties=unit)])


def _archive(path: Path) -> None:
    np.savez(path, time=TIME, **{name.replace(":", "_"): values for name, values in _values().items()})  # type: ignore[arg-type]  # the stub takes a flag


def _workbook(path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book["Sheet"]
    sheet.append(["time", *CHANNELS])
    for row in np.column_stack([TIME, *_values().values()]).tolist():
        sheet.append(row)
    book.save(path)


def _json() -> bytes:
    return json.dumps(
        {"dt": 1.0 / RATE, **{name: values.tolist() for name, values in _values().items()}}
    ).encode()


def _measurement() -> bytes:
    keys = "LabVIEW Measurement\nSeparator\tTab\nX_Columns\tOne\n***End_of_Header***\n\nChannels\t3\n"
    keys += f"Y_Unit_Label\tm\tm\tN\nDelta_X\t{1.0 / RATE}\n***End_of_Header***\n"
    names = "\t".join(CHANNELS)
    return keys.encode() + _csv("\t", f"X_Value\t{names}\tComment", False)


@cache
def sound_records() -> tuple[tuple[str, bytes], ...]:
    """Suffix and content of files that can be read."""
    names = ",".join(CHANNELS)
    own = [(suffix, _own(suffix)) for suffix in (".csv", ".mat", ".h5", ".parquet")]
    written = {
        ".mat": (_matlab, _matlab_73),
        ".h5": (_groups,),
        ".uff": (write_universal,),
        ".tdms": (_labview,),
    }
    written |= {".npz": (_archive,), ".xlsx": (_workbook,)}
    others = [(suffix, _written(suffix, write)) for suffix, writers in written.items() for write in writers]
    texts = [
        (".csv", _csv(",", f"time,{names}", False)),
        (".csv", _csv(";", "t;x:m1[mm];x:m2 (mm);force:m1[kN]", True)),
        (".tsv", _csv("\t", "time[ms]\tx:m1\tx:m2\tforce:m1", False)),
        (".txt", _csv(" ", f"# time {names.replace(',', ' ')}", False, "written by an instrument\nrig 3\n")),
    ]
    return (*own, *others, *texts, (".json", _json()), (".lvm", _measurement()))


@cache
def sound_record() -> bytes:
    """The CSV file that commands read whose other files are damaged: 0.3 s of the two-mass chain."""
    record = chain_record(2, duration=0.3, rate=500.0).with_noise(40.0, seed=1)
    return _written(".csv", lambda path: lw.write_record(record, path))


def record_case(seed: int, rng: Random) -> Case:
    suffix, content = rng.choice(sound_records())
    if suffix in _TEXT and rng.random() < 0.8:
        encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8"
        content = damaged_text(rng, content.decode(encoding)).encode(encoding, "surrogatepass")
        channels: tuple[str, ...] = ()  # a header that was changed names others
    else:
        content, channels = damaged_bytes(rng, content), () if suffix in _TEXT else CHANNELS
    name = f"run{suffix}"
    if rng.random() < 0.15:
        arguments = ("identify", name, "s.toml", "--method", "weak")
        structure = lw.model.format_structure(lw.bnes_chain(2).unknown("nes")).encode()
        return Case(seed, "record", Kind.COMMAND, arguments, {name: content, "s.toml": structure})
    return Case(seed, "record", Kind.READ, (name,), {name: content}, channels)
