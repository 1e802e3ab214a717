"""Reading in a process of its own: libraries for binary formats may crash, or never end, on a damaged file."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from linkwise.errors import RecordError
from linkwise.files.table import Table
from linkwise.runtime import available_memory

if sys.platform != "win32":
    import resource

_SECONDS = 5.0  # of processor time that reading may take, with the import of the library,
_BYTES_PER_SECOND = 1e6  # and for larger files: readers that parse text in Python reach five times this rate
_LIBRARIES = (
    4 * 2**30
)  # bytes of address space that Python and the libraries occupy before they read anything
_START = "import sys; sys.path[:] = {path!r}; from linkwise.files.isolated import main; main()"


def read_isolated(module: str, path: Path, header: str | int | None = None) -> Table:
    """What `read_table` of the module with this full name finds in the file, read in a child process.

    `header` is the header line, where it is given.

    Raises RecordError for a file that cannot be read, where the child crashes, needs more memory than there is or, except on
    Windows, takes longer than any file of its size.
    """
    if not sys.executable or getattr(sys, "frozen", False):  # Python is part of another program
        return read_here(module, path)
    seconds = _SECONDS + path.stat().st_size / _BYTES_PER_SECOND
    limits = (f"{seconds:.0f}", str(available_memory() + _LIBRARIES))
    answer: object = None
    with subprocess.Popen(
        [sys.executable, "-c", _START.format(path=sys.path), module, str(path), json.dumps(header), *limits],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
        start_new_session=True,  # Ctrl-C is for this process, which then ends the other
    ) as child:
        assert child.stdout is not None
        try:
            answer = pickle.load(child.stdout)
        except (EOFError, pickle.UnpicklingError):
            pass  # it ended before its answer was complete
        finally:
            child.kill()
    if isinstance(answer, Table):
        return answer
    if isinstance(answer, RecordError):
        raise answer
    if sys.platform != "win32" and child.returncode == -signal.SIGXCPU:
        raise RecordError(
            f"cannot be read as a {path.suffix} file: reading did not end after {seconds:.0f} s; the file is damaged",
            path,
        )
    raise RecordError(
        f"cannot be read as a {path.suffix} file: the library that reads it crashed; the file is damaged",
        path,
    )


def read_here(module: str, path: Path, header: str | int | None = None) -> Table:
    """The same in this process, without limits."""
    options = {} if header is None else {"header": header}
    try:
        table: Table = import_module(module).read_table(path, **options)
    except (RecordError, MemoryError):
        raise
    except Exception as error:  # format libraries raise all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordError(f"cannot be read as a {path.suffix} file: {reason}", path) from error
    return table


def main() -> None:
    """In the child process: read, and write the table or the error to standard output, which nothing else reaches."""
    module, name, header, seconds, memory = sys.argv[1:]
    path = Path(name)
    answer: Table | RecordError
    with os.fdopen(os.dup(1), "wb") as pipe:
        os.dup2(2, 1)
        _limit(int(seconds), int(memory))
        try:
            answer = read_here(module, path, json.loads(header))
        except RecordError as error:
            answer = error
        except MemoryError:
            answer = RecordError(
                f"cannot be read as a {path.suffix} file: it states more numbers than memory holds", path
            )
        pickle.dump(answer, pipe, protocol=pickle.HIGHEST_PROTOCOL)


def _limit(seconds: int, memory: int) -> None:
    """Let the system end this process after `seconds` of processor time, and refuse it more than `memory` bytes."""
    if sys.platform != "win32":
        for limit, most in (
            (resource.RLIMIT_CPU, seconds),
            (resource.RLIMIT_AS, memory),
            (resource.RLIMIT_CORE, 0),
        ):
            hard = resource.getrlimit(limit)[1]
            resource.setrlimit(limit, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
