"""Files of records as public programs write them: universal, TDMS, LVM, MATLAB 7.3, Testlab and Excel."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import h5py
import numpy as np
import openpyxl
import pyuff
from nptdms import ChannelObject, TdmsWriter

from linkwise.arrays import Floats


def content(suffix: str, write: Callable[[Path], object]) -> bytes:
    """The bytes of a file that is written so."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        write(path)
        return path.read_bytes()


class Response(NamedTuple):
    """A data set 58: its label, samples, step or times, code of its quantity, node, unit, and code of its function."""

    label: str
    values: Floats
    step: float | Floats
    quantity: int = 0
    node: int = 1
    unit: str = "NONE"
    function: int = 1


def universal(path: Path, responses: Iterable[Response]) -> None:
    axes = ("abscissa", "ordinate", "orddenom", "z_axis")
    units = ("len_unit_exp", "force_unit_exp", "temp_unit_exp", "spec_data_type")
    none: dict[str, Any] = {f"{axis}_{unit}": 0 for axis in axes for unit in units}
    none |= {f"{axis}_axis_units_lab": "NONE" for axis in axes} | {f"id{k}": "NONE" for k in range(2, 6)}
    for number, (label, values, step, quantity, node, unit, function) in enumerate(responses):
        even = isinstance(step, float)
        data = {
            **none, "type": 58, "binary": 0, "id1": label, "func_type": function, "ver_num": 1, "load_case_id": 0,
            "rsp_ent_name": "NONE", "rsp_node": node, "rsp_dir": 3, "ref_ent_name": "NONE", "ref_node": 0, "ref_dir": 0,
            "ord_data_type": 4, "num_pts": len(values), "abscissa_spacing": int(even), "abscissa_min": 0.0,
            "abscissa_inc": step if even else 0.0, "ordinate_spec_data_type": quantity, "ordinate_axis_units_lab": unit,
            "z_axis_value": 0.0, "abscissa_spec_data_type": 17, "x": step * np.arange(len(values)) if even else step,
            "data": values,
        }  # fmt: skip
        pyuff.UFF(str(path)).write_sets(data, "add" if number else "overwrite")


def lab_view(
    path: Path, channels: Mapping[str, tuple[Any, str]], group: str = "rig", /, **properties: Any
) -> None:
    """A TDMS file of one group, a segment for each channel: name -> (values, unit)."""
    with TdmsWriter(str(path)) as writer:
        for name, (values, unit) in channels.items():
            stated = {**properties, **({"unit_string": unit} if unit else {})}
            writer.write_segment([ChannelObject(group, name, values, stated)])


def lvm(clocks: str, rows: Sequence[str], names: str, units: str, step: float, separator: str = "\t") -> str:
    """The text of an LVM file; `names`, `units` and rows are separated by tabs, whatever the file has."""
    count = len(units.split("\t"))
    lines = [
        "LabVIEW Measurement", "Writer_Version\t2", f"Separator\t{'Tab' if separator == chr(9) else 'Comma'}",
        "Decimal_Separator\t.", f"X_Columns\t{clocks}", "***End_of_Header***", "",
        f"Channels\t{count}", "\t".join(["Samples", *[str(len(rows))] * count]), f"Y_Unit_Label\t{units}",
        "\t".join(["X_Dimension", *["Time"] * count]), "\t".join(["Delta_X", *[str(step)] * count]),
        "***End_of_Header***", names, *rows,
    ]  # fmt: skip
    return "\n".join(line.replace("\t", separator) for line in lines) + "\n"


def matlab_v73(path: Path, variables: Mapping[str, Any]) -> None:
    """A file as MATLAB's `save -v7.3` lays it out: 512 bytes of header, arrays transposed, text as numbers."""

    def put(group: h5py.Group, name: str, value: Any) -> None:
        if isinstance(value, dict):
            struct = group.create_group(name)
            struct.attrs["MATLAB_class"] = np.bytes_("struct")
            for field, member in value.items():
                put(struct, field, member)
        elif isinstance(value, str):
            codes = np.frombuffer(value.encode("utf-16-le"), np.uint16)[:, np.newaxis]
            group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
        elif isinstance(value, list):
            references = np.empty((len(value), 1), dtype=h5py.ref_dtype)
            for i, member in enumerate(value):
                put(file["#refs#"], f"{name}{i}", member)
                references[i, 0] = file["#refs#"][f"{name}{i}"].ref
            cells = group.create_dataset(name, data=references, dtype=h5py.ref_dtype)
            cells.attrs["MATLAB_class"] = np.bytes_("cell")
        else:
            item = group.create_dataset(name, data=np.atleast_2d(value).T)
            item.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_group("#refs#")
        for name, value in variables.items():
            put(file, name, value)
        empty = file.create_dataset("nothing", data=np.zeros(2, np.uint64))
        empty.attrs["MATLAB_class"], empty.attrs["MATLAB_empty"] = np.bytes_("double"), 1
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def lms_signal(
    values: Any, unit: Any, name: Any, step: float, *, start: float = 0.0, factor: float | None = None
) -> dict[str, Any]:
    """A signal as Testlab exports it to MATLAB; several of them have lists of units and names."""
    scale = {} if factor is None else {"unit_transformation": {"factor": factor, "offset": 0.0}}
    point = {} if isinstance(name, list) else {"primary_channel": {"point_id": name, "direction": "+Z"}}
    axis = {
        "start_value": start,
        "increment": step,
        "number_of_values": float(len(values)),
        "quantity": {"label": "s"},
    }
    return {
        "x_values": axis,
        "y_values": {"values": values, "quantity": {"label": unit, **scale}},
        "function_record": {"name": name, "type": "Signal", **point},
    }


def workbook(path: Path, rows: Iterable[list[Any]], **others: list[list[Any]]) -> None:
    """A workbook with these rows in its first sheet, and sheets of these names with others before or behind it."""
    book = openpyxl.Workbook()
    for row in rows:
        book["Sheet"].append(row)
    for name, lines in others.items():
        sheet = book.create_sheet(name, 0 if name == "notes" else None)
        for line in lines:
            sheet.append(line)
    book.save(path)
