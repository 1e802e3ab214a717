"""The folder of a study: one SQLite file that one process writes, and a lock that dies with that process.

A row is there for good once `add` has returned. Who only reads needs no lock and may read while the study runs.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from linkwise.atomic import FullDiskError
from linkwise.errors import StudyError
from linkwise.study.definition import Study
from linkwise.study.row import DIED, FAILED, FAULT, Case, Row
from linkwise.study.toml_file import build_study

DATABASE, LOCK = "study.sqlite", "study.lock"
_OWN = {DATABASE, f"{DATABASE}-journal", LOCK, f"{LOCK}-journal"}
_SCHEMA = """
CREATE TABLE study (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE rows (
    structure TEXT, snr_db REAL, method TEXT, seed INTEGER, masses INTEGER NOT NULL, status TEXT NOT NULL,
    links TEXT NOT NULL, coefficients TEXT NOT NULL, standard_errors TEXT NOT NULL,
    seconds REAL NOT NULL, reason TEXT NOT NULL,
    PRIMARY KEY (structure, snr_db, method, seed)
) WITHOUT ROWID;
"""
_KEY = ("structure", "snr_db", "method", "seed")
_MAPPINGS = ("links", "coefficients", "standard_errors")
_FIELDS = (*_KEY, "masses", "status", *_MAPPINGS, "seconds", "reason")
_UNDECIDED = " OR ".join(f"substr(reason, 1, {len(why)}) = '{why}'" for why in (FAULT, DIED))
_FAULTY = f"status = '{FAILED}' AND ({_UNDECIDED})"
_SHOWN = 6  # differences between two definitions that an error lists
_LONG = 160  # characters of two values that are shown beside each other


@dataclass(frozen=True, eq=False)
class Store:
    """The open store of `folder`, to add rows to."""

    folder: Path
    database: sqlite3.Connection

    def done(self) -> set[Case]:
        """The cases that have a row, but for those that failed by no fault of their own: by one of linkwise, which may be
        mended since, and by the death of workers, which may have had too little memory.
        """
        found = self.database.execute(f"SELECT {', '.join(_KEY)} FROM rows WHERE NOT ({_FAULTY})")
        return {Case(*values) for values in found}

    def rows(self) -> list[Row]:
        """All rows, in no order."""
        return _rows(self.database)

    def add(self, rows: Iterable[Row]) -> None:
        """Write finished cases to the disk, all of them or none, in place of those that failed by a fault of linkwise. A case
        that is `done` already raises StudyError.
        """
        marks, rows = ", ".join("?" * len(_FIELDS)), list(rows)
        keys = " AND ".join(f"{name} = ?" for name in _KEY)
        try:
            with self.database:
                self.database.executemany(
                    f"DELETE FROM rows WHERE {keys} AND {_FAULTY}", [astuple(row.case) for row in rows]
                )
                self.database.executemany(
                    f"INSERT INTO rows ({', '.join(_FIELDS)}) VALUES ({marks})", map(_values, rows)
                )
        except sqlite3.Error as error:
            message = f"rows could not be written: {error}; what was there is safe"
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise FullDiskError(f"{self.folder}: {message}") from error
            raise StudyError(message, str(self.folder)) from error


@contextmanager
def open_store(folder: Path, study: Study) -> Iterator[Store]:
    """The store of `study` in `folder`, made where there is none; nobody else can open it meanwhile.

    Raises StudyError where another process has it open, where the folder holds another study, or one that has changed since,
    or something else than a study.
    """
    if folder.exists() and not folder.is_dir():
        raise StudyError("it is a file; give a folder for the study", str(folder))
    folder.mkdir(parents=True, exist_ok=True)
    entries = {entry.name for entry in folder.iterdir()}
    if entries and not entries & _OWN:
        raise StudyError(
            f"it is not empty and holds no study (no {DATABASE}), so it is left as it is; give another folder",
            str(folder),
        )
    with _locked(folder), closing(_connect(folder)) as database:
        _prepare(folder, database, study)
        yield Store(folder, database)


def read_rows(folder: str | Path) -> tuple[Row, ...]:
    """The rows of the study in `folder`, finished or not, in the order of its tables: structure, noise, method, seed.

    Raises StudyError where there is no study.
    """
    with _reading(Path(folder)) as database:
        study = _stored(Path(folder), database)
        return tuple(sorted(_rows(database), key=lambda row: study.place(row.case)))


def stored_study(folder: str | Path) -> Study:
    """The definition of the study in `folder`, as it was begun. Raises StudyError where there is none."""
    with _reading(Path(folder)) as database:
        return _stored(Path(folder), database)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of the folder: a transaction on a file of its own, which the system ends with the process."""
    with closing(sqlite3.connect(folder / LOCK, timeout=0.0, isolation_level=None)) as lock:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            if "locked" not in str(error):
                raise StudyError(f"it cannot be locked: {error}", str(folder)) from error
            raise StudyError(
                "another process is running a study in this folder; wait for it, stop it, or give another folder",
                str(folder),
            ) from None
        yield


def _connect(folder: Path) -> sqlite3.Connection:
    return sqlite3.connect(folder / DATABASE, timeout=60.0)


@contextmanager
def _reading(folder: Path) -> Iterator[sqlite3.Connection]:
    absent = StudyError(f"there is no study in it (no {DATABASE})", str(folder))
    if not (folder / DATABASE).is_file():
        raise absent
    try:
        with closing(_connect(folder)) as database:
            database.execute("PRAGMA query_only = ON")
            if _empty(database):
                raise absent
            yield database
    except sqlite3.DatabaseError as error:
        raise _unreadable(folder, error) from error


def _prepare(folder: Path, database: sqlite3.Connection, study: Study) -> None:
    """Make the tables where there are none; refuse those of another study."""
    try:
        if _empty(database):
            with database:
                database.executescript(f"BEGIN; {_SCHEMA}")
                about = {"definition": study.text(), "linkwise": version("linkwise")}
                database.executemany("INSERT INTO study VALUES (?, ?)", about.items())
            return
        before = {"linkwise": _stated(database, "linkwise"), **_definition(database)}
    except sqlite3.DatabaseError as error:
        raise _unreadable(folder, error) from error
    changes = differences(before, {"linkwise": version("linkwise"), **study.document()})
    if changes:
        shown = "; ".join(changes[:_SHOWN]) + ("; ..." if len(changes) > _SHOWN else "")
        raise StudyError(
            f"the study in this folder was begun with another definition: {shown}. Rows of two definitions do not mix: give "
            "another folder, or go on with the definition that it was begun with",
            str(folder),
        )


def _empty(database: sqlite3.Connection) -> bool:
    """Whether it was made a moment ago, or by a process that was killed in that moment."""
    return not database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]


