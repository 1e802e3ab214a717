"""`linkwise simulate`: a structure and what drives it, to a record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

import linkwise as lw
from linkwise import files
from linkwise.analysis.rest_positions import hilltop_finding
from linkwise.cli.console import note, progress
from linkwise.cli.excitation_options import ExcitationOptions, SamplingOptions, drive_options
from linkwise.cli.options import ANSWER, FILE, grouped, typed, unstarted_is_usage
from linkwise.cli.reading_options import read_told
from linkwise.display import listed
from linkwise.output import to_json


@dataclass(frozen=True)
class RecordingOptions(SamplingOptions):
    """How a simulated motion is recorded.

    Parameters
    ----------
    noise : float | None
        Add noise with this signal-to-noise ratio to every response.
    seed : int
        Seed of the noise.
    output : Path
        File to write; its suffix selects the format.
    """

    noise: float | None = typed("DB", type=float)
    seed: int = typed("N", type=click.IntRange(min=0), default=0, show_default=True)
    output: Path = typed("RECORD", "-o", "--output", type=FILE, required=True)


@click.command()
@click.argument("structure", type=ANSWER)
@grouped(RecordingOptions, "recording")
@drive_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else.")
def simulate(structure: Path, recording: RecordingOptions, drive: ExcitationOptions, as_json: bool) -> None:
    """Simulate STRUCTURE and write the record of its sensors.

    \b
    Example:
      linkwise simulate chain.toml --duration 6 --rate 1000 --release v:m1=1.0 --noise 30 --seed 1 -o run.csv
    """
    output, noise = recording.output, recording.noise
    files.check_record_file(output)  # before the work, so that nobody waits for a refusal
    subject = read_told(structure)
    keywords = {**recording.keywords(), **drive.keywords()}
    with progress("simulating") as step:
        with unstarted_is_usage():
            record = lw.simulate(subject, **keywords, progress=step)
        if noise is not None:
            record = record.with_noise(noise, seed=recording.seed)
        lw.write_record(record, output)
        step(lw.estimates.ProgressReport(1.0, "energy and horizon"))
        summary = _summary(record, output)
    driven = any(keywords[kind] for kind in ("release", "impulses", "forces", "signals"))
    if not driven and keywords["base"] is None:
        note("nothing sets the structure in motion; give --release, --impulse, --force or --base.")
    start = np.array([keywords["release"].get(f"x:{name}", 0.0) for name in subject.mass_names])
    if hilltop := hilltop_finding(subject, start):
        note(hilltop)
    if noise is not None:
        summary["noise"] = {"decibel": noise, "seed": recording.seed}
    click.echo(to_json(summary) if as_json else _summary_text(subject, summary))


def _summary(record: lw.Record, output: Path) -> dict[str, Any]:
    """What was done, as plain data; energies in J at the end of the record, `closure` the worst error of the balance."""
    truth = record.simulated
    assert truth is not None
    energy = truth.energy
    scale, names = float(abs(energy.supplied).max()), [link.name for link in truth.structure.links]
    return {
        "file": str(output),
        "samples": len(record),
        "rate": record.rate,
        "channels": list(record.channels),
        "energy": {
            "put_in": float(energy.supplied[-1]),
            "stored": float(energy.kinetic[-1] + energy.potential[-1].sum()),
            "dissipated": dict(zip(names, energy.dissipated[-1].tolist(), strict=True)),
            "closure": float(abs(energy.residual).max()) / scale if scale else 0.0,
        },
        "horizon": truth.horizon,
    }


def _summary_text(structure: lw.Structure, summary: dict[str, Any]) -> str:
    energy = summary["energy"]
    total, horizon = sum(energy["dissipated"].values()), summary["horizon"]
    if horizon is None:
        horizon = "none within the record: two runs at different tolerances agree throughout"
    else:
        horizon = f"{horizon:.3g} s; past it the motion is chaotic and no two computers would agree on it"
    lines = [
        f"{structure.name or 'structure'}: {structure.contents}",
        f"record      {summary['samples']} samples at {summary['rate']:g} Hz of {listed(summary['channels'])}",
        f"energy      {energy['put_in']:.4g} J put in, {total:.4g} J dissipated, {energy['stored']:.4g} J stored at the end; "
        f"the balance closes to {energy['closure']:.0e} of the input",
        f"horizon     {horizon}",
    ]
    if "noise" in summary:
        added = summary["noise"]
        lines.append(f"noise       {added['decibel']:g} dB per channel, seed {added['seed']}")
    return "\n".join([*lines, f"written to  {summary['file']}"])
