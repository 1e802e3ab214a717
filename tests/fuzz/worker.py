"""A process that runs one case after the other and may die of any of them."""

import os
import re
import signal
import sys
import traceback
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import linkwise as lw
from fuzz.case import Case, Kind, Outcome
from fuzz.cases import make_case
from linkwise.cli import run

if sys.platform != "win32":
    import resource

SECONDS = 10  # of processor time that a case may take
_MEMORY = 6 * 2**30  # bytes of address space: what asks for more is told so
_IGNORED = re.compile(r"Columns that are not channels were ignored: (.*?)(?: and (\d+) more)?\.$")


def work(connection: Connection) -> None:
    """Answer each seed that comes with its outcome, until nothing comes."""
    if sys.platform != "win32":
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with TemporaryFile() as standard_output:  # what a library writes there stands in the way of results
        os.dup2(standard_output.fileno(), 1)
        while (seed := connection.recv()) is not None:
            case = make_case(seed)
            _allow(SECONDS)
            result = outcome(case)
            standard_output.seek(0)
            connection.send(replace(result, written=standard_output.read()))
            standard_output.seek(0)
            standard_output.truncate()


def outcome(case: Case) -> Outcome:
    """What comes of a case, run in this process."""
    before = Path.cwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for name, content in case.files.items():
                Path(name).parent.mkdir(exist_ok=True)
                Path(name).write_bytes(content)
            with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as error:
                code, lost = _run(case)
            return Outcome(code, out.getvalue(), error.getvalue(), lost=lost)
        except BaseException:
            return Outcome(None, error=traceback.format_exc())
        finally:
            os.chdir(before)


def _run(case: Case) -> tuple[int, tuple[str, ...]]:
    """The exit code, 2 for a refusal of the library, and the channels that were lost without a word."""
    if case.kind is Kind.COMMAND:
        return run(list(case.arguments)), ()
    try:
        if case.kind is Kind.READ:
            return 0, _lost(case, lw.read_record(case.arguments[0]))
        _hold(lw.Law.parse(case.arguments[0]))
    except lw.LinkwiseError as error:
        print(error, file=sys.stderr)
        return error.exit_code, ()
    return 0, ()


def _lost(case: Case, record: lw.Record) -> tuple[str, ...]:
    """The channels of the file that are neither in the record nor, under whatever name damage left them, in a note."""
    absent = [name for name in case.channels if name not in record.channels]
    elsewhere = len([name for name in record.channels if name not in case.channels])
    for note in record.notes:
        if match := _IGNORED.match(note):
            elsewhere += match[1].count(",") + 1 + int(match[2] or 0)
    return tuple(absent) if len(absent) > elsewhere else ()


def _hold(law: lw.Law) -> None:
    """Simulate a mass that is held by this law, with coefficients that suit nothing in particular."""
    coefficients = {name: lw.Coefficient.number(1.0 + 0.5 * k) for k, name in enumerate(law.coefficients)}
    link = lw.Link("l", ("m", lw.model.GROUND), law, coefficients)
    structure = lw.Structure("one", (lw.Mass("m", lw.Coefficient.number(1.0)),), (link,))
    lw.parse_structure(lw.model.format_structure(structure))
    record = lw.simulate(structure, release={"x:m": 0.1, "v:m": 1.0}, duration=0.05, rate=200.0)
    str(record.simulated)


def _allow(seconds: int) -> None:
    """Let the system end this process after so many more seconds of processor time, or twelve times as many of a clock."""
    if sys.platform != "win32":
        signal.alarm(12 * seconds)
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit = int(used.ru_utime + used.ru_stime) + seconds + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
