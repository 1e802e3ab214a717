"""
Three methods against noise
===========================

Sparse regression on differentiated signals, the weak form, and maximum likelihood, on the same
records with more and more noise.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
clean = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
unknown = chain.unknown("nes")

levels = [50, 40, 30, 20, 10]
names = {"sindy": "SINDy on derivatives", "weak": "weak form", "ml": "maximum likelihood"}
errors = {method: [] for method in names}
for level in levels:
    record = clean.with_noise(level, seed=1)
    for method in names:
        fit = lw.identify(record, unknown, method=method)
        error = lw.nmse(chain.link("nes1"), fit.structure.link("nes1"), clean)
        errors[method].append(error)

# %%
# The error of the force is its mean square over its variance, along the motion. The weak form
# takes a millisecond or so and starts the likelihood; what it leaves on the table is the
# difference between the two lower lines.

fig, ax = plt.subplots()
for (method, name), marker in zip(names.items(), "sov", strict=True):
    ax.semilogy(levels, errors[method], marker + "-", label=name)
ax.set(xlabel="signal-to-noise ratio, dB", ylabel="error of the force, %", xticks=levels)
ax.invert_xaxis()
ax.legend()
