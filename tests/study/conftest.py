"""The small study, run once for all tests of studies."""

from pathlib import Path

import pytest
from here import studies_here
from small_study import small

import linkwise as lw


@pytest.fixture(scope="session")
def small_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished small study, run by this process; not to be changed."""
    folder = tmp_path_factory.mktemp("small")
    with studies_here():
        lw.study.run_study(small(folder), folder / "out", workers=1)
    return folder / "out"
