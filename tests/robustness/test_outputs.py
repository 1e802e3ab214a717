"""Result files and folders: whole, of one run, or absent, whatever happens meanwhile; the answer is printed first."""

import gc
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EACCES, EBUSY, ENOSPC
from pathlib import Path

import pytest
from commands import said
from problems import chain_record
from structures import beam_of_one_mode

import linkwise as lw
from linkwise.cli import run
from linkwise.errors import OutputError
from linkwise.output import FullDiskError, atomic_file, atomic_folder, check_result_folder, to_json
from linkwise.plot.estimates import shapes_figure

NAMES = [f"file{k}.txt" for k in range(6)]


def write(folder: Path, text: str) -> None:
    """A result of several files that all hold `text`."""
    with atomic_folder(folder) as own:
        fill(own, text)


def fill(own: Path, text: str) -> None:
    for name in NAMES:
        (own / name).write_text(text)
    (own / "result.json").write_text(json.dumps({"method": text, "files": NAMES}))


def whole(folder: Path) -> str:
    """The one text that all files of a result hold."""
    method: str = json.loads((folder / "result.json").read_text())["method"]
    assert {(folder / name).read_text() for name in NAMES} == {method}
    assert {entry.name for entry in folder.iterdir()} >= {*NAMES, "result.json"}
    return method


def test_of_two_runs_at_once_each_writes_a_folder_of_its_own(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "answer") as first, atomic_folder(tmp_path / "answer") as second:
        assert first != second
        fill(second, "second")
        fill(first, "first")
    assert whole(tmp_path / "answer") == "first"  # the block that began first ends last
    assert [entry.name for entry in tmp_path.iterdir()] == ["answer"]


# A process that writes a result of one text and is killed as it touches the disk for the time that is given.
KILLED = """
import json, os, signal, sys
from pathlib import Path
from linkwise.output import atomic_folder

folder, text, left, *names = sys.argv[1:]
left = int(left)

def count(name, arguments):
    global left
    if name in ("os.rename", "os.mkdir", "os.remove", "os.rmdir", "shutil.rmtree") or (
        name == "open" and isinstance(arguments[1], str) and "w" in arguments[1]
    ):
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(count)
with atomic_folder(Path(folder)) as own:
    for name in names:
        (own / name).write_text(text)
    (own / "result.json").write_text(json.dumps({"method": text, "files": names}))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="nobody is killed by a signal there")
def test_a_run_killed_at_any_moment_leaves_a_whole_result_or_none(tmp_path: Path) -> None:
    states = set()
    for event in range(1, 60):
        home = tmp_path / str(event)
        home.mkdir()
        write(home / "answer", "old")
        command = [sys.executable, "-c", KILLED, str(home / "answer"), "new", str(event), *NAMES]
        code = subprocess.run(command, timeout=60, check=False).returncode
        states.add(whole(home / "answer") if (home / "answer").exists() else "absent")
        if code == 0:
            break
        assert code == -signal.SIGKILL
        with pytest.raises(RuntimeError), atomic_folder(home / "answer"):  # the next run finds what was there
            raise RuntimeError
        states.add(whole(home / "answer"))
    else:
        pytest.fail("the run never came to its end")
    assert {"old", "new"} <= states <= {"old", "new", "absent"}


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_to_a_folder_stays_one(is_there: bool, tmp_path: Path) -> None:
    if is_there:
        (tmp_path / "disk").mkdir()
    (tmp_path / "answer").symlink_to(tmp_path / "disk")
    for text in ("old", "new"):
        check_result_folder(tmp_path / "answer")
        write(tmp_path / "answer", text)
        assert (tmp_path / "answer").is_symlink() and whole(tmp_path / "disk") == text


@pytest.mark.parametrize("name", [".", "../answer"])
def test_the_folder_where_one_is(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "answer"
    home.mkdir()
    monkeypatch.chdir(home)
    write(Path(name), "old")
    (home / "mine.txt").write_text("notes")
    write(Path(name), "new")
    assert whole(home) == "new" and (home / "mine.txt").read_text() == "notes"
    assert Path.cwd() == home and {e.name for e in home.iterdir()} == {*NAMES, "result.json", "mine.txt"}
    (home / "inner").mkdir()
    (tmp_path / "other" / "inner").mkdir(parents=True)
    with pytest.raises(OutputError, match="not a result of linkwise"):
        check_result_folder(Path("../other/inner/.."))


@pytest.mark.parametrize("reason", [EBUSY, EACCES])
def test_a_fixed_folder_is_filled(reason: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one on which a disk is mounted, or one in a folder of somebody else's."""
    folder = tmp_path / "answer"
    folder.mkdir()
    rename, mkdir = Path.rename, Path.mkdir

    def fixed(path: Path, target: Path) -> Path:
        if path == folder or target == folder:
            raise OSError(reason, os.strerror(reason))
        return rename(path, target)

    def forbidden(path: Path, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        if reason == EACCES and path.parent == tmp_path:
            raise OSError(reason, os.strerror(reason))
        mkdir(path, mode, parents, exist_ok)

    monkeypatch.setattr(Path, "rename", fixed)
    monkeypatch.setattr(Path, "mkdir", forbidden)
    check_result_folder(folder)
    write(folder, "old")
    (folder / "mine.txt").write_text("notes")
    write(folder, "new")
    assert whole(folder) == "new" and (folder / "mine.txt").read_text() == "notes"
    assert {entry.name for entry in folder.iterdir()} == {*NAMES, "result.json", "mine.txt"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["answer"]


def test_folders_of_others_are_not_swept_away(tmp_path: Path) -> None:
    """Nor is one that is being written to: only those that nobody has touched for a day."""
    leftovers = [".answer.old", ".answer.backup.old", ".answer.0123abcd.partial", ".answer2.0123abcd.old"]
    for name in [*leftovers, ".answer.76543210.partial"]:
        (tmp_path / name).mkdir()
    os.utime(tmp_path / ".answer.76543210.partial", (0, 0))
    write(tmp_path / "answer", "new")
    assert {entry.name for entry in tmp_path.iterdir()} == {"answer", *leftovers}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such places")
@pytest.mark.parametrize("place", ["/proc/answer", "/dev/null/answer", "x" * 300])
def test_a_place_without_folders_is_refused(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match="the result could not be written"):
        check_result_folder(Path(place))


def test_a_full_disk_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 3_000_000}))
    with pytest.raises(
        FullDiskError, match="answer: 3 MB are free on its disk, and a result needs 20 MB"
    ) as error:
        check_result_folder(tmp_path / "answer")
    assert error.value.exit_code == 1 and list(tmp_path.iterdir()) == []


