"""Makes the README's picture: noisy displacements of the paper's two-mass chain, and the sink's force identified from them.

Run it from anywhere: .venv/bin/python docs/picture.py
"""

from __future__ import annotations

from pathlib import Path

import linkwise as lw
from linkwise.plot.style import sheet

HERE = Path(__file__).parent

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(20.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"))

with sheet(columns=3, width=9.0, height=3.2) as (figure, (motion, force, wells)):
    lw.plot.histories(record, ["x:m2", "x:m1"], ax=motion)
    motion.set_title("measured: noise at 20 dB")
    lw.plot.force(fit, "nes1", legend=False, ax=force)
    force.set_title("identified: the force of the sink")
    lw.plot.force(fit, "nes1", near_wells=True, legend=False, ax=wells)
    wells.set_title("near its wells")
    drawn = dict(zip(*reversed(force.get_legend_handles_labels()), strict=True))
    force.legend([drawn["true"], drawn["identified"], drawn["wells"]], ["true", "identified", "wells"])
    figure.savefig(HERE / "picture.png", dpi=110, metadata={"Software": "linkwise"})
