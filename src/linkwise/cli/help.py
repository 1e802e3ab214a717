"""`linkwise help`: all options of a command, or those of reading that commands with a record share; and commands whose help
fits a screen or lists what is registered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

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
        every = "--help-all" if any("--help-all" in parameter.opts for parameter in parameters) else "--help"
        group.main([topic, every], prog_name="linkwise", standalone_mode=False)
    elif not topic and ctx.parent is not None:
        click.echo(ctx.parent.get_help())
    else:
        raise UsageError(f"There is no help on {topic!r}; choose {READING} or a command.")


def listing(placeholder: str, lines: Callable[[], Iterable[str]]) -> type[click.Command]:
    """A kind of command in whose help `lines` stand in place of `placeholder`."""

    class Listing(click.Command):
        def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
            listed = "\n      ".join(lines())
            whole = click.Command(self.name, help=(self.help or "").replace(placeholder, listed))
            whole.format_help_text(ctx, formatter)

    return Listing


def screen(*first: str, base: type[click.Command] = click.Command) -> type[click.Command]:
    """A kind of command whose `--help` fits a screen: its text up to a form feed, and the first sentence on
    the options `first`, by parameter; `--help-all` shows everything.
    """

    class Screen(base):  # type: ignore[misc, valid-type]
        def __init__(self, *arguments: Any, **keywords: Any) -> None:
            super().__init__(*arguments, **keywords)
            text = "Show all options and all that is said of them."
            flag: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False}
            self.params.append(click.Option(["--help-all"], help=text, callback=self._show, **flag))

        def _show(self, ctx: click.Context, option: click.Parameter, wanted: bool) -> None:
            """Print the whole help."""
            if wanted and not ctx.resilient_parsing:
                whole = base(self.name, params=self.params, help=(self.help or "").replace("\f", ""))
                click.echo(whole.get_help(ctx))
                ctx.exit()

        def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
            """The first options, and where the others are."""
            helps = {"--help", "--help-all"}
            shown = [p for p in self.get_params(ctx) if p.name in first or helps & set(p.opts)]
            records = [record for param in shown if (record := param.get_help_record(ctx)) is not None]
            with formatter.section("Options that are needed first"):
                formatter.write_dl([(flag, text.partition(". ")[0].rstrip(".")) for flag, text in records])
            formatter.write_paragraph()
            path = ctx.command_path
            formatter.write_text(
                f"Others: {path} --help-all; how a record is read and what is known of sensors: linkwise help reading."
            )

    return Screen
