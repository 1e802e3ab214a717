"""
From accelerometers alone
=========================

Displacements are seldom measured. The law of a link is also found from accelerations. They are
never integrated, since their noise would accumulate to a drift; the displacements are unknowns
of the fit.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0, sensors=["a"])
record = record.with_noise(30.0, seed=1)

fit = lw.identify(record, chain.unknown("nes"))
print(fit)

# %%
# The identified law, over elongations that were never measured:

fig, (seen, found) = plt.subplots(1, 2, figsize=(7.6, 3.4))
lw.plot.histories(record, ["a:m2"], ax=seen)
lw.plot.force(fit, "nes1", ax=found)
