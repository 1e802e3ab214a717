"""`linkwise help`: all options of a command, or those of reading that commands with a record share."""

from __future__ import annotations

import click
from click import UsageError

from linkwise.cli.options import grouped
from linkwise.cli.reading_options import ReadingOptions

READING = "reading"


@click.command()
@grouped(ReadingOptions, "source")
def reading(source: ReadingOptions) -> None:
    """How a record is read and what is known of its sensors: options of every command that takes a RECORD.

    A channel is KIND:PLACE: x, v or a (displacement, velocity, acceleration) of a mass or the base, force of a mass, with a
    unit in brackets where it is not SI. What is said here once for all records of a test belongs into a file with --mapping,
    of which "linkwise inspect RECORD --write-mapping FILE" writes a first one.

    \b
    Examples:
      linkwise identify run.csv unknown.toml --channel "x:m1[mm]=Laser 1" --channel "time[ms]=Time"
      linkwise identify run.csv unknown.toml --mapping sensors.toml --from 0.5 --decimate 4
      linkwise identify run.csv unknown.toml --sensor x:m1:offset=+-0.1mm,gain=1% --sensor x:m2:delay
    """


@click.command(name="help")
@click.argument("topic", default="")
@click.pass_context
def help(ctx: click.Context, topic: str) -> None:
    """Show all options of a command, or with the TOPIC reading how a record is read and what is known of its sensors.

    \b
    Examples:
      linkwise help identify
      linkwise help reading
    """
    group = ctx.parent.command if ctx.parent is not None else None
    if topic == READING:
        click.echo(reading.get_help(click.Context(reading, info_name="... RECORD")))
    elif isinstance(group, click.Group) and topic in group.commands:
        parameters = group.commands[topic].params
        every = "--help-all" if any("--help-all" in one.opts for one in parameters) else "--help"
        group.main([topic, every], prog_name="linkwise", standalone_mode=False)
    elif not topic and ctx.parent is not None:
        click.echo(ctx.parent.get_help())
    else:
        raise UsageError(f"There is no help on {topic!r}; choose {READING} or a command.")
