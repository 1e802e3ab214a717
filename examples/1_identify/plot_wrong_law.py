"""
A wrong law leaves more than noise
==================================

A good-looking overlay does not support a law. The residuals do: they are noise if the law is
right, and follow the motion if it is not.
"""

import matplotlib.pyplot as plt

import linkwise as lw

rig = lw.parse_structure("""
name = "rubber mount"

[[mass]]
name = "camera"
mass = 0.35

[[link]]
name = "mount"
between = ["camera", "ground"]
law = "k1*d + k3*d**3 + c*v"
coefficients = { k1 = 900.0, k3 = 1e6, c = 0.35 }
""")
record = lw.simulate(rig, release={"x:camera": 0.01}, duration=4.0, rate=500.0)
record = record.with_noise(30.0, seed=1)

# %%
# One law with the cubic term, one without it:

cubic = rig.unknown("all")
linear = lw.parse_structure(
    lw.model.format_structure(cubic).replace(" + k3*d**3", "").replace('k3 = "unknown", ', "")
)
fits = {"linear": lw.identify(record, linear), "cubic": lw.identify(record, cubic)}
for name, fit in fits.items():
    print(f"{name}: {fit.message}")

# %%
# Both run freely from the state at the start of the record:

fig, axes = plt.subplots(2, 1, sharex=True, sharey=True)
for ax, (name, fit) in zip(axes, fits.items(), strict=True):
    left = lw.analysis.free_run(fit.structure, record, settling=100).residual
    ax.plot(left.time, 1e3 * left.channel("x:camera"), linewidth=0.6)
    ax.set(ylabel="left, mm", title=f"what the {name} law leaves")
axes[1].set_xlabel("time, s")
