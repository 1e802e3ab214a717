"""`linkwise export`: an answer, to functions and tables of other programs."""

from __future__ import annotations

from pathlib import Path

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import note
from linkwise.cli.help import listing
from linkwise.cli.options import ANSWER, FILE
from linkwise.export import answer as exports
from linkwise.export import equations as motions
from linkwise.export.fmu import compiler
from linkwise.output import to_json


def _formats() -> list[str]:
    """The formats of answers and of equations, as help lists them."""
    listed = exports.listed_formats
    return [*listed(exports.EXPORTS), "and of --equations", *listed(motions.EQUATIONS)]


_EQUATIONS = "Write the equations of motion, z' = f(t, z, u), with their Jacobian: .py, .m, .c or .fmu. May be repeated."


@click.command(cls=listing("FORMATS", _formats))
@click.argument("answer", type=ANSWER)
@click.argument("files", metavar="[FILE]...", nargs=-1, type=FILE)
@click.option("--equations", metavar="FILE", multiple=True, type=FILE, help=_EQUATIONS)
@click.option("--json", "as_json", is_flag=True, help="Print the files written as JSON and nothing else.")
def export(answer: Path, files: tuple[Path, ...], equations: tuple[Path, ...], as_json: bool) -> int:
    """Write an answer for other programs, each FILE in the format of its suffix.

    ANSWER is the folder that identify or discover wrote, or a structure file in which every coefficient is a number.
    What is written of an answer that is not to be trusted says so, and the exit code is 3.

    \b
      FORMATS

    \b
    Examples:
      linkwise export answer forces.py
      linkwise export answer forces.m coefficients.xlsx
      linkwise export answer/structure.toml structure.mat
      linkwise export answer --equations motion.py
      linkwise export answer --equations motion.c --equations motion.fmu
    """
    if not files and not equations:
        raise UsageError("nothing to write: name a FILE for forces and coefficients, or --equations FILE")
    for file in files:
        exports.format_writer(file, exports.EXPORTS, "answers")
    for file in equations:
        exports.format_writer(file, motions.EQUATIONS, "equations")
    content = exports.ExportedAnswer.of(answer)
    if remark := content.note if files else content.basis.remark:
        note(remark)
    written = [lw.export_answer(answer, file) for file in files]
    written += [motions.export_equations(answer, file) for file in equations]
    if any(file.suffix.lower() == ".fmu" for file in equations) and compiler() is None:
        note("there is no C compiler here (CC, cc, gcc or clang), so that the unit has sources and no binary")
    if as_json:
        click.echo(to_json({"files": [str(file) for file in written]}))
    else:
        click.echo("\n".join(f"written to {file}" for file in written))
    return content.basis.grade.exit_code
