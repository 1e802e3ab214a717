"""
The force law of a bistable link
================================

Two noisy displacement sensors, one record, and the force law of the link between the two masses
with its 95 % band.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0)
record = record.with_noise(10.0, seed=1)

# %%
# Everything but the sink's coefficients is known:

fit = lw.identify(record, chain.unknown("nes"))
print(fit)

# %%
# The band is drawn ten times as wide as it is, else it would hide behind the line, although the
# noise is a third of the motion.

d = np.linspace(-0.016, 0.016, 301)
force, lower, upper = fit.force_band("nes1", d)

print(f"95 % band at {1e3 * d[-1]:.0f} mm: {lower[-1]:.2f} to {upper[-1]:.2f} N")

fig, ax = plt.subplots()
ax.plot(1e3 * d, chain.link("nes1").force(d), "k", linewidth=3, alpha=0.25, label="true")
ax.plot(1e3 * d, force, label="identified")
ax.fill_between(
    1e3 * d,
    force + 10 * (lower - force),
    force + 10 * (upper - force),
    alpha=0.3,
    linewidth=0,
    label="95 % band x 10",
)
for well in fit.link("nes1").wells:
    ax.plot(1e3 * well.value, 0.0, "o", color="C1")
ax.set(xlabel="elongation, mm", ylabel="force, N", title="a spring with two wells")
ax.legend()