def test_a_file_behind_a_link_is_replaced_and_a_device_is_not(tmp_path: Path) -> None:
    (tmp_path / "there.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "there.txt")
    with atomic_file(tmp_path / "link.txt") as partial:
        partial.write_text("new")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "there.txt").read_text() == "new"
    with pytest.raises(OutputError, match="not a regular file"), atomic_file(Path(os.devnull)):
        pytest.fail("the block must not run")


@contextmanager
def full_disk() -> Iterator[None]:
    """No file gets more than 100 bytes, while this lasts: pytest itself may write its log into one."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def worked_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with files to work on."""
    monkeypatch.chdir(tmp_path)
    lw.write_structure(beam_of_one_mode(), "beam.toml")
    lw.write_structure(lw.bnes_chain(2), "chain.toml")
    lw.write_record(chain_record(2, duration=0.1, rate=500.0), "run.csv")
    Path("modes.csv").write_text("frequency[Hz],damping,tip\n5.2,0.01,1.0\n")
    lw.plot.save(shapes_figure(beam_of_one_mode()), "shown")  # fonts are found before
    monkeypatch.setattr(
        "sys.dont_write_bytecode", True
    )  # Python keeps what it could write of a module, and fails to load it


@pytest.mark.usefixtures("worked_on")
@pytest.mark.parametrize(
    "command",
    [
        *(f"export chain.toml new.{suffix}" for suffix in ("py", "m", "mat", "csv", "xlsx")),
        *(f"simulate chain.toml --duration 0.1 --rate 500 -o new.{suffix}" for suffix in ("csv", "mat", "h5", "parquet")),
        "structure bnes --dof 2 -o new.toml",
        "structure host modes.csv -o new.toml",
        "structure show beam.toml --shapes new",
        "inspect run.csv --write-mapping new.toml",
    ],
)  # fmt: skip
def test_a_full_disk_is_told_in_one_line(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = os.listdir()
    with full_disk():
        status = run(command.split())
        gc.collect()  # what is forgotten has nothing to add
    said = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("note: ")]
    assert status == 1 and len(said) == 1
    assert re.fullmatch(r"linkwise: new\.\w+: cannot be written: File too large", said[0])
    assert sorted(os.listdir()) == sorted(before) and capsys.readouterr().err == ""


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A quick identification, without a folder for the result."""
    folder = tmp_path_factory.mktemp("files")
    chain = lw.bnes_chain(2)
    lw.write_structure(chain.unknown("nes"), folder / "unknown.toml")
    record = chain_record(2, duration=1.0, rate=500.0).with_noise(30.0, seed=1)
    lw.write_record(record, folder / "run.csv")
    return f"identify {folder}/run.csv {folder}/unknown.toml --method weak"


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(("moment", "elsewhere"), [(1, True), (4, False), (7, True)])
def test_an_answer_is_printed_and_kept_where_the_disk_is_full_after_the_fit(
    moment: int, elsewhere: bool, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the file `moment` of the result; `elsewhere` tells whether another disk has room."""
    folder = tmp_path / "answer"
    write(folder, "old")
    opened, left = open, moment

    def full(file: object, mode: str = "r", *rest: object, **named: object) -> object:
        nonlocal left
        full_disk = not elsewhere or str(tmp_path / "kept") not in str(file)
        if "w" in mode and ".partial" in str(file) and "trial" not in str(file) and full_disk:
            left -= 1
            if left <= 0:
                raise OSError(ENOSPC, os.strerror(ENOSPC), str(file))
        return opened(file, mode, *rest, **named)  # type: ignore[call-overload]

    monkeypatch.setattr("io.open", full)
    monkeypatch.setattr("builtins.open", full)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "kept"))
    (tmp_path / "kept").mkdir()
    out, err = said(f"{line} -o {folder}", 1)
    assert "alpha" in out
    note, error = err.strip().splitlines()
    assert error == f"linkwise: {folder}: the result could not be written: No space left on device"
    assert whole(folder) == "old" and {entry.name for entry in tmp_path.iterdir()} == {"answer", "kept"}
    if elsewhere:
        rescued = Path(note.removeprefix("note: the result was kept in "))
        assert rescued.parent.parent == tmp_path / "kept" and lw.estimates.read_posterior(rescued).names
        assert set(json.loads((rescued / "result.json").read_text())["files"]) < set(os.listdir(rescued))
    else:
        assert note == "note: the result was not saved; only the printed text is left"
        assert os.listdir(tmp_path / "kept") == []


