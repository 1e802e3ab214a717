"""`linkwise limit`: what a planned test of a structure can determine at best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import progress
from linkwise.cli.excitation_options import ExcitationOptions, SamplingOptions, drive_options
from linkwise.cli.options import (
    ANSWER,
    POSITIVE,
    grouped,
    number,
    numbers,
    pairs,
    quantity,
    typed,
    unit_of_channel,
    unstarted_is_usage,
)
from linkwise.cli.reading_options import read_told
from linkwise.output import to_json
from linkwise.verdict import Basis


@dataclass(frozen=True)
class PlannedTest(SamplingOptions):
    """A test that is planned, and what is asked of it.

    Parameters
    ----------
    noise : tuple[str, ...]
        Signal-to-noise ratio expected in every sensor in dB, or for each sensor the standard deviation, as in
        x:m1=0.01mm, and for inputs with noise, as in force:m1=0.2. Repeatable.
    unknown : tuple[str, ...]
        The unknowns: all, nes, a link, nes1.alpha, mass:m2. Repeatable. By default the unknowns of STRUCTURE, at
        their starting values, or all if it has none.
    segment : float | None
        Length in s of the segments of the bound, each with a free initial state (default: the whole record, or the
        longest whose sensitivities are resolved where the motion is chaotic).
    optimise : str | None
        Choose the hit, sweep or multisine, its place, size and band, and the sensors of --noise that determine
        this coefficient best, in place of a stated drive.
    within : tuple[str, ...]
        With --optimise, the largest force in N (force=20) and stroke in m of any link (stroke=0.01) or of one
        (stroke:nes1=0.01). Repeatable.
    """

    noise: tuple[str, ...] = typed("DB|CHANNEL=SIGMA", multiple=True)
    unknown: tuple[str, ...] = typed("WHAT", multiple=True)
    segment: float | None = typed("S", type=POSITIVE)
    optimise: str | None = typed("COEFFICIENT")
    within: tuple[str, ...] = typed("QUANTITY=VALUE", multiple=True)


@click.command()
@click.argument("structure", type=ANSWER)
@grouped(PlannedTest, "test")
@drive_options
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON and nothing else.")
def limit(structure: Path, test: PlannedTest, drive: ExcitationOptions, as_json: bool) -> int:
    """Compute how well a planned test of STRUCTURE can determine its coefficients, before anything is measured.

    STRUCTURE holds the expected values. The result holds the smallest standard errors that any method can reach (Cramer-Rao
    bound), and the smallest coefficients and forces that 95 of 100 such tests would distinguish from zero. Where the motion
    is chaotic, the bound is that of segments of the record whose initial states are free, and a fit that links them comes out
    several times better. Exit code 3 means that the test does not determine every unknown.

    \b
    Examples:
      linkwise limit chain.toml --duration 6 --rate 1000 --release v:m1=1.0 --noise 20
      linkwise limit chain.toml --duration 6 --rate 1000 --release v:m1=1.0 --noise 20 --sensors a:m2 --unknown nes
      linkwise limit chain.toml --duration 2 --rate 500 --force m1="5*sin(30*t)" --noise x:m1=0.01mm --sensors x:m1
      linkwise limit chain.toml --duration 2 --rate 500 --optimise nes1.beta --within force=20 --noise x:m1=0.01mm
    """
    if test.optimise is not None:
        return _optimised(structure, test.optimise, test, drive, as_json)
    keywords = {**test.keywords(), **drive.keywords()}
    if test.segment is not None:
        keywords["segment"] = test.segment
    subject = read_told(structure)
    with progress("simulating the test") as step, unstarted_is_usage():
        result = lw.limit(subject, noise=_noise(test.noise), unknown=test.unknown, progress=step, **keywords)
    result = replace(result, basis=Basis.stated_in(structure))
    click.echo(to_json(result.to_dict()) if as_json else str(result))
    return result.grade.exit_code


def _noise(texts: tuple[str, ...]) -> float | dict[str, float]:
    """The ratio in dB, or standard deviations in SI by channel."""
    if len(texts) == 1 and "=" not in texts[0]:
        return number(texts[0], "--noise", "20")
    if not texts:
        raise UsageError("Give the noise of the sensors: either --noise DB or --noise CHANNEL=SIGMA.")
    sigmas = pairs(texts, "--noise", "x:m1=0.1mm").items()
    return {name: quantity(text, unit_of_channel(name), f"--noise {name}") for name, text in sigmas}


def _optimised(
    structure: Path, coefficient: str, test: PlannedTest, drive: ExcitationOptions, as_json: bool
) -> int:
    """The best test within limits, with its command."""
    noise = _noise(test.noise)
    if any(vars(drive).values()) or test.segment or isinstance(noise, float):
        raise UsageError(
            "--optimise chooses the drive, and compares tests of several sizes: it takes neither a drive nor --noise DB or "
            "--segment, but --within force=N and the sensors that there are, by --noise CHANNEL=SIGMA."
        )
    within = numbers(test.within, "--within", "force=20")
    plan: dict[str, Any] = {"duration": test.duration, "rate": test.rate, "unknown": test.unknown}
    subject = read_told(structure)
    with progress("comparing tests") as step, unstarted_is_usage():
        result = lw.best_test(subject, coefficient, noise=noise, within=within, progress=step, **plan)
    result = replace(result, file=str(structure), basis=Basis.stated_in(structure))
    click.echo(to_json(result.to_dict()) if as_json else str(result))
    return result.grade.exit_code
