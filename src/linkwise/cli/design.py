"""`linkwise design`: the coefficients and masses at which sinks absorb best."""

from __future__ import annotations

import glob
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, progress
from linkwise.cli.excitation_options import ExcitationOptions, drive_options, harmonic_excitation
from linkwise.cli.options import (
    ANSWER,
    POSITIVE,
    grouped,
    method_options,
    number,
    pairs,
    ranges,
    typed,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import tell_grade, tell_of_hosts
from linkwise.output import DESIGN
from linkwise.runtime import processors

EXAMPLE = "nes1.alpha=-300:-20"


@dataclass(frozen=True)
class WantedOptions:
    """What is varied, and what of it is wanted.

    Parameters
    ----------
    vary : tuple[str, ...]
        A coefficient (nes1.alpha) or a mass (m2.mass), and its bounds in SI units. Repeatable.
    minimise : str | None
        peak or rms (m, of the primary masses), remaining (energy left at the end), settled, stroke:LINK, resonance (with
        --from and --to: the largest steady amplitude of the primary masses), ... (default remaining).
    maximise : str | None
        Instead: sinks_share, power:LINK, rms_reduction, ...
    place : tuple[str, ...]
        Masses and points on which a link may end, as nes1=m1,m3: each is searched with all evaluations. Repeatable, for
        all combinations.
    levels : str
        Factors of the excitation at which each design is judged.
    start : float | None
        Lowest frequency of a harmonic excitation, of which --force MASS=N or --base x|v|a=SIZE is the amplitude, as of
        respond.
    stop : float | None
        Highest frequency of a harmonic excitation.
    """

    vary: tuple[str, ...] = typed("PARAMETER=LOW:HIGH", multiple=True, required=True)
    minimise: str | None = typed("QUANTITY")
    maximise: str | None = typed("QUANTITY")
    place: tuple[str, ...] = typed("LINK=PLACE,PLACE", multiple=True)
    levels: str = typed("FACTOR,FACTOR,...", default="1", show_default=True)
    start: float | None = typed("HZ", "--from", type=POSITIVE)
    stop: float | None = typed("HZ", "--to", type=POSITIVE)


def _harmonic(
    drive: ExcitationOptions, start: float | None, stop: float | None
) -> tuple[lw.response.ResponseOptions | None, ExcitationOptions]:
    """What is harmonic between the frequencies, and what else drives the structure."""
    if start is None and stop is None:
        return None, drive
    if start is None or stop is None:
        raise UsageError("--from and --to belong together: the frequencies of a harmonic excitation.")
    base = () if drive.base is None else (drive.base,)
    harmonic = lw.response.ResponseOptions(**harmonic_excitation(drive.force, base, (start, stop)))
    return harmonic, replace(drive, force=(), base=None)


@click.command()
@click.argument("structure", type=ANSWER)
@grouped(WantedOptions, "wanted")
@method_options(lw.absorption.DesignOptions, "search")
@method_options(lw.absorption.AbsorptionOptions, "options")
@drive_options
@answer_options(DESIGN)
def design(
    structure: Path, wanted: WantedOptions, drive: ExcitationOptions, delivery: Delivery, **given: Any
) -> int:
    """Find the coefficients and masses at which the sinks of STRUCTURE absorb best.

    STRUCTURE is a structure file, or the folder of an answer of identify, of which draws are judged: their mean, or with
    --quantile 0.9 what nine in ten keep. Values beyond a --limit are not allowed; at several levels the worst one counts.
    A search that was interrupted goes on where the same command with the same -o is given again.

    \b
    Examples:
      linkwise design chain.toml --vary nes1.alpha=-300:-20 --vary nes1.beta=1e5:1e7 --release v:m1=1.0 -o best
      linkwise design chain.toml --vary m2.mass=0.002:0.05 --vary nes1.beta=1e5:1e7 --minimise rms \\
        --release v:m1=1.0 --levels 0.5,1,2 --limit stroke:nes1=0.04 -o best
      linkwise design chain.toml --vary nes1.beta=1e5:1e7 --minimise resonance --force m1=0.5 --from 20 --to 36 -o best
      linkwise design chain.toml --vary m2.mass=0.002:0.05 --place nes1=m1,m3 --release v:m1=1.0
      linkwise design answer --vary nes1.c=0.005:0.2 --maximise sinks_share --quantile 0.9 --release v:m1=1.0
    """
    maximise = wanted.maximise
    if wanted.minimise and maximise:
        raise UsageError("--minimise and --maximise exclude each other: name one quantity.")
    stated = pairs(wanted.place, "--place", "nes1=m1,m3").items()
    places = {link: tuple(map(str.strip, text.split(","))) for link, text in stated}
    over = ranges(wanted.vary, "--vary", EXAMPLE, "LOW:HIGH")
    factors = tuple(number(text, "--levels", "0.5,1,2") for text in wanted.levels.split(","))
    place = None if delivery.output is None else delivery.output.resolve()
    journal = None if place is None else place.with_name(f".{place.name}.designs")
    tell_grade(structure)
    quantity = wanted.minimise or maximise or "remaining"
    with progress("simulating") as step, unstarted_is_usage():
        harmonic, drive = _harmonic(drive, wanted.start, wanted.stop)
        given["search"].setdefault("workers", processors())
        search = lw.absorption.DesignOptions(
            **given["search"], levels=factors, maximise=maximise is not None, places=places, harmonic=harmonic
        )
        keywords = {**given["options"], **drive.keywords(), "journal": journal, "progress": step}
        result = lw.design(structure, over, quantity, search, **keywords)
    tell_of_hosts(result.structure.hosts)
    code = delivery.of(result)
    if journal is not None:
        for file in journal.parent.glob(f"{glob.escape(journal.name)}*"):
            file.unlink()
    return code