@pytest.mark.parametrize("fault", [RuntimeError("no such symbol"), MemoryError()])
def test_numbers_are_kept_where_a_figure_cannot_be_drawn(
    fault: Exception, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def undrawn(*_: object) -> None:
        raise fault

    monkeypatch.setattr("linkwise.report.result_folder.embedded", undrawn)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    note, error = said(f"{line} -o {tmp_path}/answer", 1).err.strip().splitlines()
    place, _, lacking = note.removeprefix("note: the result was kept in ").partition(", ")
    assert lacking == "without figures and page" and error.startswith("linkwise: ")
    assert not (tmp_path / "answer").exists() and lw.estimates.read_posterior(place).names
    files = json.loads((Path(place) / "result.json").read_text())["files"]
    assert {*files, "result.json"} == set(os.listdir(place)) and "structure.toml" in files


@pytest.mark.usefixtures("unrendered")
def test_an_answer_is_written_where_nobody_reads_what_is_printed(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unheard(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("click.echo", unheard)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    assert run([*line.split(), "-o", str(tmp_path / "answer")]) == 1
    assert (tmp_path / "answer" / "result.json").is_file()


def test_json_is_readable_by_everyone() -> None:
    assert to_json({"a": [1.5, float("nan")], "b": (float("inf"), "x", None, True, 2)}) == (
        '{"a": [1.5, null], "b": [null, "x", null, true, 2]}'
    )


def test_file_keeps_its_suffix_while_written_and_a_failed_one_leaves_the_earlier(tmp_path: Path) -> None:
    target = tmp_path / "new" / "run.csv"
    with atomic_file(target) as partial:
        assert partial.suffix == ".csv" and not target.exists()
        partial.write_text("text")
    assert target.read_text() == "text" and list(target.parent.iterdir()) == [target]
    with pytest.raises(RuntimeError, match="on the way"), atomic_file(target) as partial:
        partial.write_text("half")
        raise RuntimeError("on the way")
    assert target.read_text() == "text" and list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("text", [None, "no JSON", '{"files": []}', '["method"]', '{"method": "weak"}'])
def test_a_folder_that_is_no_result_is_refused(tmp_path: Path, text: str | None) -> None:
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.tex").write_text("years of work")
    if text is not None:
        (folder / "result.json").write_text(text)
    with pytest.raises(
        OutputError, match=r"thesis: already exists and is not a result of linkwise .* Choose another folder"
    ):
        check_result_folder(folder)
    with pytest.raises(OutputError), atomic_folder(folder):
        pytest.fail("the block must not run")
    assert (folder / "chapter1.tex").read_text() == "years of work"
    with pytest.raises(OutputError, match="is not a result of linkwise"):
        check_result_folder(folder / "chapter1.tex")
