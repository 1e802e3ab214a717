"""
Absorption with intervals
=========================

What a sink that was *identified* does for its host, with the uncertainty of the identification
carried through.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 0.5}, duration=1.0, rate=500.0)
fit = lw.identify(record.with_noise(10.0, seed=1), chain.unknown("nes"))
print(fit)

# %%
# The same sink, under a harder blow than the one that it was identified from, in 60 structures
# drawn from what is known of it:

answer = lw.absorption_intervals(fit, duration=3.0, release={"v:m1": 1.0}, draws=60, seed=1)
taken = answer.quantity("sinks_share")
print(f"the sink takes {100 * taken.value:.1f} %, 95 % {100 * taken.lower:.1f} to {100 * taken.upper:.1f} %")

found = answer.found
fig, ax = plt.subplots()
ax.semilogy(found.time, 1e3 * found.without.envelope[:, 0], color="0.6", label="without sink")
ax.semilogy(found.time, 1e3 * found.with_sinks.envelope[:, 0], label="with sink")
ax.fill_between(
    found.time,
    1e3 * answer.lower[:, 0],
    1e3 * answer.upper[:, 0],
    alpha=0.3,
    linewidth=0,
    label="95 % of the draws",
)
ax.set(xlabel="time, s", ylabel="envelope of m1, mm", xlim=(0, 2.9), ylim=(0.1, None))
ax.legend()
