"""
The force law of a bistable link
================================

Two noisy displacement sensors, one record, and the force law of the link between the two masses
with its 95 % band.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0)
record = record.with_noise(10.0, seed=1)

# %%
# Everything but the sink's coefficients is known:

fit = lw.identify(record, chain.unknown("nes"))
print(fit)

# %%
# The whole range that the record visited, and the piece between the wells. The noise is a third of
# the motion, yet the band is hardly wider than the line.

fig, (whole, near) = plt.subplots(1, 2, figsize=(7.6, 3.4))
lw.plot.force(fit, "nes1", ax=whole)
lw.plot.force(fit, "nes1", near_wells=True, legend=False, ax=near)
near.set_title("near the wells")