def _definition(database: sqlite3.Connection) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(_stated(database, "definition"))
    return document


def _stated(database: sqlite3.Connection, key: str) -> str:
    found = database.execute("SELECT value FROM study WHERE key = ?", (key,)).fetchone()
    if found is None:
        raise sqlite3.DatabaseError(f"it has no {key}")
    return str(found[0])


def _stored(folder: Path, database: sqlite3.Connection) -> Study:
    return build_study(_definition(database), str(folder / DATABASE), folder)


def _unreadable(folder: Path, error: Exception) -> StudyError:
    return StudyError(f"this is no study of linkwise, or a damaged one: {error}", str(folder / DATABASE))


def differences(before: Any, now: Any, path: str = "") -> list[str]:
    """Sentences on what differs between two documents, with the path of the key."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = dict.fromkeys([*before, *now])
        return [
            line
            for key in keys
            for line in differences(before.get(key), now.get(key), f"{path}.{key}".lstrip("."))
        ]
    tables = (
        isinstance(before, list)
        and isinstance(now, list)
        and any(isinstance(one, dict) for one in [*before, *now])
    )
    if tables:
        named = [{one["name"]: one for one in each} for each in (before, now)]
        if list(named[0]) == list(named[1]):
            return [
                line
                for name in named[0]
                for line in differences(named[0][name], named[1][name], f'{path} "{name}"')
            ]
        before, now = (list(each) for each in named)
    if before == now:
        return []
    was, is_ = ("not given" if one is None else json.dumps(one, ensure_ascii=False) for one in (before, now))
    return [f"{path} was {was}, now {is_}" if len(was) + len(is_) <= _LONG else f"{path} has changed"]


def _values(row: Row) -> tuple[Any, ...]:
    return tuple(
        json.dumps(dict(getattr(row, name)), allow_nan=False) if name in _MAPPINGS else getattr(row, name)
        for name in _FIELDS
    )


def _rows(database: sqlite3.Connection) -> list[Row]:
    found = database.execute(f"SELECT {', '.join(_FIELDS)} FROM rows")
    return [
        Row(
            **{
                name: json.loads(value) if name in _MAPPINGS else value
                for name, value in zip(_FIELDS, values, strict=True)
            }
        )
        for values in found
    ]
