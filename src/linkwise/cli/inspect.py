"""`linkwise inspect`: records to what their channels hold and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import click
from click import UsageError

import linkwise as lw
from linkwise import files
from linkwise.cli.console import Delivery, answer_options, note, progress, tell
from linkwise.cli.options import FILE, FLAGS, grouped, typed
from linkwise.cli.reading_options import ReadingOptions, records_argument
from linkwise.output import INSPECTION

MENDED_BY = {
    **FLAGS,
    "noise": "--sensor CHANNEL:noise=SIGMA",
    **{f"{kind}s": f"--sensor CHANNEL:{kind} (identify)" for kind in ("offset", "gain", "delay", "drift")},
    "hums": "--sensor CHANNEL:hum=HZ (identify)",
    "loss": "--robust student (identify)",
}
"""Flag by the argument that an alert names."""


@dataclass(frozen=True, kw_only=True)
class RecordsOptions(ReadingOptions):
    """Files of records and how to read them.

    Parameters
    ----------
    write_mapping : Path | None
        Write a first mapping file, with quantities guessed from units and names, to be edited and given as --mapping.
    levels : bool
        The records are one test at several levels: compare modes, responses and distortion over the level, and show modes as
        they ring down, of a single record or without a recorded force too.
    modes : int | None
        Number of modes to follow over the levels, the strongest first.
    """

    write_mapping: Path | None = typed("FILE", type=FILE)
    levels: bool = typed(is_flag=True)
    modes: int | None = typed("N", type=click.IntRange(min=1))
    records: tuple[Path, ...]

    def with_first_mapping(self) -> Self | None:
        """These options, with the mapping file that was asked for; None where it names no channel yet."""
        if self.write_mapping is None:
            return self
        if self.mapping is not None:
            message = "--write-mapping writes a first mapping file, and --mapping names one: leave one out."
            raise UsageError(message)
        written, header = self.write_mapping, self.record_mapping().header
        note(*files.write_first_mapping(self.records[0], written, header))
        options = replace(self, mapping=written)
        tell(f"a mapping file was written to {written}: edit it, then give --mapping {written}")
        mapped = options.record_mapping().channels
        return options if any(not name.startswith("time") for name in mapped) else None


@click.command()
@grouped(RecordsOptions, "source", records_argument)
@answer_options(INSPECTION)
def inspect(source: RecordsOptions, delivery: Delivery) -> None:
    """Check each RECORD without a model: what its channels contain, and what is wrong with them, worst first.

    Alerts leave the exit code at 0; a file that cannot be read gives 2. --levels asks whether the structure is linear, and
    from which level on it is not: frequencies and damping of the linear modes that explain each record, response functions
    and coherence, odd and even distortion where the force is periodic, and frequency and damping of modes over their amplitude
    as they ring down, for which one record is enough.

    \b
    Examples:
      linkwise inspect run.csv
      linkwise inspect run1.csv run2.csv -o looked
      linkwise inspect soft.csv medium.csv hard.csv --levels -o levels
      linkwise inspect hammer.csv --levels -o ring_down
      linkwise inspect logger.csv --write-mapping sensors.toml
      linkwise inspect logger.csv --mapping sensors.toml
      linkwise inspect logger.csv --channel "x:m1[mm]=Laser 1" --channel "time[ms]=Time" --json
    """
    source.refuse_unknown_errors()
    if source.modes is not None and not source.levels:
        raise UsageError("--modes is for --levels: add it, or leave --modes out.")
    mapped = source.with_first_mapping()
    if mapped is None:
        return
    source = mapped
    with progress("reading") as step:
        records = []
        for number, path in enumerate(source.records):
            step(lw.estimates.ProgressReport(number / len(source.records), f"reading {path.name}"))
            records.append(source.read_file(path, None, informative=False))
        step(lw.estimates.ProgressReport(0.9, "inspecting"))
        inspection = lw.inspect(records)
        if source.levels:
            compared = lw.inspection.compare_levels(records, modes=source.modes, progress=step)
            inspection = replace(inspection, levels=compared)
    inspection = replace(inspection, alerts=tuple(map(_alert_with_flags, inspection.alerts)))
    if not delivery.as_json:
        note(*dict.fromkeys(remark for record in records for remark in record.notes))
    delivery.of(inspection)


def _alert_with_flags(alert: lw.inspection.Alert) -> lw.inspection.Alert:
    """The alert, with the flags that mend it."""
    flags = [MENDED_BY[name] for name in alert.arguments if name in MENDED_BY]
    flags = [flag.replace("CHANNEL", alert.channel) for flag in flags]
    return replace(alert, message=f"{alert.message} ({', '.join(flags)})") if flags else alert
