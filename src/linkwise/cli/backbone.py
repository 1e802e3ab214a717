"""`linkwise backbone`: free vibration of a structure over amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import deliver, note, progress
from linkwise.cli.options import (
    FILE,
    POSITIVE,
    comma_separated,
    folder_option,
    grouped,
    json_option,
    numbers,
    typed,
    unstarted_is_usage,
)
from linkwise.estimates.estimate import stated_grade
from linkwise.output import BACKBONE

_AMPLITUDE = "x:m1=0.01"


@dataclass(frozen=True)
class ModeOptions:
    """Which mode, and how far it is followed.

    Parameters
    ----------
    mode : int
        Number of the linear mode by ascending frequency, from 1.
    to_amplitude : tuple[str, ...]
        End where half of peak to peak of a channel is so large (default: where the frequency has changed by a third).
    to_energy : float | None
        End at this energy.
    show : tuple[str, ...]
        Displacements and velocities that are shown (default: the displacements of all masses and points).
    levels : Path | None
        A record of a decay, whose frequency over amplitude, as inspect --levels follows it, is laid over the curve.
    mapping : Path | None
        A file that states columns, units and how to read that record, as of identify.
    """

    mode: int = typed("K", type=click.IntRange(min=1), required=True)
    to_amplitude: tuple[str, ...] = typed("CHANNEL=SIZE", multiple=True)
    to_energy: float | None = typed("J", type=POSITIVE)
    show: tuple[str, ...] = typed("CHANNEL", multiple=True, callback=comma_separated)
    levels: Path | None = typed("RECORD", type=FILE)
    mapping: Path | None = typed("FILE", type=FILE)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.backbone`."""
        ends = numbers(self.to_amplitude, "--to-amplitude", _AMPLITUDE)
        if len(ends) > 1:
            raise UsageError("--to-amplitude is given for two channels; give one.")
        return {"to_amplitude": ends or None, "to_energy": self.to_energy, "show": self.show}


@click.command()
@click.argument("structure", type=click.Path(path_type=Path))
@grouped(ModeOptions, "chosen")
@folder_option(BACKBONE)
@json_option("backbone.json")
def backbone(structure: Path, chosen: ModeOptions, output: Path | None, as_json: bool) -> int:
    """Follow free vibration of STRUCTURE without its damping from a linear mode to large amplitudes.

    The result holds frequency, energy and amplitudes along the curve. STRUCTURE is a structure file, or the folder of an
    answer of identify.

    \b
    Examples:
      linkwise backbone chain.toml --mode 1 --to-amplitude x:m1=0.01 -o mode1
      linkwise backbone answer --mode 2 --to-energy 0.05 --levels decay.csv
    """
    measured = None if chosen.levels is None else lw.read_record(chosen.levels, mapping=chosen.mapping)
    with progress("following the mode"), unstarted_is_usage():
        result = lw.backbone(structure, chosen.mode, **chosen.keywords())
    result = result if measured is None else result.beside(measured)
    if remark := stated_grade(structure)[1]:
        note(f"{structure}: {remark}")
    return deliver(result, output, as_json=as_json, answer=structure)
