"""
An unknown mass under a measured force
======================================

Motion alone determines only ratios of forces to masses. If an applied force is measured, the
mass itself can be identified.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

rig = lw.parse_structure("""
name = "beam on a shaker"

[[mass]]
name = "tip"
mass = 0.62

[[link]]
name = "beam"
between = ["tip", "ground"]
law = "k1*d + k3*d**3 + c*v"
coefficients = { k1 = 2400.0, k3 = 4e7, c = 0.8 }
""")

# %%
# A sweep from 5 Hz to 20 Hz in ten seconds:

record = lw.simulate(
    rig,
    forces={"tip": "sin(2*pi*(5*t + 0.75*t**2))"},
    duration=10.0,
    rate=500.0,
).with_noise(30.0, seed=1)
print(record)

fit = lw.identify(record, rig.unknown("all", "mass:tip"))
print(fit)

# %%
# A hardening spring: the response grows far beyond the linear resonance, until the sweep leaves it
# behind.

resonance = lw.analysis.modes(fit.structure).frequencies[0]
frequency = 5 + 1.5 * record.time
fig, ax = plt.subplots()
ax.plot(frequency, 1e3 * record.channel("x:tip"), linewidth=0.5)
ax.axvline(resonance, color="C1", label=f"linear resonance, {resonance:.1f} Hz")
ax.set(xlabel="frequency of the force, Hz", ylabel="displacement, mm")
ax.legend(loc="lower left")
print(f"{np.abs(record.channel('x:tip')).max() * 1e3:.1f} mm at the most")
