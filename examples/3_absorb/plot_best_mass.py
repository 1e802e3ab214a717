"""
The best mass of a sink
=======================

How heavy should the sink of the paper's two-mass chain be, and how stiff? The search varies both until the
main mass moves least after a blow, and keeps what lighter sinks reach.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
options = lw.absorption.DesignOptions(evaluations=60, limits={"stroke:nes1": 0.05})
over = {"m2.mass": (0.002, 0.05), "nes1.beta": (1e5, 1e7)}
best = lw.design(chain, over, "rms", options, duration=1.0, release={"v:m1": 1.0})
print(best)

# %%
# No lighter design that was tried is as good:

mass, rms = zip(*best.trade_off, strict=True)
fig, ax = plt.subplots()
ax.step([1e3 * kg for kg in mass], [1e3 * m for m in rms], where="post", marker="o")
ax.set(xlabel="mass of the sink, g", ylabel="RMS of the main mass, mm")

# %%
# All designs; where neighbours differ, the threshold of the sink or chance decides:

fig, ax = plt.subplots()
lw.plot.designs(best, ax=ax)
