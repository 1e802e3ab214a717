"""
From accelerometers alone
=========================

Displacements are seldom measured. The law of a link is found from accelerations too: they are
never integrated, which would let their noise drift away; the displacements are unknowns of the
fit.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0, sensors=["a"])
record = record.with_noise(30.0, seed=1)

fit = lw.identify(record, chain.unknown("nes"))
print(fit)

# %%
# The identified law over the elongations that were never measured:

d = np.linspace(*fit.link("nes1").d_range, 300)
fig, (seen, found) = plt.subplots(1, 2)
seen.plot(record.time, record.channel("a:m2"), linewidth=0.4)
seen.set(xlabel="time, s", ylabel="acceleration of m2, m/s$^2$", title="measured")
found.plot(1e3 * d, chain.link("nes1").force(d), "k", linewidth=3, alpha=0.25, label="true")
found.plot(1e3 * d, fit.structure.link("nes1").force(d), label="identified")
found.set(xlabel="elongation, mm", ylabel="force, N", title="identified")
found.legend()
