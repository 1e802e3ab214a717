"""The folder of a study: an SQLite file that one process writes, and a lock that ends with that process.

A row is on the disk once `add` has returned. Reading needs no lock and is possible while the study runs.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import msgspec

from linkwise import __version__
from linkwise.errors import StudyError
from linkwise.output import FullDiskError
from linkwise.study.definition import Study, build_study
from linkwise.study.subject import REPEATED, Case, Row

DATABASE, LOCK, SHARDS = "study.sqlite", "study.lock", "shards"
_OWN = {DATABASE, f"{DATABASE}-journal", LOCK, f"{LOCK}-journal", SHARDS}
_SCHEMA = """
CREATE TABLE study (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE rows (
    structure TEXT, snr_db REAL, method TEXT, seed INTEGER, row TEXT NOT NULL,
    PRIMARY KEY (structure, snr_db, method, seed)
) WITHOUT ROWID;
"""
_KEY = ("structure", "snr_db", "method", "seed")
_IS_REPEATED = f"json_extract(row, '$.status') IN ({', '.join(map(repr, REPEATED))})"
_SHOWN = 6  # differences between two definitions that an error lists
_LONG = 160  # characters of two values up to which both are shown


@dataclass(frozen=True, eq=False)
class Store:
    """The open store of `folder`."""

    folder: Path
    database: sqlite3.Connection

    def done(self) -> set[Case]:
        """The cases that have a row and are not to be run again.

        Cases with an internal error are run again, as it may have been corrected, and those at which workers died, as these
        may have had too little memory.
        """
        finished = self.database.execute(f"SELECT {', '.join(_KEY)} FROM rows WHERE NOT ({_IS_REPEATED})")
        return {Case(*values) for values in finished}

    def rows(self) -> list[Row]:
        """All rows, in no particular order."""
        return [
            msgspec.json.decode(text, type=Row) for (text,) in self.database.execute("SELECT row FROM rows")
        ]

    def gather(self, study: Study) -> None:
        """Add what shards have in folders of their own; StudyError for one that is running, or of another definition."""
        gathered: dict[Case, Row] = {}
        for folder in sorted((self.folder / SHARDS).glob("*")):
            with open_store(folder, study) as shard:
                gathered |= {row.case: row for row in shard.rows()}
        done = self.done()
        self.add(row for case, row in gathered.items() if case not in done)

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows to the disk, all or none; they replace rows of cases that are run again.

        Raises StudyError for a case that is already done.
        """
        written = [(*astuple(row.case), msgspec.json.encode(row).decode()) for row in rows]
        keys = " AND ".join(f"{name} = ?" for name in _KEY)
        repeated = f"DELETE FROM rows WHERE {keys} AND {_IS_REPEATED}"
        try:
            with self.database:
                self.database.executemany(repeated, [case for *case, _ in written])
                self.database.executemany("INSERT INTO rows VALUES (?, ?, ?, ?, ?)", written)
        except sqlite3.Error as error:
            message = f"rows could not be written: {error}; earlier rows are not affected"
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise FullDiskError(f"{self.folder}: {message}") from error
            raise StudyError(message, str(self.folder)) from error


@contextmanager
def open_store(folder: Path, study: Study) -> Iterator[Store]:
    """The store of `study` in `folder`, locked for other processes; it is created if there is none.

    Raises StudyError if another process has it open, if the folder holds another study or the study with another definition,
    and if it holds something else.
    """
    if folder.exists() and not folder.is_dir():
        raise StudyError("this is a file; a study needs a folder", str(folder))
    folder.mkdir(parents=True, exist_ok=True)
    entries = {entry.name for entry in folder.iterdir()}
    if entries and not entries & _OWN:
        message = f"the folder is not empty and does not hold a study (no {DATABASE}); choose another folder"
        raise StudyError(message, str(folder))
    with _locked(folder), closing(sqlite3.connect(folder / DATABASE, timeout=60.0)) as database:
        _prepare(folder, database, study)
        yield Store(folder, database)


def read_rows(folder: str | Path) -> tuple[Row, ...]:
    """Read the rows of a study.

    Parameters
    ----------
    folder : str or path
        The folder of the study, finished or not; it may be running.

    Returns
    -------
    tuple of Row
        In the order of the study: by structure, noise level, method and seed.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> [row.seed for row in lw.study.read_rows("results/mine")]
    [1000, 1001]
    """
    with _reading(Path(folder)) as (store, study):
        return tuple(sorted(store.rows(), key=lambda row: study.sort_key(row.case)))


def stored_study(folder: str | Path) -> Study:
    """Read the definition of the study in a folder.

    Parameters
    ----------
    folder : str or path
        The folder of the study, finished or not.

    Returns
    -------
    Study
        The study as it was started.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> len(lw.study.stored_study("results/mine"))
    2
    """
    with _reading(Path(folder)) as (_, study):
        return study


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of the folder: a transaction on a file of its own, which ends with the process."""
    with closing(sqlite3.connect(folder / LOCK, timeout=0.0, isolation_level=None)) as lock:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY:
                raise StudyError(f"the folder cannot be locked: {error}", str(folder)) from error
            message = "another process is running a study in this folder; wait for it, stop it, or choose another folder"
            raise StudyError(message, str(folder)) from None
        yield


@contextmanager
def _reading(folder: Path) -> Iterator[tuple[Store, Study]]:
    """The store of a folder, for reading, and its study; StudyError where there is none."""
    missing = StudyError(f"the folder does not hold a study (no {DATABASE})", str(folder))
    if not (folder / DATABASE).is_file():
        raise missing
    try:
        with closing(sqlite3.connect(folder / DATABASE, timeout=60.0)) as database:
            database.execute("PRAGMA query_only = ON")
            if _empty(database):
                raise missing
            study = build_study(_definition(database), str(folder / DATABASE), folder)
            yield Store(folder, database), study
    except sqlite3.DatabaseError as error:
        raise _unreadable(folder, error) from error


def _prepare(folder: Path, database: sqlite3.Connection, study: Study) -> None:
    """Create the tables if there are none; StudyError for those of another study."""
    try:
        if _empty(database):
            with database:
                database.executescript(f"BEGIN; {_SCHEMA}")
                about = {"definition": study.text(), "linkwise": __version__}
                database.executemany("INSERT INTO study VALUES (?, ?)", about.items())
            return
        before = {"linkwise": _entry(database, "linkwise"), **_definition(database)}
    except sqlite3.DatabaseError as error:
        raise _unreadable(folder, error) from error
    changes = differences(before, {"linkwise": __version__, **study.document()})
    if changes:
        shown = "; ".join(changes[:_SHOWN]) + ("; ..." if len(changes) > _SHOWN else "")
        raise StudyError(
            f"the study in this folder was started with another definition: {shown}. Rows of two definitions are not mixed; "
            "choose another folder, or continue with the definition that it was started with",
            str(folder),
        )


def _empty(database: sqlite3.Connection) -> bool:
    """Whether the database has just been created, or was by a process that was killed then."""
    return not database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]


def _definition(database: sqlite3.Connection) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(_entry(database, "definition"))
    return document


def _entry(database: sqlite3.Connection, key: str) -> str:
    row = database.execute("SELECT value FROM study WHERE key = ?", (key,)).fetchone()
    if row is None:
        raise sqlite3.DatabaseError(f"the table study has no {key}")
    return str(row[0])


def _unreadable(folder: Path, error: Exception) -> StudyError:
    return StudyError(f"not a study of linkwise, or damaged: {error}", str(folder / DATABASE))


def differences(before: Any, after: Any, path: str = "") -> list[str]:
    """Sentences on the differences between two documents, with the path of the key."""
    if isinstance(before, dict) and isinstance(after, dict):
        pairs = {f"{path}.{key}".lstrip("."): (before.get(key), after.get(key)) for key in [*before, *after]}
        return [line for at, pair in pairs.items() for line in differences(*pair, at)]
    lists = isinstance(before, list) and isinstance(after, list)
    if lists and any(isinstance(value, dict) for value in [*before, *after]):
        old, new = ({table["name"]: table for table in tables} for tables in (before, after))
        if list(old) == list(new):
            return [line for name in old for line in differences(old[name], new[name], f'{path} "{name}"')]
        before, after = list(old), list(new)
    if before == after:
        return []
    was, is_ = ("not given" if v is None else json.dumps(v, ensure_ascii=False) for v in (before, after))
    return [f"{path} was {was}, now {is_}" if len(was) + len(is_) <= _LONG else f"{path} has changed"]
