"""
A sink on a beam
================

The primary structure is a cantilever that is known by its modes, as from a modal test. A bistable sink sits at its tip, and a
tap near the root moves it. "Without sinks" is the beam alone. What matters is how fast points of the beam come to rest, and
where the energy goes: into the sink or into the damping of the modes.
"""

import linkwise as lw

known = lw.Coefficient.number
shapes = [
    {"tip": 3.2, "mid": 1.1, "root": 0.3},
    {"tip": -3.2, "mid": 2.3, "root": 1.5},
    {"tip": 3.2, "mid": 0.06, "root": 2.8},
]
modes = [
    lw.model.HostMode(known(frequency), known(0.005), shape)
    for frequency, shape in zip([3.3, 20.6, 57.7], shapes, strict=True)
]
law = lw.Law.parse("alpha*d + beta*d**3 + c*v")
sink = lw.Link("sink", ("ball", "beam.tip"), law, {"alpha": -20.0, "beta": 4e5, "c": 0.1})
beam = lw.Structure("beam with a sink", (lw.Mass("ball", 0.02),), (sink,), (lw.Host("beam", tuple(modes)),))

# %%
# The table has a row for each point, and one for what all modes of the beam dissipate.
hit = {"forces": {"beam.root": "20*exp(-((t - 0.05)/0.01)**2)"}, "duration": 8.0}
result = lw.absorb(beam, **hit)
print(result)
lw.plot.absorption(result)

# %%
# Which barrier is best for this tap? The stiffer the negative spring, the higher it is: the sink takes its energy either way,
# but behind a high barrier it is soon caught in one well and leaves the first mode alone.
swept = lw.absorption.absorption_map(beam, {"sink.alpha": [-80.0, -40.0, -20.0, -10.0, -5.0, -2.5]}, **hit)
print(swept)
lw.plot.map(swept)
