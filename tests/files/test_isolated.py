"""Files that crash, hang or exhaust the library that reads them: an error of the file, and nothing else happens."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from linkwise.errors import RecordError
from linkwise.files.isolated import read_isolated
from linkwise.files.table import Column, Table

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no signals and limits of processes there")

READERS = {
    "segfault": "os.kill(os.getpid(), signal.SIGSEGV)",
    "leaves": "os._exit(0)",
    "endless": "\n    while True: pass",
    "greedy": "np.ones(1 << 50)",
    "chatty": "print('to standard output', flush=True); os.write(1, b'and below it')",
    "fails": "raise ValueError('two\\nlines')",
    "refuses": "raise RecordError('is not good', path, 3, 'x:m1')",
}


@pytest.fixture(autouse=True)
def _started(monkeypatch: pytest.MonkeyPatch) -> None:
    """As for users, and not as in all other tests."""
    monkeypatch.setattr("linkwise.files.isolated.subprocess", subprocess)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file to read, beside modules that read it in the ways of `READERS`."""
    for name, body in READERS.items():
        (tmp_path / f"reader_{name}.py").write_text(
            "import os, signal\nimport numpy as np\nfrom linkwise.errors import RecordError\n"
            "from linkwise.files.table import Column, Table\n"
            f"def read_table(path):\n    {body}\n    return Table((Column('a', np.arange(9.0)),), notes=('n',))\n"
        )
    monkeypatch.syspath_prepend(str(tmp_path))
    path = tmp_path / "run.mat"
    path.write_bytes(b"content")
    return path


def test_a_table_comes_through_whatever_the_library_prints(file: Path) -> None:
    table = read_isolated("reader_chatty", file)
    assert isinstance(table, Table) and table.notes == ("n",)
    np.testing.assert_array_equal(table.columns[0].values, np.arange(9.0))
    assert isinstance(table.columns[0], Column)


@pytest.mark.parametrize(
    ("reader", "message"),
    [
        ("segfault", "cannot be read as a .mat file: the library that reads it crashed; the file is damaged"),
        ("leaves", "cannot be read as a .mat file: the library that reads it crashed; the file is damaged"),
        ("greedy", "cannot be read as a .mat file: it states more numbers than memory holds"),
        ("fails", "cannot be read as a .mat file: two lines"),
    ],
)
def test_what_goes_wrong_is_an_error_of_the_file(reader: str, message: str, file: Path) -> None:
    with pytest.raises(RecordError) as caught:
        read_isolated(f"reader_{reader}", file)
    assert caught.value.message == message and caught.value.file == file


def test_an_error_of_the_reader_keeps_its_places(file: Path) -> None:
    with pytest.raises(RecordError) as caught:
        read_isolated("reader_refuses", file)
    error = caught.value
    assert (error.message, error.file, error.line, error.channel) == ("is not good", file, 3, "x:m1")


def test_what_never_ends_is_ended(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("linkwise.files.isolated._SECONDS", 1.0)
    with pytest.raises(RecordError, match="reading did not end after 1 s; the file is damaged"):
        read_isolated("reader_endless", file)


def test_a_script_need_not_guard_its_main_part(tmp_path: Path) -> None:
    """As it would have to for processes of multiprocessing, which import the script again."""
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np, linkwise as lw\n"
        "from scipy.io import savemat\n"
        "t = np.arange(64) / 100\n"
        "savemat('run.mat', {'time': t, 'x_m1': np.sin(20 * t)})\n"
        "print(lw.read_record('run.mat').channels)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.stdout, done.stderr) == ("('x:m1',)\n", "")
