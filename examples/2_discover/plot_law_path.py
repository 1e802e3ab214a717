"""
One term after the other
========================

Which terms does a link need? Start from a spring and a damper, add the term that explains most
of what is left, and stop where the criterion rises.
"""

import matplotlib.pyplot as plt

import linkwise as lw

rig = lw.parse_structure("""
name = "slider"

[[mass]]
name = "block"
mass = 0.3

[[link]]
name = "spring"
between = ["block", "ground"]
law = "k*d + k3*d**3 + F*tanh(v/0.01)"
coefficients = { k = 500.0, k3 = 1e5, F = 0.1 }
""")
record = lw.simulate(rig, release={"x:block": 0.03}, duration=3.0, rate=500.0)
record = record.with_noise(30.0, seed=1)

path = lw.law_path(
    record,
    rig,
    "spring",
    candidates=["d**2", "d**3", "v*abs(v)", "tanh(v/0.01)"],
    most=5,
)

# %%
# The part of the motion that each law leaves, and the Bayesian information criterion:

steps = range(len(path))
labels = [", ".join(path[0].terms), *(f"+ {step.terms[-1]}" for step in path[1:])]
best = min(steps, key=lambda number: path[number].bic)

fig, (left, criterion) = plt.subplots(1, 2)
left.semilogy(steps, [100 * step.left for step in path], "o-")
left.set(ylabel="left of the motion, %")
criterion.plot(steps, [step.bic for step in path], "o-")
criterion.plot(best, path[best].bic, "o", color="C1", markersize=9, label="smallest")
criterion.set(yscale="symlog", ylabel="BIC")
criterion.legend()
for ax in (left, criterion):
    ax.set_xticks(steps, labels, rotation=35, ha="right")
print(f"chosen: {', '.join(path[best].terms)}")
