"""
A test planned, and run
=======================

Before a test, the Cramér-Rao bound gives the smallest standard errors that its record allows;
after it, those of the fit should be about as small.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
levels = [10, 20, 30, 40]
names = ["nes1.alpha", "nes1.beta", "nes1.c"]
planned = {name: [] for name in names}
reached = {name: [] for name in names}
test = {"release": {"v:m1": 1.0}, "duration": 2.0, "rate": 1000.0}
clean = lw.simulate(chain, **test)
for level in levels:
    bound = lw.limit(chain, noise=level, unknown=["nes"], **test)
    fit = lw.identify(clean.with_noise(level, seed=1), chain.unknown("nes"))
    for name in names:
        truth = abs(chain.coefficient(name).value)
        planned[name].append(100 * bound.coefficient(name).standard_error / truth)
        reached[name].append(100 * fit.coefficient(name).standard_error / truth)

# %%
# The bound looks at pieces of a quarter of a second; the fit links the pieces and so may do
# better, for damping by far.

fig, ax = plt.subplots()
for color, name in enumerate(names):
    ax.semilogy(levels, planned[name], "--", color=f"C{color}")
    ax.semilogy(levels, reached[name], "o-", color=f"C{color}", label=name)
ax.plot([], [], "k--", label="planned")
ax.set(xlabel="signal-to-noise ratio, dB", ylabel="standard error, %", xticks=levels)
ax.legend(ncols=2)
