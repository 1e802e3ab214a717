"""How the command line spells the arguments of the library: errors name arguments, commands add the flags."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from linkwise.errors import LinkwiseError, SimulationError

FLAGS = {
    "channels": "--channel NAME=COLUMN",
    "mapping": "--mapping FILE (inspect --write-mapping FILE writes a first one)",
    "header": "--header LINE",
    "rate": "--rate HZ",
    "resample": "--resample HZ",
    "earliest": "--from S",
    "latest": "--to S",
    "period": "--period S",
    "mark_missing": "--mark-missing clipped,spikes",
    "burn": "--burn S",
    "segment": "--segment S",
    "ambient": "--ambient MASS",
    "sinks": "--sink LINK",
    "without": "--without removed|locked",
    "draws": "--draws N",
    "calibration": "--calibration CHANNEL=1%",
}
"""Flag by name of the argument of a public function (`LinkwiseError.arguments`)."""


def with_flags(error: LinkwiseError) -> str:
    """The message of an error, and the flags that set the arguments it names."""
    flags = [FLAGS[name] for name in error.arguments if name in FLAGS]
    if not flags:
        return str(error)
    message = str(error).rstrip(".")
    return f"{message}{'' if message.endswith('?') else '.'} On the command line: {', '.join(flags)}."


@contextmanager
def unstarted_is_usage() -> Iterator[None]:
    """Raise UsageError for a simulation that could not start, since it was not set up right by the options."""
    try:
        yield
    except SimulationError as error:
        if error.time is None:
            raise click.UsageError(with_flags(error)) from error
        raise
