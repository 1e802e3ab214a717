"""
Finding the links of a structure
================================

Only a record of four masses, and the masses themselves, are given: which of the ten possible
links exist, and which terms do they have?
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(4)
record = lw.simulate(chain, release={"v:m1": 3.0}, duration=2.0, rate=1000.0)
record = record.with_noise(30.0, seed=1)

masses = {mass.name: mass.mass.value for mass in chain.masses}
found = lw.discover(record, masses)
print(found)

# %%
# The structure that was found:

fig, ax = plt.subplots(figsize=(6.6, 4.0))
lw.plot.graph(found, ax=ax)

# %%
# What each term explains, and what those would that came nearest among the dropped ones:

fig, ax = plt.subplots(figsize=(6.6, 4.6))
lw.plot.evidence(found, ax=ax)
