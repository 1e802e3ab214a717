"""The same study on a dask cluster of two processes."""

import logging
import os
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from small_study import small

import linkwise as lw

pytestmark = pytest.mark.skipif(
    find_spec("distributed") is None, reason="the extra [cluster] is not installed"
)


@pytest.fixture(scope="module")
def distributed() -> ModuleType:
    """The library, whose import takes a second that not every worker of the tests need spend."""
    return import_module("distributed")


@pytest.fixture(scope="module")
def cluster(distributed: ModuleType) -> Iterator[str]:
    """The address of the scheduler of two processes."""
    quiet: dict[str, Any] = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **quiet) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows_and_a_killed_worker_is_no_loss(
    tmp_path: Path, small_folder: Path, cluster: str, distributed: ModuleType
) -> None:
    file = small(tmp_path)
    with distributed.Client(cluster, set_as_default=False) as client:
        victims = list(client.run(os.getpid).values())

    def strike(report: lw.estimates.ProgressReport) -> None:
        if report.detail.done > 4 and victims:  # type: ignore[attr-defined]
            os.kill(victims.pop(), signal.SIGKILL)
            victims.clear()

    rows = lw.study.run_study(file, tmp_path / "there", scheduler=cluster, progress=strike)
    assert not victims
    assert rows == lw.study.read_rows(small_folder)
    assert len(rows) == 24 and not any(row.failed for row in rows)


def test_no_scheduler_is_said(tmp_path: Path) -> None:
    file = small(tmp_path)
    for address, reason in (("tcp://127.0.0.1:1", "refused"), ("rubbish", "missing port number")):
        with pytest.raises(lw.StudyError, match=f"{address}: no scheduler answers: .*{reason}"):
            lw.study.run_study(file, tmp_path / "out", scheduler=address)


def test_the_extra_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(lw.StudyError, match=r"install it with pip install 'linkwise\[cluster\]'"):
        lw.study.run_study(small(tmp_path), tmp_path / "out", scheduler="tcp://127.0.0.1:8786")
