"""
Equivalent stiffness and damping
================================

Linear design needs one stiffness per link. A nonlinear link has one for each amplitude: that of
the linear spring and damper that store and dissipate the same energy in one cycle. Both are drawn
with their bands.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
fit = lw.identify(record.with_noise(10.0, seed=1), chain.unknown("nes"))

amplitude = np.linspace(0.001, 0.03, 100)
found = lw.estimates.equivalent(fit.link("nes1"), amplitude, frequency=27.0)

fig, (stiffness, damping) = plt.subplots(1, 2)
for ax, value, band, unit in (
    (stiffness, found.stiffness, found.stiffness_band, "stiffness, N/m"),
    (damping, found.damping, found.damping_band, "damping, N s/m"),
):
    ax.fill_between(1e3 * amplitude, *band.T, alpha=0.3, linewidth=0, label="95 % band")
    ax.plot(1e3 * amplitude, value)
    ax.set(xlabel="amplitude, mm", title=f"equivalent {unit}")
stiffness.axhline(0.0, color="k", linewidth=0.6)
damping.set_ylim(0.0195, 0.0205)
damping.legend()

# %%
# Below the amplitude where the stiffness is zero the link pushes its ends apart: that is what
# makes it bistable.

zero = amplitude[np.argmin(np.abs(found.stiffness))]
print(f"no stiffness at an amplitude of {1e3 * zero:.1f} mm")
