"""What other systems lack is not needed: modules that only POSIX has, and heyoka, which has wheels for Linux alone."""

import json
import subprocess
import sys

import pytest

WITHOUT = """
import importlib, json, pkgutil, sys, tempfile
for name in ("heyoka", "fcntl", "resource", "pwd", "termios"):
    sys.modules[name] = None
import linkwise as lw
from linkwise.cli import run

refused = []
for module in pkgutil.walk_packages(lw.__path__, "linkwise."):
    try:
        importlib.import_module(module.name)
    except ImportError:
        refused.append(module.name)
chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 0.3}, duration=0.3, rate=500.0).with_noise(30.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"), method="weak")
with tempfile.TemporaryDirectory() as folder:
    for _ in range(2):  # the second one replaces the first
        answer = lw.report.write_result(fit, f"{folder}/answer")
    files = sorted(path.name for path in answer.iterdir())
    lw.write_record(record, f"{folder}/run.csv")
    code = run(["inspect", f"{folder}/run.csv", "--json"])
print(json.dumps([refused, files, code]))
"""


@pytest.mark.slow
def test_every_module_loads_and_folders_are_written_without_what_other_systems_lack() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    refused, files, code = json.loads(done.stdout.splitlines()[-1])
    # dask.distributed imports `resource` itself where the system is not Windows
    of_heyoka = {f"linkwise.simulation.integrator.{name}" for name in ("taylor", "periods")}
    assert set(refused) <= {*of_heyoka, "linkwise.study.cluster"}
    assert {"report.html", "result.json", "structure.toml", "covariance.csv"} < set(files) and code == 0
