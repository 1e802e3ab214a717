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
# The main mass with the sink and without it:

fig, ax = plt.subplots()
lw.plot.absorption(answer, ax=ax)

# %%
# Where the energy went, and how the sink crossed from well to well to take it:

fig, (energy, sink) = plt.subplots(1, 2, figsize=(7.6, 3.4))
lw.plot.energy(answer, ax=energy)
energy.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
lw.plot.crossings(answer, ax=sink)
