"""
The loop of a damper on a rig
=============================

An actuator moves one end of a damper, a load cell measures its force, and nothing else moves. The
force depends on the history of the motion: over the elongation it forms loops, which no function
F(d) can. A law with a state can.
"""

import matplotlib.pyplot as plt

import linkwise as lw

rig = lw.parse_structure("""
name = "damper on a rig"

[[link]]
name = "damper"
between = ["base", "ground"]
law = "bouc-wen"
""")
values = {"k": 2000.0, "c": 50.0, "F": 100.0, "x0": 1e-3, "s": 0.7}
true = rig.with_values({f"damper.{name}": value for name, value in values.items()})
record = lw.simulate(
    true, base="0.01*sin(5*t)*sin(0.7*t) + 0.003*sin(17*t)", duration=10.0, rate=200.0
).with_noise(40.0, seed=1)

fit = lw.identify(record, rig)
print(fit)

# %%
# The measured loops, and those of the identified law:

fig, ax = plt.subplots()
lw.plot.loop(fit, "damper", ax=ax)
