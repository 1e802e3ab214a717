"""
Is it linear? One tap, three levels
===================================

In a linear structure the natural frequencies do not depend on how hard it is hit. Records at
several levels show, without any model, from which level on they do.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

oscillator = lw.parse_structure("""
name = "hardening oscillator"

[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "spring"
between = ["m1", "ground"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = 4e3, k3 = 4e8, c = 1.0 }
""")
taps = [
    lw.simulate(
        oscillator,
        forces={"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"},
        duration=6.0,
        rate=200.0,
        sensors=["x:m1"],
    ).with_noise(60.0, seed=1)
    for size in (0.1, 1.0, 4.0)
]
levels = lw.inspection.compare_levels(taps)
print(levels)

# %%
# After the hardest tap the mode rings down through all amplitudes, and its frequency follows
# the backbone of the spring, by the harmonic balance of one term:

fig, ax = plt.subplots()
lw.plot.ring_down(levels, legend=False, ax=ax)
amplitude = np.geomspace(*ax.get_xlim(), 100)
backbone = np.sqrt(4e3 + 0.75 * 4e8 * amplitude**2) / (2.0 * np.pi)
ax.plot(amplitude, backbone, color="C1", zorder=0, label="harmonic balance")
ax.legend()
