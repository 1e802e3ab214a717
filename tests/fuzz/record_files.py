"""Records in every format, ours and those of other programs, sound and damaged."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from random import Random

import h5py
import numpy as np
from foreign_files import Response, content, lab_view, lvm, matlab_v73, universal, workbook
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
    return content(suffix, lambda path: lw.write_record(record, path))


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
    matlab_v73(path, {"time": TIME, **{name.replace(":", "_"): values for name, values in _values().items()}})


def _groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run/time"] = TIME
        for name, values in _values().items():
            item = file.create_dataset(f"run/{name}", data=1e3 * values, compression="gzip", shuffle=True)
            item.attrs["unit"] = "kN" if name.startswith("force") else "mm"


def _universal(path: Path) -> None:
    universal(path, [Response(name, values, 1.0 / RATE) for name, values in _values().items()])


def _labview(path: Path) -> None:
    channels = {
        name: (values, "N" if name.startswith("force") else "m") for name, values in _values().items()
    }
    lab_view(path, channels, wf_increment=1.0 / RATE)


def _archive(path: Path) -> None:
    np.savez(path, time=TIME, **{name.replace(":", "_"): values for name, values in _values().items()})  # type: ignore[arg-type]  # the stub takes a flag


def _workbook(path: Path) -> None:
    workbook(path, [["time", *CHANNELS], *np.column_stack([TIME, *_values().values()]).tolist()])


def _json() -> bytes:
    return json.dumps(
        {"dt": 1.0 / RATE, **{name: values.tolist() for name, values in _values().items()}}
    ).encode()


def _measurement() -> bytes:
    header, *rows = _csv("\t", "\t".join(["X_Value", *CHANNELS, "Comment"]), False).decode().splitlines()
    return lvm("One", rows, header, "m\tm\tN", 1.0 / RATE).encode()


@cache
def sound_records() -> tuple[tuple[str, bytes], ...]:
    """Suffix and content of files that can be read."""
    names = ",".join(CHANNELS)
    own = [(suffix, _own(suffix)) for suffix in (".csv", ".mat", ".h5", ".parquet")]
    written = {
        ".mat": (_matlab, _matlab_73),
        ".h5": (_groups,),
        ".uff": (_universal,),
        ".tdms": (_labview,),
    }
    written |= {".npz": (_archive,), ".xlsx": (_workbook,)}
    others = [(suffix, content(suffix, write)) for suffix, writers in written.items() for write in writers]
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
    return content(".csv", lambda path: lw.write_record(record, path))


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
