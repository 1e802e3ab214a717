"""`linkwise start` on a hammer test: processor time of the whole command beyond that of the fit, at most 4 s."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import linkwise as lw

resource = pytest.importorskip("resource")  # which tells the processor time of a command
MOST = 4.0  # s
LINKS = {"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"}
RIG = lw.rig(
    {"frame": 1.8, "sink": 0.12},
    LINKS,
    {"leaf.k": 3000.0, "leaf.c": 1.5, "nes.alpha": 100.0, "nes.beta": 4e5, "nes.c": 0.05},
)


def test_a_first_answer_takes_seconds(tmp_path: Path) -> None:
    record = lw.simulate(RIG, forces={"frame": "300*exp(-((t - 0.1)/0.003)**2)"}, duration=3.0, rate=1000.0)
    columns = [record.time, record["force:frame"], 1e3 * record["x:frame"], 1e3 * record["x:sink"]]
    noise = np.random.default_rng(7).standard_normal((len(record.time), 3)) * [0.05, 0.02, 0.05]
    table = np.column_stack(columns) + np.column_stack([np.zeros(len(noise)), noise])
    head = "Time (s),Hammer frame (N),Laser frame (mm),Laser sink (mm)"
    np.savetxt(tmp_path / "rig.csv", table, "%.6f", ",", header=head, comments="")
    links = " ".join(f'--link "{name}: {text}"' for name, text in LINKS.items())
    line = f"start rig.csv --mass frame=1.8 --mass 'sink=120 g' {links} --yes -o rig"
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    subprocess.run([sys.executable, "-m", "linkwise", *shlex.split(line)], cwd=tmp_path, check=True)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    answer = json.loads((tmp_path / "rig" / "answer" / "result.json").read_text(encoding="utf-8"))
    print(
        f"\nstart: {seconds:.1f} s of processor time, of which the fit took {answer['seconds']:.1f} s of the clock"
    )
    values = answer["links"][1]["coefficients"]
    for name, truth in (("alpha", 100.0), ("beta", 4e5), ("c", 0.05)):
        assert abs(values[name]["value"] - truth) < 4.0 * values[name]["standard_error"]
    assert answer["grade"] == "explained" and seconds - answer["seconds"] < MOST
