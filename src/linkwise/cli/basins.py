"""`linkwise basins`: at which rest position free motion ends, over a plane of initial states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

import linkwise as lw
from linkwise.cli.console import deliver, progress
from linkwise.cli.options import (
    folder_option,
    grouped,
    json_option,
    ranges,
    typed,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import read_told
from linkwise.output import BASINS

_PLANE = "x:m2=-0.02:0.02,v:m2=-2:2"


@dataclass(frozen=True)
class PlaneOptions:
    """A plane of initial states.

    Parameters
    ----------
    plane : str
        Two initial displacements or velocities with their ranges; all others begin at zero.
    points : int
        Values of each.
    """

    plane: str = typed("CHANNEL=FROM:TO,CHANNEL=FROM:TO", required=True)
    points: int = typed("N", type=click.IntRange(min=2), default=31, show_default=True)


@click.command()
@click.argument("structure", type=click.Path(path_type=Path))
@grouped(PlaneOptions, "chosen")
@folder_option(BASINS)
@json_option("basins.json")
def basins(structure: Path, chosen: PlaneOptions, output: Path | None, as_json: bool) -> int:
    """Find at which rest position free motion of STRUCTURE ends, over a plane of two initial states.

    The result holds the share of each rest position. STRUCTURE is a structure file, or the folder of an answer of identify.

    \b
    Examples:
      linkwise basins chain.toml --plane x:m2=-0.02:0.02,v:m2=-2:2 -o basins
    """
    plane = ranges(chosen.plane.split(","), "--plane", _PLANE)
    subject = read_told(structure)
    with progress("free motion") as step, unstarted_is_usage():
        result = lw.response.basins(subject, plane, points=chosen.points, progress=step)
    return deliver(result, output, as_json=as_json, answer=structure)
