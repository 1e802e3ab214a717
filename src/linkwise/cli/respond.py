"""`linkwise respond`, `backbone` and `basins`: steady motion over frequency, free vibration, and where it ends."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, progress
from linkwise.cli.excitation_options import harmonic_excitation
from linkwise.cli.options import (
    ANSWER,
    FILE,
    POSITIVE,
    comma_separated,
    grouped,
    method_options,
    number,
    numbers,
    ranges,
    typed,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import read_told, tell_grade, tell_of_hosts
from linkwise.output import BACKBONE, BASINS, RESPONSE


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
    record: Path | None = typed("FILE", type=FILE)
    mapping: Path | None = typed("FILE", type=FILE)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.respond` for what drives the structure."""
        levels = tuple(number(size, "--levels", "0.5,1,2") for size in self.levels)
        return {**harmonic_excitation(self.force, self.base, (self.start, self.stop)), "levels": levels}


@click.command()
@click.argument("structure", type=ANSWER)
@grouped(HarmonicOptions, "harmonic")
@method_options(lw.response.ResponseOptions, "options")
@answer_options(RESPONSE)
def respond(structure: Path, harmonic: HarmonicOptions, options: dict[str, Any], delivery: Delivery) -> int:
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
        result = lw.respond(structure, progress=step, **harmonic.keywords(), **options)
    result = result if measured is None else result.beside(measured)
    tell_grade(structure)
    tell_of_hosts(result.structure.hosts)
    return delivery.of(result)


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
    force : str | None
        The mass or point on which a harmonic force acts: the phase resonance of the damped structure is followed, with
        the size of that force. Laws may then have kinks and memory.
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
    force: str | None = typed("MASS")
    show: tuple[str, ...] = typed("CHANNEL", multiple=True, callback=comma_separated)
    levels: Path | None = typed("RECORD", type=FILE)
    mapping: Path | None = typed("FILE", type=FILE)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.backbone`."""
        ends = numbers(self.to_amplitude, "--to-amplitude", _AMPLITUDE)
        if len(ends) > 1:
            raise UsageError("--to-amplitude is given for two channels; give one.")
        end = {"to_amplitude": ends or None, "to_energy": self.to_energy}
        return {**end, "force": self.force, "show": self.show}


@click.command()
@click.argument("structure", type=ANSWER)
@grouped(ModeOptions, "chosen")
@answer_options(BACKBONE)
def backbone(structure: Path, chosen: ModeOptions, delivery: Delivery) -> int:
    """Follow free vibration of STRUCTURE without its damping from a linear mode to large amplitudes, or its phase resonance.

    The result holds frequency, damping, energy and amplitudes along the curve. STRUCTURE is a structure file, or the folder of
    an answer of identify, which gives frequency and damping with bands.

    \b
    Examples:
      linkwise backbone chain.toml --mode 1 --to-amplitude x:m1=0.01 -o mode1
      linkwise backbone chain.toml --mode 2 --to-amplitude x:m1=0.002 --force m1
      linkwise backbone answer --mode 2 --to-energy 0.05 --levels decay.csv
    """
    measured = None if chosen.levels is None else lw.read_record(chosen.levels, mapping=chosen.mapping)
    with progress("following the mode"), unstarted_is_usage():
        result = lw.backbone(structure, chosen.mode, **chosen.keywords())
    result = result if measured is None else result.beside(measured)
    tell_grade(structure)
    return delivery.of(result)


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
@click.argument("structure", type=ANSWER)
@grouped(PlaneOptions, "chosen")
@answer_options(BASINS)
def basins(structure: Path, chosen: PlaneOptions, delivery: Delivery) -> int:
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
    return delivery.of(result, answer=structure)
