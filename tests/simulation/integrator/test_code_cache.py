"""The folder of compiled equations: small, of linkwise alone, and where the user wants it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_SIMULATE = """
import linkwise as lw
lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.01, rate=1000.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
@pytest.mark.parametrize(
    ("variables", "folders"),
    [
        ({"HOME": "home"}, {"home/.cache/linkwise"}),
        ({"HOME": "home", "HEYOKA_CACHE_DIR": "chosen"}, {"chosen"}),
        ({"HOME": "a file"}, set()),  # where no folder can be made
        ({}, set()),
    ],
)
def test_compiled_code_stays_in_a_folder(
    tmp_path: Path, variables: dict[str, str], folders: set[str]
) -> None:
    (tmp_path / "a file").touch()
    left = {"HEYOKA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"}
    environment = {name: value for name, value in os.environ.items() if name not in left}
    environment |= {name: str(tmp_path / value) for name, value in variables.items()}
    subprocess.run([sys.executable, "-c", _SIMULATE], env=environment, cwd=tmp_path, check=True)
    assert {str(path.parent.relative_to(tmp_path)) for path in tmp_path.rglob("cache.db")} == folders
