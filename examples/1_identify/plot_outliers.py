"""
Outliers
========

A laser that loses its target for single samples spoils a least-squares fit. Student's t
distribution expects outliers and gives them little weight.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
record = record.with_noise(30.0, seed=1)

# %%
# One sample in fifty is off by up to 30 mm:

rng = np.random.default_rng(1)
values = record.values.copy()
lost = rng.random(values.shape) < 0.02
values[lost] += rng.uniform(-0.03, 0.03, lost.sum())
spoiled = replace(record, values=values)

unknown = chain.unknown("nes")
fits = {
    "clean record": lw.identify(record, unknown),
    "outliers, Gaussian": lw.identify(spoiled, unknown),
    "outliers, Student's t": lw.identify(spoiled, unknown, loss=lw.likelihood.Student()),
}
for name, fit in fits.items():
    print(f"{name}: {fit.message}")

# %%
# The stiffness of the sink and its interval. The Gaussian fit is refused, since its residuals are not
# what the noise of the rest explains, and has none.

fig, ax = plt.subplots(figsize=(6.6, 2.2))
for place, fit in enumerate(fits.values()):
    alpha = fit.coefficient("nes1.alpha")
    error = 0.0 if alpha.standard_error is None else 1.96 * alpha.standard_error
    ax.errorbar(alpha.value, place, xerr=error, fmt="o", capsize=3)
ax.axvline(chain.coefficient("nes1.alpha").value, color="k", linewidth=0.8)
ax.set_yticks(range(len(fits)), fits)
ax.set(xlabel="alpha, N/m", ylim=(2.5, -0.5))
