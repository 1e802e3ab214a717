"""
A stop that is hit on a shaking base
====================================

Laws may have kinks: a free play of 1 mm, then a stiff stop. The integrator ends its steps at
the kinks, so the energy balance closes to rounding.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

rig = lw.parse_structure("""
name = "pin with play"

[[mass]]
name = "pin"
mass = 0.05

[[link]]
name = "spring"
between = ["pin", "base"]
law = "k*d + c*v"
coefficients = { k = 200.0, c = 0.1 }

[[link]]
name = "stop"
between = ["pin", "base"]
law = "ks*(max(d - 0.001, 0) + min(d + 0.001, 0))"
coefficients = { ks = 20000.0 }
""")
record = lw.simulate(rig, base="0.0005*sin(2*pi*10*t)", duration=2.0, rate=2000.0)

d = record.channel("x:pin") - record.channel("x:base")
energy = record.simulated.energy
error = np.abs(energy.residual).max() / energy.supplied.max()
print(f"energy balance closes to {error:.0e} of the energy put in")

# %%
# The elongation of the spring, and the force of both links along the motion:

stop = rig.link("spring").force(d) + rig.link("stop").force(d)
last = record.time > 1.5
fig, (motion, force) = plt.subplots(1, 2, width_ratios=[2, 1])
motion.plot(record.time[last], 1e3 * d[last])
motion.axhspan(-1.0, 1.0, color="0.92")
motion.text(1.5, -0.95, "free play", va="bottom")
motion.set(xlabel="time, s", ylabel="elongation, mm")
order = np.argsort(d)
force.plot(1e3 * d[order], stop[order])
force.set(xlabel="elongation, mm", ylabel="force, N")
