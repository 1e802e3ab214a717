"""
Absorption with intervals
=========================

The effect of an *identified* sink on the structure, with the uncertainty of the identification
propagated.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 0.5}, duration=1.0, rate=500.0)
fit = lw.identify(record.with_noise(10.0, seed=1), chain.unknown("nes"))
print(fit)

# %%
# The same sink, under a harder blow than the one that it was identified from, in 30 structures
# drawn from what is known of it:

answer = lw.absorption.absorption_intervals(fit, duration=3.0, release={"v:m1": 1.0}, draws=30, seed=1)
taken = answer.quantity("sinks_share")
print(f"the sink takes {100 * taken.value:.1f} %, 95 % {100 * taken.lower:.1f} to {100 * taken.upper:.1f} %")

fig, ax = plt.subplots(figsize=(6.6, 4.0))
lw.plot.absorption(answer, ax=ax)
ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.15), ncols=3)
