"""`linkwise respond`: steady motion of a structure under a harmonic excitation over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import linkwise as lw
from linkwise.cli.console import deliver, note, progress
from linkwise.cli.excitation_options import harmonic_excitation
from linkwise.cli.options import (
    FILE,
    POSITIVE,
    comma_separated,
    folder_option,
    grouped,
    json_option,
    number,
    stated,
    typed,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import tell_of_hosts
from linkwise.estimates.estimate import stated_grade
from linkwise.output import RESPONSE


@dataclass(frozen=True)
class HarmonicOptions:
    """What drives a structure, and over which frequencies.

    Parameters
    ----------
    force : tuple[str, ...]
        A harmonic force on a mass or point: its amplitude in N, on what turns in N m.
    base : tuple[str, ...]
        A harmonic motion of the base: the amplitude of its displacement x in m, velocity v in m/s or acceleration a in
        m/s2.
    start : float
        Lowest frequency of the excitation.
    stop : float
        Highest frequency of the excitation.
    levels : tuple[str, ...]
        Amplitudes of the excitation in place of the one of --force or --base.
    show : tuple[str, ...]
        Displacements and velocities that are shown (default: the displacements of all masses and points).
    starts : int | None
        Simulations from states at random at each of several frequencies, in search of further motions (default 3).
    seed : int | None
        Seed of these states and of draws (default 0).
    draws : int | None
        Draws from an identified structure, for bands (default 100).
    harmonics : int | None
        Use harmonic balance with so many harmonics (default: 25 where a law has kinks or flat parts, as friction has,
        else shooting).
    record : Path | None
        A record of a stepped or slowly swept sine, with its excitation, whose points are laid over the curves.
    mapping : Path | None
        A file that states columns, units and how to read that record, as of identify.
    """

    force: tuple[str, ...] = typed("MASS=N", multiple=True)
    base: tuple[str, ...] = typed("x|v|a=SIZE", multiple=True)
    start: float = typed("HZ", "--from", type=POSITIVE, required=True)
    stop: float = typed("HZ", "--to", type=POSITIVE, required=True)
    levels: tuple[str, ...] = typed("SIZE,SIZE", multiple=True, callback=comma_separated)
    show: tuple[str, ...] = typed("CHANNEL", multiple=True, callback=comma_separated)
    starts: int | None = typed("N", type=click.IntRange(min=0))
    seed: int | None = typed("N", type=click.IntRange(min=0))
    draws: int | None = typed("N", type=click.IntRange(min=2))
    harmonics: int | None = typed("N", type=click.IntRange(min=1))
    record: Path | None = typed("FILE", type=FILE)
    mapping: Path | None = typed("FILE", type=FILE)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.respond`."""
        return {
            **harmonic_excitation(self.force, self.base, (self.start, self.stop)),
            "levels": tuple(number(size, "--levels", "0.5,1,2") for size in self.levels),
            "show": self.show,
            **stated({name: getattr(self, name) for name in ("starts", "seed", "draws", "harmonics")}),
        }


@click.command()
@click.argument("structure", type=click.Path(path_type=Path))
@grouped(HarmonicOptions, "harmonic")
@folder_option(RESPONSE)
@json_option("response.json")
def respond(structure: Path, harmonic: HarmonicOptions, output: Path | None, as_json: bool) -> int:
    """Compute the steady motion of STRUCTURE under a harmonic force or motion of its base, over frequency.

    The result holds every branch that was found, stable and unstable, with the frequencies at which motion jumps (folds),
    doubles its period or becomes quasi-periodic, and chaotic motion where there is some. STRUCTURE is a structure file, or the
    folder of an answer of identify, which gives amplitudes with bands.

    \b
    Examples:
      linkwise respond chain.toml --force m1=0.5 --from 20 --to 36 -o response
      linkwise respond chain.toml --force m1=0.5 --from 20 --to 36 --levels 0.3,1,3 --show x:m2
      linkwise respond rig.toml --base a=9.81 --from 5 --to 40
      linkwise respond answer --force m1=0.5 --from 20 --to 36 --record sweep.csv -o response
    """
    measured = None if harmonic.record is None else lw.read_record(harmonic.record, mapping=harmonic.mapping)
    with progress("steady motion") as step, unstarted_is_usage():
        result = lw.respond(structure, progress=step, **harmonic.keywords())
    result = result if measured is None else result.beside(measured)
    if remark := stated_grade(structure)[1]:
        note(f"{structure}: {remark}")
    tell_of_hosts(result.structure.hosts)
    return deliver(result, output, as_json=as_json, answer=structure)
