"""
Tuning a sink
=============

How much of the energy does the sink dissipate, for each stiffness of its wells and each strength
of the blow?
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
answer = lw.absorption.absorption_map(
    chain,
    {"nes1.alpha": np.linspace(-200, -20, 32), "v:m1": np.linspace(0.1, 2.0, 32)},
    duration=3.0,
    rate=400.0,
)
print([quantity.name for quantity in answer.quantities])

# %%
# The sink takes most where a blow carries it across its barrier again and again. Softer ones leave
# it in one well, and where the wells are shallow (right) and the blow is soft it does little. The
# speckle is real: which well it ends in is chaotic.

fig, (share, reduction) = plt.subplots(1, 2, figsize=(7.6, 3.2))
lw.plot.map(answer, "sinks_share", ax=share)
lw.plot.map(answer, "rms_reduction", ax=reduction)
