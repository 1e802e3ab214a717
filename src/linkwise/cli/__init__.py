"""The command line: one command a file, no logic; what goes wrong ends in one paragraph and an exit code.

Exit codes: 0 done; 1 failed with a reason; 2 wrong usage or unreadable input; 3 finished, but the answer is
refused; 4 finished, and the answer is approximate.
"""

from __future__ import annotations

import logging
import os
import sys
import traceback
from collections.abc import MutableMapping, Sequence
from typing import cast

import click
from click import UsageError

from linkwise import __version__
from linkwise.cli.console import fail
from linkwise.cli.options import METHOD_FLAGS, with_flags
from linkwise.errors import LinkwiseError
from linkwise.output import is_disk_fault
from linkwise.registry import Registry

FAILED, USAGE, INTERRUPTED = 1, 2, 130

HELP = {
    "absorb": "Compare the vibration of a structure with and without its sinks.",
    "compare": "Identify a record by every method, side by side.",
    "design": "Find the coefficients and masses at which sinks absorb best.",
    "backbone": "Follow free vibration from a linear mode to large amplitudes.",
    "basins": "Find at which rest position free motion ends, from a plane of states.",
    "discover": "Discover which masses are linked, and by which laws, from records.",
    "export": "Write an answer for other programs.",
    "help": "Show all options of a command, or those that say how a record is read.",
    "identify": "Identify the unknown coefficients of a structure from a record.",
    "inspect": "Check records without a model: what their channels hold.",
    "limit": "Compute how well a planned test can determine the unknowns.",
    "respond": "Compute steady motion under a harmonic excitation over frequency.",
    "simulate": "Simulate a structure and write the record of its sensors.",
    "start": "Get from the files of a test to a first answer; what is missing is asked.",
    "structure": "Write or show a structure file.",
    "study": "Run a Monte Carlo study.",
    "validate": "Predict a record with an identified structure.",
}
"""What each command does; `linkwise --help` shows it without loading any."""

_HOMES = {"backbone": "respond", "basins": "respond", "compare": "identify"}
"""The modules of commands that have none of their name."""
COMMANDS: Registry[click.Command] = Registry(
    "command", {name: f"linkwise.cli.{_HOMES.get(name, name)}:{name}" for name in HELP}
)
"""The commands by name; each is loaded when it is run."""


class _Commands(click.Group):
    """The group of all commands, which lists them without loading any."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The lines of `HELP`."""
        with formatter.section("Commands"):
            formatter.write_dl(list(HELP.items()))


@click.group(
    cls=_Commands,
    commands=cast(MutableMapping[str, click.Command], COMMANDS),  # click reads it only
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__)
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def linkwise(debug: bool) -> None:
    """Identify the force law of every link of a nonlinear structure from its measured motion.

    \b
    Examples:
      linkwise start FILE
      linkwise structure bnes --dof 2 -o chain.toml
      linkwise structure bnes --dof 2 --unknown nes -o unknown.toml
      linkwise simulate chain.toml --duration 6 --rate 1000 --release v:m1=1.0 --noise 30 --seed 1 -o run.csv
      linkwise identify run.csv unknown.toml -o answer
      linkwise validate second.csv answer -o validation
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.01 -o found
    """


def run(arguments: Sequence[str]) -> int:
    """Run the command line on these arguments and return the exit code; nothing is raised."""
    debug = "--debug" in arguments
    rest = [argument for argument in arguments if argument != "--debug"]
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # else it tells of its slow first run
    try:
        status = linkwise.main(rest, prog_name="linkwise", standalone_mode=False)
        sys.stdout.flush()
    except UsageError as error:
        path = error.ctx.command_path if error.ctx else "linkwise"
        message = _explained(error).rstrip(".")
        stop = "" if message.endswith("?") else "."
        return _report(error, f"{message}{stop} Try: {path} --help", USAGE, debug)
    except click.ClickException as error:
        return _report(error, error.format_message(), USAGE, debug)
    except LinkwiseError as error:
        code = USAGE if set(error.arguments) & set(METHOD_FLAGS) else error.exit_code
        return _report(error, with_flags(error, COMMANDS.get(rest[0])), code, debug)
    except BrokenPipeError:  # the reader of a pipe has gone, as `head` does: there is nobody left to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        code = FAILED if is_disk_fault(error) else USAGE
        return _report(error, f"{place}{error.strerror or error}", code, debug)
    except MemoryError as error:
        detail = f" ({error})" if str(error) else ""
        return _report(error, f"the computer has too little memory for this{detail}", FAILED, debug)
    except (click.Abort, KeyboardInterrupt):
        fail("interrupted; nothing was left half written")
        return INTERRUPTED
    except Exception as error:
        detail = f"{type(error).__name__}: {error}".strip()
        message = f"internal error of linkwise: {detail}. Run again with --debug for a traceback"
        return _report(error, message, FAILED, debug)
    return status if isinstance(status, int) else 0


def _explained(error: UsageError) -> str:
    """The message of click, and for arguments too many how to state several records, if the command takes them."""
    message = error.format_message()
    several = error.ctx and any("--with" in parameter.opts for parameter in error.ctx.command.params)
    if several and message.startswith("Got unexpected extra argument"):
        return f"{message}. State each further record with --with"
    return message


def _report(error: Exception, message: str, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)
    fail(message)
    return code
