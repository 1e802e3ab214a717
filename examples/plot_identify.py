"""
The force law of a bistable link
================================

From noisy displacements of two masses to the force law of the link between them.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(20.0, seed=1)
fit = lw.identify(record, chain.unknown("nes"))
print(fit)

# %%
# The identified law against the true one:

d = np.linspace(-0.03, 0.03, 301)
fig, ax = plt.subplots()
ax.plot(1e3 * d, chain.link("nes1").force(d, 0.0 * d), "k", label="true")
ax.plot(1e3 * d, fit.structure.link("nes1").force(d, 0.0 * d), "--", label="identified")
ax.set(xlabel="elongation, mm", ylabel="force, N")
ax.legend()
