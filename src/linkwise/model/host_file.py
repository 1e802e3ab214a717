"""A host of a structure file: modes in place, in a CSV file or in a universal file (data sets 55), or matrices of a
finite-element model in other files.

A mode is `{ frequency = "5.2 Hz", damping = 0.01, shape = { tip = 1.0, joint = 0.62 } }`; a shape may be known to within,
`{ start = 0.62, sigma = 0.02 }`. `frequency_sigma`, `damping_sigma` and `shape_sigma`, such as "2 %", are for all modes.
A CSV file has the columns frequency[Hz], damping, and one for the shape at each point, in 1/sqrt(kg). Matrices are
reduced to `keep` modes and residual attachment modes when the file is read. A point that turns is in rad, `units = {
tip_r = "rad" }`; a column `tip_r[rad]` of a CSV file and a direction such as 21ry of other files say so themselves.

Damping between modes is given by `damping`, in N s/m at unit modal mass: `[ { modes = [1, 2], damping = 0.3 } ]`, each a
number, "unknown" or known to within, or the whole matrix `[[0.65, 0.3], [0.3, 0.9]]`, whose diagonal stands for the
ratios.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.errors import LinkwiseError, StructureError, located
from linkwise.model.coefficient import Coefficient, coefficient_of, percentage
from linkwise.model.host import Host, HostMode, Pair, entries_of
from linkwise.model.matrix_files import read_host_matrices
from linkwise.model.toml import decode, read_toml_text
from linkwise.units import converts, to_si

_DATA_AT_NODES, _NORMAL_MODE = 55, 2
_DIRECTIONS = {"r1": "x", "r2": "y", "r3": "z", "r4": "rx", "r5": "ry", "r6": "rz"}


def modes_of_uff(path: str | Path) -> tuple[HostMode, ...]:
    """Modes from a universal file; points are named by node and direction, such as "12z".

    Raises StructureError for a file without real normal modes, or modes without a modal mass.
    """
    source = str(path)
    try:
        pyuff = import_module("pyuff")
    except ImportError:
        needed = "reading modes from universal files needs the library pyuff"
        raise StructureError(f"{needed}: install linkwise[files]", source) from None
    if not Path(path).is_file():
        raise StructureError("there is no such file", source)
    try:
        sets = pyuff.UFF(source).read_sets()
    except Exception as error:  # the library raises all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"cannot be read as a universal file: {reason[:200]}", source) from None
    read = sets if isinstance(sets, list) else [sets]
    data_sets = [data for data in read if data.get("type") == _DATA_AT_NODES]
    normal = [data for data in data_sets if data.get("analysis_type") == _NORMAL_MODE]
    if not normal:
        problem = "holds no real normal modes, only other data at nodes" if data_sets else "holds no modes"
        advice = "write those of the test as normal modes (data set 55, analysis type 2)"
        raise StructureError(f"{problem}; {advice}", source)
    moving = [
        (key, name)
        for key, name in _DIRECTIONS.items()
        if any(np.any(np.asarray(data.get(key, 0.0)) != 0.0) for data in normal)
    ]
    return tuple(_mode_of_row(data, moving, f"{source}, mode {n}") for n, data in enumerate(normal, start=1))


def _mode_of_row(data: dict[str, Any], moving: list[tuple[str, str]], where: str) -> HostMode:
    mass = float(data.get("modal_m", 0.0))
    if not mass > 0.0:
        problem = f"has the modal mass {mass:g}, which does not scale its shape"
        raise StructureError(f"{problem}; it must be positive", where)
    nodes = [int(node) for node in np.atleast_1d(data["node_nums"])]
    shape: dict[str, float] = {}
    for key, name in moving:
        values = np.atleast_1d(np.real(data.get(key, np.zeros(len(nodes))))) / np.sqrt(mass)
        shape |= {f"{node}{name}": float(value) for node, value in zip(nodes, values, strict=True)}
    rotations = [f"{node}{name}" for _, name in moving if name.startswith("r") for node in nodes]
    with located(where):
        return HostMode(float(data["freq"]), float(data["modal_damp_vis"]), shape, rotations=rotations)


_FREQUENCY, _DAMPING = "frequency", "damping"


_OPTIONS = ("keep", "modal_damping", "rayleigh", "residual")
_OF_MATRICES = ("points", *_OPTIONS)


class HostTable(msgspec.Struct, forbid_unknown_fields=True):
    """A host as written: `modes`, a list of tables or the name of a file of modes; or `matrices` with `points` and options."""

    name: str
    modes: list[Any] | str | None = None
    matrices: dict[str, str] | None = None
    points: dict[str, int | str] = {}
    keep: int | None = None
    modal_damping: float | None = None
    rayleigh: tuple[float, float] | None = None
    residual: bool | None = None
    frequency_sigma: str | None = None
    damping_sigma: str | None = None
    shape_sigma: str | None = None
    damping: list[Any] | None = None
    units: dict[str, str] = {}


class _DampingTable(msgspec.Struct, forbid_unknown_fields=True):
    modes: tuple[int, int]
    damping: float | str | dict[str, Any]


class _ModeTable(msgspec.Struct, forbid_unknown_fields=True):
    frequency: float | str | dict[str, Any]
    shape: dict[str, float | dict[str, Any]]
    damping: float | str | dict[str, Any] = 0.0


def host_of(entry: HostTable, index: int, source: str) -> Host:
    """The host of entry `index` of the file `source`. Raises StructureError with the place of what is wrong."""
    path = f"host[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    if (entry.modes is None) == (entry.matrices is None):
        raise StructureError("a host has either modes or matrices", where)
    if entry.modes is None and entry.damping is not None:
        message = (
            'damping belongs to modes; a damping matrix is named in matrices, such as damping = "beam.mat:C"'
        )
        raise StructureError(message, where)
    for key in _OF_MATRICES if entry.modes is not None else ():
        if getattr(entry, key) not in (None, {}):
            advice = "modes are taken as they are, with a shape at every point"
            raise StructureError(f"{key} belongs to matrices; {advice}", where)
    host = _of_matrices(entry, source, where) if entry.modes is None else _of_modes(entry, source, path)
    parts: dict[str, Any] = {
        quantity: 0.01 * percentage(text, f"{source}, {path}.{quantity}_sigma")
        for quantity in ("frequency", "damping", "shape")
        if (text := getattr(entry, f"{quantity}_sigma")) is not None
    }
    with located(where):
        return host.with_units(entry.units, entry.points).known_to_within(**parts)


def _of_modes(entry: HostTable, source: str, path: str) -> Host:
    where = f'{source}, {path} "{entry.name}"'
    if isinstance(entry.modes, str):
        modes = read_modes(Path(source).parent / entry.modes)
    else:
        listed = enumerate(entry.modes or ())
        modes = tuple(_mode_of_table(given, source, f"{path}.modes[{n}]") for n, given in listed)
    if entry.damping and all(isinstance(row, list) for row in entry.damping):
        return _damped_by_matrix(entry.name, modes, entry.damping, where)
    entries: dict[Pair, Coefficient] = {}
    for number, given in enumerate(entry.damping or ()):
        place = f"{path}.damping[{number}]"
        table = decode(given, _DampingTable, source, place, StructureError)
        if table.modes in entries:
            raise StructureError("the damping between two modes is given twice", where)
        entries[table.modes] = coefficient_of(table.damping, "N s/m", source, f"{place}.damping")
    with located(where):
        return Host(entry.name, modes, damping=entries)


def _damped_by_matrix(name: str, modes: tuple[HostMode, ...], rows: list[Any], where: str) -> Host:
    """A host with a whole modal damping matrix, from its rows; the diagonal as damping ratios of modes that vibrate."""
    count = len(modes)
    numbers = [entry for row in rows for entry in row if type(entry) in (int, float)]
    if len(numbers) != count * count or any(len(row) != count for row in rows):
        raise StructureError(
            f"damping must be a matrix of {count} rows of {count} numbers, one for each mode, or a list of tables such as "
            "{ modes = [1, 2], damping = 0.3 }",
            where,
        )
    entries = entries_of(np.array(rows, dtype=float), where)
    damped = []
    for number, mode in enumerate(modes, start=1):
        own = entries.get((number, number), 0.0)
        if own and (mode.damping.value or not mode.damping.known):
            message = f"mode {number} has a damping of its own and one on the diagonal of the damping matrix; give one"
            raise StructureError(message, where)
        if own and mode.frequency.value:
            del entries[number, number]
            mode = replace(mode, damping=Coefficient.number(own / (4.0 * math.pi * mode.frequency.value)))
        damped.append(mode)
    between = {pair: Coefficient.number(entry) for pair, entry in entries.items()}
    return Host(name, tuple(damped), damping=between)


def _of_matrices(entry: HostTable, source: str, where: str) -> Host:
    matrices = entry.matrices or {}
    if not {"mass", "stiffness"} <= set(matrices) <= {"mass", "stiffness", "damping"}:
        raise StructureError(
            'matrices need the keys mass and stiffness, such as { mass = "beam.mat:M", stiffness = "beam.mat:K" }, and may '
            f"have damping; got {', '.join(matrices) or 'none'}",
            where,
        )
    read = read_host_matrices(**matrices, folder=Path(source).parent)
    with located(where):
        how = {key: given for key in _OPTIONS if (given := getattr(entry, key)) is not None}
        reduced = read.reduce(entry.name, entry.points, **how)
    return replace(reduced.host, notes=reduced.notes)


def _mode_of_table(given: object, source: str, path: str) -> HostMode:
    table = decode(given, _ModeTable, source, path, StructureError)
    stated = table.frequency.values() if isinstance(table.frequency, dict) else (table.frequency,)
    for text in stated:
        if isinstance(text, str) and text != "unknown" and "%" not in text:
            _require_frequency(text.lstrip("+-0123456789.eE ") or "Hz", f"{source}, {path}.frequency")
    frequency = coefficient_of(table.frequency, "Hz", source, f"{path}.frequency")
    damping = coefficient_of(table.damping, "", source, f"{path}.damping")
    shape = {}
    for point, given_there in table.shape.items():
        place = f"{path}.shape.{point}"
        shape[point] = value = coefficient_of(given_there, "", source, place)
        if value.value is None or (value.lower, value.upper) != (-math.inf, math.inf):
            raise StructureError("expected a number, or a table of start and sigma", f"{source}, {place}")
    with located(f"{source}, {path}"):
        starts = {point: float(value.value or 0.0) for point, value in shape.items()}
        return HostMode(frequency, damping, starts).with_shape(shape)


def read_modes(path: str | Path) -> tuple[HostMode, ...]:
    """Read the modes of a host from a CSV or a universal file.

    Parameters
    ----------
    path : str or Path
        A CSV file with the columns ``frequency[Hz]``, ``damping`` (0 without it) and one for the shape at each point, in
        1/sqrt(kg), ``tip_r[rad]`` for a rotation in rad/(m sqrt(kg)),
        separated by commas, or by semicolons or tabs, where numbers may have decimal commas; or a universal file
        (.uff, .unv) with data sets of type 55 in SI units, whose points are named by node and direction, such as ``"12z"``.

    Returns
    -------
    tuple of HostMode
        The modes.

    Raises
    ------
    StructureError
        If the file cannot be read, or is no such table; the error names the file and the line.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "wing.csv"
    ...     _ = path.write_text("frequency[Hz],damping,tip\\n5.2,0.01,1.0\\n")
    ...     lw.modal.read_modes(path)[0].frequency.value
    5.2
    """
    source = str(path)
    if Path(path).suffix.lower() in (".uff", ".unv"):
        return modes_of_uff(path)
    text = read_toml_text(path, StructureError)
    first = next((line for line in text.splitlines() if line.strip()), "")
    delimiter = next((mark for mark in ";\t" if mark in first), ",")  # names of points have neither
    try:
        lines = list(csv.reader(text.splitlines(), delimiter=delimiter))
    except csv.Error as error:
        raise StructureError(f"cannot be read as a CSV file: {error}", source) from None
    rows = [(number, cells) for number, cells in enumerate(lines, start=1) if any(c.strip() for c in cells)]
    if len(rows) < 2:
        message = (
            "expected a line of column names, frequency[Hz], damping and the points, and a line for each mode"
        )
        raise StructureError(message, source)
    (_, header), *modes = rows
    names, units = _mode_columns([name.strip() for name in header], source)
    if delimiter != ",":  # numbers may have decimal commas
        modes = [(number, [cell.replace(",", ".") for cell in cells]) for number, cells in modes]
    return tuple(_mode_of_line(names, units, cells, f"{source}, line {number}") for number, cells in modes)


def _mode_columns(header: list[str], source: str) -> tuple[list[str], dict[str, str]]:
    """The columns, and the units that their names state."""
    where, names, units = f"{source}, line 1", [], {}
    for name in header:
        plain, bracket, bracketed = name.partition("[")
        key = plain.strip().lower() if plain.strip().lower() in (_FREQUENCY, _DAMPING) else plain.strip()
        names.append(key)
        if bracket:
            units[key] = bracketed.rstrip("] ")
    repeated = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if _FREQUENCY not in names or repeated is not None or "" in names:
        problem = f"the column {repeated} is listed twice" if repeated else "there is no column frequency[Hz]"
        problem = "a column has no name" if "" in names else problem
        if _FREQUENCY not in names and any(name.startswith("force:") for name in names):
            advice = "identify its modes, by `structure host` with modes auto"
            problem += f", and this is the record of a test: {advice}"
        raise StructureError(f"{problem}; the columns are {', '.join(names)}", where)
    _require_frequency(units.get(_FREQUENCY, "Hz"), where)
    for key, unit in units.items():
        allowed = {_DAMPING: ("", "1", "%")}.get(key, (*_OF_SHAPES, *_OF_ROTATIONS))
        if key != _FREQUENCY and unit.replace(" ", "") not in allowed:
            listed = " or ".join(filter(None, allowed))
            raise StructureError(f"the unit of {key} must be {listed}, got {unit!r}", where)
    return names, units


_OF_SHAPES = ("1/sqrt(kg)", "kg^-0.5", "kg**-0.5", "1/kg^0.5")
_OF_ROTATIONS = ("rad", "rad/(msqrt(kg))", "rad/(m*sqrt(kg))", "rad/m/sqrt(kg)")


def _require_frequency(unit: str, where: str) -> None:
    """Raise StructureError unless a unit is one of cycles per time, for which an angle must not be taken."""
    if any(word in unit.lower() for word in ("rad", "deg", "rpm", "rev", "turn")):
        advice = "divide rad/s by 2 pi, and rpm by 60"
        raise StructureError(f"a frequency is given in Hz, not in {unit}: {advice}", where)
    if not converts(unit, "Hz"):
        wanted = "expected Hz or what converts to it, such as kHz"
        raise StructureError(f"unit of the frequency: {wanted}, got {unit}", where)


def _mode_of_line(names: list[str], units: dict[str, str], cells: list[str], where: str) -> HostMode:
    if len(cells) != len(names):
        raise StructureError(f"expected {len(names)} cells, as in the first line, got {len(cells)}", where)
    numbers = {}
    for name, cell in zip(names, cells, strict=True):
        try:
            numbers[name] = float(cell)
        except ValueError:
            wanted = f"expected a number in the column {name}"
            raise StructureError(f"{wanted}, got {cell.strip()!r}", where) from None
    frequency, damping = numbers.pop(_FREQUENCY), numbers.pop(_DAMPING, 0.0)
    try:
        in_hertz = float(to_si(f"{frequency!r} {units.get(_FREQUENCY, 'Hz')}", "Hz"))
        damping *= 0.01 if units.get(_DAMPING) == "%" else 1.0
        rotations = [name for name in numbers if units.get(name, "").replace(" ", "") in _OF_ROTATIONS]
        return HostMode(in_hertz, damping, numbers, rotations=rotations)
    except LinkwiseError as error:
        raise StructureError(str(error), where) from None
