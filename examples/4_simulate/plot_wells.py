"""
Wells, barriers and modes
=========================

A law implies more than its coefficients: where the link is in equilibrium, the energy that takes
it across the barrier, and how fast it vibrates in a well.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
link = chain.link("nes1")
wells, barrier = lw.analysis.wells(link), lw.analysis.barrier(link)
print(f"wells at {', '.join(f'{1e3 * well:.1f} mm' for well in wells)}")
print(f"barrier of {1e3 * barrier:.2f} mJ")

# %%
# The whole structure has an equilibrium for each well and one on top, which is not stable.
# About each stable one it has modes:

for point in lw.analysis.equilibria(chain):
    place = 1e3 * point.x[1]
    if point.stable:
        modes = lw.analysis.modes(chain, point.x)
        text = ", ".join(f"{frequency:.2f} Hz" for frequency in modes.frequencies)
        print(f"m2 at {place:+.1f} mm: stable, modes at {text}")
    else:
        print(f"m2 at {place:+.1f} mm: not stable")

# %%
# Force and potential of the link:

d = np.linspace(-0.016, 0.016, 400)
fig, (force, potential) = plt.subplots(1, 2)
force.plot(1e3 * d, link.force(d))
force.plot(1e3 * np.array(wells), [0.0, 0.0], "o")
force.set(xlabel="elongation, mm", ylabel="force, N")
potential.plot(1e3 * d, 1e3 * link.potential(d))
potential.plot(1e3 * np.array(wells), 1e3 * link.potential(wells), "o")
potential.set(xlabel="elongation, mm", ylabel="potential, mJ")
