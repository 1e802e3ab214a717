"""`linkwise absorb`: what the sinks of a structure do, with them and without them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, progress
from linkwise.cli.excitation_options import ExcitationOptions, drive_options
from linkwise.cli.options import (
    ANSWER,
    grouped,
    method_options,
    number,
    pairs,
    stated,
    typed,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import read_told, tell_grade
from linkwise.output import ABSORPTION

EXAMPLE = "nes1.alpha=-200:-20:100"
MOST = 100_000  # values of a swept parameter


@dataclass(frozen=True)
class RepetitionOptions:
    """Over what the comparison is repeated.

    Parameters
    ----------
    sweep : tuple[str, ...]
        Map the result over a coefficient (nes1.alpha), a mass (m2.mass) or a release (v:m1); given twice, over two of
        them.
    workers : int | None
        Number of threads (default: one per processor).
    draws : int | None
        Number of draws from an identified structure, for intervals (default 200).
    seed : int | None
        Seed of the draws (default 0).
    """

    sweep: tuple[str, ...] = typed("NAME=FROM:TO:COUNT[:log]", multiple=True)
    workers: int | None = typed("N", type=click.IntRange(min=1))
    draws: int | None = typed("N", type=click.IntRange(min=2))
    seed: int | None = typed("N", type=click.IntRange(min=0))

    def check(self, folder: bool) -> None:
        """UsageError for options that do not go together; `folder` says whether STRUCTURE is one."""
        named = stated({"--draws": self.draws, "--seed": self.seed})
        if named and (self.sweep or not folder):
            raise UsageError(
                f"{next(iter(named))} is for intervals: give the folder that identify wrote as STRUCTURE, and no --sweep."
            )

    def drawing(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.absorption.absorption_intervals` beside those of `absorb`."""
        return stated({"draws": self.draws, "seed": self.seed, "workers": self.workers})

    def axes(self) -> dict[str, list[float]]:
        """Values of each swept parameter."""
        return {name: _swept_values(text) for name, text in pairs(self.sweep, "--sweep", EXAMPLE).items()}


def _swept_values(text: str) -> list[float]:
    """`FROM:TO:COUNT`, steps equal in difference, or with `:log` in ratio."""
    parts = text.split(":")
    if len(parts) not in (3, 4) or parts[3:] not in ([], ["log"]):
        raise UsageError(f"--sweep: {text!r} is not FROM:TO:COUNT or FROM:TO:COUNT:log, as in {EXAMPLE}.")
    first, last, count = (number(part, "--sweep", EXAMPLE) for part in parts[:3])
    if not (count.is_integer() and 2 <= count <= MOST):
        raise UsageError(f"--sweep: {parts[2]!r} is not a whole number from 2 to {MOST}, as in {EXAMPLE}.")
    ways = [k / (count - 1) for k in range(int(count))]
    if len(parts) == 3:
        return [first + way * (last - first) for way in ways]
    if first * last <= 0.0:
        message = f"--sweep: {text!r} cannot have steps of equal ratio; both ends must have the same sign and not be zero."
        raise UsageError(message)
    return [first * (last / first) ** way for way in ways]


@click.command()
@click.argument("structure", type=ANSWER)
@method_options(lw.absorption.AbsorptionOptions, "options")
@grouped(RepetitionOptions, "repetition")
@drive_options
@answer_options(ABSORPTION)
def absorb(
    structure: Path,
    options: dict[str, Any],
    repetition: RepetitionOptions,
    drive: ExcitationOptions,
    delivery: Delivery,
) -> int:
    """Compare the vibration of STRUCTURE with and without its sinks.

    The result holds the decay and settling of the primary masses, the share of the energy that each link dissipates, and how
    often each sink crosses from well to well. STRUCTURE is a structure file, or the folder of an answer of identify, which
    gives all results with intervals.

    \b
    Examples:
      linkwise absorb chain.toml --duration 6 --release v:m1=1.0 -o absorbed
      linkwise absorb chain.toml --duration 6 --release v:m1=1.0 --without locked --harvester nes1=0.01
      linkwise absorb chain.toml --duration 20 --force m1="5*sin(170*t)" --sink nes1
      linkwise absorb answer --duration 6 --release v:m1=1.0 -o absorbed
      linkwise absorb chain.toml --duration 6 --release v:m1=1.0 -o map \\
        --sweep nes1.alpha=-200:-20:100 --sweep nes1.beta=1e5:2e6:100:log
    """
    repetition.check(structure.is_dir())
    keywords = {**options, **drive.keywords()}
    with progress("simulating") as step, unstarted_is_usage():
        result = _answer(structure, repetition, {**keywords, "progress": step})
    return delivery.of(result, answer=structure)


def _answer(
    structure: Path, repetition: RepetitionOptions, keywords: dict[str, Any]
) -> lw.Absorption | lw.absorption.AbsorptionIntervals | lw.absorption.AbsorptionMap:
    """A map for a sweep, intervals for the folder of an answer, else one comparison."""
    over = repetition.axes()
    if structure.is_dir() and not over:
        posterior = lw.estimates.read_posterior(structure)
        tell_grade(structure)
        return lw.absorption.absorption_intervals(posterior, **repetition.drawing(), **keywords)
    subject = read_told(structure)
    if over:
        return lw.absorption.absorption_map(subject, over, workers=repetition.workers, **keywords)
    return lw.absorb(subject, **keywords)
