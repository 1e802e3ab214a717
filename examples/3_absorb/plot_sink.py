"""
What an energy sink does
========================

A mass is hit. How fast does it come to rest with a bistable sink on it, how fast without, and
where does the energy go?
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
answer = lw.absorb(chain, duration=6.0, release={"v:m1": 1.0})
print(answer)

# %%
# The envelope of the main mass, and the share of the energy that the sink has taken:

fig, (decay, energy) = plt.subplots(1, 2)
for run, label in ((answer.without, "without sink"), (answer.with_sinks, "with sink")):
    decay.semilogy(answer.time, 1e3 * run.envelope[:, 0], label=label)
decay.set(xlabel="time, s", ylabel="envelope of m1, mm", xlim=(0, 5), ylim=(0.03, None))
decay.legend()

shares = answer.with_sinks.shares
energy.stackplot(
    answer.time,
    100 * shares[:, 1],
    100 * shares[:, 0],
    100 * answer.with_sinks.remaining,
    colors=["C1", "C0", "0.85"],
)
energy.set(xlabel="time, s", ylabel="energy, %", ylim=(0, 100), xlim=(0, 5))
energy.text(3, 28, "taken by the sink", ha="center", color="white")
energy.text(3, 78, "taken by the spring", ha="center", color="white")
energy.text(0.15, 92, "left")
