"""Makes the README's picture: what sensors saw of the paper's two-mass chain, and the sink's force found in it.

Run it from anywhere: .venv/bin/python docs/picture.py
"""

from __future__ import annotations

from pathlib import Path

import linkwise as lw
from linkwise.plot.downsample import envelope
from linkwise.plot.force import draw_force, zoom_to_wells
from linkwise.plot.force_view import force_view
from linkwise.plot.palette import SERIES
from linkwise.plot.style import sheet

HERE = Path(__file__).parent

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(20.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"))

view = force_view(fit, "nes1")
with sheet(columns=3, width=9.0, height=3.2) as (figure, (motion, force, wells)):
    for name, color in zip(("x:m2", "x:m1"), SERIES, strict=False):
        motion.plot(
            *envelope(record.time, 1e3 * record.channel(name)), color=color, linewidth=0.6, label=name
        )
    motion.set_xlabel("time, s")
    motion.set_ylabel("displacement, mm")
    motion.set_title("seen: noise at 20 dB")
    motion.legend(ncols=2)
    for axes in (force, wells):
        draw_force(axes, view)
    force.set_title("found: the force of the sink")
    zoom_to_wells(wells, view)
    wells.set_title("near its wells")
    drawn = dict(zip(*reversed(force.get_legend_handles_labels()), strict=True))
    force.legend([drawn["true"], drawn["identified"], drawn["wells"]], ["true", "identified", "wells"])
    figure.savefig(HERE / "picture.png", dpi=110, metadata={"Software": "linkwise"})
