"""`linkwise absorb`: what the sinks of a structure do, with them and without them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import linkwise as lw
from linkwise.cli.console import progress, tell
from linkwise.cli.options import FILE, FOLDER, POSITIVE, grouped, number, pairs
from linkwise.cli.plan import Drive, drive_options
from linkwise.output import check_result_folder, to_json

UNTRUSTED = 3  # exit code: finished, but the answer is not to be trusted


@dataclass(frozen=True)
class Comparison:
    """What is compared with what, as typed."""

    duration: float
    rate: float | None
    sink: tuple[str, ...]
    without: str
    settle: float
    harvester: tuple[str, ...]

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.absorb`."""
        dampings = pairs(self.harvester, "--harvester", "nes1=0.01")
        return {
            "duration": self.duration,
            "rate": self.rate,
            "sinks": self.sink,
            "without": self.without,
            "settle": self.settle,
            "harvesters": {
                name: number(value, "--harvester", "nes1=0.01") for name, value in dampings.items()
            },
        }


comparison_options = grouped(
    Comparison,
    "comparison",
    click.option("--duration", metavar="S", type=POSITIVE, required=True, help="How long to look, in s."),
    click.option(
        "--rate",
        metavar="HZ",
        type=POSITIVE,
        help="Samples per second (default: 20 a period of the fastest mode).",
    ),
    click.option(
        "--sink",
        metavar="LINK",
        multiple=True,
        help="A link that is a sink (default: those with more than one stable well). Repeatable.",
    ),
    click.option(
        "--without",
        type=click.Choice(["removed", "locked"]),
        default="removed",
        show_default=True,
        help="How the structure is without its sinks: their masses gone, or held where they start.",
    ),
    click.option(
        "--settle",
        metavar="PART",
        type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
        default=0.05,
        show_default=True,
        help="A mass has settled below this part of its peak without sinks.",
    ),
    click.option(
        "--harvester",
        metavar="LINK=NS/M",
        multiple=True,
        help="Put a damper of so many N s/m in parallel to a link and tell its power. Repeatable.",
    ),
)


@click.command()
@click.argument("structure", type=FILE)
@comparison_options
@drive_options
@click.option(
    "-o", "--output", metavar="DIR", type=FOLDER, help="Folder for the result: numbers, figures, report."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print absorption.json on standard output and nothing else."
)
def absorb(structure: Path, comparison: Comparison, drive: Drive, output: Path | None, as_json: bool) -> int:
    """Tell what the sinks of STRUCTURE do, against the same structure without them.

    Printed are decay and settling of the primary masses, the share of the energy that each link dissipates, and how often
    each sink crosses from well to well.

    \b
    Examples:
      linkwise absorb chain.toml --duration 6 --release v:m1=1.0 -o absorbed
      linkwise absorb chain.toml --duration 6 --release v:m1=1.0 --without locked --harvester nes1=0.01
      linkwise absorb chain.toml --duration 20 --force m1="5*sin(170*t)" --sink nes1
    """
    if output is not None:
        check_result_folder(output)  # before the work, so that nobody waits for a refusal
    subject = lw.read_structure(structure)
    asked = {**comparison.keywords(), **drive.keywords()}
    with progress("simulating") as step:
        try:
            found = lw.absorb(subject, **asked, progress=step)
        except lw.SimulationError as error:
            if error.time is None:  # it never began: what was asked for cannot be
                raise click.UsageError(str(error)) from error
            raise
        if output is not None:
            lw.write_absorption(found, output, progress=step)
    click.echo(to_json(lw.absorption_of(found)) if as_json else str(found))
    if output is not None and not as_json:
        tell(f"written to {output}; open {output / 'report.html'}")
    return 0 if found.trusted else UNTRUSTED
