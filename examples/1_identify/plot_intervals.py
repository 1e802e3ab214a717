"""
What a 95 % interval means
==========================

Forty tests of the same structure, each with its own noise: about two of the intervals should
miss the truth.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

rig = lw.parse_structure("""
name = "hardening spring"

[[mass]]
name = "m"
mass = 1.0

[[link]]
name = "spring"
between = ["m", "ground"]
law = "k1*d + k3*d**3 + c*v"
coefficients = { k1 = 400.0, k3 = 5e5, c = 0.5 }
""")
clean = lw.simulate(rig, release={"x:m": 0.03}, duration=2.0, rate=250.0)
fits = [lw.identify(clean.with_noise(20.0, seed=seed), rig.unknown("all")) for seed in range(40)]

# %%
# The intervals of the cubic coefficient, in order, with the truth as a line:

found = sorted((fit.coefficient("spring.k3") for fit in fits), key=lambda k3: k3.value)
truth = rig.coefficient("spring.k3").value
fig, ax = plt.subplots()
for place, k3 in enumerate(found):
    low, high = k3.interval
    missed = not low <= truth <= high
    ax.plot([place, place], [low / 1e3, high / 1e3], color="C1" if missed else "C0")
ax.axhline(truth / 1e3, color="k", linewidth=0.8)
ax.set(xlabel="tests, in order", ylabel="k3, kN/m$^3$", xticks=[])
missing = sum(not k3.interval[0] <= truth <= k3.interval[1] for k3 in found)
ax.set_title(f"{missing} of {len(found)} intervals miss the truth")

# %%
# Errors in units of their standard error have a standard deviation of one:

scores = np.array([(k3.value - truth) / k3.standard_error for k3 in found])
print(f"standard deviation of the scores: {scores.std():.2f}")
