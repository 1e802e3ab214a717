"""`linkwise structure host`: modes or matrices of a linear structure as a host for structure files."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import click
from click import UsageError
from click.core import ParameterSource

import linkwise as lw
from linkwise.cli.console import deliver_structure, note, progress
from linkwise.cli.options import FILE, grouped, pairs, percentage, quantity, typed
from linkwise.cli.reading_options import ReadingOptions

# options that mean nothing for modes
_OF_MATRICES = ("keep", "damping", "modal_damping", "rayleigh", "no_residual")
_NOT_OF_RECORDS = ("points", "units", "mass", "stiffness", *_OF_MATRICES)
_OF_RECORDS = (*(field.name for field in fields(ReadingOptions)), "point_mass")


@dataclass(frozen=True)
class HostOptions:
    """What the file of a host states, as typed.

    Parameters
    ----------
    name : str | None
        Name of the host; by default that of the first file. With --modes, by default the part of the channel names
        before the dot, such as beam in a:beam.tip; if they have one, no other name is accepted.
    mass : str | None
        The mass matrix in FILE, by default M, mass or MAA.
    stiffness : str | None
        The stiffness matrix in FILE, by default K, stiffness or KAA.
    damping : str | None
        The matrix of viscous damping in FILE; without it, none.
    points : tuple[str, ...]
        A point for links, sensors or forces: a row of the matrices, counted from 1, or a node and a direction, such
        as 1205z, where the files name them; or a sum with factors, such as 0.6*1205x+0.8*1205z, an oblique direction.
        Repeatable.
    units : tuple[str, ...]
        That a point turns, where neither a direction such as 1205rz nor the unit of a column says so. Repeatable.
    keep : int
        Number of modes kept.
    modal_damping : float
        Damping ratio of every mode.
    rayleigh : str | None
        Damping by a matrix of A times mass and B times stiffness, in 1/s and s, such as 0.5,1e-5.
    modes : str | None
        FILE is a record of a test at a low level; identify this many modes, or as many as it shows (auto).
    point_mass : tuple[str, ...]
        With --modes of free decays, without a force: the mass that moves at a point. All that moves is stated, and sets the
        scale of the shapes. Repeatable.
    no_residual : bool
        Leave out the flexibility of the modes that are not kept.
    frequency_sigma : str | None
        Relative standard deviation of the frequencies, such as 1%; identify then estimates them with the links.
    damping_sigma : str | None
        Relative standard deviation of the damping, such as 20%.
    shape_sigma : str | None
        Standard deviation of the shapes, such as 2% of the largest shape of the mode at the points.
    """

    name: str | None = typed()
    mass: str | None = typed("NAME")
    stiffness: str | None = typed("NAME")
    damping: str | None = typed("NAME")
    points: tuple[str, ...] = typed("NAME=ROW", "--point", multiple=True)
    units: tuple[str, ...] = typed("NAME=rad", "--unit", multiple=True)
    keep: int = typed("N", type=click.IntRange(min=1), default=10, show_default=True)
    modal_damping: float = typed("RATIO", type=click.FloatRange(min=0.0), default=0.0)
    rayleigh: str | None = typed("A,B")
    modes: str | None = typed("N|auto")
    point_mass: tuple[str, ...] = typed("POINT=KG", multiple=True)
    no_residual: bool = typed(is_flag=True)
    frequency_sigma: str | None = typed("PERCENT%")
    damping_sigma: str | None = typed("PERCENT%")
    shape_sigma: str | None = typed("PERCENT%")


@click.command()
@click.argument("files", metavar="FILE...", type=FILE, nargs=-1, required=True)
@grouped(HostOptions, "given")
@grouped(ReadingOptions, "source")
@click.option("-o", "--output", metavar="HOST", type=FILE, help="File to write; without it, standard output.")
@click.option("--json", "as_json", is_flag=True, help="Print the host as JSON and nothing else.")
def host(
    files: tuple[Path, ...], source: ReadingOptions, given: HostOptions, output: Path | None, as_json: bool
) -> int:
    """Write a host from modes (CSV, UFF), matrices (MAT, NPZ, MTX, PCH, OP4) or records of a modal test.

    The result is the beginning of a structure file, to which links are added. A CSV file has the columns frequency[Hz],
    damping and the shape at every point, in 1/sqrt(kg). Matrices, in SI units (kg, N/m), are reduced to the lowest modes and
    the residual flexibility of the others at the points. Two MTX files are the mass and the stiffness matrix, in this order,
    of MatrixMarket or Abaqus; a third is the damping matrix. Nastran's DMIG entries (PCH, BDF) and OUTPUT4 files (OP4) need
    linkwise[nastran].

    With --modes the files are records of a test at a low level: hits of a hammer, or a shaker, with channels such as
    force:beam.tip, a:beam.tip and a:beam.mid. One response must be where the force acts. Without a force they are free
    decays from the first sample on (--from), and --point-mass sets the scale of the shapes. Frequencies, damping and shapes
    are written with their standard errors, or with --frequency-sigma and the like if these are larger. Columns of other
    names are mapped as in identify, by --channel or --mapping, and other options of records read as there. Exit code 3 means
    that linear modes do not explain the records, or that shapes have no scale.

    \b
    Examples:
      linkwise structure host beam.mat --point tip=79 --point root=5 --keep 8 --modal-damping 0.01 -o beam.toml
      linkwise structure host Job-1_MASS1.mtx Job-1_STIF1.mtx --point tip=1205z --rayleigh 0.5,1e-5 -o beam.toml
      linkwise structure host wing_modes.csv --name wing --shape-sigma 2% -o wing.toml
      linkwise structure host taps.csv --modes auto -o beam.toml
      linkwise structure host decay.csv --from 0.1 --modes auto --point-mass a=1.2 --point-mass b=500g -o frame.toml
      linkwise structure host logger.csv --channel force:beam.tip=Hammer --channel a:beam.tip[g]=Acc1 --modes auto -o beam.toml
    """
    context, modes = click.get_current_context(), given.modes
    if output is not None and any(output.resolve() == file.resolve() for file in files):
        raise UsageError(f"-o {output} would overwrite the file that is read; choose another file.")
    if output is not None and output.exists() and not _holds_hosts_alone(output):
        held = "is there already and holds more than hosts, which would be lost"
        raise UsageError(f"-o {output} {held}; choose another.")
    if modes is None:
        _refuse(context, _OF_RECORDS, "{} is for records of a test: give --modes with it.")
    title = given.name or files[0].stem
    sigmas: dict[str, Any] = {}
    for kind in ("frequency", "damping", "shape"):
        if text := getattr(given, f"{kind}_sigma"):
            sigmas[kind] = 0.01 * percentage(text, f"--{kind}-sigma", "2%")
    estimate = None
    if modes is not None:
        _refuse(context, _NOT_OF_RECORDS, "{} is for modes or matrices, and --modes for records of a test.")
        estimate = _identified(source, files, given)
        new_host = estimate.host.known_to_within(**sigmas, at_least=True)
    elif files[0].suffix.lower() in (".csv", ".uff", ".unv"):
        if len(files) > 1 or given.points or given.mass or given.stiffness:
            raise UsageError("A file of modes has its own points, and is read alone.")
        _refuse(context, _OF_MATRICES, "{} is for matrices; of a file of modes, all are taken as they are.")
        new_host = lw.Host(title, lw.modal.read_modes(files[0])).known_to_within(**sigmas)
    else:
        new_host = _reduced(files, title, given).known_to_within(**sigmas)
    _tell_of_damping(new_host)
    units = pairs(given.units, "--unit", "tip_r=rad")
    new_host = new_host.with_units(units, _points(given))
    identified = {} if estimate is None else {"identified": estimate.to_dict()}
    deliver_structure(lw.Structure(title, (), (), (new_host,)), output, as_json=as_json, further=identified)
    if estimate is None:
        return 0
    if output is not None and not as_json:
        click.echo(str(estimate))
    else:
        note(*estimate.remarks)
        if not estimate.trusted:
            note(f"not to be trusted: {estimate.verdicts[0].value}")
    return estimate.grade.exit_code


def _holds_hosts_alone(path: Path) -> bool:
    """Whether a file is what this command writes, without links and masses that were added."""
    try:
        return set(tomllib.loads(path.read_text(encoding="utf-8-sig"))) <= {"name", "host"}
    except (OSError, ValueError):
        return False


def _tell_of_damping(new_host: lw.Host) -> None:
    """Say that a mode does not oscillate, as where a ratio was given in per cent."""
    for number, mode in enumerate(new_host.modes, start=1):
        if (ratio := mode.damping.value or 0.0) >= 1.0:
            still = (
                f"mode {number} does not oscillate: its damping ratio is {ratio:g}, of which 1 is critical"
            )
            note(f"{still}; {ratio:g} % is {ratio / 100.0:g}")
            return


def _refuse(context: click.Context, options: Sequence[str], message: str) -> None:
    """UsageError with `message` for the first of some options that is given."""
    flags = {parameter.name: parameter.opts[-1] for parameter in context.command.params}
    for option in options:
        if context.get_parameter_source(option) is not ParameterSource.DEFAULT:
            raise UsageError(message.format(flags[option]))


def _identified(source: ReadingOptions, files: tuple[Path, ...], given: HostOptions) -> lw.modal.HostEstimate:
    """The host identified from records of a test."""
    source.refuse_unknown_errors()
    modes = given.modes or "auto"
    stated = pairs(given.point_mass, "--point-mass", "tip=1.2")
    masses = {point: quantity(text, "kg", f"--point-mass {point}") for point, text in stated.items()}
    if modes != "auto" and (not modes.isdecimal() or int(modes) < 1):
        raise UsageError(f"--modes needs a number of modes, or auto, got {modes!r}.")
    with progress("reading") as step:
        records = [source.read_file(file, None) for file in files]
        note(*dict.fromkeys(remark for record in records for remark in record.notes))
        count = None if modes == "auto" else int(modes)
        return lw.modal.identify_host(records, modes=count, name=given.name, masses=masses, progress=step)


def _reduced(files: tuple[Path, ...], title: str, given: HostOptions) -> lw.Host:
    """The host of matrices, by their names in one file, or of two or three files by their order."""
    rayleigh = _rayleigh(given.rayleigh)
    if len(files) > 3:
        message = "Give one file with all matrices, or one for each: mass, stiffness and perhaps damping, in this order."
        raise UsageError(message)
    if given.damping and len(files) == 2:
        raise UsageError("--damping needs a third file, with the damping matrix.")
    if len(files) == 1:
        files *= 3 if given.damping else 2
    names = [f":{name}" if name else "" for name in (given.mass, given.stiffness, given.damping)]
    matrices = lw.modal.read_host_matrices(*map("{}{}".format, files, names))
    how: dict[str, Any] = {"keep": given.keep, "modal_damping": given.modal_damping, "rayleigh": rayleigh}
    reduced = matrices.reduce(title, _points(given), residual=not given.no_residual, **how)
    note(*reduced.notes)
    return reduced.host


def _rayleigh(given: str | None) -> tuple[float, float] | None:
    if given is None:
        return None
    try:
        of_mass, of_stiffness = map(float, given.split(","))
    except ValueError:
        raise UsageError(f"--rayleigh needs two numbers A,B, such as 0.5,1e-5, got {given!r}.") from None
    return of_mass, of_stiffness


def _points(given: HostOptions) -> dict[str, str]:
    """The row of each point, or its node and a direction."""
    return pairs(given.points, "--point", "tip=79 (a row, or a node and a direction)")
